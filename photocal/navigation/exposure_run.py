"""The whole way from flight logs and images to exposures.

What a person judges exposures by: figures and sentences.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np

from photocal.base.arrays import Floats, as_plain, picked
from photocal.base.errors import ConfigurationError
from photocal.block.project import Project
from photocal.findings.digits import Number
from photocal.findings.finding import Finding
from photocal.findings.texts import Catalogue, catalogue, finding_json
from photocal.measurement.event_matching import Matching, match_images
from photocal.measurement.image_metadata import ImageMetadata, clock_time_s, read_images
from photocal.navigation.common_errors import common_text
from photocal.navigation.device_clocks import ComparedClocks, clock_sentences, device_by_arrival
from photocal.navigation.events import Events, listed_in, read_mrk
from photocal.navigation.exposure_checks import Evidence, check_exposures, times_against_pictures
from photocal.navigation.exposure_sources import (
    OF_IMAGES,
    SEA_LEVEL,
    attitudes_of_images,
    attitudes_of_vehicle,
    events_of,
    events_of_images,
    placed_by,
)
from photocal.navigation.exposures import Exposures, at_camera, at_events
from photocal.navigation.flight_log import FlightLog
from photocal.navigation.image_checks import TieMatching, check_images, check_oriented, oriented_images
from photocal.navigation.ppk import solved
from photocal.navigation.ppk_inputs import Sources
from photocal.navigation.ppk_result import PpkFigures
from photocal.navigation.receiver_recording import ReceiverRecording, read_receivers
from photocal.navigation.rig import CameraOnBody, rig_of_mounting
from photocal.navigation.time import HostTime
from photocal.navigation.trajectory import LARGEST_GAP_S, Trajectory, plainly
from photocal.navigation.vehicle import VehicleTrack, autopilot_time, read_vehicle

# What schema 1 calls the outcome of a check; all others failed.
_VERDICTS = {"passed": "passed", "note": "passed", "untested": "not possible"}


def exposure_figures(
    exposures: Exposures,
    events: Events,
    cameras: list[Matching],
    clocks: list[ComparedClocks],
    checks: list[Finding],
    ppk: PpkFigures | None,
) -> dict[str, Any]:
    """Return the figures of a run, ready for JSON; `findings` are the warnings among them."""
    placed, say = exposures.placed, catalogue("en")
    status = placed.status[placed.placed]
    failed = [check for check in checks if not check.small]
    findings = (*failed, *_unmatched(cameras, events), *_missing(exposures))
    missing = np.flatnonzero(~placed.placed).tolist()
    figures: dict[str, Any] = as_plain(
        {
            "schema": "photocal.exposures/1",
            "events": len(events),
            "events_from": events.source,
            "remarks": [*events.remarks, *clock_sentences(clocks)],
            "placed": placed.placed.sum(),
            **{name: (status == name).sum() for name in ("fixed", "float", "single")},
            "not_placed": [
                {
                    "event": exposures.number[i],
                    "time_gps": exposures.time[[i]].iso()[0],
                    "reason": exposures.reason(i),
                }
                for i in missing
            ],
            "with_attitude": exposures.attitude.known.sum(),
            "height": exposures.height_kind,
            "heights": _heights(exposures),
            "sigma": _sigmas(exposures),
            "cameras": [_camera(camera, events) for camera in cameras],
            "clocks": [clock.figures() for clock in clocks],
            "checks": [
                finding_json(check, say) | {"verdict": _VERDICTS.get(check.severity, "failed")}
                for check in checks
            ],
            "findings": [finding_json(finding, say) for finding in findings],
            "common": None if ppk is None else ppk.record.get("common"),
            "ppk": None if ppk is None else ppk.record,
        }
    )
    return figures


def _heights(exposures: Exposures) -> dict[str, Any]:
    rows = exposures.placed.placed
    kinds = {exposures.height_kind: exposures.placed.height_m[rows]}
    if exposures.above_take_off_m is not None:
        kinds["above the take-off, as the images state it"] = exposures.above_take_off_m
    return {
        kind: {"lowest_m": np.min(v), "highest_m": np.max(v)}
        for kind, values in kinds.items()
        if len(v := values[np.isfinite(values)])
    }


def _sigmas(exposures: Exposures) -> dict[str, Any]:
    """Return medians of the standard deviations."""
    position = exposures.placed.sigma_m[exposures.placed.placed]
    angles = np.degrees(exposures.angle_sigma[exposures.attitude.known])
    return {"position_enu_m": _medians(position), "roll_pitch_yaw_deg": _medians(angles)}


def _medians(values: Floats) -> Floats | None:
    known = values[np.isfinite(values).all(axis=1)]
    return np.median(known, axis=0) if len(known) else None


def _camera(m: Matching, events: Events) -> dict[str, Any]:
    return {
        "camera": m.camera,
        "matched": len(m.image),
        "unmatched_images": [m.names[i] for i in m.unmatched_images.tolist()],
        "ambiguous_images": [m.names[i] for i in m.ambiguous_images.tolist()],
        "unmatched_events": events.number[m.unmatched_events],
        "matched_by_next_best": m.rival,
        **picked(m, clock_offset_s="offset_s", clock_offset_sigma_s="offset_sigma_s", residual_s="scatter_s"),
        "clock_drift_ppm": m.drift * 1e6,
        "clock_drift_sigma_ppm": m.drift_sigma * 1e6,
    }


def _unmatched(cameras: list[Matching], events: Events) -> Iterator[Finding]:
    """Find images and events without a partner."""
    for m in cameras:
        images = {"images-without-event": m.unmatched_images, "images-ambiguous": m.ambiguous_images}
        for code, rows in images.items():
            names = tuple(m.names[i] for i in rows.tolist())
            if names:
                yield Finding(code, "doubtful", m.camera, {"n": float(len(names)), "images": names})
        numbers = tuple(str(events.number[i]) for i in m.unmatched_events.tolist())
        if numbers:
            figures = {"n": float(len(numbers)), "events": numbers}
            yield Finding("events-without-image", "doubtful", m.camera, figures)


def _missing(exposures: Exposures) -> Iterator[Finding]:
    """Find what lacks a position or an attitude; without any attitude none was recorded."""
    there, turned = exposures.placed.placed, exposures.attitude.known
    gap = exposures.placed.gap_s
    without = {"outside-trajectory": ~there & ~np.isfinite(gap), "gap": ~there & np.isfinite(gap)}
    for cause, lost in without.items():
        if lost.any():
            figures: dict[str, Any] = {"events": tuple(str(n) for n in exposures.number[lost].tolist())}
            figures |= {"n": float(lost.sum()), "gap_s": float(np.max(gap[lost])), "limit_s": LARGEST_GAP_S}
            yield Finding("exposure-not-placed", "doubtful", figures=figures, cause=cause)
    count = float((there & ~turned).sum())
    if count and turned.any():
        yield Finding("telemetry-gap", "doubtful", figures={"n": count, "all": float(len(exposures))})


def exposures_text(figures: dict[str, Any], say: Catalogue) -> str:
    """Return the summary in words."""
    # The table has all; a screen shows this many.
    listed = 12
    counts = {name: figures[name] for name in ("events", "placed", "fixed", "float", "single")}
    lines = [
        say("exposed.head", source=figures["events_from"], **counts),
        say("exposed.attitudes", n=figures["with_attitude"]),
    ]
    for kind, span in figures["heights"].items():
        ends = {"least": say.fixed(span["lowest_m"], 2), "largest": say.fixed(span["highest_m"], 2)}
        lines.append(say("exposed.height", kind=kind, **ends))
    sigma = figures["sigma"]
    if sigma["position_enu_m"]:
        parts = " ".join(say.fixed(v, 3) for v in sigma["position_enu_m"])
        lines.append(say("exposed.position", figures=parts))
    if sigma["roll_pitch_yaw_deg"]:
        parts = " ".join(say.fixed(v, 2) for v in sigma["roll_pitch_yaw_deg"])
        lines.append(say("exposed.angles", figures=parts))
    if figures["common"] is not None:
        lines += common_text(figures["common"], say)
    lines += figures["remarks"]
    for camera in figures["cameras"]:
        clock = ""
        if camera["matched"]:
            off = Number(camera["clock_offset_s"], say.mark), Number(camera["clock_drift_ppm"], say.mark)
            sigma_s = say.fixed(camera["clock_offset_sigma_s"], 3)
            clock = say("exposed.clock", offset=f"{off[0]:+.3f}", sigma=sigma_s, drift=f"{off[1]:+.0f}")
        rest = {kind: len(camera[f"unmatched_{kind}"]) for kind in ("images", "events")}
        who = {"camera": camera["camera"], "matched": camera["matched"]}
        lines.append(say("exposed.camera", **who, **rest, clock=clock))
    missing = figures["not_placed"]
    lines += [
        say("exposed.event", event=x["event"], time=x["time_gps"], reason=x["reason"])
        for x in missing[:listed]
    ]
    if len(missing) > listed:
        lines.append(say("exposed.more", n=len(missing) - listed))
    lines.append(say("exposed.checks"))
    keys = {"passed": "exposed.passed", "failed": "exposed.failed", "not possible": "exposed.not_possible"}
    words = {verdict: say(key) for verdict, key in keys.items()}
    wide = max(map(len, words.values()))
    lines += [f"  {words[c['verdict']]:<{wide}} {c['code']}: {c['text']}" for c in figures["checks"]]
    checked = {c["text"] for c in figures["checks"]}
    of_ppk = [] if figures["ppk"] is None else figures["ppk"].get("findings", [])
    told = [f["text"] for f in (*of_ppk, *figures["findings"]) if f["text"] not in checked]
    lines += [say("exposed.warning", text=text) for text in told]
    return "\n".join(lines)


@dataclass(frozen=True)
class ExposureChoices:
    """What a person asked for.

    images: folder of images, or a table of their names and times.
    mrk: event list of the vehicle, instead of the events of the log.
    edge: ``rising`` or ``falling``.
    delay_s, delay_sigma_s: from the event to the exposure, and its standard deviation from exposure to
        exposure.
    rig: lever arm, boresight, axes and their standard deviations.
    largest_offset_s: between the clocks of camera and log.
    oriented: run folder of an adjustment of the same images, whose positions check the exposures.
    ties: how to find tie points of the images to check their rotations; None: not at all.
    """

    sources: Sources
    images: Path | None = None
    mrk: Path | None = None
    edge: str = "rising"
    delay_s: float = 0.0
    delay_sigma_s: float = 0.0
    rig: CameraOnBody = field(default_factory=CameraOnBody)
    largest_offset_s: float = 60.0
    oriented: Path | None = None
    ties: TieMatching | None = None


@dataclass(frozen=True)
class ExposureRun:
    """Exposures and what was noticed on the way.

    antenna: at the antenna, event and delay.
    exposures: at the camera: lever arm and time offset of the rig applied.
    """

    antenna: Exposures
    exposures: Exposures
    trajectory: Trajectory | None
    cameras: list[Matching]
    checks: list[Finding]
    figures: dict[str, Any]


def run_exposures(choices: ExposureChoices, folder: Path) -> ExposureRun:
    """Find events, positions, attitudes and images of a flight.

    raises ConfigurationError: when the log has neither events nor images, or nothing that tells positions.
    """
    sources = choices.sources
    rover = read_receivers(sources.log).get(sources.rover_link)
    raw = rover is not None and bool(rover.epochs or rover.empty_epochs or rover.untimed_epochs)
    if not raw and sources.rover is None:
        return place_exposures(choices, None, None)
    made = solved(sources, folder)
    return place_exposures(choices, made.trajectory, PpkFigures.of(made.figures))


def place_exposures(
    choices: ExposureChoices, trajectory: Trajectory | None, ppk: PpkFigures | None
) -> ExposureRun:
    """Do the same with a trajectory that is there already, with the figures of its PPK.

    What the engine leaves of the air between base and rover is taken out of the positions.
    """
    if trajectory is not None and ppk is not None and ppk.common is not None:
        trajectory = ppk.common.corrected(trajectory)
    sources, rig = choices.sources, choices.rig
    receivers = read_receivers(sources.log)
    rover = receivers.get(sources.rover_link)
    vehicle = read_vehicle(sources.log, sources.vehicle_link, _receiver_clock(rover)) if sources.log else None
    listed = listed_in(sources.log) if choices.mrk is None else read_mrk(choices.mrk)
    images = [] if choices.images is None else read_images(choices.images)
    noted = events_of(sources, choices.edge, receivers, vehicle)
    noted = noted if listed is None else listed.events
    if noted is None:
        return _without_events(choices, rover, vehicle, images)
    events = noted.delayed(choices.delay_s, choices.delay_sigma_s)
    names: list[tuple[str, ...]] = [()] * len(events)
    cameras: list[Matching] = []
    if images:
        placed, _ = placed_by(events, trajectory, listed, vehicle)
        utc_s = events.time.to_utc().ns / 1e9
        names, cameras = match_images(images, utc_s, placed.place, choices.largest_offset_s)
    by_name = {image.name: image for image in images}
    shown = [by_name.get(some[0]) if some else None for some in names]
    camera, of_images, stated = attitudes_of_images(shown, rig)

    def at(events: Events) -> Exposures:
        """Exposures at times of events, with the attitude of vehicle or gimbal."""
        placed, kind = placed_by(events, trajectory, listed, vehicle)
        flown = attitudes_of_vehicle(vehicle, events.time, rig)
        if not stated.any():
            return at_events(events, placed, flown, events.accuracy_s, names, kind)
        # A gimbal holds the camera: its attitude is the camera's, the lever arm turns with the vehicle.
        carrier = flown if flown.known.any() else of_images
        made = at_events(events, placed, camera, events.accuracy_s, names, kind)
        return replace(made, carrier=carrier, above_take_off_m=_above_take_off(shown))

    antenna = later = at(events)
    if rig.time_offset_s or rig.time_offset_sigma_s:
        later = at(events.delayed(rig.time_offset_s, rig.time_offset_sigma_s))
    return _judged(
        choices,
        Evidence(rig, events, antenna, trajectory, rover, vehicle, listed, images, ppk),
        # A list's positions are those of the camera already.
        at_camera(later, rig) if listed is None else later,
        cameras,
    )


def exposures_of_pictures(images: list[ImageMetadata]) -> ExposureRun:
    """Exposures of images that are their own events, at the positions that they state, without any log.

    raises ConfigurationError: when none states a position, or one no time.
    """
    return _without_events(ExposureChoices(Sources()), None, None, images)


def _without_events(
    choices: ExposureChoices,
    rover: ReceiverRecording | None,
    track: VehicleTrack | None,
    images: list[ImageMetadata],
) -> ExposureRun:
    """Exposures of images that are their own events: by the host's time in their names, or by their EXIF."""
    if not images or (choices.sources.log and not all(image.from_name for image in images)):
        raise ConfigurationError(
            "has no camera events (time marks, CAMERA_* messages, CAM or TRIG records, an event list)",
            where=str(choices.sources.log) or None,
            remedy="give an event list with --mrk, or images with the time of the log in their names",
        )
    if not choices.sources.log:
        events, placed = events_of_images(images)
        ordered = sorted(images, key=clock_time_s)
        camera, vehicle, _ = attitudes_of_images(ordered, choices.rig)
        names = [(image.name,) for image in ordered]
        made = at_events(events, placed, camera, events.accuracy_s, names, OF_IMAGES)
        antenna = replace(made, carrier=vehicle, above_take_off_m=_above_take_off(ordered))
    elif track is None or len(track.path) < 2:
        raise ConfigurationError(
            "has no positions of an autopilot", where=choices.sources.log, remedy="check the log"
        )
    else:
        host = HostTime(np.array([round(clock_time_s(image) * 1e9) for image in images], np.int64))
        time, sigma = autopilot_time(track, host)
        events = Events("time of receipt in file names", time, np.arange(len(images)), sigma)
        flown = attitudes_of_vehicle(track, time, choices.rig)
        names = [(image.name,) for image in images]
        antenna = at_events(events, plainly(track.path, time), flown, sigma, names, SEA_LEVEL)
    evidence = Evidence(choices.rig, events, antenna, None, rover, track, None, images, None)
    return _judged(choices, evidence, at_camera(antenna, choices.rig), [])


def _judged(
    choices: ExposureChoices, evidence: Evidence, exposures: Exposures, cameras: list[Matching]
) -> ExposureRun:
    vehicle, images, ppk = evidence.vehicle, evidence.images, evidence.ppk
    gnss = _receiver_clock(evidence.rover)
    clocks = [*([] if vehicle is None else vehicle.clocks.compared), *([] if gnss is None else [gnss])]
    checks = check_exposures(evidence) + times_against_pictures(evidence.events, cameras, images)
    if choices.oriented is not None:
        oriented = oriented_images(choices.oriented, exposures.first_images)
        checks += check_oriented(oriented, exposures, choices.rig, "the-adjustment")
    elif choices.ties is not None:
        checks += check_images(exposures, images, choices.rig, choices.ties)
    if choices.oriented is not None or choices.ties is not None:
        # What was said to be out of sight is in sight now.
        seen = {check.code for check in checks if check.severity != "untested"}
        checks = [c for c in checks if c.severity != "untested" or c.code not in seen]
    figures = exposure_figures(exposures, evidence.events, cameras, clocks, checks, ppk)
    return ExposureRun(evidence.antenna, exposures, evidence.trajectory, cameras, checks, figures)


def _receiver_clock(rover: ReceiverRecording | None) -> ComparedClocks | None:
    if rover is None:
        return None
    epochs, arrivals = rover.epochs_and_arrivals()
    return device_by_arrival("GNSS time by the recording computer's clock (RXM-RAWX)", epochs, arrivals)


def _above_take_off(images: Sequence[ImageMetadata | None]) -> Floats:
    facts = [None if image is None else image.facts for image in images]
    return np.array([np.nan if fact is None else fact.relative_altitude_m for fact in facts])


def choices_of_project(project: Project) -> ExposureChoices:
    """Return what `[flight]`, `[images]` and `[rig]` ask for.

    raises ConfigurationError: without `[flight]`, or when camera axes are impossible.
    """
    flight = project.flight
    position = flight.base_position
    sources = Sources(
        FlightLog(flight.logs),
        flight.rover_rinex,
        flight.base_rinex,
        tuple(map(str, flight.navigation)),
        None if position is None else ",".join(repr(float(v)) for v in position),
        flight.rover,
        flight.base,
        flight.vehicle,
        flight.rover_antenna_height_m,
        flight.base_antenna_height_m,
        None if flight.base_sigma_m is None else np.array(flight.base_sigma_m),
        flight.weather,
        flight.base_frame,
        project.crs,
    )
    images = project.contents.images
    keys = project.contents.rig
    rig = CameraOnBody()
    if keys is not None:
        rig = rig_of_mounting(keys.mounting(), np.radians(np.asarray(keys.attitude_sigma_deg, np.float64)))
    return ExposureChoices(
        sources,
        None if images is None else images.folder or images.times,
        edge=flight.edge,
        delay_s=flight.delay_s,
        rig=rig,
        largest_offset_s=flight.clock_offset_s,
    )
