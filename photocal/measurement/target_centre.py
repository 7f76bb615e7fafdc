"""The measured centre of a target: a place to a fraction of a pixel with its own covariance.

Pictures of targets: ideal edges blurred by a Gaussian, as functions of their parameters.

Each takes its parameters and columns and rows, and gives grey values; place in px, angles in radians. A
straight edge blurred by a Gaussian of standard deviation s is erf(d / (s sqrt 2)), d the distance from it.

Least squares template matching: a parametric picture of a target is fitted to the grey values.

The picture is an ideal edge pattern blurred by a Gaussian, in light that may change evenly across it, so its
parameters, the centre among them, come with their covariance from the noise that remains. After Foerstner and
Wrobel 2016, section 13.5 (LS matching with a model in place of the second image).
"""

from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Literal

import numpy as np
from scipy.special import erf

from photocal.base.arrays import Columns, Flags, Floats
from photocal.geometry.camera import Camera, pixel_to_plane
from photocal.geometry.distortion import undistorted
from photocal.measurement.image_file import Grey, as_eight_bit

# Grey values at columns and rows, relative to the middle of the window, for a vector of parameters; for
# several of them, (k, m, 1), in rows, (m, n).
Template = Callable[[Floats, Floats, Floats], Floats]
# Derivatives of a template with respect to its parameters, (n, k).
Slopes = Callable[[Floats, Floats, Floats], Floats]


@dataclass(frozen=True)
class Window(Columns):
    """Grey values around a place.

    middle: column and row of the pixel to which coordinates are relative.
    x, y (n,): column and row relative to `middle`, px.
    grey (n,).
    """

    middle: tuple[int, int]
    x: Floats
    y: Floats
    grey: Floats


@dataclass(frozen=True)
class Fit:
    """A fitted template.

    parameters (k,): place relative to the middle of the window.
    cofactor (k, k): their covariance for grey values of variance 1.
    noise: standard deviation of a grey value about the template.
    residual (n,): grey values less the template.
    basis (n, m): orthonormal columns that span what the parameters can explain.
    """

    parameters: Floats
    cofactor: Floats
    noise: float
    residual: Floats
    basis: Floats


def cut_window(grey: Grey, centre: tuple[float, float], radius: float) -> Window | None:
    """Cut a round window out of an image; None where it leaves the image."""
    if not (np.isfinite(centre[0]) and np.isfinite(centre[1])):
        return None
    column, row, reach = round(centre[0]), round(centre[1]), int(np.ceil(radius))
    height, width = grey.shape
    if column - reach < 0 or row - reach < 0 or column + reach >= width or row + reach >= height:
        return None
    return cut_part(grey, centre, radius)


def cut_part(grey: Grey, centre: tuple[float, float], radius: float) -> Window:
    """Cut what lies in the image of a round window; the centre lies in it."""
    column, row, reach = round(centre[0]), round(centre[1]), int(np.ceil(radius))
    height, width = grey.shape
    left, right = max(column - reach, 0), min(column + reach + 1, width)
    top, bottom = max(row - reach, 0), min(row + reach + 1, height)
    part = grey[top:bottom, left:right]
    y, x = np.mgrid[top - row : bottom - row, left - column : right - column].astype(float)
    inside = np.hypot(x - (centre[0] - column), y - (centre[1] - row)) <= radius
    return Window((column, row), x[inside], y[inside], part[inside].astype(float))


def fit_template(
    window: Window, template: Template, start: Floats, sizes: Floats, partial: Slopes | None = None
) -> Fit | None:
    """Fit a template in light that changes evenly (Levenberg-Marquardt).

    partial: derivatives of the template; they are differences where it is not given.
    """
    across = np.column_stack([window.x, window.y])

    def lit(p: Floats) -> Floats:
        """Return the template under uneven light."""
        return np.asarray(template(p[:-2], window.x, window.y) * (1 + across @ p[-2:]))

    # Light changes by parts of itself per px: typical size. Without it a shadow would push the centre aside.
    uneven = 0.005

    def slopes(p: Floats) -> Floats:
        """Return the derivatives of `lit` with respect to its parameters."""
        if partial is None:
            partials = _differences(window, template, p[:-2], sizes[:-2])
        else:
            partials = partial(p[:-2], window.x, window.y) * sizes[:-2]
        light = 1 + across @ p[-2:]
        even = template(p[:-2], window.x, window.y)
        return np.column_stack([partials * light[:, None], even[:, None] * across * uneven])

    count = len(start)
    parameters, sizes = np.r_[start.astype(float), 0, 0], np.r_[sizes, uneven, uneven]
    residual = window.grey - lit(parameters)
    lowest, damping = float(residual @ residual), 1e-3
    if len(window.grey) <= count + 6 or not np.isfinite(lowest):
        return None
    jacobian = slopes(parameters)
    settled = False
    # What is a target settles in about ten.
    iterations = 25
    # Settled: the next step would change the squares of the residuals by this part of their variance, so
    # that it is a tenth of the standard deviation of any parameter.
    settled_part = 1e-2
    for _ in range(iterations):
        normal, right = jacobian.T @ jacobian, jacobian.T @ residual
        scaled = normal + damping * np.diag(np.diag(normal) + 1e-12 * np.trace(normal))
        try:
            step = np.linalg.solve(scaled, right)
        except np.linalg.LinAlgError:
            return None
        trial = parameters + step * sizes
        left = window.grey - lit(trial)
        squares = float(left @ left)
        settled = float(step @ right) < settled_part * lowest / len(residual)
        if squares <= lowest:
            parameters, residual, lowest = trial, left, squares
            if settled:
                break
            jacobian = slopes(parameters)
            damping = max(damping / 8, 1e-9)
        elif settled or damping > 1e6:
            break
        else:
            damping *= 8
    if not settled:
        return None
    return _judged(parameters[:count], jacobian, residual, sizes)


def odd_variance(window: Window, fit: Fit, middle: Floats) -> float:
    """Variance of the grey values that can move the centre of a target."""
    # Targets look the same when turned by half a turn, so what is left of the grey values and looks the same,
    # too, such as a plate's edge all around or corners that are rounder than drawn, does not move their
    # centre: only the odd part does, grey values less those across the centre.
    x, y = window.x.astype(np.int64), window.y.astype(np.int64)
    # To half a pixel: noise does not mind, and other remains are smooth.
    u, v = np.round(2 * middle).astype(np.int64)
    low = min(x.min(), y.min())
    side = max(x.max(), y.max()) - low + 1
    number = np.full((side, side), -1)
    number[y - low, x - low] = np.arange(len(x))
    across_x, across_y = u - x - low, v - y - low
    inside = (across_x >= 0) & (across_x < side) & (across_y >= 0) & (across_y < side)
    pixel = np.flatnonzero(inside)
    opposite = number[across_y[pixel], across_x[pixel]]
    pixel, opposite = pixel[opposite >= 0], opposite[opposite >= 0]
    squares = float(np.sum((fit.residual[pixel] - fit.residual[opposite]) ** 2)) / 4
    taken = np.einsum("ik,ik->i", fit.basis[pixel], fit.basis[pixel] - fit.basis[opposite])
    free = float(np.sum((pixel != opposite) - taken)) / 2
    # A variance of fewer differences than this says nothing.
    fewest_free = 5
    # Grey values are whole numbers: rounding alone leaves 1/12.
    return max(squares / free, 1 / 12) if free >= fewest_free else np.inf


def _judged(parameters: Floats, jacobian: Floats, residual: Floats, sizes: Floats) -> Fit | None:
    variance = max(float(residual @ residual) / (len(residual) - len(sizes)), 1 / 12)
    try:
        inverse = np.linalg.inv(jacobian.T @ jacobian)
        root = np.linalg.cholesky(inverse)
    except np.linalg.LinAlgError:
        return None
    cofactor = (inverse * np.outer(sizes, sizes))[: len(parameters), : len(parameters)]
    if not np.isfinite(cofactor).all() or (np.diag(cofactor) < 0).any():
        return None
    return Fit(parameters, cofactor, float(np.sqrt(variance)), residual, jacobian @ root)


def _differences(window: Window, template: Template, parameters: Floats, sizes: Floats) -> Floats:
    steps = 1e-3 * np.diag(sizes)
    # All at once: a column of values for each parameter, against the row of pixels.
    moved = np.concatenate([parameters + steps, parameters - steps]).T[:, :, None]
    ahead, behind = np.split(template(moved, window.x, window.y), 2)
    return np.asarray((ahead - behind).T / 2e-3)


# Of a plane parallel to an image without distortion: see `target_centre.ground_bend`.
FLAT = np.zeros((2, 2, 2))
# The bars of a cross are a fifth as wide as long, a ring's hole is half as wide.
BAR, HOLE = 1 / 5, 1 / 2
# An edge without blur has no slope to fit.
FINEST_BLUR_PX = 0.15


def saddle(p: Floats, x: Floats, y: Floats) -> Floats:
    """Corner of four fields in a chessboard, or an hourglass."""
    return np.asarray(p[5] + p[6] * _edge(_beside(p, p[2], x, y), p[4]) * _edge(_beside(p, p[3], x, y), p[4]))


def cross(p: Floats, x: Floats, y: Floats, bend: Floats = FLAT) -> Floats:
    """Two bars that cross, in perspective.

    x, y (n,).
    bend (2, 2, 2): of the ground, from `target_centre.ground_bend`.
    returns (n,).
    """
    dx, dy = flattened(x - p[0], y - p[1], bend)
    first, second = (_bar(dy * np.cos(a) - dx * np.sin(a), p[4], p[5]) for a in (p[2], p[3]))
    return np.asarray(p[6] + p[7] * (first + second - first * second))


def disc(p: Floats, x: Floats, y: Floats, bend: Floats = FLAT) -> Floats:
    """Filled circle in perspective."""
    return np.asarray(p[6] + p[7] * 0.5 * (1 + _edge(inside_circle(p[:5], x, y, bend), p[5])))


def ring(p: Floats, x: Floats, y: Floats, bend: Floats = FLAT) -> Floats:
    """Ring between two concentric circles, in perspective."""
    hole = np.r_[p[:2], p[2:5] * p[5]]
    outer, inner = (_edge(inside_circle(circle, x, y, bend), p[6]) for circle in (p[:5], hole))
    return np.asarray(p[7] + p[8] * 0.5 * (outer - inner))


def inside_circle(p: Floats, x: Floats, y: Floats, bend: Floats = FLAT) -> Floats:
    """Distance from a circle in perspective to first order, positive inside (Sampson 1982)."""
    xx, xy, yy = np.array([p[4], -p[3], p[2]]) / (p[2] * p[4] - p[3] ** 2)
    dx, dy = flattened(x - p[0], y - p[1], bend)
    u, v = xx * dx + xy * dy, xy * dx + yy * dy
    radius = np.maximum(np.hypot(u, v), 1e-9)
    gradient = np.hypot(xx * u + xy * v, xy * u + yy * v) / radius
    return np.asarray((1 - radius) / np.maximum(gradient, 1e-9))


def quadrilateral(p: Floats, x: Floats, y: Floats) -> Floats:
    """Dark quadrilateral on a light ground."""
    blur = np.maximum(np.abs(p[8]), FINEST_BLUR_PX)
    angle = [p[k] for k in (0, 2, 4, 6)]
    away = [(x * np.cos(a) + y * np.sin(a) + p[2 * k + 1]) / blur for k, a in enumerate(angle)]
    inside = np.prod([0.5 * (1 + erf(a / np.sqrt(2))) for a in away], axis=0)
    slope = [np.exp(-(a**2) / 2) / np.sqrt(2 * np.pi) for a in away]
    # A blurred corner is the integral of a bivariate normal density whose correlation is the cosine between
    # its edges' normals: the product of the edges, and the first terms of Mehler's series. The product alone
    # is right for right angles; by it acute corners are measured too far in, obtuse ones too far out.
    for k in range(4):
        a, b, r = away[k - 1], away[k], np.cos(angle[k] - angle[k - 1])
        series = r + r**2 / 2 * a * b + r**3 / 6 * (a**2 - 1) * (b**2 - 1)
        inside = inside + series * slope[k - 1] * slope[k]
    return np.asarray(p[9] + p[10] * inside)


def quadrilateral_slopes(p: Floats, x: Floats, y: Floats) -> Floats:
    """Derivatives of `quadrilateral` with respect to its eleven parameters, (n, 11)."""
    blur, blurs = max(abs(p[8]), FINEST_BLUR_PX), np.sign(p[8]) * (abs(p[8]) > FINEST_BLUR_PX)
    cos, sin = np.cos(p[0:8:2])[:, None], np.sin(p[0:8:2])[:, None]
    # Of each edge, (4, n): distance in blurs, the part of the light inside, and the density.
    away = (x * cos + y * sin + p[1:8:2][:, None]) / blur
    edge = 0.5 * (1 + erf(away / np.sqrt(2)))
    slope = np.exp(-(away**2) / 2) / np.sqrt(2 * np.pi)
    # Of each corner between an edge and the one before it: see `quadrilateral`.
    a, b, both = np.roll(away, 1, axis=0), away, np.roll(slope, 1, axis=0) * slope
    turn = (p[0:8:2] - np.roll(p[0:8:2], 1))[:, None]
    r = np.cos(turn)
    outer, other = a**2 - 1, b**2 - 1
    series = r + r**2 / 2 * a * b + r**3 / 6 * outer * other
    by_a = both * (r**2 / 2 * b + r**3 / 3 * a * other - a * series)
    by_b = both * (r**2 / 2 * a + r**3 / 3 * b * outer - b * series)
    by_turn = -np.sin(turn) * both * (1 + r * a * b + r**2 / 2 * outer * other)
    others = np.stack([edge[k - 1] * edge[k - 2] * edge[k - 3] for k in range(4)])
    by_away = slope * others + by_b + np.roll(by_a, -1, axis=0)
    slopes = np.empty((len(x), 11))
    by_angle = by_away * (y * cos - x * sin) / blur + by_turn - np.roll(by_turn, -1, axis=0)
    slopes[:, 0:8:2], slopes[:, 1:8:2] = p[10] * by_angle.T, p[10] / blur * by_away.T
    slopes[:, 8] = -blurs * p[10] / blur * np.sum(by_away * away, axis=0)
    slopes[:, 9], slopes[:, 10] = 1.0, np.prod(edge, axis=0) + np.sum(both * series, axis=0)
    return slopes


def flattened(dx: Floats, dy: Floats, bend: Floats) -> tuple[Floats, Floats]:
    """Offsets in an image as they would be if it were parallel to the ground and not distorted."""
    xx, xy, yy = dx * dx, 2 * dx * dy, dy * dy
    return (
        dx + bend[0, 0, 0] * xx + bend[0, 0, 1] * xy + bend[0, 1, 1] * yy,
        dy + bend[1, 0, 0] * xx + bend[1, 0, 1] * xy + bend[1, 1, 1] * yy,
    )


def _beside(p: Floats, angle: float, x: Floats, y: Floats) -> Floats:
    """Distance from the line through the centre with this direction."""
    return np.asarray((y - p[1]) * np.cos(angle) - (x - p[0]) * np.sin(angle))


def _edge(distance: Floats, blur: Floats | float) -> Floats:
    return np.asarray(erf(distance / (np.sqrt(2) * np.maximum(np.abs(blur), FINEST_BLUR_PX))))


def _bar(distance: Floats, width: float, blur: float) -> Floats:
    return 0.5 * (_edge(distance + width / 2, blur) - _edge(distance - width / 2, blur))


# A target that was found has at least this contrast, grey values.
LEAST_CONTRAST = 20.0

# Far enough for digits, near enough for the third order not to matter.
_STEP_PX = 8.0
_AROUND = _STEP_PX * np.array([[0, 0], [1, 0], [-1, 0], [0, 1], [0, -1], [1, 1], [-1, -1], [1, -1], [-1, 1]])
Kind = Literal["disc", "ring", "cross", "hourglass"]

# Targets that are smaller are not distinguished from specks: side in px where it is seen shortest.
SMALLEST_PX = {"disc": 8.0, "ring": 8.0, "cross": 12.0, "hourglass": 12.0}
# Width of a cross's bars, diameter of a ring's hole, as parts of the side.
PARTS = {"disc": 1.0, "ring": HOLE, "cross": BAR, "hourglass": 1.0}
_BLUR_PX = 0.7
# Ground that is examined around a target, as a part of its half side, and at least, px.
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
    covariance = odd_variance(window, fit, place) * fit.cofactor[:2, :2]
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
        """Whether it can be distinguished from a speck."""
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
