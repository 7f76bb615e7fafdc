"""Figures of a calibration flight that run and particulars give together, or that another program printed."""

import math
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

import numpy as np
from pydantic import FiniteFloat, PositiveInt

from photocal.analysis.plausibility import CalibrationRecord, Offsets, effective_unit, plausibility
from photocal.base.checked_toml import Table, read_toml
from photocal.base.errors import ConfigurationError
from photocal.findings.finding import Finding
from photocal.geometry.camera import PARAMETERS, Camera
from photocal.report.camera_sections import rms_px
from photocal.report.certificate_metadata import CameraParticulars, CampaignKeys, GnssInsKeys, Metadata
from photocal.report.sensor import sensor_residuals
from photocal.report.stored_analysis import AnalysedRun

Verdict = Literal["acceptable", "new_calibration", "not_determined"]
Pair = tuple[FiniteFloat, FiniteFloat]
# A block counts as flown when every camera looks down within so many degrees.
NADIR_DEG = 30.0


@dataclass(frozen=True)
class Limit:
    """One figure and what it may not exceed; None where it is not determined.

    key: "image_x", "image_y", "planimetric" or "altimetric".
    """

    key: str
    unit: str
    value: float | None
    limit: float | None

    @property
    def met(self) -> bool | None:
        """Whether the limit is kept; None when not determined."""
        return None if self.value is None or self.limit is None else self.value <= self.limit


def expected_altimetric_error_cm(
    height_m: float | None, base_m: float | None, focal_mm: float | None, pixel_mm: float | None
) -> float | None:
    """Expected altimetric accuracy dz by which the ministry measures the check points; None if unknown.

    Ministry of Defence of Brazil, technical report for aerial survey with remotely piloted aircraft,
    item 2.r.
    """
    if not (height_m and base_m and focal_mm and pixel_mm):
        return None
    return 100.0 * math.sqrt(2.0) * height_m**2 / (base_m * focal_mm) * pixel_mm


def limits(
    image_rmse_mm: tuple[float, float] | None,
    pixel_mm: float | None,
    check_rmse_cm: tuple[float, float] | None,
    gsd_cm: float | None,
    dz_cm: float | None,
) -> tuple[Limit, ...]:
    """Set each figure against its limit."""
    x, y = image_rmse_mm if image_rmse_mm is not None else (None, None)
    plane, height = check_rmse_cm if check_rmse_cm is not None else (None, None)
    return (
        Limit("image_x", "mm", x, pixel_mm),
        Limit("image_y", "mm", y, pixel_mm),
        Limit("planimetric", "cm", plane, gsd_cm),
        Limit("altimetric", "cm", height, dz_cm),
    )


def verdict(checked: tuple[Limit, ...]) -> Verdict:
    """Judge over all limits: one that is broken decides, one that is not determined leaves it open."""
    kept = [limit.met for limit in checked]
    if False in kept:
        return "new_calibration"
    return "acceptable" if all(kept) else "not_determined"


class CalibrationKeys(Table):
    """Table `[calibration]`: parameters as (value, standard deviation), correlations as lower triangle."""

    name: str
    unit: Literal["mm", "px"]
    coefficients: Literal["plane", "normalised"]
    direction: Literal["observed", "ideal"]
    parameters: dict[str, Pair]
    correlation_names: tuple[str, ...] = ()
    correlation: tuple[tuple[FiniteFloat, ...], ...] = ()
    correlation_decimals: PositiveInt = 2


class PrintedCameraKeys(CameraParticulars):
    """Table `[camera]`."""

    size_px: tuple[PositiveInt, PositiveInt] | None = None


class ResidualKeys(Table):
    """Table `[residuals]`: root mean square errors."""

    image_rmse_mm: Pair | None = None
    check_rmse_cm: Pair | None = None


class PrintedKeys(Table):
    """The whole file."""

    calibration: CalibrationKeys
    camera: PrintedCameraKeys = PrintedCameraKeys()
    campaign: CampaignKeys = CampaignKeys()
    gnss_ins: GnssInsKeys = GnssInsKeys()
    residuals: ResidualKeys = ResidualKeys()


def check_printed(path: Path) -> tuple[str, tuple[Finding, ...], tuple[Limit, ...]]:
    """Check a printed calibration against itself.

    path: TOML file with the printed figures.
    returns: its name, findings, and the ministry's limits, with the figures taken as they are printed.
    raises InputNotFoundError: when there is no such file.
    raises ConfigurationError: for a wrong key or value.
    """
    keys = read_toml(path, PrintedKeys)
    record = _record_of_print(keys, path)
    flight, camera = keys.campaign, keys.camera
    # The form works with the focal length in millimetres; a value in pixels cannot stand in for it.
    focal = camera.nominal_focal_length_mm
    if effective_unit(record) == "mm":
        focal = record.values["c"]
    pixel = camera.pixel_size_mm
    dz = expected_altimetric_error_cm(flight.flying_height_m, flight.air_base_m, focal, pixel)
    checked = limits(keys.residuals.image_rmse_mm, pixel, keys.residuals.check_rmse_cm, flight.gsd_cm, dz)
    return keys.calibration.name, plausibility(record), checked


def _record_of_print(keys: PrintedKeys, path: Path) -> CalibrationRecord:
    printed, camera, flight, system = keys.calibration, keys.camera, keys.campaign, keys.gnss_ins
    if not printed.parameters.get("c", (0.0, 0.0))[0] > 0.0:
        raise ConfigurationError("calibration.parameters: c must be positive", "give c", where=path)
    names, rows = printed.correlation_names, printed.correlation
    if [len(row) for row in rows] != list(range(1, len(names) + 1)):
        raise ConfigurationError(
            f"calibration.correlation is not a lower triangle of {len(names)} rows",
            "give each row one number more than the row above",
            where=path,
        )
    matrix = np.eye(len(names))
    for i, row in enumerate(rows):
        matrix[i, : i + 1] = matrix[: i + 1, i] = row
    return CalibrationRecord(
        unit=printed.unit,
        values={name: value for name, (value, _) in printed.parameters.items()},
        sigmas={name: sigma for name, (_, sigma) in printed.parameters.items()},
        coefficients=printed.coefficients,
        direction=printed.direction,
        names=names,
        correlation=matrix if names else None,
        correlation_rounding=0.5 * 10.0**-printed.correlation_decimals,
        size_px=camera.size_px,
        pitch_mm=camera.pixel_size_mm,
        **given_figures(camera, flight, system),
    )


def given_figures(camera: CameraParticulars, campaign: CampaignKeys, system: GnssInsKeys) -> dict[str, Any]:
    """What a person gives of the fields of a `CalibrationRecord`."""
    prior = system.boresight_prior_sigma_deg
    return {
        "sensor_mm": camera.sensor_size_mm,
        "nominal_focal_mm": camera.nominal_focal_length_mm,
        "height_m": campaign.flying_height_m,
        "gsd_cm": campaign.gsd_cm,
        "base_m": campaign.air_base_m,
        "forward_overlap": campaign.forward_overlap,
        "lever_arm_cm": offsets(system.lever_arm_cm, system.lever_arm_sigma_cm),
        "boresight_deg": offsets(system.boresight_deg, system.boresight_sigma_deg, prior),
    }


def offsets(
    values: tuple[float, float, float] | None,
    sigmas: tuple[float, float, float] | None,
    prior: float | None = None,
) -> Offsets | None:
    """Make offsets of what is given; None unless values and standard deviations are."""
    return Offsets(values, sigmas, prior) if values is not None and sigmas is not None else None


@dataclass(frozen=True)
class DerivedFigures:
    """What is known of one camera and its flight; None is not determined.

    height_m, gsd_cm, base_m: flying height over the object points, ground sampling distance, air base.
    computed: which of those three were computed rather than given.
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


def derived_figures(run: AnalysedRun, camera_id: str, particulars: Metadata) -> DerivedFigures:
    """Collect the figures and check them."""
    camera, campaign = run.result.cameras[camera_id], particulars.campaign
    pixel = pixel_size_mm(camera, particulars)
    focal = camera.value("c") if camera.unit == "mm" else camera.value("c") * pixel if pixel else None
    height = campaign.flying_height_m or flying_height(run, camera_id)
    gsd = campaign.gsd_cm or (100.0 * height * pixel / focal if height and pixel and focal else None)
    base = campaign.air_base_m or (air_base(run, camera_id) if height else None)
    given = {"height": campaign.flying_height_m, "gsd": campaign.gsd_cm, "base": campaign.air_base_m}
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


def check_rmse_cm(run: AnalysedRun) -> tuple[float, float] | None:
    """Planimetric and altimetric root mean square error of the check points, cm; None without any."""
    rmse = [run.result.checks.rmse_m.get(axis) for axis in "xyz"]
    x, y, z = (value if value is not None else np.nan for value in rmse)
    if run.result.checks.n == 0 or not np.isfinite([x, y, z]).all():
        return None
    return 100.0 * float(np.hypot(x, y)), 100.0 * float(z)


def flying_height(run: AnalysedRun, camera_id: str) -> float | None:
    """Mean height of the exposures over the object points, m; None unless the cameras look down.

    A free block has the scale that somebody has assumed.
    """
    images = run.result.images_of(camera_id)
    if run.result.block.datum == "free":
        return None
    if not len(images) or not len(run.result.points.names):
        return None
    if np.abs(run.result.images.angles_deg[images, :2]).max() > NADIR_DEG:
        return None
    height = float(run.result.images.station[images, 2].mean() - run.result.points.values[:, 2].mean())
    return height if height > 0.0 else None


def air_base(run: AnalysedRun, camera_id: str) -> float | None:
    """Median distance of an exposure to its nearest neighbour, m; None for a single one."""
    from scipy.spatial import cKDTree

    images = run.result.images_of(camera_id)
    if len(images) < 2:
        return None
    places = run.result.images.station[images]
    distance = np.asarray(cKDTree(places).query(places, k=2)[0], dtype=np.float64)
    base = float(np.median(distance[:, 1]))
    return base if base > 0.0 else None


def _record(run: AnalysedRun, camera_id: str, particulars: Metadata) -> CalibrationRecord:
    camera = run.result.cameras[camera_id]
    prior = dict(zip(PARAMETERS, camera.prior_sigma.tolist(), strict=True))
    # Coefficients of other lenses are not those of Brown's polynomial, which are judged there.
    judged = [name for name in PARAMETERS if not camera.lens.relative or name not in camera.lens.terms]
    free = tuple(name for name in camera.free if name in judged)
    place = sensor_residuals(run, camera_id).place - [camera.value("x0"), camera.value("y0")]
    convergence, spread = network_shape(run, camera_id) or (None, None)
    # What the sides of the pixel do is known where B1 is estimated, or where the analysis has measured it.
    found = () if run.analysis is None else run.analysis.findings
    measured = "B1" in camera.free or any(f.code == "y-scale" and f.subject == camera_id for f in found)
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
        pitch_ratio=1.0 if measured else camera.pitch[0] / camera.pitch[1],
        **given_figures(particulars.camera, particulars.campaign, particulars.gnss_ins),
        convergence_deg=convergence,
        depth_spread=spread,
        stated_sigma_c=run.stated(camera_id)[0],
        prior_sigmas={name: prior[name] for name in camera.free if np.isfinite(prior[name])},
    )


def network_shape(run: AnalysedRun, camera_id: str) -> tuple[float, float] | None:
    """Largest angle between two optical axes of a camera, deg, and the spread of distances along them.

    The spread is the 95th less the 5th percentile over the median.
    """
    result, rays = run.result, run.result.residuals_of(camera_id)
    point = result.observed[rays.point]
    image, point = rays.image[point >= 0], point[point >= 0]
    if not len(image):
        return None
    # The third row of the rotation is the camera's backward axis in object space.
    axes = result.images.rotation[:, 2, :]
    depth = np.abs(
        np.einsum("ij,ij->i", axes[image], result.points.values[point] - result.images.station[image])
    )
    low, middle, high = np.percentile(depth, [5, 50, 95])
    axes = axes[np.unique(image)]
    # Pairs of axes are compared for this many images at most; beyond, every k-th is taken.
    images = 1000
    axes = axes[:: -(-len(axes) // images)]
    angle = np.degrees(np.arccos(np.clip((axes @ axes.T).min(), -1.0, 1.0)))
    return float(angle), float((high - low) / middle)
