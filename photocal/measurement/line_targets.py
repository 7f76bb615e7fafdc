"""Centres of targets of straight edges: chessboard corners, hourglasses and crosses."""

from __future__ import annotations

from functools import partial

import numpy as np

from drivers.arrays import Floats
from photocal.measurement import patterns
from photocal.measurement.centre import Centre, accepted, half_contrast
from photocal.measurement.image_file import Grey
from photocal.measurement.patterns import FLAT
from photocal.measurement.template import Template, Window, cut_window, fit_template


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
    fit = fit_template(window, patterns.saddle, start, sizes)
    if fit is None or abs(np.sin(fit.parameters[2] - fit.parameters[3])) < 0.2:
        return None
    return accepted(window, fit, 2 * abs(fit.parameters[6]), approximate, radius / 2, fit.parameters[2:5])


def cross_centre(
    grey: Grey,
    approximate: tuple[float, float],
    size: float,
    width: float | None = None,
    bend: Floats = FLAT,
) -> Centre | None:
    """Centre of a cross of two bars."""
    window = cut_window(grey, approximate, size / 2)
    if window is None:
        return None
    x, y = approximate[0] - window.middle[0], approximate[1] - window.middle[1]
    half, broad = half_contrast(window), width or size / 5
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
    return accepted(window, fit, abs(fit.parameters[7]), approximate, size / 4, fit.parameters[2:6])


def _sketch(window: Window, template: Template, start: Floats) -> tuple[float, Floats]:
    left = window.grey - template(start, window.x, window.y)
    return float(left @ left), start
