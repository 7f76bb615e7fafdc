"""Figures of a calibration flight that the run and the particulars give together."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from drivers.arrays import Floats
from photocal.analysis.plausibility import CalibrationRecord, plausibility
from photocal.findings.finding import Finding
from photocal.geometry.camera import PARAMETERS, Camera
from photocal.report.acceptance import Limit, expected_altimetric_error_cm, limits
from photocal.report.certificate_metadata import Metadata
from photocal.report.image_sections import rms_px
from photocal.report.printed import given_figures
from photocal.report.sensor import sensor_residuals
from photocal.report.stored_analysis import Run

# A block counts as flown when every camera looks down within so many degrees.
NADIR_DEG = 30.0


@dataclass(frozen=True)
class DerivedFigures:
    """What is known of one camera and its flight; None is not determined.

    camera_id: the camera.
    pixel_mm, focal_mm: pixel size and calibrated principal distance, mm.
    height_m, gsd_cm, base_m: flying height over the object points, ground sampling distance, air base.
    computed: which of those three were computed rather than given.
    dz_cm: expected altimetric accuracy.
    limits: the ministry's limits.
    findings: contradictions.
    """

    camera_id: str
    pixel_mm: float | None
    focal_mm: float | None
    height_m: float | None
    gsd_cm: float | None
    base_m: float | None
    computed: frozenset[str]
    dz_cm: float | None
    limits: tuple[Limit, ...]
    findings: tuple[Finding, ...]


def derived_figures(run: Run, camera_id: str, particulars: Metadata) -> DerivedFigures:
    """Collect the figures and check them."""
    camera, campaign = run.result.cameras[camera_id], particulars.campaign
    pixel = pixel_size_mm(camera, particulars)
    focal = camera.value("c") if camera.unit == "mm" else camera.value("c") * pixel if pixel else None
    height = campaign.flying_height_m or flying_height(run, camera_id)
    gsd = campaign.gsd_cm or (100.0 * height * pixel / focal if height and pixel and focal else None)
    base = campaign.air_base_m or (air_base(run, camera_id) if height else None)
    given = {"height": campaign.flying_height_m, "gsd": campaign.gsd_cm, "base": campaign.air_base_m}
    dz = None
    if height and base and focal and pixel:
        dz = expected_altimetric_error_cm(height, base, focal, pixel)
    rms = rms_px(sensor_residuals(run, camera_id))
    image = (rms[0] * pixel, rms[1] * pixel) if pixel else None
    return DerivedFigures(
        camera_id,
        pixel,
        focal,
        height,
        gsd,
        base,
        frozenset(name for name, value in given.items() if value is None),
        dz,
        limits(image, pixel, check_rmse_cm(run), gsd, dz),
        plausibility(_record(run, camera_id, particulars)),
    )


def pixel_size_mm(camera: Camera, particulars: Metadata) -> float | None:
    """Pixel size in mm: that of the adjustment, or the one given for a camera in pixels."""
    if camera.unit == "mm":
        return float(np.mean(camera.pitch))
    return particulars.camera.pixel_size_mm


def check_rmse_cm(run: Run) -> tuple[float, float] | None:
    """Planimetric and altimetric root mean square error of the check points, cm; None without any."""
    rmse = [run.result.checks.rmse_m.get(axis) for axis in "xyz"]
    x, y, z = (value if value is not None else np.nan for value in rmse)
    if run.result.checks.n == 0 or not np.isfinite([x, y, z]).all():
        return None
    return 100.0 * float(np.hypot(x, y)), 100.0 * float(z)


def flying_height(run: Run, camera_id: str) -> float | None:
    """Mean height of the exposures over the object points, m; None unless the cameras look down."""
    own = run.result.images_of(camera_id)
    if not len(own) or not len(run.result.points.names):
        return None
    if np.abs(run.result.images.angles_deg[own, :2]).max() > NADIR_DEG:
        return None
    height = float(run.result.images.station[own, 2].mean() - run.result.points.values[:, 2].mean())
    return height if height > 0.0 else None


def air_base(run: Run, camera_id: str) -> float | None:
    """Median distance of an exposure to its nearest neighbour, m; None for a single one."""
    from scipy.spatial import cKDTree

    own = run.result.images_of(camera_id)
    if len(own) < 2:
        return None
    places = run.result.images.station[own]
    distance = np.asarray(cKDTree(places).query(places, k=2)[0], dtype=np.float64)
    base = float(np.median(distance[:, 1]))
    return base if base > 0.0 else None


def _record(run: Run, camera_id: str, particulars: Metadata) -> CalibrationRecord:
    camera = run.result.cameras[camera_id]
    prior = dict(zip(PARAMETERS, camera.prior_sigma.tolist(), strict=True))
    # Coefficients of other lenses are not those of Brown's polynomial, which are judged there.
    judged = [name for name in PARAMETERS if not camera.lens.relative or name not in camera.lens.terms]
    free = tuple(name for name in camera.free if name in judged)
    place = sensor_residuals(run, camera_id).place - [camera.value("x0"), camera.value("y0")]
    shape = network_shape(run, camera_id)
    return CalibrationRecord(
        unit=camera.unit,
        values={name: camera.value(name) for name in judged},
        sigmas={name: camera.sigma_of(name) for name in free},
        direction="observed" if camera.model == "brown-observed" else "ideal",
        reference_radius=camera.reference_radius,
        names=free,
        correlation=camera.correlation_of(free) if free else None,
        size_px=camera.size_px,
        observed_radius=float(np.hypot(*place.T).max()) if len(place) else None,
        pitch_mm=pixel_size_mm(camera, particulars),
        pitch_ratio=camera.pitch[0] / camera.pitch[1],
        **given_figures(particulars.camera, particulars.campaign, particulars.gnss_ins),
        convergence_deg=shape.convergence_deg if shape else None,
        depth_spread=shape.depth_spread if shape else None,
        prior_sigmas={name: prior[name] for name in camera.free if np.isfinite(prior[name])},
    )


# Pairs of axes are compared for this many images at most; beyond, every k-th is taken.
IMAGES = 1000


@dataclass(frozen=True)
class NetworkShape:
    """Two figures of a network.

    convergence_deg: largest angle between two optical axes.
    depth_spread: distances of the points along the axes: 95th less 5th percentile over the median.
    """

    convergence_deg: float
    depth_spread: float


def network_shape(run: Run, camera_id: str) -> NetworkShape | None:
    """Measure the exposures of one camera."""
    result, rays = run.result, run.result.residuals_of(camera_id)
    place = {name: j for j, name in enumerate(result.points.names)}
    point = np.array([place.get(name, -1) for name in rays.point_names], dtype=np.int64)[rays.point]
    image, point = rays.image[point >= 0], point[point >= 0]
    if not len(image):
        return None
    # The third row of the rotation is the camera's backward axis in object space.
    axes = result.images.rotation[:, 2, :]
    depth = np.abs(
        np.einsum("ij,ij->i", axes[image], result.points.values[point] - result.images.station[image])
    )
    low, middle, high = np.percentile(depth, [5, 50, 95])
    own = axes[np.unique(image)]
    own = own[:: -(-len(own) // IMAGES)]
    return NetworkShape(_largest_angle(own), float((high - low) / middle))


def _largest_angle(axes: Floats) -> float:
    return float(np.degrees(np.arccos(np.clip((axes @ axes.T).min(), -1.0, 1.0))))
