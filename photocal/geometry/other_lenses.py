"""Lenses that are not Brown's: OpenCV's rational one, and fisheyes, polynomials of the angle off the axis."""

import numpy as np

from photocal.base.arrays import Floats
from photocal.base.compiled import inlined
from photocal.geometry.camera import PARAMETERS

_C, _K1, _P1, _K5, _S1 = (PARAMETERS.index(name) for name in ("c", "K1", "P1", "K5", "S1"))
# Of Pix4D's polynomial, whose variable is 1 at a right angle.
_RIGHT = np.pi / 2
# No lens sees what lies behind it, nor beyond the turning point of its polynomial.
_BEHIND = 3.1


@inlined
def rational(
    cameras: Floats, k: int, u: float, v: float, w: float, by_q: Floats, by_camera: Floats, depth: Floats
) -> tuple[float, float]:
    """Project through a quotient of polynomials with a thin prism; x, y over the principal distance, y up.

    c (x h + P1 (r^2 + 2 x^2) + 2 P2 x y + S1 r^2 + S2 r^4), c (y h + P2 (r^2 + 2 y^2) + 2 P1 x y
    + S3 r^2 + S4 r^4) with h = (1 + K1 r^2 + K2 r^4 + K3 r^6) / (1 + K4 r^2 + K5 r^4 + K6 r^6): OpenCV's
    k1 to k6, whose p1 and p2 are -P2 and P1, and s1 to s4 are S1, S2, -S3, -S4, for its y is down.
    """
    c, p1, p2 = cameras[k, _C], cameras[k, _P1], cameras[k, _P1 + 1]
    k1, k2, k3, k4 = cameras[k, _K1], cameras[k, _K1 + 1], cameras[k, _K1 + 2], cameras[k, _K1 + 3]
    k5, k6 = cameras[k, _K5], cameras[k, _K5 + 1]
    s1, s2, s3, s4 = cameras[k, _S1], cameras[k, _S1 + 1], cameras[k, _S1 + 2], cameras[k, _S1 + 3]
    x, y = -u / w, -v / w
    q = x * x + y * y
    over = 1.0 + q * (k1 + q * (k2 + q * k3))
    under = 1.0 + q * (k4 + q * (k5 + q * k6))
    h = over / under
    # Twice the derivative of h to r^2.
    steep = 2.0 * (k1 + q * (2.0 * k2 + q * 3.0 * k3) - h * (k4 + q * (2.0 * k5 + q * 3.0 * k6))) / under
    sx, sy = 2.0 * (s1 + 2.0 * s2 * q), 2.0 * (s3 + 2.0 * s4 * q)
    a00 = c * (h + x * x * steep + 6.0 * p1 * x + 2.0 * p2 * y + sx * x)
    a01 = c * (x * y * steep + 2.0 * p1 * y + 2.0 * p2 * x + sx * y)
    a10 = c * (x * y * steep + 2.0 * p1 * y + 2.0 * p2 * x + sy * x)
    a11 = c * (h + y * y * steep + 6.0 * p2 * y + 2.0 * p1 * x + sy * y)
    by_q[0, 0], by_q[0, 1], by_q[0, 2] = -a00 / w, -a01 / w, -(a00 * x + a01 * y) / w
    by_q[1, 0], by_q[1, 1], by_q[1, 2] = -a10 / w, -a11 / w, -(a10 * x + a11 * y) / w
    gx, gy, cross = q + 2.0 * x * x, q + 2.0 * y * y, 2.0 * x * y
    px = x * h + p1 * gx + p2 * cross + q * (s1 + q * s2)
    py = y * h + p2 * gy + p1 * cross + q * (s3 + q * s4)
    by_camera[0, _C], by_camera[1, _C] = px, py
    power = c / under
    for n in range(3):
        power *= q
        by_camera[0, _K1 + n], by_camera[1, _K1 + n] = x * power, y * power
        at = _K1 + 3 if n == 0 else _K5 + n - 1
        by_camera[0, at], by_camera[1, at] = -h * x * power, -h * y * power
    by_camera[0, _P1], by_camera[0, _P1 + 1] = c * gx, c * cross
    by_camera[1, _P1], by_camera[1, _P1 + 1] = c * cross, c * gy
    for n in range(2):
        prism = c * q if n == 0 else c * q * q
        by_camera[0, _S1 + n], by_camera[1, _S1 + n] = prism, 0.0
        by_camera[0, _S1 + 2 + n], by_camera[1, _S1 + 2 + n] = 0.0, prism
    depth[0] = -w
    return c * px, c * py


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
