"""Pictures of targets: ideal edges blurred by a Gaussian, as functions of their parameters.

Each takes its parameters and columns and rows, and gives grey values; place in px, angles in radians. A
straight edge blurred by a Gaussian of standard deviation s is erf(d / (s sqrt 2)), d the distance from it.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]

_FINEST_BLUR_PX = 0.15


def saddle(p: Floats, x: Floats, y: Floats) -> Floats:
    """Corner of four fields in a chessboard, or an hourglass.

    Parameters
    ----------
    p : ndarray
        Column, row, directions of the two edges, blur, mean grey value, half of the contrast.
    x, y : ndarray, shape (n,)

    Returns
    -------
    ndarray, shape (n,)
    """
    return np.asarray(p[5] + p[6] * _edge(_beside(p, p[2], x, y), p[4]) * _edge(_beside(p, p[3], x, y), p[4]))


def cross(p: Floats, x: Floats, y: Floats) -> Floats:
    """Two bars that cross.

    Parameters
    ----------
    p : ndarray
        Column, row, directions of the bars, width, blur, grey value beside, contrast of the bars.
    x, y : ndarray, shape (n,)

    Returns
    -------
    ndarray, shape (n,)
    """
    first, second = (_bar(_beside(p, angle, x, y), p[4], p[5]) for angle in (p[2], p[3]))
    return np.asarray(p[6] + p[7] * (first + second - first * second))


def disc(p: Floats, x: Floats, y: Floats) -> Floats:
    """Filled ellipse.

    Parameters
    ----------
    p : ndarray
        Column, row, the two semi-axes, direction of the first, blur, grey value outside, contrast inside.
    x, y : ndarray, shape (n,)

    Returns
    -------
    ndarray, shape (n,)
    """
    return np.asarray(p[6] + p[7] * 0.5 * (1 + _edge(_inside_ellipse(p[:5], x, y), p[5])))


def quadrilateral(p: Floats, x: Floats, y: Floats) -> Floats:
    """Dark quadrilateral on a light ground.

    Parameters
    ----------
    p : ndarray
        Direction of the inward normal and distance from the origin of each of four edges (8), blur, grey
        value outside, contrast inside (negative for dark).
    x, y : ndarray, shape (n,)

    Returns
    -------
    ndarray, shape (n,)
    """
    inside = np.ones_like(x)
    for k in range(4):
        angle, distance = p[2 * k], p[2 * k + 1]
        inside = inside * 0.5 * (1 + _edge(x * np.cos(angle) + y * np.sin(angle) + distance, p[8]))
    return np.asarray(p[9] + p[10] * inside)


def _beside(p: Floats, angle: float, x: Floats, y: Floats) -> Floats:
    """Distance from the line through the centre with this direction."""
    return np.asarray((y - p[1]) * np.cos(angle) - (x - p[0]) * np.sin(angle))


def _edge(distance: Floats, blur: float) -> Floats:
    from scipy.special import erf

    return np.asarray(erf(distance / (np.sqrt(2) * max(abs(blur), _FINEST_BLUR_PX))))


def _bar(distance: Floats, width: float, blur: float) -> Floats:
    return 0.5 * (_edge(distance + width / 2, blur) - _edge(distance - width / 2, blur))


def _inside_ellipse(p: Floats, x: Floats, y: Floats) -> Floats:
    """Distance from the ellipse to first order, positive inside (Sampson 1982)."""
    cos, sin = np.cos(p[4]), np.sin(p[4])
    u = ((x - p[0]) * cos + (y - p[1]) * sin) / p[2]
    v = (-(x - p[0]) * sin + (y - p[1]) * cos) / p[3]
    radius = np.maximum(np.hypot(u, v), 1e-9)
    slope = np.hypot(u / p[2], v / p[3]) / radius
    return np.asarray((1 - radius) / np.maximum(slope, 1e-9))
