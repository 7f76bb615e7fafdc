"""The set-up file of a control survey: known marks, baselines, antenna heights, required times."""

from __future__ import annotations

from pathlib import Path

from pydantic import Field

from acquire.checked_toml import Table, read_toml
from photocal.project_tables import AirAtBase


class KnownMark(Table):
    """A mark with a known position: degrees, ellipsoidal height, sigmas east, north, up (0: held)."""

    name: str
    lat_deg: float = Field(ge=-90, le=90)
    lon_deg: float = Field(ge=-360, le=360)
    height_m: float
    sigma_m: tuple[float, float, float]


class MeasuredBaseline(Table):
    """A session between two marks; files relative to the set-up file.

    name: of the session.
    start, end: marks of base and rover.
    base, rover: RINEX observations, or flight logs (MCAP) with raw frames.
    base_link, rover_link: links of flight logs.
    nav: RINEX navigation files, beside the ephemerides that logs recorded.
    products: precise orbits and clocks (SP3, CLK) that take the place of broadcast ones.
    base_antenna_m, rover_antenna_m: heights of the antenna reference points above the marks.
    base_antenna, rover_antenna: types and radomes in `antex`; empty: as the RINEX header names them.
    """

    name: str
    start: str
    end: str
    base: Path
    rover: Path
    base_link: str = "base"
    rover_link: str = "rover"
    nav: tuple[Path, ...] = ()
    products: tuple[Path, ...] = ()
    base_antenna_m: float
    rover_antenna_m: float
    base_antenna: str = ""
    rover_antenna: str = ""


class PrecisePoint(Table):
    """A mark that is positioned by itself with precise orbits and clocks; keys as of a baseline's rover."""

    name: str
    rover: Path
    rover_link: str = "base"
    nav: tuple[Path, ...] = ()
    products: tuple[Path, ...] = Field(min_length=1)
    rover_antenna_m: float
    rover_antenna: str = ""


class SurveySetup(Table):
    """A survey; the weather is that of its time and place, None: the climate's; antex: antenna models."""

    crs: str | None = None
    required_minutes: float = Field(gt=0)
    weather: AirAtBase | None = None
    antex: Path | None = None
    known: tuple[KnownMark, ...] = ()
    ppp: tuple[PrecisePoint, ...] = ()
    baseline: tuple[MeasuredBaseline, ...] = ()


def read_setup(path: Path) -> SurveySetup:
    """Read a set-up file (TOML).

    raises InputNotFoundError, ConfigurationError: when it cannot be read, or has an unknown key or an
        impossible value.
    """
    return read_toml(path, SurveySetup)
