"""Centres of targets to a fraction of a pixel, each with its own covariance."""

from __future__ import annotations

from dataclasses import dataclass
from functools import partial

import numpy as np
from numpy.typing import NDArray

from photocal.measurement import patterns
from photocal.measurement.image_file import Grey, as_eight_bit
from photocal.measurement.patterns import FLAT
from photocal.measurement.template import Fit, Template, Window, cut_window, fit_template

Floats = NDArray[np.float64]

# A contrast below this multiple of the noise is no target.
WEAKEST_CONTRAST = 3.0
# Targets are drawn on paper; a centre that claims more than this trusts the model too much.
FINEST_PX = 0.003


@dataclass(frozen=True)
class Centre:
    """A measured centre.

    Attributes
    ----------
    column, row : float
        px; the centre of the upper-left pixel is (0, 0).
    covariance : ndarray, shape (2, 2)
        px squared.
    contrast, noise : float
        Grey values.
    shape : ndarray, shape (k,)
        Further parameters of the target, as in `patterns`; the blur stands last.
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
    """Grey values in whole steps, as the templates take them for granted.

    Parameters
    ----------
    grey : ndarray, shape (height, width)

    Returns
    -------
    ndarray
        Unchanged but for floating point values, which may count in any unit: these get 8 bits.
    """
    return as_eight_bit(grey) if grey.dtype == np.float32 else grey


def saddle_centre(grey: Grey, approximate: tuple[float, float], radius: float) -> Centre | None:
    """Centre of a chessboard corner or an hourglass mark.

    Parameters
    ----------
    grey : ndarray, shape (height, width)
    approximate : tuple of float
        Column and row, px; within half of the radius of the truth.
    radius : float
        Of the window, px: no other edge may be nearer.

    Returns
    -------
    Centre or None
        None when there is no such target.
    """
    window = cut_window(grey, approximate, radius)
    if window is None:
        return None
    x, y = approximate[0] - window.middle[0], approximate[1] - window.middle[1]
    # The second harmonic around the centre gives the bisector of the light fields.
    angle = np.arctan2(window.y - y, window.x - x)
    wave = np.sum((window.grey - window.grey.mean()) * np.exp(2j * angle))
    bisector = 0.5 * float(np.angle(wave))
    half = _half_contrast(window)
    # The product of the two edge functions is negative between the directions, positive beside them.
    start = np.array([x, y, bisector - np.pi / 4, bisector + np.pi / 4, 1.0, window.grey.mean(), -half])
    sizes = np.array([1, 1, 0.3, 0.3, 0.5, half, half])
    fit = fit_template(window, patterns.saddle, start, sizes)
    if fit is None or abs(np.sin(fit.parameters[2] - fit.parameters[3])) < 0.2:
        return None
    return _centre(window, fit, 2 * abs(fit.parameters[6]), approximate, radius / 2, fit.parameters[2:5])


def cross_centre(
    grey: Grey,
    approximate: tuple[float, float],
    size: float,
    width: float | None = None,
    bend: Floats = FLAT,
) -> Centre | None:
    """Centre of a cross of two bars.

    Parameters
    ----------
    grey : ndarray, shape (height, width)
    approximate : tuple of float
        Column and row, px; within a quarter of the size of the truth.
    size : float
        Length of a bar, px: the window is a circle of this diameter.
    width : float, optional
        Of a bar, px; a fifth of the size when not given.
    bend : ndarray, shape (2, 2, 2)
        Of the ground, from `eccentricity.ground_bend`.

    Returns
    -------
    Centre or None
        None when there is no such target.
    """
    window = cut_window(grey, approximate, size / 2)
    if window is None:
        return None
    x, y = approximate[0] - window.middle[0], approximate[1] - window.middle[1]
    half, broad = _half_contrast(window), width or size / 5
    low, high = np.quantile(window.grey, [0.1, 0.9])
    sizes = np.array([1, 1, 0.3, 0.3, 1, 0.5, half, half])
    fits, template = [], partial(patterns.cross, bend=bend)
    for turn in np.arange(0, np.pi / 2, np.pi / 8):
        for beside, contrast in ((low, high - low), (high, low - high)):
            start = np.array([x, y, turn, turn + np.pi / 2, broad, 1.0, beside, contrast])
            fits.append(_sketch(window, template, start))
    _, start = min(fits, key=lambda pair: pair[0])
    fit = fit_template(window, template, start, sizes)
    if fit is None or not 0.3 * broad < fit.parameters[4] < 3 * broad:
        return None
    if abs(np.sin(fit.parameters[2] - fit.parameters[3])) < 0.4:
        return None
    return _centre(window, fit, abs(fit.parameters[7]), approximate, size / 4, fit.parameters[2:6])


def disc_centre(
    grey: Grey,
    approximate: tuple[float, float],
    semi_axes: tuple[float, float],
    direction: float = 0.0,
    bend: Floats = FLAT,
    margin: float | None = None,
) -> Centre | None:
    """Centre of a filled circle in perspective.

    Parameters
    ----------
    grey : ndarray, shape (height, width)
    approximate : tuple of float
        Column and row, px.
    semi_axes : tuple of float
        px.
    direction : float
        Of the first axis, from the columns towards the rows, radians.
    bend : ndarray, shape (2, 2, 2)
        Of the ground, from `eccentricity.ground_bend`. Without it the centre is that of the ellipse,
        which is not where the circle's centre is seen.
    margin : float, optional
        Even ground around it that is used, px; without it all within a third more than the longer axis.

    Returns
    -------
    Centre or None
        None when there is no such target; `shape` holds semi-axes, direction and blur.
    """
    window = _round_window(grey, approximate, semi_axes, direction, margin)
    if window is None:
        return None
    start, sizes = _round_start(window, approximate, semi_axes, direction, (0.0, 0.6))
    if not np.isfinite(start).all():
        return None
    fit = fit_template(window, partial(patterns.disc, bend=bend), start, sizes)
    if fit is None or not _alike(fit.parameters[2:4], semi_axes):
        return None
    farthest = max(semi_axes) / 2 + 1
    return _centre(window, fit, abs(fit.parameters[7]), approximate, farthest, fit.parameters[2:6])


def ring_centre(
    grey: Grey,
    approximate: tuple[float, float],
    semi_axes: tuple[float, float],
    direction: float = 0.0,
    hole: float = 0.5,
    bend: Floats = FLAT,
    margin: float | None = None,
) -> Centre | None:
    """Centre of a ring between two concentric circles, in perspective.

    Parameters
    ----------
    grey, approximate, direction, bend, margin
        As in `disc_centre`.
    semi_axes : tuple of float
        Of the outer circle, px.
    hole : float
        Inner over outer diameter.

    Returns
    -------
    Centre or None
        None when there is no such target; `shape` holds semi-axes, direction, hole and blur.
    """
    window = _round_window(grey, approximate, semi_axes, direction, margin)
    if window is None:
        return None
    start, sizes = _round_start(window, approximate, semi_axes, direction, (hole, 1.0))
    if not np.isfinite(start).all():
        return None
    start, sizes = np.insert(start, 5, hole), np.insert(sizes, 5, 0.1)
    fit = fit_template(window, partial(patterns.ring, bend=bend), start, sizes)
    if fit is None or not (_alike(fit.parameters[2:4], semi_axes) and 0.05 < fit.parameters[5] < 0.95):
        return None
    farthest = max(semi_axes) * (1 - hole) / 2 + 1
    return _centre(window, fit, abs(fit.parameters[8]), approximate, farthest, fit.parameters[2:7])


def _round_window(
    grey: Grey,
    approximate: tuple[float, float],
    semi_axes: tuple[float, float],
    direction: float,
    margin: float | None,
) -> Window | None:
    longest = max(semi_axes)
    beside = max(3.0, 0.35 * longest) if margin is None else margin
    window = cut_window(grey, approximate, longest + beside)
    if window is None or margin is None:
        return window
    x, y = approximate[0] - window.middle[0], approximate[1] - window.middle[1]
    outline = np.array([x, y, *semi_axes, direction])
    return window.where(patterns.inside_circle(outline, window.x, window.y) >= -margin)


def _round_start(
    window: Window,
    approximate: tuple[float, float],
    semi_axes: tuple[float, float],
    direction: float,
    filled: tuple[float, float],
) -> tuple[Floats, Floats]:
    """Parameters of a disc to start from, and their sizes; NaN where a part of the picture has no pixel.

    `filled` tells between which parts of the radius the picture is inside.
    """
    longest = max(semi_axes)
    x, y = approximate[0] - window.middle[0], approximate[1] - window.middle[1]
    depth = patterns.inside_circle(np.array([x, y, *semi_axes, direction]), window.x, window.y)
    shortest = min(semi_axes)
    inside = (depth >= (1 - filled[1]) * shortest) & (depth <= (1 - filled[0]) * shortest)
    outside = depth < -min(1.5, -depth.min() / 2)
    within, beside = (float(np.median(window.grey[m])) if m.any() else np.nan for m in (inside, outside))
    start = np.array([x, y, *semi_axes, direction, 0.7, beside, within - beside])
    # The direction of a circle is undetermined: a whisper of an ellipse keeps the system regular.
    if abs(semi_axes[0] - semi_axes[1]) < 0.02 * longest:
        start[2] *= 1.02
    half = _half_contrast(window)
    return start, np.array([1, 1, 1, 1, 0.3, 0.5, half, half])


def _alike(found: Floats, semi_axes: tuple[float, float]) -> bool:
    return all(0.5 < a / b < 2 for a, b in zip(found, semi_axes, strict=True))


def quadrilateral_centre(grey: Grey, corners: Floats, cell: float) -> tuple[Centre, Floats] | None:
    """Centre and corners of a dark quadrilateral, such as the border of a coded marker.

    Parameters
    ----------
    grey : ndarray, shape (height, width)
    corners : ndarray, shape (4, 2)
        Approximate columns and rows, px, in order around it.
    cell : float
        Width of the dark border and at least of the light margin around it, px.

    Returns
    -------
    centre : Centre
        Where the diagonals meet: the image of the centre of a square.
    corners : ndarray, shape (4, 2)
        px.

    None when there is no such target.
    """
    middle = corners.mean(axis=0)
    reach = float(np.hypot(*(corners - middle).T).max()) + 0.7 * cell + 1
    window = cut_window(grey, (float(middle[0]), float(middle[1])), reach)
    if window is None:
        return None
    local = corners - window.middle
    along = np.roll(local, -1, axis=0) - local
    normal = np.column_stack([-along[:, 1], along[:, 0]]) / np.hypot(*along.T)[:, None]
    inward = np.sign(np.sum(normal * (local.mean(axis=0) - local), axis=1))
    normal *= inward[:, None]
    distance = -np.sum(normal * local, axis=1)
    depth = np.min(np.column_stack([window.x, window.y]) @ normal.T + distance, axis=1)
    # Inside the border lies the code, beyond the margin anything.
    window = window.where(np.abs(depth) <= max(0.75 * cell, 1.5))
    if len(window.grey) < 20:
        return None
    half = _half_contrast(window)
    edges = np.column_stack([np.arctan2(normal[:, 1], normal[:, 0]), distance]).ravel()
    light, dark = np.quantile(window.grey, [0.9, 0.1])
    start = np.concatenate([edges, [0.7, light, dark - light]])
    side = float(np.hypot(*along.T).mean())
    sizes = np.array([1 / side, 1] * 4 + [0.5, half, half])
    fit = fit_template(window, patterns.quadrilateral, start, sizes)
    if fit is None or fit.parameters[10] > 0:
        return None
    found = _corners(fit.parameters)
    if np.abs(found - local).max() > max(2.0, 0.15 * side):
        return None
    step = np.eye(11) * 1e-5
    slope = np.column_stack(
        [(_diagonals(fit.parameters + s) - _diagonals(fit.parameters - s)) / 2e-5 for s in step]
    )
    place = _diagonals(fit.parameters)
    refined = Fit(np.concatenate([place, fit.parameters]), slope @ fit.covariance @ slope.T, fit.noise)
    target = (float(middle[0]), float(middle[1]))
    centre = _centre(window, refined, -fit.parameters[10], target, 0.15 * side + 1, fit.parameters[:9])
    return None if centre is None else (centre, found + window.middle)


def _corners(p: Floats) -> Floats:
    lines = np.array([[np.cos(p[2 * k]), np.sin(p[2 * k]), p[2 * k + 1]] for k in range(4)])
    # Edge k runs from corner k to corner k + 1.
    meeting = np.cross(np.roll(lines, 1, axis=0), lines)
    return np.asarray(meeting[:, :2] / meeting[:, 2:])


def _diagonals(p: Floats) -> Floats:
    corners = np.column_stack([_corners(p), np.ones(4)])
    meeting = np.cross(np.cross(corners[0], corners[2]), np.cross(corners[1], corners[3]))
    return np.asarray(meeting[:2] / meeting[2])


def _half_contrast(window: Window) -> float:
    low, high = np.quantile(window.grey, [0.05, 0.95])
    return max(float(high - low) / 2, 1.0)


def _sketch(window: Window, template: Template, start: Floats) -> tuple[float, Floats]:
    left = window.grey - template(start, window.x, window.y)
    return float(left @ left), start


def _centre(
    window: Window,
    fit: Fit,
    contrast: float,
    approximate: tuple[float, float],
    farthest: float,
    shape: Floats,
) -> Centre | None:
    column, row = float(fit.parameters[0] + window.middle[0]), float(fit.parameters[1] + window.middle[1])
    moved = np.hypot(column - approximate[0], row - approximate[1])
    covariance = fit.covariance[:2, :2] + FINEST_PX**2 * np.eye(2)
    too_weak = contrast < WEAKEST_CONTRAST * fit.noise
    if moved > farthest or too_weak or max(covariance[0, 0], covariance[1, 1]) > 1:
        return None
    return Centre(column, row, covariance, contrast, fit.noise, shape.copy())
