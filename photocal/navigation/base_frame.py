"""Frame and epoch of a base beside those of the control: the shift between them, and its application."""

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any, Self

import numpy as np

from photocal.base.arrays import Floats, picked
from photocal.findings.finding import Finding
from photocal.geometry.realizations import FIXED, FrameShift, Realization, frame_shift, known_realization
from photocal.navigation.time import GpsTime

# The newest frame of the world: what precise orbits, and casters that state none, mostly refer to.
_OF_TODAY = "ITRF2020"


@dataclass(frozen=True)
class BaseFrame:
    """What is known of the frames.

    source: of the base's position; None where it is not stated.
    target: of the control; None without a control system, or where its realization is not known.
    shift: from one to the other; where `source` is not stated, from the frame of the world on that day.
    """

    source: Realization | None = None
    target: Realization | None = None
    shift: FrameShift | None = None

    @classmethod
    def of(cls, base_m: Floats, source: Realization | None, crs: str | None, today: float | None) -> Self:
        """Compare the frame of a base with that of the control.

        base_m (3,): earth-centred.
        today: epoch of the observations, years: that of a moving frame that is stated without one.
        """
        target = None if crs in (None, "local") else known_realization(crs or "")
        if source is not None and source.moves and source.epoch is None:
            source = Realization(source.frame, today)
        if target is None:
            return cls(source, None, None)
        if target.moves and target.epoch is None:
            target = Realization(target.frame, today)
        told = source or Realization(_OF_TODAY, today)
        return cls(source, target, frame_shift(base_m, told, target))

    @property
    def moved(self) -> FrameShift | None:
        """The shift that is applied; None where the base stays."""
        return self.shift if self.source is not None else None

    def as_json(self) -> dict[str, Any]:
        """Both frames, and the shift between them where it is known."""
        plain = {"from": str(self.source), "to": str(self.target)}
        return plain if self.moved is None else self.moved.as_json()

    def findings(self) -> Iterator[Finding]:
        """Say what a person should know of it."""
        source, target, shift = self.source, self.target, self.shift
        # Less between two frames is no matter beside a base's own coordinates.
        matters_m = 0.02
        if target is None or (shift is not None and shift.size_m < matters_m):
            return
        if shift is None:
            if source is not None and source != target:
                yield Finding("base-other-frame", "doubtful", figures=_named(source, target))
            return
        along = dict(zip(("east_m", "north_m", "up_m"), shift.shift_enu_m.tolist(), strict=True))
        figures = _named(shift.source, target) | along | picked(shift, "size_m", "sigma_m", "way")
        if source is not None:
            yield Finding("base-moved", "note", figures=figures)
        elif target.frame in FIXED:
            yield Finding("base-frame-untold", "note", figures=figures)


def _named(source: Realization, target: Realization) -> dict[str, str | float]:
    return {"source": str(source), "target": str(target)}


def decimal_year(time: GpsTime) -> float:
    """Epoch of the middle of some times, years; the days of GPS and UTC are one here."""
    middle = time.ns[[0, -1]].mean()
    day = np.datetime64("1980-01-06", "s") + np.timedelta64(int(middle // 1e9), "s")
    year = day.astype("datetime64[Y]")
    length = (year + 1).astype("datetime64[s]") - year.astype("datetime64[s]")
    part = (day - year.astype("datetime64[s]")) / length
    return 1970 + int(year.astype(np.int64)) + round(float(part), 4)
