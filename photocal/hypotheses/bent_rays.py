"""Rays that the air bends, and heights above a curved earth that were taken in a plane, as fields."""

import numpy as np

from photocal.adjustment.adjusted import AdjustedNetwork
from photocal.base.arrays import Floats
from photocal.base.policy import policy
from photocal.geometry.refraction import apparent_rise
from photocal.hypotheses.fields import RayField


def bent_rays(adjusted: AdjustedNetwork) -> tuple[RayField, ...]:
    """List refraction (by its coefficient) and curvature (1: neglected, -1: applied to a plane) by camera.

    At one height both are a radial term: only another height, oblique rays or a held lens tell them from it.
    """
    network, state, q = adjusted.network, adjusted.state, adjusted.seen
    image, point = network.rays.image, network.rays.point
    apart, upward = state.points[point] - state.centre[image], state.rotation[image, :, 2]
    camera_of_ray, listed = network.exposures.camera[image], list[RayField]()
    c = state.cameras[camera_of_ray, :1]
    for code, refraction, most in (("refraction", 1.0, policy.refraction), ("earth-curvature", 0.0, 1.0)):
        rise = apparent_rise(apart, refraction, curved=not refraction)
        raised = _raised(c, q, upward * rise[:, None])
        for k in range(len(network.cameras)):
            own = (camera_of_ray == k)[:, None]
            if own.any():
                listed.append(RayField(code, "", k, -raised * own, "1", most))
    return tuple(listed)


def _raised(c: Floats, q: Floats, dq: Floats) -> Floats:
    """Displacement on the image plane of points q in camera axes that seem to lie dq away, (n, 2).

    Distortion is left out.
    """
    return np.asarray(-c * (dq[:, :2] / q[:, 2:] - q[:, :2] * dq[:, 2:] / q[:, 2:] ** 2))
