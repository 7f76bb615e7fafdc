"""The configuration of a recording (TOML)."""

from pathlib import Path
from typing import Annotated, Literal, Self

from pydantic import AfterValidator, AliasChoices, BeforeValidator, ConfigDict, Field, model_validator

from drivers.protocols import link_protocols
from photocal.base.checked_toml import Table, read_toml
from photocal.base.errors import ConfigurationError

Name = Annotated[str, Field(pattern=r"^[A-Za-z0-9_-]+$")]
Positive = Annotated[float, Field(gt=0)]
Latitude = Annotated[float, Field(ge=-90, le=90)]
Longitude = Annotated[float, Field(ge=-180, le=180)]
Height = Annotated[float, Field(ge=-1000, le=20_000)]


def _several(value: object) -> object:
    return (value,) if isinstance(value, str) else value


class Recording(Table):
    """Where the log goes, how often it is made safe, and when the next file begins (0: never).

    fallback: another word for `spare`, a folder or several.
    """

    output: Path
    spare: Annotated[tuple[Path, ...], BeforeValidator(_several)] = Field(
        default=(), validation_alias=AliasChoices("spare", "fallback")
    )
    flush_s: Annotated[float, Field(gt=0, le=1)] = 0.5
    rotate_mb: Annotated[float, Field(ge=0)] = 0.0
    rotate_min: Annotated[float, Field(ge=0)] = 0.0
    least_free_mb: Annotated[float, Field(ge=0)] = 500.0


class Ublox(Table):
    """Configuration of a u-blox receiver: its port that we are connected to is never guessed."""

    port: Literal["i2c", "uart1", "uart2", "usb", "spi"]
    messages: Annotated[
        tuple[Literal["NAV-PVT", "RXM-RAWX", "RXM-SFRBX", "TIM-TM2"], ...], Field(min_length=1)
    ] = ("NAV-PVT", "RXM-RAWX", "RXM-SFRBX", "TIM-TM2")
    rate_ms: Annotated[int, Field(ge=25, le=65535)]


class VehicleConfiguration(Table):
    """What is asked of an autopilot: message rates, comparison of clocks, parameters of its mounting."""

    rates_hz: dict[str, Annotated[float, Field(gt=0, le=1000)]] = Field(default={})
    timesync_s: Annotated[float, Field(ge=0)] = 1.0
    parameters: bool = True


def _known_protocol(name: str) -> str:
    if name not in link_protocols():
        raise ValueError(f"must be one of {', '.join(link_protocols())}")
    return name


class LinkConfiguration(Table):
    """A link: its name, protocol, address and, on serial lines, its speed."""

    name: Name
    protocol: Annotated[str, AfterValidator(_known_protocol)]
    url: str
    baud: Annotated[int, Field(gt=0)] = 115_200
    silent_s: Positive = 10.0
    corrections_to: tuple[Name, ...] = ()
    user: str = ""
    password_env: str = ""
    position_from: Name | None = None
    position: tuple[Latitude, Longitude, Height] | None = None
    position_every_s: Positive = 10.0
    vehicle: VehicleConfiguration | None = None
    ublox: Ublox | None = None

    @model_validator(mode="after")
    def _fits(self) -> Self:
        if self.vehicle is not None and self.protocol != "mavlink":
            raise ValueError("[link.vehicle] belongs to a link with protocol mavlink")
        if self.ublox is not None and self.protocol != "ubx":
            raise ValueError("[link.ublox] belongs to a link with protocol ubx")
        if self.corrections_to and self.protocol == "mavlink":
            raise ValueError("corrections must come from a receiver or a caster, not from a vehicle")
        if (self.user or self.password_env) and not self.url.startswith(("ntrip:", "ntrips:")):
            raise ValueError("user and password_env belong to an ntrip link")
        has_position = self.position is not None or self.position_from is not None
        if has_position and not self.url.startswith(("ntrip:", "ntrips:")):
            raise ValueError(
                "position and position_from belong to an ntrip link: they are sent to the caster"
            )
        return self


class Site(Table):
    """Place, people and antenna, as free texts, and files that ride along with the log."""

    model_config = ConfigDict(extra="allow", frozen=True)

    antenna_height_m: float | None = None
    antenna_height_kind: Literal["vertical", "slant"] | None = None
    control_file: Path | None = None
    attachments: tuple[Path, ...] = ()

    @model_validator(mode="after")
    def _height_has_kind(self) -> Self:
        if (self.antenna_height_m is None) != (self.antenna_height_kind is None):
            raise ValueError("antenna_height_m and antenna_height_kind (vertical or slant) go together")
        for key, value in (self.model_extra or {}).items():
            if not isinstance(value, str):
                raise ValueError(f"{key} must be a text")  # noqa: TRY004 - pydantic collects ValueErrors
        return self

    def texts(self) -> dict[str, str]:
        """Return the table that the log keeps; of files the names."""
        table = {key: str(value) for key, value in (self.model_extra or {}).items()}
        if self.antenna_height_m is not None:
            table["antenna_height_m"] = repr(self.antenna_height_m)
            table["antenna_height_kind"] = str(self.antenna_height_kind)
        if self.control_file is not None:
            table["control_file"] = self.control_file.name
        return table

    def files(self) -> tuple[Path, ...]:
        """Return the files to be attached."""
        control = () if self.control_file is None else (self.control_file,)
        return (*control, *self.attachments)


class RecordingConfiguration(Table):
    """A recording: `[recording]`, `[[link]]` and `[site]`."""

    recording: Recording
    link: Annotated[tuple[LinkConfiguration, ...], Field(min_length=1)]
    site: Site = Site()


def read_configuration(path: Path) -> RecordingConfiguration:
    """Read a configuration.

    raises InputNotFoundError: when the file cannot be read.
    raises ConfigurationError: when it is no TOML, has an unknown key or an impossible value, or names a link
        twice.
    """
    configuration = read_toml(path, RecordingConfiguration)
    names = [link.name for link in configuration.link]
    for name in names:
        if names.count(name) > 1:
            raise ConfigurationError(f"the link {name!r} is named twice", where=path, remedy="rename one")
    for link in configuration.link:
        others = [name for name in names if name != link.name]
        named = [
            ("corrections_to", name, f"name one of {', '.join(others) or 'none'}")
            for name in link.corrections_to
        ]
        if link.position_from is not None:
            named.append(
                ("position_from", link.position_from, "name the link of the rover or of the vehicle")
            )
        for key, name, remedy in named:
            if name not in others:
                raise ConfigurationError(
                    f"{link.name}.{key} names {name!r}, which is not another link", where=path, remedy=remedy
                )
    return configuration
