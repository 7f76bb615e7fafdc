"""Checks of the exposures of a flight: what can be seen at this stage, and what cannot."""

from dataclasses import dataclass, replace

import numpy as np

from photocal.base.errors import IllPosedError
from photocal.base.geodesy import enu_offsets
from photocal.findings.finding import Finding, untested
from photocal.measurement.event_matching import Matching
from photocal.measurement.image_metadata import ImageMetadata, stated_places
from photocal.measurement.listed_positions import (
    ListedPositions,
    judge_against_pictures,
    judge_listed,
    judge_marks,
    judge_order,
)
from photocal.navigation.events import CameraEventList, Events
from photocal.navigation.exposures import Exposures
from photocal.navigation.position_comparison import compare_positions, judge_positions
from photocal.navigation.ppk_result import PpkFigures
from photocal.navigation.receiver_recording import ReceiverRecording
from photocal.navigation.rig import CameraOnBody, check_mounting
from photocal.navigation.time import leap_seconds
from photocal.navigation.trajectory import Trajectory, plainly
from photocal.navigation.vehicle import VehicleTrack


@dataclass(frozen=True)
class Evidence:
    """What checks may use.

    events: those used, with the delay.
    """

    rig: CameraOnBody
    events: Events
    antenna: Exposures
    trajectory: Trajectory | None
    rover: ReceiverRecording | None
    vehicle: VehicleTrack | None
    listed: CameraEventList | None
    images: list[ImageMetadata]
    ppk: PpkFigures | None


def check_exposures(evidence: Evidence) -> list[Finding]:
    """Run every check that the data allow; the rest say why they are not possible."""
    return [
        _time_base(evidence),
        _height_kind(evidence),
        _autopilot_clock(evidence),
        *_other_positions(evidence),
        *_listed_events(evidence),
        *([] if evidence.vehicle is None else check_mounting(evidence.rig, evidence.vehicle.mounting)),
        *_out_of_sight(evidence),
    ]


def _listed_events(e: Evidence) -> list[Finding]:
    """Judge positions that a list or the device tells with its events, by themselves and by the pictures."""
    findings = list(e.listed.findings) if e.listed is not None else []
    told, sigma, lines = None, np.full((len(e.antenna), 3), np.nan), tuple[str, ...]()
    if e.listed is not None:
        told, sigma, lines = e.listed.placed.place, e.listed.placed.sigma_m, e.listed.lines
    elif e.events.claimed is not None and np.isfinite(e.events.claimed[:, :2]).any():
        told = e.events.claimed[:, :3]
        lines = tuple(f"event {number}" for number in e.events.number.tolist())
        seconds = (e.events.time.ns - e.events.time.ns[0]) / 1e9
        findings += judge_listed(ListedPositions(lines, seconds, told, sigma, e.events.number)).findings
    if e.listed is None and e.events.stream_ns is not None:
        marks = tuple(f"mark {number}" for number in e.events.number.tolist())
        seconds = (e.events.time.ns - e.events.time.ns[0]) / 1e9
        findings += judge_marks(marks, seconds, e.events.accuracy_s)
    facts = {image.name: image.facts for image in e.images}
    shown = [facts.get(name) for name in e.antenna.first_images]
    if told is not None and any(shown):
        stated = np.array([(np.nan,) * 3 if f is None else f.position_sigma_m for f in shown])
        places = stated_places(shown)
        shifted = judge_order(lines, told, places)
        findings += shifted or judge_against_pictures(lines, told, sigma, places, stated)[1]
    return findings


def times_against_pictures(
    events: Events, cameras: list[Matching], images: list[ImageMetadata]
) -> list[Finding]:
    """Compare events with pictures that state the UTC of their exposure: no clocks are between them."""
    # Events and the UTC that pictures state of the same exposures differ by less: delays of shutters.
    same_time_s = 0.5
    utc, findings = {image.name for image in images if image.utc}, list[Finding]()
    leap = float(leap_seconds(events.time[[0]])[0]) if len(events) else 0.0
    for camera in cameras:
        matched = [camera.names[i] for i in camera.image.tolist()]
        late = camera.offset_s
        if not matched or not utc.issuperset(matched) or abs(late) < same_time_s:
            continue
        hours = round(late / 3600.0)
        cause = "leap-seconds-list" if abs(abs(late) - leap) < same_time_s else ""
        cause = "hours-list" if hours and abs(late - 3600.0 * hours) < same_time_s else cause
        figures = {"late_s": late, "n": float(len(matched)), "leap_seconds": leap, "hours": float(hours)}
        findings.append(Finding("events-beside-time", "grave", camera.camera, figures, cause=cause))
    return findings


def _time_base(e: Evidence) -> Finding:
    """Hold the time marks against the epochs around them in the receiver's own stream."""
    code, stream = "event-time-base", e.events.stream_ns
    if stream is None or not (stream > 0).any():
        return untested(code, "no-marks-in-stream")
    there = stream > 0
    late = (e.events.noted_ns[there] - stream[there]) / 1e9
    middle = float(np.median(late))
    leap = float(leap_seconds(e.events.time[[0]])[0])
    figures = {"median_s": middle, "leap_seconds": leap}
    near = min((0.0, leap, -leap), key=lambda step: abs(middle - step))
    if abs(middle) < leap / 2:
        return Finding(code, "passed", figures=figures)
    return Finding(code, "grave", figures=figures, cause="leap-seconds" if near else "")


def _height_kind(e: Evidence) -> Finding:
    """Hold ellipsoidal heights against heights above sea level: they must differ by the geoid."""
    # Heights above sea level of autopilots drift by metres with the air pressure.
    pressure_m = 4.0
    code = "height-kind"
    if e.trajectory is None:
        return untested(code, "no-trajectory")
    undulations = [*(e.rover.geoid_m if e.rover is not None else [])]
    if not undulations and e.vehicle is not None and e.vehicle.geoid_m is not None:
        undulations = [e.vehicle.geoid_m]
    if not undulations:
        return untested(code, "no-geoid-told")
    geoid = float(np.median(undulations))
    apart = _above_sea(e)
    base = None if e.ppk is None else e.ppk.base.up_off_code_solution_m
    figures = {"geoid_m": geoid, "less_sea_level_m": apart, "base_up_off_code_m": base}
    # Two witnesses: the autopilot's height, and the base's own code solution.
    seen = [] if apart is None else [apart]
    seen += [] if base is None else [geoid + base]
    if not seen:
        return untested(code, "no-sea-level", figures)
    if abs(geoid) < 2 * pressure_m:
        return untested(code, "flat-geoid", figures)
    figures["above_m"] = value = float(np.mean(seen))
    if abs(value - geoid) < min(abs(geoid) / 2, 3 * pressure_m):
        return Finding(code, "passed", figures=figures)
    cause = "orthometric-heights" if abs(value) < abs(geoid) / 2 else "base-height"
    return Finding(code, "grave", figures=figures, cause=cause)


def _above_sea(e: Evidence) -> float | None:
    """Return by how much the trajectory lies above the autopilot's heights above sea level."""
    if e.vehicle is None or e.trajectory is None or len(e.vehicle.path) < 2:
        return None
    path = e.vehicle.path
    ours = plainly(e.trajectory, path.time)
    if not ours.placed.any():
        return None
    return float(np.median((ours.height_m - path.height_m)[ours.placed]))


def _autopilot_clock(e: Evidence) -> Finding:
    """Hold the autopilot's positions against the trajectory: a time offset lies along the velocity."""
    code = "autopilot-clock"
    if e.vehicle is None or e.trajectory is None or len(e.vehicle.path) < 2:
        return untested(code, "no-autopilot-positions")
    path = e.vehicle.path
    ours = plainly(e.trajectory, path.time)
    rows = ours.placed & (np.linalg.norm(np.nan_to_num(ours.velocity_m_s), axis=1) > 1.0)
    if rows.sum() < 20:
        return untested(code, "hardly-moved")
    origin = np.mean(ours.place[rows], axis=0)
    here = ours.rows(rows).offsets(origin)
    # Heights of an autopilot follow the air pressure: they say nothing of the time.
    theirs = enu_offsets(path.lat_deg[rows], path.lon_deg[rows], ours.height_m[rows], origin)
    try:
        comparison = compare_positions(here, theirs, ours.velocity_m_s[rows] * [1, 1, 0], "shift")
    except IllPosedError as refusal:
        return untested(code, "ill-posed", {"reason": str(refusal)})
    best = comparison.best
    # A position that is ahead of ours was measured later than its stamp says.
    late = 0.0 if best is None else float(best.value[0])
    figures = {
        "late_s": late,
        "late_ms": abs(late) * 1e3,
        "detectable_s": comparison.detectable_s,
        "detectable_ms": comparison.detectable_s * 1e3,
        "rms_m": comparison.rms_m.tolist(),
    }
    # Of the autopilot's attitudes: with usual turns of 20 degrees a second half of 0.1 s is a degree.
    late_attitude_s = 0.05
    if abs(late) <= max(late_attitude_s, comparison.detectable_s):
        return Finding(code, "passed", figures=figures)
    return Finding(code, "grave", figures=figures, clauses=("slow" if late > 0 else "fast",))


def _other_positions(e: Evidence) -> list[Finding]:
    """Compare the exposures with every other position that was stated for them."""
    if e.trajectory is None:
        return []
    findings, at_antenna = [], replace(e.rig, lever_m=None)
    if e.listed is not None:
        places = e.listed.placed.place
        findings.append(judge_positions("vehicle-event-list", e.antenna, places, e.rig, "shift"))
    if e.events.claimed is not None:
        claimed = e.events.claimed[:, :3]
        findings.append(judge_positions("event-source", e.antenna, claimed, at_antenna, "shift"))
    by_name = {image.name: image.facts for image in e.images}
    facts = [by_name.get(name) for name in e.antenna.first_images]
    if any(f is not None and f.has_position for f in facts):
        stated = stated_places(facts)
        findings.append(judge_positions("image-positions", e.antenna, stated, at_antenna, "shift"))
    return findings


def _out_of_sight(e: Evidence) -> list[Finding]:
    """Say what nothing at this stage can show."""
    hidden = [untested("antenna-height", "shows-at-control")]
    if e.rig.lever_m is not None and np.count_nonzero(e.rig.lever_m):
        hidden.append(untested("boresight", "shows-in-images"))
    return hidden
