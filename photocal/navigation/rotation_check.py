"""Rotations between neighbouring images against recorded attitudes: images stored turned, other attitudes."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from drivers.arrays import Floats
from photocal.findings.finding import Finding, untested
from photocal.navigation.exposures import Exposures
from photocal.navigation.trajectory import enu_offsets

CODE = "image-rotations"
# Attitudes of small vehicles are good to a few degrees.
ROUGH_DEG = 5.0


@dataclass(frozen=True)
class PairRotation:
    """Two neighbouring images.

    first, second: rows of the exposures.
    points: matched points; 0 where an adjustment gave the rotations.
    quarter_turns: turns by 90 degrees in the image plane by which the second image is stored otherwise than
        recorded, relative to the first.
    angle_deg: angle between both relative rotations beside those turns.
    along: cosine between the direction to the second image by the points and by the recorded orientation and
        positions, both in the axes of the first; NaN without positions.
    """

    first: int
    second: int
    points: int
    quarter_turns: int
    angle_deg: float
    along: float


def least_turn(measured: Floats, recorded: Floats) -> tuple[int, float]:
    """Return the quarter turns in the image plane that bring two relative rotations closest, and the rest."""
    quarters = Rotation.from_rotvec([[0, 0, np.pi / 2 * turns] for turns in range(4)])
    angles = np.degrees((quarters * Rotation.from_matrix(measured @ recorded.T)).magnitude())
    turns = int(np.argmin(angles))
    return turns, float(angles[turns])


def places_of(exposures: Exposures) -> Floats:
    """Return positions east, north, up about their middle, m (n, 3); NaN where unknown."""
    p = exposures.placed
    known = p.placed
    if not known.any():
        return np.full((len(exposures), 3), np.nan)
    origin = np.array([np.mean(c[known]) for c in (p.lat_deg, p.lon_deg, p.height_m)])
    return enu_offsets(p.lat_deg, p.lon_deg, p.height_m, origin)


def stored_turns(pairs: list[PairRotation]) -> dict[int, int]:
    """Tell which exposures' images are stored turned against their attitude, in quarter turns.

    Turns between neighbours leave one turn common to all open: the images whose direction to the next one
    agrees with the recorded positions decide it; without positions most images are taken to be right.
    """
    turns: dict[int, int] = {}
    group: dict[int, int] = {}
    for number, pair in enumerate(pairs):
        if pair.first not in turns:
            turns[pair.first], group[pair.first] = 0, number
        turns[pair.second] = (turns[pair.first] + pair.quarter_turns) % 4
        group[pair.second] = group[pair.first]
    for own in set(group.values()):
        members = [row for row in turns if group[row] == own]
        votes = np.zeros(4)
        for pair in pairs:
            if group[pair.first] == own and np.isfinite(pair.along):
                # Pictures stored upside down see their follower behind them.
                votes[(turns[pair.first] + (0 if pair.along > 0 else 2)) % 4] += abs(pair.along)
        if not votes.any():
            votes = np.bincount([turns[row] for row in members], minlength=4).astype(float)
        upright = int(np.argmax(votes))
        for row in members:
            turns[row] = (turns[row] - upright) % 4
    return {row: turn for row, turn in turns.items() if turn}


def rotation_check(exposures: Exposures, pairs: list[PairRotation], source: str) -> Finding:
    """Return what the comparison shows as a check."""
    if not pairs:
        return untested(CODE, "no-neighbours", {"source": source})
    angles = np.array([pair.angle_deg for pair in pairs])
    turned = stored_turns(pairs)
    # Over a turn of the vehicle attitudes lag behind: pairs within a strip are told apart from those across.
    within = np.array([pair.quarter_turns == 0 for pair in pairs])
    figures: dict[str, Any] = {
        "source": source,
        "n": len(pairs),
        "pairs": [
            {
                "first": exposures.image[pair.first],
                "second": exposures.image[pair.second],
                "points": pair.points,
                "angle_deg": pair.angle_deg,
                "quarter_turns": pair.quarter_turns,
            }
            for pair in pairs
        ],
        "median_deg": float(np.median(angles)),
        "median_same_way_deg": float(np.median(angles[within])) if within.any() else None,
        "stored_turned": [
            {"image": exposures.image[row], "degrees": 90 * turn} for row, turn in sorted(turned.items())
        ],
    }
    clauses = ("within",) if within.any() and not within.all() else ()
    figures["within"] = int(within.sum())
    if turned:
        rows = sorted(turned)
        figures["images"] = tuple(exposures.image[row] for row in rows)
        figures["first"], figures["last"] = figures["images"][0], figures["images"][-1]
        strip = len(rows) > 2 and rows[-1] - rows[0] == len(rows) - 1
        stored = "strip-turned" if strip else "stored-turned"
        figures["turns_deg"] = tuple(sorted({str(90 * turn) for turn in turned.values()}))
        return Finding(CODE, "grave", figures=figures, clauses=(stored, "pairs-differ", *clauses))
    if figures["median_deg"] > ROUGH_DEG:
        return Finding(CODE, "grave", figures=figures, clauses=("other-images", "pairs-differ", *clauses))
    return Finding(CODE, "passed", figures=figures, clauses=clauses)
