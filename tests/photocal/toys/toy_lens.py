"""A lens as a stranger would bring it: a stereographic fisheye with one coefficient.

The image point lies in the direction of the object point at c f, f = 2 tan(t/2) (1 + K1 tan(t/2)^2), with t
the angle off the axis.
"""

import numpy as np

from photocal.base.arrays import Floats
from photocal.base.compiled import inlined
from photocal.geometry.camera import PARAMETERS, LensModel

_C, _K1 = PARAMETERS.index("c"), PARAMETERS.index("K1")


@inlined
def project(
    cameras: Floats, k: int, u: float, v: float, w: float, by_q: Floats, by_camera: Floats, depth: Floats
) -> tuple[float, float]:
    c, k1 = cameras[k, _C], cameras[k, _K1]
    # tan(t/2) = r / (d - w), so that 2 tan(t/2) (u, v) / r = 2 (u, v) / (d - w).
    d = np.sqrt(u * u + v * v + w * w)
    s = 1.0 / (d - w)
    h2 = (u * u + v * v) * s * s
    g, slope = 1.0 + k1 * h2, 2.0 * k1
    sx, sy = 2.0 * s * u, 2.0 * s * v
    # Derivatives of s and h2 to u, v, w.
    su, sv, sw = -s * s * u / d, -s * s * v / d, -s * s * (w / d - 1.0)
    r2 = u * u + v * v
    hu, hv, hw = 2.0 * (u * s * s + r2 * s * su), 2.0 * (v * s * s + r2 * s * sv), 2.0 * r2 * s * sw
    half = 0.5 * slope
    by_q[0, 0] = c * (2.0 * (s + u * su) * g + sx * half * hu)
    by_q[0, 1] = c * (2.0 * u * sv * g + sx * half * hv)
    by_q[0, 2] = c * (2.0 * u * sw * g + sx * half * hw)
    by_q[1, 0] = c * (2.0 * v * su * g + sy * half * hu)
    by_q[1, 1] = c * (2.0 * (s + v * sv) * g + sy * half * hv)
    by_q[1, 2] = c * (2.0 * v * sw * g + sy * half * hw)
    by_camera[0, _C], by_camera[1, _C] = sx * g, sy * g
    by_camera[0, _K1], by_camera[1, _K1] = c * sx * h2, c * sy * h2
    depth[0] = d
    return c * sx * g, c * sy * g


LENS = LensModel(("K1",), relative=True, angular=True, project=project)
