"""The set-up file of a control survey: known marks, baselines, antenna heights, required times."""

from __future__ import annotations

import tomllib
from pathlib import Path
from typing import Any

from pydantic import BaseModel, ConfigDict, Field, ValidationError

from drivers.errors import ConfigurationError, InputNotFoundError


class _Strict(BaseModel):
    model_config = ConfigDict(extra="forbid", frozen=True)


class KnownMark(_Strict):
    """A mark with a known position: degrees, ellipsoidal height, sigmas east, north, up (0: held)."""

    name: str
    lat_deg: float = Field(ge=-90, le=90)
    lon_deg: float = Field(ge=-360, le=360)
    height_m: float
    sigma_m: tuple[float, float, float]


class MeasuredBaseline(_Strict):
    """A session: files (relative to the set-up file) and antenna heights above the marks, metres."""

    name: str
    start: str
    end: str
    base: Path
    rover: Path
    nav: list[Path]
    base_antenna_m: float
    rover_antenna_m: float


class SurveySetup(_Strict):
    """A survey."""

    crs: str | None = None
    required_minutes: float = Field(gt=0)
    known: list[KnownMark]
    baseline: list[MeasuredBaseline]


def read_setup(path: Path) -> SurveySetup:
    """Read a set-up file (TOML).

    Raises
    ------
    InputNotFoundError, ConfigurationError
        When it cannot be read, or has an unknown key or an impossible value.
    """
    try:
        content: dict[str, Any] = tomllib.loads(path.read_text("utf-8"))
    except OSError as refusal:
        reason = (refusal.strerror or str(refusal)).lower()
        raise InputNotFoundError(f"cannot be read ({reason})", where=path) from refusal
    except (tomllib.TOMLDecodeError, UnicodeDecodeError) as damage:
        raise ConfigurationError(f"is no TOML ({damage})", where=path) from damage
    try:
        return SurveySetup.model_validate(content)
    except ValidationError as refusal:
        first = refusal.errors()[0]
        place = ".".join(map(str, first["loc"]))
        raise ConfigurationError(
            f"{place}: {first['msg'].lower()}", where=path, remedy="see photocal survey --help"
        ) from refusal
