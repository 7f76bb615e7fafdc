"""What a calibration report states, field by field, with its own units."""

from __future__ import annotations

import tomllib
from dataclasses import dataclass, field
from importlib import resources

import numpy as np
from numpy.typing import NDArray

FloatArray = NDArray[np.float64]


@dataclass(frozen=True)
class StatedParameter:
    """A parameter as printed: value and standard deviation in the printed unit."""

    name: str
    value: float
    sigma: float


@dataclass(frozen=True)
class Corner:
    """A row of the corner table of the ministry's form."""

    column_px: float
    line_px: float
    x_mm: float
    y_mm: float


@dataclass(frozen=True)
class StatedReport:
    """A calibration report as it stands on paper; what it does not state is None or empty.

    Attributes
    ----------
    camera_model : str or None
        Camera, as named.
    pixel_mm : float or None
        Pixel size, mm.
    pixel_text_mm : float or None
        Pixel size as the running text gives it, mm, where it is given a second time.
    columns, rows : int or None
        Image size, px.
    focal_nominal_mm : float or None
        Nominal focal length.
    focal_calibrated_mm : float or None
        What stands in the table of the calibrated parameters under the unit mm.
    focal_form_mm : float or None
        What stands in the field "calibrated focal length".
    height_m, gsd_m, base_m : float or None
        Flying height above ground, ground sample distance, air base.
    forward_overlap : float or None
        Share of the footprint.
    exposure_s : float or None
        Exposure time.
    parameters : tuple of StatedParameter
        Table of the interior orientation.
    parameters_elsewhere : tuple of StatedParameter
        The same table where it stands a second time.
    correlation_names : tuple of str
        Order of the correlation matrix.
    correlation : ndarray or None
        Correlation matrix, with `correlation_decimals` decimals.
    lever_arm, boresight : tuple of StatedParameter
        Mounting parameters.
    eo_rmse_m : float or None
        Planimetric RMSE between original and adjusted exposure positions.
    eo_angle_rmse_rad : float or None
        The same for the angles.
    camera_position_error_m : float or None
        Largest camera position error that the report tells elsewhere.
    positions_deg : tuple of tuple of str
        Latitude and longitude of targets as printed, digit by digit.
    check_rmse_m : float or None
        Planimetric RMSE at the check points.
    targets, control_points, check_points : int or None
        How many.
    corners : tuple of Corner
        Corner table.
    claimed_class : str or None
        Accuracy class that is claimed.
    claimed_scale : float or None
        Scale denominator that the class refers to.
    claimed_interval_m : float or None
        Contour interval that the class refers to.
    """

    camera_model: str | None = None
    pixel_mm: float | None = None
    pixel_text_mm: float | None = None
    columns: int | None = None
    rows: int | None = None
    focal_nominal_mm: float | None = None
    focal_calibrated_mm: float | None = None
    focal_form_mm: float | None = None
    height_m: float | None = None
    gsd_m: float | None = None
    base_m: float | None = None
    forward_overlap: float | None = None
    exposure_s: float | None = None
    parameters: tuple[StatedParameter, ...] = ()
    parameters_elsewhere: tuple[StatedParameter, ...] = ()
    correlation_names: tuple[str, ...] = ()
    correlation: FloatArray | None = None
    correlation_decimals: int = 2
    lever_arm: tuple[StatedParameter, ...] = ()
    boresight: tuple[StatedParameter, ...] = ()
    eo_rmse_m: float | None = None
    eo_angle_rmse_rad: float | None = None
    camera_position_error_m: float | None = None
    positions_deg: tuple[tuple[str, str], ...] = ()
    check_rmse_m: float | None = None
    targets: int | None = None
    control_points: int | None = None
    check_points: int | None = None
    corners: tuple[Corner, ...] = field(default=())
    claimed_class: str | None = None
    claimed_scale: float | None = None
    claimed_interval_m: float | None = None


@dataclass(frozen=True)
class KnownCamera:
    """Image format and sensor of a camera model."""

    model: str
    aliases: tuple[str, ...]
    columns: int
    rows: int
    sensor_mm: tuple[float, float]

    @property
    def pixel_mm(self) -> float:
        """Pixel pitch from sensor width and columns, mm."""
        return self.sensor_mm[0] / self.columns


def known_cameras() -> tuple[KnownCamera, ...]:
    """Read the cameras that the package knows."""
    text = (resources.files(__package__) / "cameras.toml").read_text(encoding="utf-8")
    return tuple(
        KnownCamera(
            entry["model"],
            tuple(entry["aliases"]),
            entry["columns"],
            entry["rows"],
            (entry["sensor_mm"][0], entry["sensor_mm"][1]),
        )
        for entry in tomllib.loads(text)["camera"]
    )


def find_camera(name: str | None, cameras: tuple[KnownCamera, ...]) -> KnownCamera | None:
    """Find a camera by its model or an alias."""
    wanted = (name or "").casefold()
    return next(
        (c for c in cameras if wanted in {c.model.casefold(), *(alias.casefold() for alias in c.aliases)}),
        None,
    )
