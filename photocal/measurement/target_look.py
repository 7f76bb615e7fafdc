"""How an uncoded target should look in an image: its picture about its middle."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Literal

import numpy as np

from drivers.arrays import Flags, Floats
from photocal.measurement.patterns import FLAT, flattened
from photocal.measurement.target_shapes import BAR, HOLE

Kind = Literal["disc", "ring", "cross", "hourglass"]

# Targets that are smaller are not told from specks: side in px where it is seen shortest.
SMALLEST_PX = {"disc": 8.0, "ring": 8.0, "cross": 12.0, "hourglass": 12.0}
# Width of a cross's bars, diameter of a ring's hole, as parts of the side.
PARTS = {"disc": 1.0, "ring": HOLE, "cross": BAR, "hourglass": 1.0}
_BLUR_PX = 0.7
# Ground that is looked at around a target, as a part of its half side, and at least, px.
_BESIDE, _BESIDE_PX = 0.15, 1.5
_STEP = np.pi / 12
# How many steps until a target looks the same again.
_TURNS = {"disc": 1, "ring": 1, "cross": 6, "hourglass": 12}


@dataclass(frozen=True)
class Look:
    """A target as an image should show it.

    affine (2, 2): from the target's plane, in half sides, to px.
    part: as in `PARTS`.
    bend (2, 2, 2): of the ground: see `eccentricity.ground_bend`.
    """

    kind: Kind
    affine: Floats
    part: float
    bend: Floats = field(default_factory=FLAT.copy)

    @property
    def semi_axes(self) -> tuple[float, float]:
        """Half of the longest and of the shortest side seen, px."""
        longest, shortest = np.linalg.svd(self.affine, compute_uv=False)
        return float(longest), float(shortest)

    @property
    def direction(self) -> float:
        """Where the longest side points, from columns to rows, radians."""
        axes = np.linalg.svd(self.affine)[0]
        return float(np.arctan2(axes[1, 0], axes[0, 0]))

    @property
    def size(self) -> float:
        """Side of a square of the same area, px."""
        return 2 * float(np.sqrt(abs(np.linalg.det(self.affine))))

    @property
    def large_enough(self) -> bool:
        """Whether it can be told from a speck."""
        return 2 * self.semi_axes[1] >= SMALLEST_PX[self.kind]

    @property
    def reach(self) -> tuple[int, int]:
        """Columns and rows to either side of the middle that `picture` covers."""
        half = np.hypot(*self.affine.T)
        columns, rows = np.ceil(half + np.maximum(_BESIDE * half, _BESIDE_PX))
        return int(columns), int(rows)

    @property
    def turns(self) -> Floats:
        """Directions in which the target may lie that look different."""
        return np.asarray(_STEP * np.arange(_TURNS[self.kind]), dtype=np.float64)

    @property
    def margin(self) -> float:
        """Even ground around it that may be used, px."""
        return max(_BESIDE_PX, _BESIDE * 1.8 * self.semi_axes[1])

    def smaller(self, factor: float) -> Look:
        """Give the look in an image that is reduced by a factor."""
        return Look(self.kind, self.affine / factor, self.part, self.bend * factor)

    def in_plane(self, direction: float) -> float:
        """Turn in the target's plane of a direction in the image, radians."""
        x, y = np.linalg.solve(self.affine, [np.cos(direction), np.sin(direction)])
        return float(np.arctan2(y, x))

    def picture(
        self, turn: float, aside: tuple[float, float] = (0.0, 0.0), blur_px: float = _BLUR_PX
    ) -> Floats:
        """Draw the target: 1 inside, 0 outside, about the middle of the array."""
        from scipy.special import erf

        a, b = self._plane(aside)
        u, v = a * np.cos(turn) + b * np.sin(turn), b * np.cos(turn) - a * np.sin(turn)
        sharp = self.semi_axes[1] / (np.sqrt(2) * blur_px)

        def inside(distance: Floats) -> Floats:
            return np.asarray(0.5 * (1 + erf(distance * sharp)))

        if self.kind == "hourglass":
            # Two triangles that meet with a point; their sides are the diagonals of the square.
            sides = erf((v - u) * sharp / np.sqrt(2)) * erf((v + u) * sharp / np.sqrt(2))
            return np.asarray(0.5 * (1 + sides) * inside(1 - abs(v)))
        if self.kind == "cross":
            long_u, long_v, wide_u, wide_v = (
                inside(d) for d in (1 - abs(u), 1 - abs(v), self.part - abs(u), self.part - abs(v))
            )
            return long_u * wide_v + wide_u * long_v - wide_u * wide_v
        away = np.hypot(u, v)
        hole = inside(self.part - away) if self.kind == "ring" else 0.0
        return np.asarray(inside(1 - away) - hole)

    def covered(self, aside: tuple[float, float]) -> Flags:
        """Which pixels of `picture` show the target or its margin."""
        return np.asarray(np.hypot(*self._plane(aside)) <= 1 + self.margin / self.semi_axes[1])

    def _plane(self, aside: tuple[float, float]) -> Floats:
        """Coordinates in the target's plane, half sides, of the pixels of `picture`; shape (2, h, w)."""
        columns, rows = self.reach
        y, x = np.mgrid[-rows : rows + 1, -columns : columns + 1].astype(float)
        flat = np.stack(flattened(x - aside[0], y - aside[1], self.bend))
        return np.asarray(np.tensordot(np.linalg.inv(self.affine), flat, 1))
