"""The configuration of a recording (TOML)."""

from __future__ import annotations

import tomllib
from pathlib import Path
from typing import Annotated, Literal

from pydantic import BaseModel, ConfigDict, Field, ValidationError

from drivers.errors import ConfigurationError, InputNotFoundError

Name = Annotated[str, Field(pattern=r"^[A-Za-z0-9_-]+$")]


class Section(BaseModel):
    """A table of the file: unknown keys are errors."""

    model_config = ConfigDict(extra="forbid", frozen=True)


class Recording(Section):
    """Where the log goes and how often it is made safe."""

    output: Path
    flush_s: Annotated[float, Field(gt=0, le=1)] = 0.5


class Link(Section):
    """A link: its name, protocol, address and, on serial lines, its speed."""

    name: Name
    protocol: Literal["mavlink", "ubx", "rtcm3", "nmea"]
    url: str
    baud: Annotated[int, Field(gt=0)] = 115_200


class Configuration(Section):
    """A recording: `[recording]`, `[[link]]` and free texts in `[site]`."""

    recording: Recording
    link: Annotated[tuple[Link, ...], Field(min_length=1)]
    site: dict[str, str] = {}


def read_configuration(path: Path) -> Configuration:
    """Read a configuration.

    Parameters
    ----------
    path : Path
        The file; a relative output is taken from its folder.

    Raises
    ------
    InputNotFoundError
        When the file cannot be read.
    ConfigurationError
        When it is no TOML, has an unknown key or an impossible value, or names a link twice.
    """
    try:
        content = tomllib.loads(path.read_text(encoding="utf-8"))
    except OSError as refusal:
        reason = (refusal.strerror or str(refusal)).lower()
        raise InputNotFoundError(
            f"cannot be read ({reason})", where=path, remedy="check the name"
        ) from refusal
    except ValueError as refusal:
        raise ConfigurationError(f"is no TOML ({refusal})", where=path, remedy="correct it") from refusal
    try:
        configuration = Configuration.model_validate(content)
    except ValidationError as refusal:
        first = refusal.errors()[0]
        key = ".".join(str(part) for part in first["loc"])
        raise ConfigurationError(
            f"{key}: {first['msg'].lower()}", where=path, remedy="correct this key"
        ) from refusal
    names = [link.name for link in configuration.link]
    for name in names:
        if names.count(name) > 1:
            raise ConfigurationError(f"the link {name!r} is named twice", where=path, remedy="rename one")
    return configuration
