"""The measured centre of a target: a place to a fraction of a pixel with its own covariance."""

from dataclasses import dataclass, field
from typing import Literal

import numpy as np

from photocal.base.arrays import Flags, Floats
from photocal.geometry.camera import Camera, pixel_to_plane
from photocal.geometry.distortion import undistorted
from photocal.measurement.image_file import Grey, as_eight_bit
from photocal.measurement.target_patterns import BAR, FLAT, HOLE, flattened
from photocal.measurement.template_fit import Fit, Window, odd_variance

# A target that was found has at least this contrast, grey values.
LEAST_CONTRAST = 20.0

# Far enough for digits, near enough for the third order not to matter.
_STEP_PX = 8.0
_AROUND = _STEP_PX * np.array([[0, 0], [1, 0], [-1, 0], [0, 1], [0, -1], [1, 1], [-1, -1], [1, -1], [-1, 1]])
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
class Centre:
    """A measured centre.

    column, row: px; the centre of the upper-left pixel is (0, 0).
    covariance (2, 2): px squared.
    contrast, noise: grey values.
    shape (k,): further parameters of the target, as in `patterns`; the blur stands last.
    """

    column: float
    row: float
    covariance: Floats
    contrast: float
    noise: float
    shape: Floats

    @property
    def sigma(self) -> tuple[float, float]:
        """Standard deviations of column and row, px."""
        return float(np.sqrt(self.covariance[0, 0])), float(np.sqrt(self.covariance[1, 1]))


def measurable(grey: Grey) -> Grey:
    """Grey values in whole steps, as the templates take them for granted."""
    return as_eight_bit(grey) if grey.dtype == np.float32 else grey


def half_contrast(window: Window) -> float:
    """Half of the range of the grey values in a window, outliers apart; 1 at least."""
    low, high = np.quantile(window.grey, [0.05, 0.95])
    return max(float(high - low) / 2, 1.0)


def accepted(
    window: Window,
    fit: Fit,
    contrast: float,
    approximate: tuple[float, float],
    farthest: float,
    shape: Floats,
) -> Centre | None:
    """Make a centre of a fitted template, unless it is too faint, unsure or far from where it was expected.

    approximate: column and row where it was expected, px.
    farthest: how far from there it may be, px.
    shape (k,): as in `Centre`.
    """
    place = fit.parameters[:2]
    column, row = (float(p + m) for p, m in zip(place, window.middle, strict=True))
    moved = np.hypot(column - approximate[0], row - approximate[1])
    # A contrast below this multiple of the noise is no target.
    weakest_contrast = 3.0
    if not moved <= farthest or contrast < weakest_contrast * fit.noise:
        return None
    # Targets are drawn on paper; a centre that claims more than this trusts the model too much.
    finest_px = 0.003
    covariance = odd_variance(window, fit, place) * fit.cofactor[:2, :2] + finest_px**2 * np.eye(2)
    if not max(covariance[0, 0], covariance[1, 1]) <= 1:
        return None
    return Centre(column, row, covariance, contrast, fit.noise, shape.copy())


def ground_bend(camera: Camera, rotation: Floats, pixel: Floats) -> Floats:
    """Bend of level ground about a place: what takes a target's middle out of that of its picture."""
    # The centre of the ellipse that shows a circle is not where the circle's centre is seen: perspective and
    # distortion move it by a part of the target's size squared. To the second order an offset d in the image
    # belongs to the offset A^-1 (d + b(d, d)) on the ground, with A the affine part and b the bend. A picture
    # that is drawn with this bend has its centre where the target has its own (for perspective alone this is
    # the correction of Ahn, Warnecke and Kotowski 1999, up to the third order).
    ideal = undistorted(camera, pixel_to_plane(camera.size_px, camera.pitch, pixel + _AROUND))
    ray = np.column_stack([ideal, np.full(len(ideal), -camera.value("c"))]) @ rotation
    ground = ray[:, :2] / ray[:, 2:]
    by_pixel = np.column_stack([ground[1] - ground[2], ground[3] - ground[4]]) / (2 * _STEP_PX)
    second = np.empty((2, 2, 2))
    second[:, 0, 0], second[:, 1, 1] = (ground[k] - 2 * ground[0] + ground[k + 1] for k in (1, 3))
    second[:, 0, 1] = second[:, 1, 0] = (ground[5] + ground[6] - ground[7] - ground[8]) / 4
    return np.asarray(np.tensordot(np.linalg.inv(by_pixel), second, 1) / (2 * _STEP_PX**2))


@dataclass(frozen=True)
class TargetImage:
    """A target as an image should show it.

    affine (2, 2): from the target's plane, in half sides, to px.
    part: as in `PARTS`.
    bend (2, 2, 2): of the ground: see `target_centre.ground_bend`.
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

    def smaller(self, factor: float) -> "TargetImage":
        """Give the look in an image that is reduced by a factor."""
        return TargetImage(self.kind, self.affine / factor, self.part, self.bend * factor)

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
            """Return the share of light at distances (px) within a blurred edge."""
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
