"""Options of `photocal plan` and `photocal flown`."""

import math
import re
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from photocal.base.console import numbers_of
from photocal.base.errors import ConfigurationError
from photocal.base.options import Option, Options

if TYPE_CHECKING:
    from photocal.planning.flight import FlightRequest

_SIZE = re.compile(r"^(?P<columns>[0-9]+)\s*[xX]\s*(?P<rows>[0-9]+)$")


@dataclass(frozen=True, kw_only=True)
class FlightOptions(Options):
    """Camera, height, overlaps and strips of a flight."""

    focal_mm: Annotated[float, Option("Principal distance, mm.")]
    pixel_um: Annotated[float, Option("Pixel pitch, micrometres.")]
    image_px: Annotated[str, Option("Image size, columns x rows, such as 5472x3648.")]
    height: Annotated[float | None, Option("Height above ground, m (or --gsd-cm).")] = None
    gsd_cm: Annotated[float | None, Option("Ground sample distance, cm (or --height).")] = None
    forward: Annotated[float, Option("Forward overlap, 0 to 1.")] = 0.8
    side: Annotated[float, Option("Side overlap, 0 to 1.")] = 0.7
    width_along: Annotated[bool, Option("Image width along the flight line (otherwise across it).")] = False
    azimuth_deg: Annotated[
        float | None, Option("Flying direction, degrees from north; without: fewest strips.")
    ] = None
    cross: Annotated[bool, Option("Add cross strips.", ("--cross",))] = False
    second_height: Annotated[
        float | None, Option("Fly the cross strips at this height above ground, m (calibration).")
    ] = None
    speed: Annotated[
        float, Option("Speed over ground, m/s; of a fixed wing in a given wind, through the air.")
    ] = 10.0
    border: Annotated[float, Option("Buffer around the area, m.")] = 0.0

    def request(self) -> "FlightRequest":
        """Give the request in metres and radians.

        Raises
        ------
        ConfigurationError
            For an image size that is none, or when not exactly one of height and ground sample distance is
            given.
        """
        from photocal.planning.flight import FlightRequest, flying_height, planned_camera

        size = _SIZE.match(self.image_px.strip())
        if size is None:
            raise ConfigurationError(
                f"{self.image_px!r} is not an image size", "write columns x rows: 5472x3648"
            )
        size_px = int(size["columns"]), int(size["rows"])
        camera = planned_camera(self.focal_mm, self.pixel_um, size_px)
        if (self.height is None) == (self.gsd_cm is None):
            raise ConfigurationError("give either --height or --gsd-cm")
        height = self.height
        if height is None:
            height = flying_height((self.gsd_cm or 0.0) * 1e-2, camera)
        return FlightRequest(
            camera,
            height,
            self.forward,
            self.side,
            along="columns" if self.width_along else "rows",
            speed_m_s=self.speed,
            azimuth_rad=None if self.azimuth_deg is None else math.radians(self.azimuth_deg),
            cross_strips=self.cross,
            second_height_m=self.second_height,
            border_m=self.border,
        )


@dataclass(frozen=True, kw_only=True)
class LimitOptions(Options):
    """What a planned flight is compared with: wind, radio, the class of its product, the camera's times."""

    wind: Annotated[
        str | None,
        Option("SPEED,FROM: m/s, and the direction it comes from, degrees: the strips are planned for it."),
    ] = None
    radio_range: Annotated[float | None, Option("Range of the radio link, m, to check from --home.")] = None
    scale: Annotated[str | None, Option("Map scale of the product, such as 1:1000.")] = None
    map_class: Annotated[str, Option("Accuracy class that the product must reach.", ("--class",))] = "A"
    standard: Annotated[str, Option("Standard of that class.")] = "pec-pcd"
    exposure_ms: Annotated[float | None, Option("Exposure time, ms, to check the motion blur.")] = None
    shortest_interval: Annotated[
        float | None, Option("Shortest time between two photos of the camera, s.")
    ] = None


@dataclass(frozen=True, kw_only=True)
class MissionOptions(Options):
    """Take-off, ground and vehicle of the mission to be written."""

    home: Annotated[
        str | None, Option("Take-off place: LAT,LON,HEIGHT above mean sea level; needed for a mission.")
    ] = None
    ground_height: Annotated[
        float | None, Option("Mean height of the area above mean sea level, m; needed for a mission.")
    ] = None
    autopilot: Annotated[str, Option("ardupilot or px4.")] = "ardupilot"
    vehicle: Annotated[str, Option("quadrotor or fixed-wing.")] = "quadrotor"

    def __post_init__(self) -> None:
        """Refuse half a mission."""
        if (self.home is None) != (self.ground_height is None):
            raise ConfigurationError("a mission needs both --home and --ground-height")


@dataclass(frozen=True, kw_only=True)
class PrecisionOptions(Options):
    """Ground points to suggest, and the observations with which the planned flight is adjusted."""

    control: Annotated[int, Option("Number of control points to suggest.")] = 8
    check: Annotated[int, Option("Number of check points to suggest.")] = 30
    simulation: Annotated[
        bool, Option("Simulate and adjust the planned flight to predict its precision.")
    ] = True
    image_sigma_px: Annotated[float, Option("Expected precision in the image, px.")] = 0.5
    control_sigma_m: Annotated[str, Option("Expected precision of control in plane and height, m.")] = (
        "0.02,0.03"
    )
    gnss_sigma_m: Annotated[str | None, Option("Precision of exposure positions in plane and height, m.")] = (
        None
    )
    calibrate: Annotated[bool, Option("Estimate the camera from the flight itself.", ("--calibrate",))] = (
        False
    )
    relief_m: Annotated[float, Option("Terrain above and below its mean, m.")] = 0.0

    def __post_init__(self) -> None:
        """Refuse a precision that cannot be."""
        if self.simulation and not (self.image_sigma_px > 0.0 and self.relief_m >= 0.0):
            raise ConfigurationError("image precision must be positive and relief not negative")

    @property
    def control_m(self) -> tuple[float, float]:
        """Precision of control in plane and height, m; ConfigurationError for an invalid text."""
        return _pair(self.control_sigma_m)

    @property
    def gnss_m(self) -> tuple[float, float] | None:
        """Precision of positions in plane and height, m, None without; ConfigurationError as above."""
        return None if self.gnss_sigma_m is None else _pair(self.gnss_sigma_m)


def _pair(text: str) -> tuple[float, float]:
    plane, height = numbers_of(text, "sigma", "PLANE,HEIGHT: metres, write 0.02,0.03")
    if not (plane > 0.0 and height > 0.0):
        raise ConfigurationError(f"a precision of {text} m is not positive", "write 0.02,0.03")
    return plane, height


@dataclass(frozen=True, kw_only=True)
class FlownOptions(Options):
    """What a flown block is compared with."""

    images: Annotated[
        Path | None, Option("Folder of the image files, for exposure time, ISO and laser distances.")
    ] = None
    plan: Annotated[Path | None, Option("plan.json of `photocal plan`, to compare with.")] = None
    terrain: Annotated[
        Path | None, Option("Terrain model (GeoTIFF) to check laser distances; without: tie points.")
    ] = None
    terrain_heights: Annotated[
        str | None,
        Option("Heights of that model, ellipsoidal or orthometric, if the file does not state them."),
    ] = None
