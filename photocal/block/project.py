"""Project files, and their tables checked key by key."""

from dataclasses import dataclass, replace
from pathlib import Path
from typing import Annotated, Any, Literal, Self, TypeVar

from pydantic import (
    AfterValidator,
    BeforeValidator,
    Discriminator,
    Field,
    FiniteFloat,
    PositiveFloat,
    Tag,
    ValidationInfo,
    model_validator,
)

from photocal.base.checked_toml import Table, read_toml
from photocal.base.errors import ConfigurationError, InputNotFoundError
from photocal.base.files import one_line
from photocal.block.camera_setup import CameraKeys, NonNegative, Sigma, make_camera
from photocal.block.folder import SETUP
from photocal.block.rig import HeadKeys
from photocal.block.setup import BodyAxis, MountingKeys
from photocal.geometry.camera import Camera

Degrees = Annotated[FiniteFloat, Field(ge=-360, le=360)]
Triple = tuple[FiniteFloat, FiniteFloat, FiniteFloat]
Sigmas = tuple[PositiveFloat, PositiveFloat, PositiveFloat]
Part = TypeVar("Part")
# File that `photocal new` writes into the folder of a flight.
NAME = "project.toml"
_LONGEST_NAME = 255


def _beside(path: Path, info: ValidationInfo) -> Path:
    """Take a path from the folder of the project file."""
    if "\0" in str(path) or any(len(part) > _LONGEST_NAME for part in path.parts):
        raise ValueError("is not a valid path")
    return path if info.context is None else Path(info.context["folder"]) / path


Beside = Annotated[Path, AfterValidator(_beside)]


# What `photocal new` writes where it does not know.
ASKED = "?"


class ProjectKeys(Table):
    """`[project]`: name, the coordinates of results and of the control table, the work folder."""

    name: Annotated[str, Field(min_length=1), AfterValidator(one_line)]
    crs: str
    height: Literal["ellipsoidal", "orthometric", "local"]
    output: Beside
    refraction: Annotated[float, Field(ge=-2.0, le=2.0)] | None = None

    @model_validator(mode="before")
    @classmethod
    def _said(cls, given: Any) -> Any:
        open_keys = [key for key, value in given.items() if value == ASKED] if isinstance(given, dict) else []
        if open_keys:
            raise ValueError(f"{open_keys[0]} = {ASKED!r} is still to be filled in")
        return given

    @model_validator(mode="after")
    def _fits(self) -> Self:
        if (self.crs == "local") != (self.height == "local"):
            raise ValueError('crs = "local" and height = "local" go together')
        return self


class AirAtBase(Table):
    """`[flight] weather`: temperature in the shade, humidity, pressure at the place (not of sea level)."""

    temperature_c: Annotated[float, Field(ge=-60, le=60)]
    relative_humidity_percent: Annotated[float, Field(ge=0, le=100)]
    pressure_hpa: Annotated[float, Field(ge=400, le=1100)] | None = None


class FlightKeys(Table):
    """`[flight]`: recordings and what is known of the receivers and the camera's events.

    logs: flight logs in the order of time.
    vehicle, rover, base: names of links in the logs.
    rover_rinex, base_rinex: RINEX observations, which go before the links.
    navigation: RINEX navigation files.
    base_position: latitude, longitude in degrees, ellipsoidal height in m; goes before what the log says.
    base_antenna_height_m, rover_antenna_height_m: antenna reference point above the mark; None: as the RINEX
        headers have it.
    base_sigma_m: standard deviations of the base's position, east, north, up.
    base_frame: `FRAME[@EPOCH]` of the base's position, such as "IGS20@2026.9"; it is moved to that of `crs`.
    weather: measured at the base during the flight.
    edge: of the time marks.
    delay_s: from the event to the exposure.
    clock_offset_s: largest difference between the clocks of camera and log.
    """

    logs: tuple[Beside, ...] = Field(min_length=1)
    vehicle: str = "vehicle"
    rover: str = "rover"
    base: str = "base"
    rover_rinex: Beside | None = None
    base_rinex: Beside | None = None
    navigation: tuple[Beside, ...] = ()
    base_position: tuple[Annotated[float, Field(ge=-90, le=90)], Degrees, FiniteFloat] | None = None
    base_antenna_height_m: FiniteFloat | None = None
    rover_antenna_height_m: FiniteFloat | None = None
    base_sigma_m: Sigmas | None = None
    base_frame: str | None = None
    weather: AirAtBase | None = None
    edge: Literal["rising", "falling"] = "rising"
    delay_s: FiniteFloat = 0.0
    clock_offset_s: PositiveFloat = 60.0


class ImageKeys(Table):
    """`[images]`: a folder of pictures, or without pictures a table of their names and times.

    position_sigma_m: without a flight: east, north, up, of positions whose pictures do not state it; "free"
        takes them as start values only, None assumes what a receiver without corrections reaches.
    positions: without a flight: a `Timestamp.MRK`, `_events.pos` of RTKLIB, table of times and places,
        geo.txt or reference table, whose positions go before those of the pictures.
    position_frame: without a flight: `FRAME[@EPOCH]` of these positions, that of the caster, such as
        "IGS20@2026.9"; they are moved to that of the project.
    pictures: table of pictures with the camera that took each and, of cameras on one frame, the exposure.
    lens: "unknown" where the rays may choose between Brown's two lenses, with and without K4.
    laser: laser distances of the pictures check the heights of the block, or are observations of it.
    """

    folder: Beside | None = None
    pictures: Beside | None = None
    times: Beside | None = None
    positions: Beside | None = None
    position_sigma_m: Sigmas | Literal["free"] | None = None
    position_frame: str | None = None
    lens: Literal["given", "unknown"] = "given"
    laser: Literal["check", "observation"] = "check"

    @model_validator(mode="after")
    def _one(self) -> Self:
        if (self.folder is None) == (self.times is None):
            raise ValueError("give either folder (pictures) or times (a table of names and times)")
        if self.laser == "observation" and self.folder is None:
            raise ValueError('laser = "observation" needs pictures: give folder')
        return self


class RigSettings(Table):
    """`[rig]`: camera, antenna and inertial unit beside each other, in body axes forward, right, down.

    camera_to_antenna_m: vector from the projection centre to the antenna.
    camera_to_antenna_sigma_m: float, 3 of them, or "free". One rule holds for all of these: 0 holds the
        value, a number makes it an observation.
    boresight_deg, boresight_sigma_deg: small turns about the body axes between body and camera.
    attitude_sigma_deg: of roll, pitch, yaw.
    time_offset_s, time_offset_sigma_s: of the exposure against its event, beyond `delay_s`.
    camera_axes: body directions of the camera's x (right), y (up in the image), z (backwards).
    """

    camera_to_antenna_m: Triple
    camera_to_antenna_sigma_m: Sigma
    boresight_deg: Triple = (0.0, 0.0, 0.0)
    boresight_sigma_deg: Sigma
    attitude_sigma_deg: Sigmas
    time_offset_s: FiniteFloat = 0.0
    time_offset_sigma_s: NonNegative | Literal["free"]
    camera_axes: tuple[BodyAxis, BodyAxis, BodyAxis] = ("right", "forward", "up")

    def mounting(self) -> MountingKeys:
        """Give the section `[mounting]` of a block."""
        return MountingKeys(
            lever_arm_m=self.camera_to_antenna_m,
            lever_arm_sigma_m=self.camera_to_antenna_sigma_m,
            boresight_deg=self.boresight_deg,
            boresight_sigma_deg=self.boresight_sigma_deg,
            time_offset_s=self.time_offset_s,
            time_offset_sigma_s=self.time_offset_sigma_s,
            camera_axes=self.camera_axes,
        )


class CodedTargets(Table):
    """`targets` of `[control]` with a code: found in whole images, named by it."""

    dictionary: str
    side_m: PositiveFloat
    names: dict[str, str]


class PlainTargets(Table):
    """`targets` of `[control]` without a code: found and named where the exposures predict them.

    kind: as `photocal targets` prints them.
    side_m: diameter, or side of the square around the target.
    part: width of a cross's bars, or diameter of a ring's hole, as a part of `side_m`; None: as printed.
    points: control and check points that have such a target; empty for all.
    """

    kind: Literal["disc", "ring", "cross", "hourglass"]
    side_m: PositiveFloat
    part: Annotated[float, Field(ge=0.05, le=0.9)] | None = None
    points: tuple[str, ...] = ()

    @model_validator(mode="after")
    def _fits(self) -> Self:
        if self.part is not None and self.kind not in ("ring", "cross"):
            raise ValueError(f"a {self.kind} has no key part: remove it")
        return self


def _variant(given: Any) -> str:
    plain = isinstance(given, PlainTargets) or (isinstance(given, dict) and "kind" in given)
    return "<plain>" if plain else "<coded>"


Targets = Annotated[
    Annotated[CodedTargets, Tag("<coded>")] | Annotated[PlainTargets, Tag("<plain>")], Discriminator(_variant)
]


class Control(Table):
    """`[control]`: surveyed points, marks made by hand, distances, targets that are found by themselves."""

    points: Beside | None = None
    marks: Beside | None = None
    distances: Beside | None = None
    # One table is a list of one.
    targets: Annotated[
        tuple[Targets, ...], BeforeValidator(lambda value: (value,) if isinstance(value, dict) else value)
    ] = ()

    @property
    def coded_targets(self) -> tuple[CodedTargets, ...]:
        """Targets with a code."""
        return tuple(target for target in self.targets if isinstance(target, CodedTargets))

    @property
    def plain_targets(self) -> tuple[PlainTargets, ...]:
        """Targets without a code."""
        return tuple(target for target in self.targets if isinstance(target, PlainTargets))


class Measurements(Table):
    """`[measurements]`: what was measured elsewhere.

    observations: instead of measuring in pictures: `observations.csv` as in a block folder, in pixels.
    sigma_px: of observations without sigmas of their own.
    block: instead of flight, images, rig, cameras and control: a block folder that has all of them.
    """

    observations: Beside | None = None
    sigma_px: PositiveFloat | None = None
    block: Beside | None = None

    @model_validator(mode="after")
    def _one(self) -> Self:
        if (self.observations is None) == (self.block is None):
            raise ValueError("give either observations (a table) or block (a folder)")
        return self


class WantedCalibration(Table):
    """`[calibration]`: standard deviation of the principal distance that the flight is to reach."""

    c_sigma_px: PositiveFloat | None = None
    c_sigma_percent: PositiveFloat | None = None

    @model_validator(mode="after")
    def _one(self) -> Self:
        if self.c_sigma_px is not None and self.c_sigma_percent is not None:
            raise ValueError("give either c_sigma_px or c_sigma_percent")
        return self


class JudgementKeys(Table):
    """`[judgement]`: what the check points are judged against."""

    scale: str | None = None
    contour_interval_m: PositiveFloat | None = None
    standards: tuple[str, ...] = ()
    survey_horizontal_m: PositiveFloat | None = None
    survey_vertical_m: PositiveFloat | None = None
    target_horizontal_m: PositiveFloat | None = None
    target_vertical_m: PositiveFloat | None = None


class LeaveOutKeys(Table):
    """`[[leave_out]]`: what a person takes out of the block before it is adjusted.

    image, point: both for one observation, one of them for the whole image or point.
    reason: as it stands on the certificate.
    """

    image: Annotated[str, Field(min_length=1)] | None = None
    point: Annotated[str, Field(min_length=1)] | None = None
    reason: Annotated[str, Field(min_length=1, max_length=400), AfterValidator(one_line)]

    @model_validator(mode="after")
    def _something(self) -> Self:
        if self.image is None and self.point is None:
            raise ValueError("name an image, a point, or both for one observation")
        return self


class CertificateKeys(Table):
    """`[certificate]`: what only people know, the `plan.json` that was flown, a form, and the language.

    English where no language is given: a project has one certificate, whoever runs it. `photocal new`
    writes the language in which it was asked.
    """

    particulars: Beside | None = None
    plan: Beside | None = None
    client: str = ""
    operator: str = ""
    form: Literal["", "br-md"] = ""
    language: Literal["en", "pt-BR"] | None = None


class Contents(Table):
    """The whole file."""

    project: ProjectKeys
    flight: FlightKeys | None = None
    images: ImageKeys | None = None
    rig: RigSettings | None = None
    camera: tuple[CameraKeys, ...] = ()
    head: tuple[HeadKeys, ...] = ()
    control: Control | None = None
    measurements: Measurements | None = None
    leave_out: tuple[LeaveOutKeys, ...] = ()
    calibration: WantedCalibration = WantedCalibration()
    judgement: JudgementKeys = JudgementKeys()
    certificate: CertificateKeys = CertificateKeys()

    @model_validator(mode="after")
    def _fits(self) -> Self:
        sections = ("flight", "images", "rig", "camera", "control")
        given = [name for name in sections if getattr(self, name)]
        if self.images is not None and {"folder"} <= self.images.model_fields_set <= {"folder", "laser"}:
            # Pictures of a ready block are shown, and their laser is read, but nothing is measured.
            given.remove("images")
        if self.measurements is not None and self.measurements.block is not None and given:
            raise ValueError(f"[{given[0]}] is given with a ready block, which contains it: remove one")
        if len({camera.id for camera in self.camera}) < len(self.camera):
            raise ValueError("two cameras have the same id: rename one")
        return self


@dataclass(frozen=True, repr=False)
class Project:
    """A project file that was read and checked; a person writes it, or `photocal new`.

    Attributes
    ----------
    path
        The file.
    contents
        Its tables; paths are taken from the folder of the file.
    cameras
        Of `[[camera]]`.
    """

    path: Path
    contents: Contents
    cameras: tuple[Camera, ...]

    @staticmethod
    def read(path: str | Path) -> "Project":
        """Read a project file, or that of a folder; errors as of `read_project`."""
        return read_project(Path(path))

    def __repr__(self) -> str:
        """Say in one line what it names and where it works."""
        named = [name for name, part in self.contents if part and name not in ("project", "camera")]
        lenses = ", ".join(camera.id for camera in self.cameras) or "none"
        return (
            f"Project {self.name} ({self.crs}, {self.height} heights): {', '.join(named) or 'no sections'}; "
            f"cameras {lenses}; output {self.output}"
        )

    @property
    def name(self) -> str:
        """Name of the project."""
        return self.contents.project.name

    @property
    def crs(self) -> str:
        """System of results and control: a name such as "EPSG:31982", or "local"."""
        return self.contents.project.crs

    @property
    def height(self) -> str:
        """Kind of the heights in it: ellipsoidal, orthometric or local."""
        return self.contents.project.height

    @property
    def output(self) -> Path:
        """Work folder, with one folder for each stage of `photocal run`."""
        return self.contents.project.output

    @property
    def flight(self) -> FlightKeys:
        """`[flight]`; ConfigurationError without it, as for all sections below."""
        return self._needed(self.contents.flight, "[flight]")

    @property
    def images(self) -> ImageKeys:
        """`[images]`."""
        return self._needed(self.contents.images, "[images]")

    @property
    def picture_folder(self) -> Path:
        """Folder of the pictures."""
        return self._needed(self.images.folder, "folder in [images]")

    @property
    def rig(self) -> RigSettings:
        """`[rig]`."""
        return self._needed(self.contents.rig, "[rig]")

    @property
    def control(self) -> Control:
        """`[control]`; empty without it."""
        return self.contents.control or Control()

    @property
    def camera(self) -> Camera:
        """The only camera."""
        if len(self.cameras) > 1:
            raise ConfigurationError(
                f"has {len(self.cameras)} cameras, one was expected", "keep one [[camera]]", where=self.path
            )
        return self._needed(self.cameras[0] if self.cameras else None, "[[camera]]")

    def _needed(self, part: Part | None, name: str) -> Part:
        if part is None:
            raise ConfigurationError(f"{name} is missing", "add it", where=self.path)
        return part


def is_project(path: Path) -> bool:
    """Whether a path is a project file or a folder that has one, and no block."""
    if path.is_dir():
        return (path / NAME).is_file() and not (path / SETUP).exists()
    return path.suffix == ".toml" and path.name != SETUP


def read_project(path: Path) -> Project:
    """Read and check a project file, or that of a folder.

    raises InputNotFoundError: when there is no such file.
    raises ConfigurationError: for what is not TOML, an unknown key, a missing one, or an impossible value.
    """
    if path.is_dir():
        folder, path = path, path / NAME
        if not path.exists():
            remedy = f"photocal new {folder} writes one from its pictures and tables"
            raise InputNotFoundError(f"has no {NAME}", remedy, where=folder)
    contents = read_toml(path, Contents, {"folder": path.parent})
    cameras = [make_camera(keys, path) for keys in contents.camera]
    # Nobody said: the adjustment of the flight will tell.
    cameras = [
        replace(camera, shutter="unknown") if keys.shutter is None and not camera.rolling else camera
        for keys, camera in zip(contents.camera, cameras, strict=True)
    ]
    return Project(path, contents, tuple(cameras))
