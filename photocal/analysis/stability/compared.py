"""Cameras compared pair by pair, as figures and as text."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np

from photocal.analysis.stability.camera_file import CameraFile
from photocal.analysis.stability.comparison import (
    CalibrationPair,
    ComparisonFigure,
    Followed,
    compare,
    follow,
    likeness,
    sentences,
)
from photocal.analysis.stability.joint import JointComparison, joint_comparison, joint_text
from photocal.analysis.stability.methods import methods, sensor_grid
from photocal.base.arrays import as_plain
from photocal.base.policy import policy

SCHEMA = "photocal.comparison/1"


@dataclass(frozen=True)
class Compared:
    """Every pair of some calibrations, compared by all methods.

    Attributes
    ----------
    asked
        The calibrations, and how they are compared.
    points
        Number of places of the format at which they are.
    pairs
        Misclosure, zero rotation, rotation and single photo resection of each pair, px.
    followed
        Published figures, and whether these follow them.
    joint
        Every pair, and all, tested for equality of their parameters as vectors.
    """

    asked: CameraFile
    points: int
    pairs: tuple[CalibrationPair, ...]
    followed: tuple[Followed, ...]
    joint: JointComparison

    def figures(self) -> dict[str, Any]:
        """Give all figures as a JSON value."""
        made = _figures(self.asked, self.points, self.pairs, self.followed)
        return made | {"joint": as_plain(self.joint)}

    def __str__(self) -> str:
        """Say it for people: a matrix for each method, then what differs."""
        level = 1.0 - policy.confidence
        told = (_text(self.asked, self.pairs, self.followed), joint_text(self.joint, level))
        return "\n\n".join(filter(None, told))


def compare_cameras(asked: CameraFile, done: Callable[[], None] = lambda: None) -> Compared:
    """Compare every pair of calibrations.

    Parameters
    ----------
    asked
        Calibrations, and grid, terrains and seed of the comparison.
    done
        Called after each pair.

    Returns
    -------
    Compared
        All pairs, and what differs beyond the noise of both.

    Raises
    ------
    ConfigurationError
        When the calibrations are of formats that cannot be compared.
    """
    how = asked.comparison
    pixels = sensor_grid(asked.calibrations[0].size_px, how.grid_step_px)
    chosen = methods(len(pixels), how.terrain, how.terrains_each, how.seed)
    pairs = compare(asked.calibrations, pixels, chosen, np.random.default_rng(how.seed), done=done)
    joint = joint_comparison(asked.calibrations, pixels)
    return Compared(asked, len(pixels), pairs, follow(asked.published, pairs), joint)


def _figures(
    asked: CameraFile, points: int, pairs: tuple[CalibrationPair, ...], followed: tuple[Followed, ...]
) -> dict[str, Any]:
    how = asked.comparison
    return {
        "schema": SCHEMA,
        "cameras": [calibration.id for calibration in asked.calibrations],
        "grid": {"points": points, "step_px": how.grid_step_px},
        "thresholds_px": how.thresholds_px,
        "terrains": [terrain.model_dump() for terrain in how.terrain],
        "terrains_each": how.terrains_each,
        "seed": how.seed,
        "pairs": [
            {
                "first": pair.first,
                "second": pair.second,
                "figures": [
                    as_plain(figure)
                    | {"different": figure.different, "within_px": likeness(figure, how.thresholds_px)}
                    for figure in pair.figures
                ],
            }
            for pair in pairs
        ],
        "published": [as_plain(row) | {"follows": row.follows} for row in followed],
        "findings": list(sentences(pairs, how.thresholds_px, followed)),
    }


def _text(asked: CameraFile, pairs: tuple[CalibrationPair, ...], followed: tuple[Followed, ...]) -> str:
    names = tuple(calibration.id for calibration in asked.calibrations)
    blocks = [_matrix(pairs, names, k) for k in range(len(pairs[0].figures))]
    if any(figure.sigma_px is not None for pair in pairs for figure in pair.figures):
        blocks.append("value +- its standard deviation, px; * differs beyond the noise of both (95 %)")
    return "\n\n".join([*blocks, "\n".join(sentences(pairs, asked.comparison.thresholds_px, followed))])


def _matrix(pairs: tuple[CalibrationPair, ...], names: tuple[str, ...], which: int) -> str:
    from photocal.findings.document import Section, table, text

    cells = {(pair.first, pair.second): _cell(pair.figures[which]) for pair in pairs}
    kind = pairs[0].figures[which]
    rows = [(second, *(cells.get((first, second), "") for first in names[:-1])) for second in names[1:]]
    return text([Section("", (table(f"{kind.method}, {kind.definition}, px", ["", *names[:-1]], rows),))])


def _cell(figure: ComparisonFigure) -> str:
    if figure.sigma_px is None:
        return f"{figure.value_px:.2f} "
    return f"{figure.value_px:.2f}+-{figure.sigma_px:.2f}{'*' if figure.different else ' '}"
