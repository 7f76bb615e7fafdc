"""Options of `photocal ppk`, `photocal exposures` and `photocal localise`."""

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

from photocal.base.errors import ConfigurationError
from photocal.base.options import Option, Options


@dataclass(frozen=True, kw_only=True)
class ReceiverOptions(Options):
    """Observations of rover and base, and what is known of the base."""

    rover: Annotated[
        Path | None, Option("Observations of the rover: RINEX (also gz, Z, Hatanaka), or a raw file.")
    ] = None
    base: Annotated[Path | None, Option("Observations of the base, as of the rover.")] = None
    nav: Annotated[
        tuple[str, ...],
        Option("RINEX navigation file; may be repeated. `base`: those that the base's link recorded."),
    ] = ()
    base_position: Annotated[
        str | None,
        Option("LAT,LON,H of the base: degrees, ellipsoidal height in metres; or a CSRS-PPP or SINEX file."),
    ] = None
    base_sigma: Annotated[str | None, Option("Standard deviations E,N,U of the base's position, metres.")] = (
        None
    )
    base_frame: Annotated[
        str | None,
        Option("Frame and epoch of the base's position, as IGS20@2026.9; without: as its file names them."),
    ] = None
    weather: Annotated[
        str | None, Option("TEMPERATURE,HUMIDITY[,PRESSURE] at the base: degrees Celsius, percent, hPa.")
    ] = None
    rover_link: Annotated[str, Option("Link of the rover in the flight log.")] = "rover"
    base_link: Annotated[str, Option("Link of the base in the flight log.")] = "base"


@dataclass(frozen=True, kw_only=True)
class PpkOptions(Options):
    """Antennas, elevation mask and motion of the rover."""

    rover_antenna_height: Annotated[
        float | None,
        Option("Antenna reference point above the rover's mark, metres; without: RINEX header."),
    ] = None
    base_antenna_height: Annotated[
        float | None, Option("Antenna reference point above the base's mark, metres; without: RINEX header.")
    ] = None
    antex: Annotated[Path | None, Option("Antenna models: an ANTEX file, such as igs20.atx of the IGS.")] = (
        None
    )
    rover_antenna: Annotated[
        str, Option("Type and radome of the rover's antenna in that file; none: without a model.")
    ] = ""
    base_antenna: Annotated[str, Option("The base's; without: as the RINEX header names it.")] = ""
    crs: Annotated[
        str | None,
        Option("System of the control, as EPSG:31982: the base is moved to its frame and epoch."),
    ] = None
    elevation: Annotated[float, Option("Elevation mask, degrees.")] = 15.0
    static: Annotated[bool, Option("The rover stood still: one position.", ("--static",))] = False


@dataclass(frozen=True, kw_only=True)
class ExposureOptions(Options):
    """Images and events, delay, lever arm and boresight, and what checks the exposures."""

    images: Annotated[Path | None, Option("Folder of the images, or a table image,taken[,camera].")] = None
    mrk: Annotated[Path | None, Option("The vehicle's own event list (Timestamp.MRK).")] = None
    edge: Annotated[str, Option("Edge of the time marks: rising or falling.")] = "rising"
    delay: Annotated[float, Option("Delay from the event to the exposure, seconds.")] = 0.0
    delay_sigma: Annotated[
        float, Option("Standard deviation of the delay from exposure to exposure, seconds.")
    ] = 0.0
    camera_to_antenna: Annotated[
        str | None,
        Option(
            "Lever arm: X,Y,Z from the camera's projection centre to the antenna, metres forward, "
            "right, down (above is negative)."
        ),
    ] = None
    camera_to_antenna_sigma: Annotated[str, Option("Standard deviations of the lever arm, metres.")] = (
        "0.01,0.01,0.01"
    )
    attitude_sigma: Annotated[str | None, Option("Standard deviations of roll, pitch, yaw, degrees.")] = None
    boresight: Annotated[
        str, Option("Rotation from nominal to true camera axes, about camera x, y, z, degrees.")
    ] = "0,0,0"
    boresight_sigma: Annotated[str, Option("Standard deviations of the boresight, degrees.")] = "0,0,0"
    camera_axes: Annotated[
        str, Option("Body directions of camera x (right), y (up in the image), z (backwards).")
    ] = "right,forward,up"
    clock_offset: Annotated[
        float, Option("Largest offset between the camera's clock and the log's, seconds.")
    ] = 60.0
    camera: Annotated[str, Option("Id of the camera in images.csv.")] = "camera"
    crs: Annotated[str | None, Option("System of images.csv, such as EPSG:32722; without: local.")] = None
    oriented: Annotated[
        Path | None, Option("Run folder of an adjustment of these images: its positions check the exposures.")
    ] = None
    check_images: Annotated[
        bool, Option("Orient the images by tie points and compare their rotations.", ("--check-images",))
    ] = False

    def __post_init__(self) -> None:
        """Refuse what is not an edge of a pulse."""
        if self.edge not in ("rising", "falling"):
            raise ConfigurationError(f"{self.edge!r} is not an edge", "rising or falling", where="--edge")


@dataclass(frozen=True, kw_only=True)
class SiteOptions(Options):
    """Scale, heights and points of a site calibration."""

    crs: Annotated[str, Option("Map system of the second table, such as EPSG:31982.")]
    scale: Annotated[str, Option("free, ground (metres on the ground), or a number: local over map.")] = (
        "free"
    )
    level: Annotated[bool, Option("Estimate a shift of the heights, not a tilted plane.")] = False
    without: Annotated[str, Option("Common points to leave out, separated by commas.")] = ""

    @property
    def left_out(self) -> tuple[str, ...]:
        """Names of the common points that are not used."""
        return tuple(name.strip() for name in self.without.split(",") if name.strip())
