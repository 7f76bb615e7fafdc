"""Rays that the air bends, and heights above a curved earth that were taken in a plane, as fields."""

from functools import partial

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
    network = adjusted.network
    camera_of_ray = network.exposures.camera[network.rays.image]
    used = [k for k in range(len(network.cameras)) if (camera_of_ray == k).any()]
    kinds = (("refraction", policy.refraction), ("earth-curvature", 1.0))
    return tuple(
        RayField(code, "", k, partial(_bent, adjusted, code == "earth-curvature", k), "1", most)
        for code, most in kinds
        for k in used
    )


def _bent(adjusted: AdjustedNetwork, curved: bool, camera: int) -> Floats:
    """Displacement of the rays of a camera by refraction of coefficient 1, or by neglected curvature."""
    network, state = adjusted.network, adjusted.state
    image, point = network.rays.image, network.rays.point
    apart, upward = state.points[point] - state.centre[image], state.rotation[image, :, 2]
    camera_of_ray = network.exposures.camera[image]
    rise = apparent_rise(apart, 0.0 if curved else 1.0, curved=curved)
    raised = _raised(state.cameras[camera_of_ray, :1], adjusted.seen, upward * rise[:, None])
    return np.asarray(-raised * (camera_of_ray == camera)[:, None])


def _raised(c: Floats, q: Floats, dq: Floats) -> Floats:
    """Displacement on the image plane of points q in camera axes that seem to lie dq away, (n, 2).

    Distortion is left out.
    """
    return np.asarray(-c * (dq[:, :2] / q[:, 2:] - q[:, :2] * dq[:, 2:] / q[:, 2:] ** 2))
