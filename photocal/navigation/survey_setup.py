"""The set-up file of a control survey: marks, sessions, how long and how they are observed."""

from pathlib import Path
from typing import Self

from pydantic import Field, model_validator

from photocal.base.checked_toml import Table
from photocal.navigation.ppk import SYSTEMS
from photocal.project import AirAtBase


class KnownMark(Table):
    """A mark with a known position: degrees, ellipsoidal height, sigmas east, north, up (0: held).

    frame: `FRAME[@EPOCH]` of it; empty: that of the survey's system.
    """

    name: str
    lat_deg: float = Field(ge=-90, le=90)
    lon_deg: float = Field(ge=-360, le=360)
    height_m: float
    sigma_m: tuple[float, float, float]
    frame: str = ""


class MarkSession(Table):
    """A receiver on a mark; files relative to the set-up file.

    rover: RINEX observations, or a flight log (MCAP) with raw frames.
    nav: RINEX navigation files, beside the ephemerides that logs recorded.
    products: precise orbits and clocks (SP3, CLK) that take the place of broadcast ones.
    rover_antenna_m: height of the antenna reference point above the mark.
    rover_antenna: type and radome in `antex`; empty: as the RINEX header names them.
    """

    name: str
    rover: Path
    rover_link: str = "rover"
    nav: tuple[Path, ...] = ()
    products: tuple[Path, ...] = ()
    rover_antenna_m: float
    rover_antenna: str = ""


class MeasuredBaseline(MarkSession):
    """A session between two marks, `start` of the base and `end` of the rover; base as rover."""

    start: str
    end: str
    base: Path
    base_link: str = "base"
    base_antenna_m: float
    base_antenna: str = ""


class PrecisePoint(MarkSession):
    """A mark that is positioned by itself with precise orbits and clocks."""

    rover_link: str = "base"
    products: tuple[Path, ...] = Field(min_length=1)


class PublishedMark(Table):
    """A mark whose position stands in a file: a SINEX of one or many sites, or the summary of CSRS-PPP.

    site: its code in that file; empty: the mark's name.
    frame: `FRAME[@EPOCH]`; empty: as the file tells it.
    """

    name: str
    file: Path
    site: str = ""
    frame: str = ""


class RequiredTime(Table):
    """How long baselines of up to a length are observed, and whether with two frequencies."""

    up_to_km: float = Field(gt=0)
    minutes: float = Field(gt=0)
    two_frequencies: bool = False


class SurveySetup(Table):
    """A survey; the weather is that of its time and place, None: the climate's; antex: antenna models.

    outside_area: whether marks may lie outside the area of use of the system.
    required_minutes: of each session; with `required` only of precise points.
    required: times by the length of a baseline.
    elevation_deg: satellites below are left out.
    systems: letters of the satellite systems that may be used (G, R, E, J, C).
    two_frequencies: whether the second one is used where both receivers have it.
    """

    crs: str | None = None
    outside_area: bool = False
    required_minutes: float | None = Field(default=None, gt=0)
    required: tuple[RequiredTime, ...] = ()
    elevation_deg: float = Field(default=15.0, ge=0, lt=90)
    systems: str = Field(default=SYSTEMS, pattern=f"^[{SYSTEMS}]+$")
    two_frequencies: bool = True
    weather: AirAtBase | None = None
    antex: Path | None = None
    known: tuple[KnownMark, ...] = ()
    station: tuple[PublishedMark, ...] = ()
    ppp: tuple[PrecisePoint, ...] = ()
    baseline: tuple[MeasuredBaseline, ...] = ()

    @model_validator(mode="after")
    def _has_times(self) -> Self:
        if self.required_minutes is None and (not self.required or self.ppp):
            what = "of the precise points" if self.required else "that each session is asked to last"
            raise ValueError(f"required_minutes is missing: the time {what}")
        return self

    def required_of_points(self) -> RequiredTime | None:
        """Return what a precise point is asked: it has no length."""
        minutes = self.required_minutes
        return None if minutes is None else RequiredTime(up_to_km=1.0, minutes=minutes)

    def required_for(self, length_m: float) -> RequiredTime | None:
        """Return what a baseline of a length is asked; None where the table of times ends before."""
        if not self.required:
            return self.required_of_points()
        fitting = [row for row in self.required if length_m <= 1e3 * row.up_to_km]
        return min(fitting, key=lambda row: row.up_to_km, default=None)
