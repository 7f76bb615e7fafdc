"""A control survey: static baselines and precise points computed, adjusted as a network.

The set-up file of a control survey: marks, sessions, how long and how they are observed.

Marks of a survey in the frame and epoch of its system.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Self

import numpy as np
from pydantic import Field, model_validator

from photocal.base.arrays import Floats, picked
from photocal.base.checked_toml import Table
from photocal.base.errors import (
    ConfigurationError,
    IllPosedError,
    InputMalformedError,
    InputNotFoundError,
    reading,
)
from photocal.base.geodesy import enu_axes, geocentric, geodetic
from photocal.block.project import AirAtBase
from photocal.geometry.realizations import Realization, known_realization, realization
from photocal.geometry.systems import degrees_outside
from photocal.navigation.base_frame import BaseFrame, decimal_year
from photocal.navigation.baseline_network import Baseline, GroundMark, NetworkSolution, adjust_baselines
from photocal.navigation.engine import STATIC_FLOOR_M, ProcessingOptions, in_order, solve, trajectory_of
from photocal.navigation.flight_log import FlightLog
from photocal.navigation.ppk import SYSTEMS, options_for, process, with_antennas
from photocal.navigation.ppk_inputs import Inputs, converted
from photocal.navigation.ppk_result import Ppk
from photocal.navigation.precise_results import (
    ObservationFile,
    read_observation_file,
    read_precise_result,
)
from photocal.navigation.receiver_recording import pick, read_receivers, refuse_unusable
from photocal.navigation.rinex_files import navigation_ready, now, observations_ready
from photocal.navigation.time import GpsTime
from photocal.navigation.trajectory import Trajectory


def frame_told(mark: str, text: str, epoch: float | None = None) -> Realization | None:
    """Frame of a known mark as a person tells it; None for none.

    epoch: of its coordinates where the text has none, years.

    raises ConfigurationError: for one that is not known; InputMalformedError: for one whose epoch is missing.
    """
    told = realization(text) if text else None
    if told is not None and told.moves and told.epoch is None:
        told = known_realization(told.frame, epoch) or told
    if told is not None and told.moves and told.epoch is None:
        raise InputMalformedError(
            f"mark {mark}: coordinates in {told.frame} change with time and need an epoch",
            f'write frame = "{told.frame}@2026.9" with the epoch in years',
        )
    return told


def frame_of_orbits(products: tuple[Path, ...]) -> Realization | None:
    """Frame of the first file of precise orbits (SP3) among products; None where none tells."""
    for path in products:
        with reading(path), path.open(encoding="latin-1") as stream:
            line = stream.readline()
        if line[:1] == "#" and line[1:2] in "abcd" and line[46:51].strip():
            return known_realization(line[46:51].strip())
    return None


def in_system(
    mark: GroundMark, source: Realization | None, crs: str | None, time: GpsTime | None = None
) -> tuple[GroundMark, BaseFrame | None]:
    """Transform a mark to the frame of a system, with the uncertainty of the transformation.

    time: of the observations, at whose epoch a precise position counts.
    returns: the mark, and from which frame to which; None where nothing is to be done.
    """
    if source is None or crs is None:
        return mark, None
    # A known mark has its epoch with it.
    known = BaseFrame.of(mark.xyz_m, source, crs, source.epoch if time is None else decimal_year(time))
    if known.target is None or known.source is None or known.source == known.target:
        return mark, None
    if known.moved is None:
        return mark, known
    spread = mark.covariance_m2 + known.moved.sigma_m**2 * np.eye(3)
    return replace(mark, xyz_m=mark.xyz_m + known.moved.shift_m, covariance_m2=spread), known


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


_LOG = ".mcap"


@dataclass(frozen=True)
class Survey:
    """A survey, the folder of the files that it names, and one for those of the engine."""

    setup: SurveySetup
    folder: Path
    scratch: Path

    @property
    def antex(self) -> Path | None:
        """The file of antenna models."""
        return None if self.setup.antex is None else self.folder / self.setup.antex


def run_survey(survey: Survey) -> tuple[NetworkSolution, list[dict[str, Any]], list[dict[str, Any]]]:
    """Compute precise points, then the baselines one after the other, and adjust them.

    returns: also figures of each session, and what was taken from one frame to another.
    raises ConfigurationError: when no chain of baselines reaches a start.
    raises InputNotFoundError: when a file is missing.
    """
    sessions: list[dict[str, Any]] = []
    crs = survey.setup.crs
    published = [_published(mark, survey) for mark in survey.setup.station]
    held = [(_mark(mark), frame_told(mark.name, mark.frame)) for mark in survey.setup.known] + published
    require_inside(survey.setup, [mark for mark, _ in held])
    started = [in_system(mark, frame, crs) for mark, frame in held]
    for point in survey.setup.ppp:
        mark, time, session = _precise(point, survey)
        orbits = frame_of_orbits(tuple(survey.folder / path for path in point.products))
        started.append(in_system(mark, orbits, crs, time))
        sessions.append(session)
    control = [mark for mark, _ in started]
    known = {mark.name: mark.xyz_m for mark in control}
    baselines = []
    waiting = list(survey.setup.baseline)
    while waiting:
        ready = next((b for b in waiting if b.start in known), None)
        if ready is None:
            raise ConfigurationError(
                f"baseline {waiting[0].name}: no chain of baselines reaches its start {waiting[0].start}",
                remedy="let every baseline start at a known mark or at the end of another one",
            )
        waiting.remove(ready)
        baseline, session = _session(ready, survey, known[ready.start])
        baselines.append(baseline)
        sessions.append(session)
        known.setdefault(ready.end, known[ready.start] + baseline.vector_m)
    frames = [{"mark": mark.name, **done.as_json()} for mark, done in started if done is not None]
    return adjust_baselines(baselines, control), sessions, frames


def require_inside(setup: SurveySetup, held: Sequence[GroundMark]) -> None:
    """Refuse known marks outside the area of use of the survey's system.

    raises ConfigurationError: with systems that have the place in theirs.
    """
    if setup.crs is None or setup.outside_area or not held:
        return
    latitude, longitude, _ = geodetic(np.array([mark.xyz_m for mark in held]))
    outside = degrees_outside(setup.crs, latitude, longitude)
    worst = int(np.argmax(outside))
    if outside[worst] > 0:
        raise ConfigurationError(
            f"mark {held[worst].name} lies {outside[worst]:.2f} degrees outside the area of use of "
            f"{setup.crs}",
            "name the system of the place, check the signs of latitude and longitude, or write "
            "outside_area = true",
        )


def _mark(mark: KnownMark) -> GroundMark:
    xyz = geocentric(mark.lat_deg, mark.lon_deg, mark.height_m)
    axes = enu_axes(mark.lat_deg, mark.lon_deg)
    return GroundMark(mark.name, xyz, axes.T @ np.diag(np.square(mark.sigma_m)) @ axes)


def _published(mark: PublishedMark, survey: Survey) -> tuple[GroundMark, Realization | None]:
    """Return a mark from the file that has its position, and the frame and epoch of that."""
    result = read_precise_result(survey.folder / mark.file, mark.site, mark.name)
    told = frame_told(mark.name, mark.frame, result.epoch) if mark.frame else result.realization
    if told is None and survey.setup.crs is not None:
        raise ConfigurationError(
            f"station {mark.name}: {mark.file} does not say in which frame its coordinates are",
            'add frame = "IGS20", or that of its service, to the station',
        )
    return GroundMark(mark.name, result.position_m, result.covariance_m2), told


def _observations(
    path: Path, link: str, role: str, survey: Survey, stem: Path
) -> tuple[ObservationFile, list[Path]]:
    """Return the observations of a RINEX file or of a link of a log, and ephemerides recorded there."""
    source = survey.folder / path
    if not source.is_file():
        raise InputNotFoundError("does not exist", where=source, remedy="check the set-up file")
    if source.suffix != _LOG:
        ready = observations_ready(source, stem.with_name(f"{stem.name}-file"), now())
        return read_observation_file(ready.path), list(ready.navigation)
    log = FlightLog((source,))
    recording = pick(read_receivers(log), link, role, log)
    refuse_unusable(recording, role, log)
    observations, navigation = converted(recording, stem)
    return read_observation_file(observations), [navigation] if navigation.exists() else []


def _session(measured: MeasuredBaseline, survey: Survey, start_m: Floats) -> tuple[Baseline, dict[str, Any]]:
    folder = _own_folder(survey, measured.name)
    rover, of_rover = _observations(measured.rover, measured.rover_link, "rover", survey, folder / "rover")
    base, of_base = _observations(measured.base, measured.base_link, "base", survey, folder / "base")
    named = [*_navigation(measured, survey, folder), *(survey.folder / p for p in measured.products)]
    files = [*of_rover, *of_base, *named]
    inputs = Inputs(rover, base, files, start_m, f"mark {measured.start}", weather=survey.setup.weather)
    options = replace(
        _options(rover, base, survey.setup),
        rover_antenna_m=measured.rover_antenna_m,
        base_antenna_m=measured.base_antenna_m,
        precise=bool(measured.products),
    )
    options = with_antennas(
        options, survey.antex, (rover, measured.rover_antenna), (base, measured.base_antenna)
    )
    result = process(inputs, options, "static", folder)
    position, air_m = _through_air(result)
    end, covariance = _earth_centred(position)
    first, last = max(rover.time.ns[0], base.time.ns[0]), min(rover.time.ns[-1], base.time.ns[-1])
    length_m = float(np.linalg.norm(end - start_m))
    required = survey.setup.required_for(length_m)
    session = {
        **picked(measured, "name", "start", "end", "base_antenna_m", "rover_antenna_m"),
        "status": str(position.status[0]),
        "length_m": length_m,
        "two_frequencies": options.two_frequencies,
        "air_correction_m": air_m,
        "antenna_models": [options.base_antenna, options.rover_antenna],
        **_judged(float(last - first) / 60e9, options.two_frequencies, required),
    }
    return Baseline(measured.name, measured.start, measured.end, end - start_m, covariance), session


def _options(rover: ObservationFile, base: ObservationFile, setup: SurveySetup) -> ProcessingOptions:
    """Choose from what both receivers observed that which the survey takes."""
    options = options_for(rover, base, elevation_deg=setup.elevation_deg)
    systems = "".join(letter for letter in options.systems if letter in setup.systems)
    if not systems:
        raise ConfigurationError(
            f'systems = "{setup.systems}", and the receivers share {"+".join(options.systems)}',
            "name one that they share",
            where=rover.path.name,
        )
    return replace(
        options, systems=systems, two_frequencies=options.two_frequencies and setup.two_frequencies
    )


def _through_air(result: Ppk) -> tuple[Trajectory, float]:
    """Return a static position corrected for the air between both marks, and the correction of its height."""
    position, common = result.trajectory, result.common
    if common.shift_by_zenith_delay is None:
        return position, 0.0
    corrected = common.corrected(position)
    above = float(position.height_m[0]) - common.base_height_m
    spread = common.shift_by_zenith_delay * common.lapse.sigma * above
    covariance = corrected.covariance_m2 + np.outer(spread, spread)
    air_m = float(corrected.height_m[0] - position.height_m[0])
    return replace(corrected, covariance_m2=covariance), air_m


def _precise(point: PrecisePoint, survey: Survey) -> tuple[GroundMark, GpsTime, dict[str, Any]]:
    folder = _own_folder(survey, f"ppp-{point.name}")
    observed, recorded = _observations(point.rover, point.rover_link, "rover", survey, folder / "rover")
    named = [*_navigation(point, survey, folder), *(survey.folder / p for p in point.products)]
    # The ionosphere goes by two frequencies, whatever baselines use.
    options = replace(
        _options(observed, observed, survey.setup),
        two_frequencies=True,
        rover_antenna_m=point.rover_antenna_m,
        precise=True,
    )
    options = with_antennas(options, survey.antex, (observed, point.rover_antenna), None)
    result = _precise_point(observed, [*recorded, *named], options, folder)
    place, covariance = _earth_centred(result)
    required = survey.setup.required_of_points()
    session = {
        "name": f"precise point {point.name}",
        "start": "",
        "end": point.name,
        "status": "precise point",
        "length_m": 0.0,
        "rover_antenna_m": point.rover_antenna_m,
        "two_frequencies": True,
        **_judged(float(observed.time.ns[-1] - observed.time.ns[0]) / 60e9, True, required),
    }
    return GroundMark(point.name, place, covariance), observed.time, session


def _navigation(session: MarkSession, survey: Survey, folder: Path) -> list[Path]:
    return [
        ready
        for k, path in enumerate(session.nav)
        for ready in navigation_ready(survey.folder / path, folder / f"navigation-{k}")
    ]


def _own_folder(survey: Survey, name: str) -> Path:
    # A session's name may hold what no file name may.
    folder = survey.scratch / "".join(c if c.isalnum() or c in "-_" else "_" for c in name)
    folder.mkdir(exist_ok=True)
    return folder


def _judged(minutes: float, two_frequencies: bool, required: RequiredTime | None) -> dict[str, Any]:
    """Compare a session with what is asked of it; None: nothing is said of such a length."""
    return {
        "minutes": minutes,
        "required_minutes": None if required is None else required.minutes,
        "long_enough": required is not None and minutes >= required.minutes,
        "enough_frequencies": required is not None and two_frequencies >= required.two_frequencies,
    }


def _earth_centred(t: Trajectory) -> tuple[Floats, Floats]:
    """Return the position of a static run and its covariance in earth-centred axes."""
    axes = enu_axes(*t.place[0, :2])
    return t.xyz_m[0], np.asarray(axes.T @ t.covariance_m2[0] @ axes)


def _precise_point(
    rover: ObservationFile, files: list[Path], options: ProcessingOptions, folder: Path
) -> Trajectory:
    """Compute the position of a receiver that stood still by itself, with precise orbits and clocks."""
    ill_posed = IllPosedError.at(rover.path.name)
    if "2" not in rover.bands:
        raise ill_posed("a precise point needs two frequencies", "measure a baseline instead")
    epochs = in_order(solve("ppp-static", "forward", [rover.path, *files], options, None, folder))
    # How the engine numbers precise positions.
    precise = 6
    epochs = epochs.rows(epochs.quality == precise)
    if not len(epochs):
        raise ill_posed(
            "the engine found no precise position", "check that the products cover the observations"
        )
    last = epochs.rows(np.array([len(epochs) - 1]))
    way = epochs.rows(np.arange(len(epochs) // 2, len(epochs))).offsets(last.place[0])
    spread = np.maximum(np.sqrt(np.mean(way**2, axis=0)), 10 * STATIC_FLOOR_M)
    settled = replace(last, covariance_m2=last.covariance_m2 + np.diag(spread**2))
    return trajectory_of(settled, 0.0, last.xyz_m[0])
