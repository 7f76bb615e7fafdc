"""A calibration that another program printed: what can be checked of it without its inputs."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

import numpy as np
from pydantic import FiniteFloat, PositiveInt

from acquire.checked_toml import Table, read_toml
from drivers.errors import ConfigurationError
from photocal.analysis.plausibility import CalibrationRecord, Offsets, effective_unit, plausibility
from photocal.findings.finding import Finding
from photocal.report.acceptance import Limit, expected_altimetric_error_cm, limits
from photocal.report.certificate_metadata import CameraKeys, CampaignKeys, GnssInsKeys

Pair = tuple[FiniteFloat, FiniteFloat]


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


class PrintedCameraKeys(CameraKeys):
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


@dataclass(frozen=True)
class PrintedCheck:
    """What the check of a printed calibration gave.

    name: what the calibration is of.
    findings: worst first.
    limits: the ministry's limits, with the figures taken as they are printed.
    """

    name: str
    findings: tuple[Finding, ...]
    limits: tuple[Limit, ...]


def check_printed(path: Path) -> PrintedCheck:
    """Check a printed calibration against itself.

    path: TOML file with the printed figures.
    raises InputNotFoundError: when there is no such file.
    raises ConfigurationError: for a wrong key or value.
    """
    keys = read_toml(path, PrintedKeys)
    record = _record(keys, path)
    flight, camera = keys.campaign, keys.camera
    # The form works with the focal length in millimetres; a value in pixels cannot stand in for it.
    focal = camera.nominal_focal_length_mm
    if effective_unit(record) == "mm":
        focal = record.values["c"]
    dz = None
    if flight.flying_height_m and flight.air_base_m and focal and camera.pixel_size_mm:
        dz = expected_altimetric_error_cm(
            flight.flying_height_m, flight.air_base_m, focal, camera.pixel_size_mm
        )
    checked = limits(
        keys.residuals.image_rmse_mm,
        camera.pixel_size_mm,
        keys.residuals.check_rmse_cm,
        flight.gsd_cm,
        dz,
    )
    return PrintedCheck(keys.calibration.name, plausibility(record), checked)


def _record(keys: PrintedKeys, path: Path) -> CalibrationRecord:
    printed, camera, flight, system = keys.calibration, keys.camera, keys.campaign, keys.gnss_ins
    if not printed.parameters.get("c", (0.0, 0.0))[0] > 0.0:
        raise ConfigurationError("calibration.parameters: c must be positive", where=path, remedy="give c")
    names, rows = printed.correlation_names, printed.correlation
    if [len(row) for row in rows] != list(range(1, len(names) + 1)):
        raise ConfigurationError(
            f"calibration.correlation is no lower triangle of {len(names)} rows",
            where=path,
            remedy="give one number more in each row",
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


def given_figures(camera: CameraKeys, campaign: CampaignKeys, system: GnssInsKeys) -> dict[str, Any]:
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
    """Make offsets of what is given; None unless values and standard deviations are.

    values, sigmas: three components and their standard deviations.
    prior: standard deviation beforehand.
    """
    return Offsets(values, sigmas, prior) if values is not None and sigmas is not None else None
