"""Fisheye lenses: the distance from the principal point as a polynomial of the angle off the axis."""

import numpy as np

from drivers.arrays import Floats
from photocal.compiled import inlined
from photocal.geometry.camera import PARAMETERS

_C, _K1 = PARAMETERS.index("c"), PARAMETERS.index("K1")
# Of Pix4D's polynomial, whose variable is 1 at a right angle.
_RIGHT = np.pi / 2
# No lens sees what lies behind it, nor beyond the turning point of its polynomial.
_BEHIND = 3.1


@inlined
def _spread(
    c: float, f: float, slope: float, u: float, v: float, w: float, by_q: Floats, by_camera: Floats
) -> tuple[float, float, float, float]:
    """Image point at c f in the direction of (u, v), with its derivatives to q and c, and that direction."""
    r2 = u * u + v * v
    square = r2 + w * w
    r = np.sqrt(r2)
    if r2 > 1e-24 * square:
        nx, ny = u / r, v / r
        along, across, deep = c * slope * -w / square, c * f / r, c * slope * r / square
    else:
        nx, ny = 0.0, 0.0
        along, across, deep = -c * slope / w, -c * slope / w, 0.0
    by_q[0, 0] = across + (along - across) * nx * nx
    by_q[0, 1] = by_q[1, 0] = (along - across) * nx * ny
    by_q[1, 1] = across + (along - across) * ny * ny
    by_q[0, 2], by_q[1, 2] = deep * nx, deep * ny
    by_camera[0, _C], by_camera[1, _C] = f * nx, f * ny
    return c * f * nx, c * f * ny, nx, ny


@inlined
def equidistant(
    cameras: Floats, k: int, u: float, v: float, w: float, by_q: Floats, by_camera: Floats, depth: Floats
) -> tuple[float, float]:
    """Project to c (t + K1 t^3 + K2 t^5 + K3 t^7 + K4 t^9) at the angle t (Kannala and Brandt 2006)."""
    t = np.arctan2(np.sqrt(u * u + v * v), -w)
    k1, k2, k3, k4 = cameras[k, _K1], cameras[k, _K1 + 1], cameras[k, _K1 + 2], cameras[k, _K1 + 3]
    q = t * t
    f = t * (1.0 + q * (k1 + q * (k2 + q * (k3 + q * k4))))
    slope = 1.0 + q * (3.0 * k1 + q * (5.0 * k2 + q * (7.0 * k3 + q * 9.0 * k4)))
    c = cameras[k, _C]
    x, y, nx, ny = _spread(c, f, slope, u, v, w, by_q, by_camera)
    power = c * t
    for n in range(4):
        power *= q
        by_camera[0, _K1 + n], by_camera[1, _K1 + n] = power * nx, power * ny
    depth[0] = np.sqrt(u * u + v * v + w * w) if slope > 0.0 and t < _BEHIND else -1.0
    return x, y


@inlined
def pix4d_fisheye(
    cameras: Floats, k: int, u: float, v: float, w: float, by_q: Floats, by_camera: Floats, depth: Floats
) -> tuple[float, float]:
    """Project to c pi/2 (t + K1 t^2 + K2 t^3 + K3 t^4) at the angle t in right angles."""
    # K1 to K3 are Pix4D's p2, p3, p4, and c pi/2 its C (Strecha et al. 2015).
    t = np.arctan2(np.sqrt(u * u + v * v), -w) / _RIGHT
    p2, p3, p4 = cameras[k, _K1], cameras[k, _K1 + 1], cameras[k, _K1 + 2]
    f = _RIGHT * t * (1.0 + t * (p2 + t * (p3 + t * p4)))
    slope = 1.0 + t * (2.0 * p2 + t * (3.0 * p3 + t * 4.0 * p4))
    c = cameras[k, _C]
    x, y, nx, ny = _spread(c, f, slope, u, v, w, by_q, by_camera)
    power = c * _RIGHT * t
    for n in range(3):
        power *= t
        by_camera[0, _K1 + n], by_camera[1, _K1 + n] = power * nx, power * ny
    depth[0] = np.sqrt(u * u + v * v + w * w) if slope > 0.0 and t < _BEHIND / _RIGHT else -1.0
    return x, y
