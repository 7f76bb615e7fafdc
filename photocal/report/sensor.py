"""Image residuals in the image plane of their camera, whatever unit and axes they were observed in."""

from dataclasses import dataclass

import numpy as np

from photocal.base.arrays import Floats
from photocal.geometry.camera import Camera
from photocal.geometry.distortion import radial_profile as beyond
from photocal.geometry.distortion import radial_profile_sigma
from photocal.report.stored_analysis import AnalysedRun

RADIAL = ("K1", "K2", "K3", "K4")
_PRISM = ("S1", "S2", "S3", "S4")


def radial_profile(camera: Camera, radius: Floats) -> Floats:
    """Evaluate the radial distortion and its standard deviation.

    d(r) = K1 (r^3 - R0^2 r) + K2 (r^5 - R0^4 r) + ..., Brown (1971), the part of the camera equations
    that is added to the projection. The decentring part along the line of its largest effect is
    3 sqrt(P1^2 + P2^2) r^2 (1 + P3 r^2 + P4 r^4) (Brown 1966).

    returns: radius, displacement (measured minus ideal radius: positive outwards), its sigma, and the largest
        displacement by P1 to P4 at that radius, all in the unit of the camera, shape (n, 4).
    """
    r = np.asarray(radius, dtype=np.float64)
    decentring = 3.0 * np.hypot(camera.value("P1"), camera.value("P2"))
    if camera.lens.relative:
        # A lens that is not Brown's.
        c = camera.value("c")
        ray = r / c
        prism = np.hypot(*(camera.value(a) + camera.value(b) * ray**2 for a, b in (_PRISM[:2], _PRISM[2:])))
        swing = c * ray**2 * (decentring + prism)
    else:
        swing = decentring * r**2 * np.abs(1.0 + camera.value("P3") * r**2 + camera.value("P4") * r**4)
    return np.column_stack([r, beyond(camera, r), radial_profile_sigma(camera, r), swing])


def farthest_corner(camera: Camera) -> float:
    """Distance of the principal point from the farthest corner of the image, in the unit of the camera."""
    half = np.array(camera.size_px) * np.array(camera.pitch) / 2
    return float(np.hypot(half[0] + abs(camera.value("x0")), half[1] + abs(camera.value("y0"))))


@dataclass(frozen=True)
class SensorResiduals:
    """Rays of one camera in its image plane: x right, y up from the image centre.

    place (n, 2): measured coordinates, in the unit of the camera.
    residual_px (n, 2): residuals (computed minus measured) in pixels.
    """

    place: Floats
    residual_px: Floats


def sensor_residuals(run: AnalysedRun, camera_id: str) -> SensorResiduals:
    """Take the residuals of one camera to its image plane."""
    camera = run.result.cameras[camera_id]
    rays = run.result.residuals_of(camera_id)
    unit, axes = run.result.block.observation_unit, run.result.block.observation_axes
    return to_plane(camera, rays.measured, rays.residual, unit=unit, axes=axes)


def to_plane(camera: Camera, measured: Floats, residual: Floats, *, unit: str, axes: str) -> SensorResiduals:
    """Turn observed coordinates and residuals into the image plane of a camera."""
    # Pitch in the unit of the observations per pixel, and in the unit of the camera per pixel.
    observed = np.array((1.0, 1.0) if unit == "px" else camera.pitch)
    pixels, vectors = measured / observed, residual / observed
    if axes == "pixel":
        pixels = (pixels - (np.array(camera.size_px) - 1) / 2) * [1.0, -1.0]
        vectors = vectors * [1.0, -1.0]
    return SensorResiduals(pixels * np.array(camera.pitch), vectors)


def thinned(residuals: SensorResiduals, camera: Camera, at_most: int) -> SensorResiduals:
    """Keep every residual, or their means over square cells when there are too many to see."""
    if len(residuals.place) <= at_most:
        return residuals
    extent = np.array(camera.size_px) * np.array(camera.pitch)
    cell = float(np.sqrt(extent[0] * extent[1] / (at_most / 4)))
    columns, rows = (int(k) for k in np.ceil(extent / cell))
    ij = np.clip(np.floor((residuals.place + extent / 2) / cell).astype(np.int64), 0, [columns - 1, rows - 1])
    flat = ij[:, 1] * columns + ij[:, 0]
    rays = np.bincount(flat, minlength=columns * rows)
    full = rays > 0
    total = [
        np.bincount(flat, values, len(rays)) for values in (*residuals.place.T, *residuals.residual_px.T)
    ]
    mean = np.array(total)[:, full] / rays[full]
    return SensorResiduals(mean[:2].T, mean[2:].T)
