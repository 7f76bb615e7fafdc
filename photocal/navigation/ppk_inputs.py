"""Where base, rover, ephemerides and the base's position come from: a flight log, RINEX files or both."""

from dataclasses import dataclass, field
from pathlib import Path
from typing import Literal

import numpy as np

from photocal.base.arrays import Floats
from photocal.base.console import numbers_of
from photocal.base.errors import ConfigurationError, IllPosedError
from photocal.base.geodesy import geocentric
from photocal.base.time_scales import GPS_EPOCH_NS
from photocal.block.project import AirAtBase
from photocal.geometry.realizations import realization
from photocal.navigation.base_frame import BaseFrame, decimal_year
from photocal.navigation.engine import to_rinex
from photocal.navigation.flight_log import FlightLog
from photocal.navigation.precise_results import (
    ObservationFile,
    count_ephemerides,
    read_observation_file,
    read_precise_result,
)
from photocal.navigation.receiver_recording import ReceiverRecording, pick, read_receivers, refuse_unusable
from photocal.navigation.rinex_files import navigation_ready, now, observations_ready
from photocal.navigation.time import GpsTime

NAV_OF_BASE = "base"


@dataclass(frozen=True)
class Sources:
    """What a person named.

    log: the flight; may be empty.
    rover, base: RINEX observation files; they go before the links of the log.
    navigation: RINEX navigation files, or ``base`` for the base's own ephemerides.
    base_position: ``LAT,LON,H``, or the result file of a service; goes before what the log says.
    rover_link, base_link, vehicle_link: links of the logs; no vehicle link: any.
    rover_antenna_m, base_antenna_m: antenna reference point above the mark; None: as the RINEX header has it.
    base_sigma_m (3,): standard deviations of the base's coordinates, east, north, up; goes before what a
        survey-in says.
    base_frame: `FRAME[@EPOCH]` of the base's position; goes before what a service's file says.
    crs: system of the control: the base is moved to its frame and epoch; None: it stays.
    """

    log: FlightLog = field(default_factory=FlightLog)
    rover: Path | None = None
    base: Path | None = None
    navigation: tuple[str, ...] = ()
    base_position: str | None = None
    rover_link: str = "rover"
    base_link: str = "base"
    vehicle_link: str | None = None
    rover_antenna_m: float | None = None
    base_antenna_m: float | None = None
    base_sigma_m: Floats | None = None
    weather: AirAtBase | None = None
    base_frame: str | None = None
    crs: str | None = None


@dataclass(frozen=True)
class Inputs:
    """What a PPK run starts from.

    base_m (3,): Earth-centred position of the base's antenna reference point (or mark, with an antenna
        height).
    base_sigma_m (3,): its standard deviations, east, north, up; None: nobody stated them.
    weather: measured at the base; None: that of the climate.
    base_frame: frame and epoch of its position, and whether it was moved to those of the control.
    remarks: on what was left out of the log.
    """

    rover: ObservationFile
    base: ObservationFile
    navigation: list[Path]
    base_m: Floats
    base_source: str
    base_sigma_m: Floats | None = None
    weather: AirAtBase | None = None
    base_frame: BaseFrame | None = None
    remarks: list[str] = field(default_factory=list)


def gather_inputs(sources: Sources, folder: Path) -> Inputs:
    """Return the inputs of a run.

    raises ConfigurationError: when something that is needed was not named.
    raises IllPosedError: when a recording has nothing to compute from.
    """
    receivers = read_receivers(sources.log)
    remarks: list[str] = []
    navigation: list[Path] = []

    def recorded(link: str, role: str, near: GpsTime | None = None) -> tuple[Path, ReceiverRecording]:
        """RINEX file and recording of a link; its ephemerides are added to those known."""
        log = _needed(sources.log, role)
        recording = pick(receivers, link, role, log)
        refuse_unusable(recording, role, log)
        if role == "rover":
            _refuse_without_ephemerides(recording, sources)
        observations, ephemerides = converted(recording, folder / role, near)
        navigation.append(ephemerides)
        counts = {"without signals": recording.empty_epochs, "of week 0": recording.untimed_epochs}
        remarks.extend(f"{role}: {n} epochs {kind} left out" for kind, n in counts.items() if n)
        return observations, recording

    def named(path: Path, other: Path | None, role: str) -> Path:
        """Observations of a file; ephemerides and remarks of a raw one are added to those known."""
        ready = observations_ready(path, folder / f"{role}-file", now(), other)
        navigation.extend(ready.navigation)
        remarks.extend(f"{role}: {remark}" for remark in ready.remarks)
        return ready.path

    rover_path, base_path = sources.rover, sources.base
    if rover_path is not None:
        rover_path = named(rover_path, base_path, "rover")
    rover = read_observation_file(rover_path or recorded(sources.rover_link, "rover")[0])
    base_recording = None
    if base_path is None:
        base_path, base_recording = recorded(sources.base_link, "base", rover.time[[0]])
    else:
        base_path = named(base_path, rover.path, "base")
    base = read_observation_file(base_path)
    for number, name in enumerate(sources.navigation):
        if name != NAV_OF_BASE:
            ready = navigation_ready(Path(name), folder / f"navigation-{number}")
            if not any(map(count_ephemerides, ready)):
                raise IllPosedError("has no ephemerides", "give a RINEX navigation file", where=name)
            navigation.extend(ready)
    given = sources.base_position
    sigma, frame = None, None
    if given is None or "," in given:
        position, source = _base_position(sources, base_recording, receivers.get(sources.rover_link))
        if given is None and base_recording is not None:
            sigma = base_recording.position_sigma_m()
    else:
        precise = read_precise_result(Path(given))
        position, source, sigma = precise.position_m, f"{given}{precise.description}", precise.sigma_enu_m
        frame = precise.realization
    files = [path for path in navigation if path.exists()]
    sigma = sigma if sources.base_sigma_m is None else sources.base_sigma_m
    frame = frame if sources.base_frame is None else realization(sources.base_frame)
    base_frame = BaseFrame.of(position, frame, sources.crs, decimal_year(base.time))
    moved = base_frame.moved
    if moved is not None:
        position, source = position + moved.shift_m, f"{source}, moved to {moved.target}"
        sigma = None if sigma is None else np.hypot(sigma, moved.sigma_m)
    return Inputs(rover, base, files, position, source, sigma, sources.weather, base_frame, remarks)


def _needed(log: FlightLog, role: str) -> FlightLog:
    if not log:
        raise ConfigurationError(
            f"the {role} is not named", f"give a flight log, or RINEX with --{role} and --nav"
        )
    return log


def _refuse_without_ephemerides(recording: ReceiverRecording, sources: Sources) -> None:
    if not recording.ephemeris_frames and not sources.navigation:
        raise IllPosedError(
            "the rover recorded no ephemerides (RXM-SFRBX)",
            "give --nav FILE, or --nav base to use those that the base recorded",
            where=f"{sources.log}, link {recording.link}",
        )


def converted(recording: ReceiverRecording, stem: Path, near: GpsTime | None = None) -> tuple[Path, Path]:
    """Convert what a receiver recorded to RINEX; raises IllPosedError when no observations come out."""
    # A base that sends both repeats the same observations; the raw ones are finer.
    form: Literal["ubx", "rtcm3"] = "ubx" if recording.epochs else "rtcm3"
    frames = recording.ubx if form == "ubx" else recording.rtcm
    if near is None:
        epochs, _ = recording.epochs_and_arrivals()
        # The receiver knows the time; the recording computer's clock may be years off.
        near = GpsTime(epochs[:1] if len(epochs) else np.array([recording.first_log_ns - GPS_EPOCH_NS]))
    made = to_rinex(b"".join(frames), form, stem, near if form == "rtcm3" else None)
    if not made[0].exists():
        raise IllPosedError(
            "the observations could not be converted to RINEX",
            "check that the receiver sent RXM-RAWX or RTCM MSM of known signals",
            where=f"link {recording.link}",
        )
    return made


def parse_position(text: str) -> Floats:
    """Return earth-centred coordinates of ``LAT,LON,H`` (degrees, ellipsoidal height in metres)."""
    form = "LAT,LON,H: degrees and the ellipsoidal height in metres"
    lat, lon, height = numbers_of(text, "--base-position", form)
    if not (abs(lat) <= 90 and abs(lon) <= 360 and abs(height) < 20_000):
        raise ConfigurationError(f"{text!r} is not a position", f"give {form}", where="--base-position")
    return np.asarray(geocentric(lat, lon, height))


def _base_position(
    sources: Sources, recording: ReceiverRecording | None, other: ReceiverRecording | None
) -> tuple[Floats, str]:
    """Position of the base, and who states it; other: what the rover's link recorded."""
    if sources.base_position is not None:
        return parse_position(sources.base_position), "--base-position"
    position = None if recording is None else recording.position_m()
    if position is None and sources.rover is None and other is not None and other.position_m() is not None:
        raise ConfigurationError(
            f"the base's position is not known, but the rover's link {other.link} states one, as a base does",
            f"if they are exchanged, give --rover-link {sources.base_link} --base-link {sources.rover_link}; "
            "else give --base-position LAT,LON,H (ellipsoidal height)",
        )
    if position is None:
        raise ConfigurationError(
            "the base's position is not known: neither RTCM 1005/1006 nor a survey-in states it",
            "give --base-position LAT,LON,H (ellipsoidal height)",
        )
    return position
