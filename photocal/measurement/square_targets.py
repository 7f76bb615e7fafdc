"""Centre and corners of the border of a coded marker."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from drivers.arrays import Floats
from photocal.measurement import patterns
from photocal.measurement.centre import Centre, accepted, half_contrast
from photocal.measurement.image_file import Grey
from photocal.measurement.template import cut_window, fit_template


def quadrilateral_centre(grey: Grey, corners: Floats, cell: float) -> tuple[Centre, Floats] | None:
    """Centre and corners of a dark quadrilateral, such as the border of a coded marker."""
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
    half = half_contrast(window)
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
    refined = replace(fit, parameters=place, cofactor=slope @ fit.cofactor @ slope.T)
    target = (float(middle[0]), float(middle[1]))
    centre = accepted(window, refined, -fit.parameters[10], target, 0.15 * side + 1, fit.parameters[:9])
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
