"""Marks of a survey in the frame and epoch of its system."""

import math
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from photocal.base.errors import InputMalformedError, reading
from photocal.geometry.realizations import FrameShift, Realization, known_realization, realization
from photocal.navigation.base_frame import BaseFrame, decimal_year
from photocal.navigation.baseline_network import GroundMark
from photocal.navigation.time import GpsTime


@dataclass(frozen=True)
class MovedMark:
    """Frame and epoch of a mark's coordinates, and those to which they were transformed.

    moved: None where they stay: nobody tells a frame, or nothing known leads to that of the survey.
    """

    mark: str
    source: Realization
    target: Realization
    moved: FrameShift | None

    def as_json(self) -> dict[str, object]:
        """Figures for JSON."""
        plain = {"from": str(self.source), "to": str(self.target)}
        return {"mark": self.mark, **(plain if self.moved is None else self.moved.as_json())}


def frame_told(mark: str, text: str, epoch: float = math.nan) -> Realization | None:
    """Frame of a known mark as a person tells it; None for none.

    epoch: of its coordinates where the text has none, years.

    raises ConfigurationError: for one that is not known; InputMalformedError: for one whose epoch is missing.
    """
    told = realization(text) if text else None
    if told is not None and told.moves and np.isnan(told.epoch):
        told = known_realization(told.frame, epoch) or told
    if told is not None and told.moves and np.isnan(told.epoch):
        raise InputMalformedError(
            f"mark {mark}: coordinates in {told.frame} change with time and need an epoch",
            f'write frame = "{told.frame}@2026.9" with the epoch in years',
        )
    return told


def frame_of_orbits(products: tuple[Path, ...]) -> Realization | None:
    """Frame of the first file of precise orbits (SP3) among products; None where none tells."""
    for path in products:
        with reading(path), path.open(encoding="latin-1") as stream:
            line = stream.readline()
        if line[:1] == "#" and line[1:2] in "abcd" and line[46:51].strip():
            return known_realization(line[46:51].strip())
    return None


def in_system(
    mark: GroundMark, source: Realization | None, crs: str | None, time: GpsTime | None = None
) -> tuple[GroundMark, MovedMark | None]:
    """Transform a mark to the frame of a system, with the uncertainty of the transformation.

    time: of the observations, at whose epoch a precise position counts.
    returns: the mark, and what was done; None where nothing is to be done.
    """
    if source is None or crs is None:
        return mark, None
    # A known mark has its epoch with it.
    known = BaseFrame.of(mark.xyz_m, source, crs, source.epoch if time is None else decimal_year(time))
    if known.target is None or known.source is None or known.source == known.target:
        return mark, None
    done = MovedMark(mark.name, known.source, known.target, known.moved)
    if known.moved is None:
        return mark, done
    spread = mark.covariance_m2 + known.moved.sigma_m**2 * np.eye(3)
    return replace(mark, xyz_m=mark.xyz_m + known.moved.shift_m, covariance_m2=spread), done
