"""A maker's tag against the camera that an adjustment found: how far apart they record the same rays."""

import numpy as np

from photocal.base.arrays import Floats
from photocal.base.policy import policy
from photocal.findings.finding import Finding
from photocal.geometry.camera import PARAMETERS, Camera
from photocal.geometry.distortion import projected, undistorted

CODE = "maker-tag"
# Step of a derivative, in standard deviations.
_STEP = 0.1


def tag_finding(camera: Camera) -> Finding | None:
    """Say by how much the tag that a camera came with is wrong in a corner; None where it is not shown to be.

    A maker's calibration is a prior: what contradicts it says something about the tag, not that the camera
    has changed.
    """
    if not camera.stated_by or camera.given is None or camera.sigma is None:
        return None
    corners = 0.5 * np.array([[-1.0, 1.0], [1.0, 1.0], [1.0, -1.0], [-1.0, -1.0]])
    corners *= np.array(camera.size_px) * camera.pitch
    rays = undistorted(camera, corners) / camera.value("c")
    q = np.column_stack([rays, np.full(len(rays), -1.0)])
    apart = projected(camera.with_values(camera.given), q) - corners
    spread = _sigma_along(camera, q, apart)
    size = np.linalg.norm(apart, axis=1)
    seen = np.isfinite(size)
    if not seen.any():
        return None
    worst = int(np.nanargmax(size))
    px, sigma_px = size[worst] / camera.pitch[0], spread[worst] / camera.pitch[0]
    if px < policy.small_px or px < policy.times_999 * sigma_px:
        return None
    moved = np.abs(camera.values - camera.given)
    names = tuple(
        n for n in camera.free if moved[PARAMETERS.index(n)] > policy.times_999 * camera.sigma_of(n)
    )
    figures = {"camera": camera.id, "tag": camera.stated_by, "px": float(px), "sigma_px": float(sigma_px)}
    return Finding(CODE, "note", camera.id, {**figures, "names": names or camera.free})


def _sigma_along(camera: Camera, q: Floats, apart: Floats) -> Floats:
    """Standard deviations of where the adjusted camera records rays, along what it is apart by (n,)."""
    way = apart / np.maximum(np.linalg.norm(apart, axis=1), 1e-300)[:, None]
    covariance = camera.covariance_of(camera.free)
    slopes = np.empty((len(q), len(camera.free)))
    for j, name in enumerate(camera.free):
        step = _STEP * camera.sigma_of(name)
        ahead, behind = (
            projected(camera.changed(**{name: camera.value(name) + sign * step}), q) for sign in (1.0, -1.0)
        )
        slopes[:, j] = np.einsum("ni,ni->n", ahead - behind, way) / max(2.0 * step, 1e-300)
    return np.asarray(np.sqrt(np.maximum(np.einsum("ni,ij,nj->n", slopes, covariance, slopes), 0.0)))
