"""Pictures of targets: ideal edges blurred by a Gaussian, as functions of their parameters.

Each takes its parameters and columns and rows, and gives grey values; place in px, angles in radians. A
straight edge blurred by a Gaussian of standard deviation s is erf(d / (s sqrt 2)), d the distance from it.
"""

import numpy as np
from scipy.special import erf

from photocal.base.arrays import Floats

# Of a plane parallel to an image without distortion: see `target_centre.ground_bend`.
FLAT = np.zeros((2, 2, 2))
_FINEST_BLUR_PX = 0.15
# The bars of a cross are a fifth as wide as long, a ring's hole is half as wide.
BAR, HOLE = 1 / 5, 1 / 2


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
    inside = np.ones_like(x)
    for k in range(4):
        angle, distance = p[2 * k], p[2 * k + 1]
        inside = inside * 0.5 * (1 + _edge(x * np.cos(angle) + y * np.sin(angle) + distance, p[8]))
    return np.asarray(p[9] + p[10] * inside)


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
    return np.asarray(erf(distance / (np.sqrt(2) * np.maximum(np.abs(blur), _FINEST_BLUR_PX))))


def _bar(distance: Floats, width: float, blur: float) -> Floats:
    return 0.5 * (_edge(distance + width / 2, blur) - _edge(distance - width / 2, blur))
