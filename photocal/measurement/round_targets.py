"""Centres of circles and rings in perspective."""

from functools import partial

import numpy as np

from photocal.base.arrays import Floats
from photocal.measurement import target_patterns
from photocal.measurement.image_file import Grey
from photocal.measurement.target_centre import Centre, accepted, half_contrast
from photocal.measurement.target_patterns import FLAT
from photocal.measurement.template_fit import Window, cut_window, fit_template


def round_centre(
    grey: Grey,
    approximate: tuple[float, float],
    semi_axes: tuple[float, float],
    direction: float = 0.0,
    bend: Floats = FLAT,
    margin: float | None = None,
    hole: float = 0.0,
) -> Centre | None:
    """Centre of a filled circle in perspective; with a hole, a part of its size, of a ring.

    margin: even ground around it that may be used, px; None: as much as a window of the usual size has.
    """
    longest = max(semi_axes)
    window = cut_window(grey, approximate, longest + (max(3.0, 0.35 * longest) if margin is None else margin))
    if window is not None and margin is not None:
        x, y = approximate[0] - window.middle[0], approximate[1] - window.middle[1]
        outline = np.array([x, y, *_extent(semi_axes, direction)])
        window = window.rows(target_patterns.inside_circle(outline, window.x, window.y) >= -margin)
    if window is None:
        return None
    filled = (hole, 1.0) if hole else (0.0, 0.6)
    start, sizes = _round_start(window, approximate, semi_axes, direction, filled)
    if not np.isfinite(start).all():
        return None
    if hole:
        start, sizes = np.insert(start, 5, hole), np.insert(sizes, 5, 0.1)
    template = partial(target_patterns.ring if hole else target_patterns.disc, bend=bend)
    fit = fit_template(window, template, start, sizes)
    if fit is None:
        return None
    outline = _axes(fit.parameters[2:5])
    alike = all(0.5 < a / b < 2 for a, b in zip(outline[:2], sorted(semi_axes)[::-1], strict=True))
    if not alike or (hole and not 0.05 < fit.parameters[5] < 0.95):
        return None
    farthest = longest * (1 - hole) / 2 + 1
    shape = np.r_[outline, fit.parameters[5:-2]]
    return accepted(window, fit, abs(fit.parameters[-1]), approximate, farthest, shape)


def _round_start(
    window: Window,
    approximate: tuple[float, float],
    semi_axes: tuple[float, float],
    direction: float,
    filled: tuple[float, float],
) -> tuple[Floats, Floats]:
    """Parameters of a disc to start from, and their sizes; NaN where a part of the picture has no pixel."""
    # `filled` tells between which parts of the radius the picture is inside.
    x, y = approximate[0] - window.middle[0], approximate[1] - window.middle[1]
    outline = np.array([x, y, *_extent(semi_axes, direction)])
    depth = target_patterns.inside_circle(outline, window.x, window.y)
    shortest = min(semi_axes)
    inside = (depth >= (1 - filled[1]) * shortest) & (depth <= (1 - filled[0]) * shortest)
    outside = depth < -min(1.5, -depth.min() / 2)
    within, beside = (float(np.median(window.grey[m])) if m.any() else np.nan for m in (inside, outside))
    half = half_contrast(window)
    return np.r_[outline, 0.7, beside, within - beside], np.array([1, 1, 1, 1, 1, 0.5, half, half])


def _extent(semi_axes: tuple[float, float], direction: float) -> tuple[float, float, float]:
    """The symmetric matrix (xx, xy, yy) that takes the unit circle to an ellipse."""
    (a, b), cos, sin = semi_axes, np.cos(direction), np.sin(direction)
    return float(a * cos**2 + b * sin**2), float((a - b) * cos * sin), float(a * sin**2 + b * cos**2)


def _axes(extent: Floats) -> Floats:
    """The longer and the shorter semi-axis of an ellipse, and the direction of the longer one."""
    values, vectors = np.linalg.eigh(np.array([[extent[0], extent[1]], [extent[1], extent[2]]]))
    return np.array([values[1], values[0], np.arctan2(vectors[1, 1], vectors[0, 1])])


def saddle_centre(grey: Grey, approximate: tuple[float, float], radius: float) -> Centre | None:
    """Centre of a chessboard corner or an hourglass mark."""
    window = cut_window(grey, approximate, radius)
    if window is None:
        return None
    x, y = approximate[0] - window.middle[0], approximate[1] - window.middle[1]
    # The second harmonic around the centre gives the bisector of the light fields.
    angle = np.arctan2(window.y - y, window.x - x)
    wave = np.sum((window.grey - window.grey.mean()) * np.exp(2j * angle))
    bisector = 0.5 * float(np.angle(wave))
    half = half_contrast(window)
    # The product of the two edge functions is negative between the directions, positive beside them.
    start = np.array([x, y, bisector - np.pi / 4, bisector + np.pi / 4, 1.0, window.grey.mean(), -half])
    sizes = np.array([1, 1, 0.3, 0.3, 0.5, half, half])
    fit = fit_template(window, target_patterns.saddle, start, sizes)
    if fit is None or abs(np.sin(fit.parameters[2] - fit.parameters[3])) < 0.2:
        return None
    return accepted(window, fit, 2 * abs(fit.parameters[6]), approximate, radius / 2, fit.parameters[2:5])


def cross_centre(
    grey: Grey, approximate: tuple[float, float], size: float, width: float | None = None, bend: Floats = FLAT
) -> Centre | None:
    """Centre of a cross of two bars."""
    window = cut_window(grey, approximate, size / 2)
    if window is None:
        return None
    x, y = approximate[0] - window.middle[0], approximate[1] - window.middle[1]
    half, broad = half_contrast(window), width or size / 5
    low, high = np.quantile(window.grey, [0.1, 0.9])
    sizes = np.array([1, 1, 0.3, 0.3, 1, 0.5, half, half])
    fits, template = [], partial(target_patterns.cross, bend=bend)
    for turn in np.arange(0, np.pi / 2, np.pi / 8):
        for beside, contrast in ((low, high - low), (high, low - high)):
            start = np.array([x, y, turn, turn + np.pi / 2, broad, 1.0, beside, contrast])
            left = window.grey - template(start, window.x, window.y)
            fits.append((float(left @ left), start))
    _, start = min(fits, key=lambda pair: pair[0])
    fit = fit_template(window, template, start, sizes)
    if fit is None or not 0.3 * broad < fit.parameters[4] < 3 * broad:
        return None
    if abs(np.sin(fit.parameters[2] - fit.parameters[3])) < 0.4:
        return None
    return accepted(window, fit, abs(fit.parameters[7]), approximate, size / 4, fit.parameters[2:6])
