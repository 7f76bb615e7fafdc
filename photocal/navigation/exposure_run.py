"""The whole way from a flight log (and images) to exposures."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from drivers.errors import ConfigurationError
from photocal.navigation.engine import Engine
from photocal.navigation.events import Events, logged_exposures, time_marks
from photocal.navigation.exposures import CameraMatch, Exposures, at_camera, match_images
from photocal.navigation.image_metadata import ImageMetadata, read_images
from photocal.navigation.interpolation import Placed, interpolate
from photocal.navigation.mrk import CameraEventList, moved, read_mrk
from photocal.navigation.ppk import options_for, process
from photocal.navigation.ppk_inputs import Sources, gather_inputs
from photocal.navigation.ppk_report import ppk_figures
from photocal.navigation.receiver_recording import ReceiverRecording, read_receivers
from photocal.navigation.time import GpsTime, HostTime
from photocal.navigation.trajectory import Trajectory
from photocal.navigation.vehicle import VehicleTrack, attitude_at, autopilot_time, read_vehicle

Floats = NDArray[np.float64]
ELLIPSOIDAL, SEA_LEVEL = "ellipsoidal", "above mean sea level, as the autopilot computes it"


@dataclass(frozen=True)
class Choices:
    """What a person asked for.

    Parameters
    ----------
    sources : Sources
        For the trajectory.
    images : Path or None
        Folder of images.
    mrk : Path or None
        Event list of the vehicle, instead of the events of the log.
    edge : str
        ``rising`` or ``falling``.
    delay_s : float
        From the event to the exposure.
    lever_m, lever_sigma_m : float64 (3,) or None
        Antenna to camera, body axes.
    angle_sigma : float64 (3,) or None
        Of roll, pitch, yaw, rad.
    largest_offset_s : float
        Between the clocks of camera and log.
    """

    sources: Sources
    images: Path | None
    mrk: Path | None
    edge: str
    delay_s: float
    lever_m: Floats | None
    lever_sigma_m: Floats | None
    angle_sigma: Floats | None
    largest_offset_s: float


@dataclass(frozen=True)
class ExposureRun:
    """Exposures and what was noticed on the way."""

    exposures: Exposures
    trajectory: Trajectory | None
    cameras: list[CameraMatch]
    figures: dict[str, Any]


def run_exposures(choices: Choices, engine: Engine, folder: Path) -> ExposureRun:
    """Find events, positions, attitudes and images of a flight.

    Raises
    ------
    ConfigurationError
        When the log has neither events nor images, or nothing that tells positions.
    """
    flight = choices.sources.flight
    receivers = {} if flight is None else read_receivers(flight)
    trajectory, figures = _trajectory(choices, receivers, engine, folder)
    return _exposures(choices, receivers, trajectory, figures)


def place_exposures(
    choices: Choices, trajectory: Trajectory | None, ppk: dict[str, Any] | None
) -> ExposureRun:
    """Do the same with a trajectory that is there already, with the figures of its PPK."""
    flight = choices.sources.flight
    return _exposures(choices, {} if flight is None else read_receivers(flight), trajectory, ppk)


def _exposures(
    choices: Choices,
    receivers: dict[str, ReceiverRecording],
    trajectory: Trajectory | None,
    figures: dict[str, Any] | None,
) -> ExposureRun:
    flight = choices.sources.flight
    images = [] if choices.images is None else read_images(choices.images)
    vehicle = None if flight is None else read_vehicle(flight)
    listed = None if choices.mrk is None else read_mrk(choices.mrk)
    events = listed.events if listed else _events(choices, receivers)
    if events is None:
        return _by_arrival(images, vehicle, flight)
    events = events.delayed(choices.delay_s)
    placed = _placed(events, trajectory, vehicle, listed)
    if listed is not None and trajectory is not None:
        # The file's own offsets lead from the antenna, which PPK gives, to the camera.
        lat, lon, height = moved(placed.lat_deg, placed.lon_deg, placed.height_m, listed.offset_enu_m)
        placed = _replaced(placed, lat, lon, height)
    kind = SEA_LEVEL if trajectory is None and listed is None else ELLIPSOIDAL
    angles = np.full((len(events), 3), np.nan) if vehicle is None else attitude_at(vehicle, events.time)
    names = [""] * len(events)
    cameras: list[CameraMatch] = []
    if images:
        names, cameras = match_images(images, events, choices.largest_offset_s)
    exposures = Exposures(events.time, events.number, placed, angles, names, kind)
    if choices.lever_m is not None:
        if choices.lever_sigma_m is None or choices.angle_sigma is None:
            raise ConfigurationError(
                "a lever arm needs its standard deviations and those of the attitude",
                remedy="give --lever-arm-sigma and --attitude-sigma",
            )
        exposures = at_camera(exposures, choices.lever_m, choices.lever_sigma_m, choices.angle_sigma)
    return ExposureRun(exposures, trajectory, cameras, _figures(exposures, events, cameras, figures))


def _trajectory(
    choices: Choices, receivers: dict[str, ReceiverRecording], engine: Engine, folder: Path
) -> tuple[Trajectory | None, dict[str, Any] | None]:
    sources = choices.sources
    rover = receivers.get(sources.rover_link)
    raw = rover is not None and bool(rover.epochs or rover.empty_epochs or rover.untimed_epochs)
    if not raw and sources.rover is None:
        return None, None
    inputs, remarks = gather_inputs(sources, engine, folder)
    result = process(inputs, options_for(inputs.rover, inputs.base), "kinematic", engine, folder)
    return result.trajectory, ppk_figures(result, remarks)


def _events(choices: Choices, receivers: dict[str, ReceiverRecording]) -> Events | None:
    """Return the best events of the log: time marks before feedback before triggers."""
    rover = receivers.get(choices.sources.rover_link)
    if rover is not None:
        marks = time_marks(rover.marks(), choices.edge, rover.link)
        if len(marks):
            return marks
    if choices.sources.flight is None:
        return None
    logged = {events.source: events for events in logged_exposures(choices.sources.flight) if len(events)}
    for source in ("CAMERA_FEEDBACK", "CAMERA_IMAGE_CAPTURED", "CAMERA_TRIGGER"):
        if source in logged:
            return logged[source]
    return None


def _placed(
    events: Events,
    trajectory: Trajectory | None,
    vehicle: VehicleTrack | None,
    listed: CameraEventList | None,
) -> Placed:
    if trajectory is not None:
        return interpolate(trajectory, events.time, events.accuracy_s)
    if listed is not None:
        n = len(events)
        covariance = listed.sigma_enu_m[:, :, None] ** 2 * np.eye(3)
        unknown = np.full((n, 3), np.nan)
        return Placed(
            np.ones(n, bool), np.zeros(n), listed.lat_deg, listed.lon_deg, listed.height_m, unknown,
            covariance, listed.status,
        )  # fmt: skip
    if vehicle is None or len(vehicle.position_time) < 2:
        raise ConfigurationError(
            "nothing tells positions: neither raw frames of a rover and a base nor an autopilot's positions",
            remedy="give RINEX files, or a log with GLOBAL_POSITION_INT",
        )
    return vehicle_positions(vehicle, events.time)


def vehicle_positions(vehicle: VehicleTrack, time: GpsTime) -> Placed:
    """Return the autopilot's own positions at instants, between its messages; their sigma is not known."""
    n = len(time)
    path = Trajectory(
        vehicle.position_time,
        vehicle.lat_deg,
        vehicle.lon_deg,
        vehicle.height_msl_m,
        np.full(len(vehicle.position_time), "single"),
        np.full((len(vehicle.position_time), 3, 3), np.nan),
        np.full((len(vehicle.position_time), 3), np.nan),
        np.nan,
    )
    return interpolate(path, time, np.zeros(n), np.zeros((n, 3)))


def _by_arrival(
    images: list[ImageMetadata], vehicle: VehicleTrack | None, flight: Path | None
) -> ExposureRun:
    """Exposures of images that carry the recording computer's time in their names."""
    if not images or not all(image.from_name for image in images):
        raise ConfigurationError(
            "has no camera events (TIM-TM2, CAMERA_FEEDBACK, CAMERA_IMAGE_CAPTURED, CAMERA_TRIGGER)",
            where=flight,
            remedy="give an event list with --mrk, or images with the time of the log in their names",
        )
    if vehicle is None or len(vehicle.position_time) < 2:
        raise ConfigurationError("has no positions of an autopilot", where=flight, remedy="check the log")
    host = HostTime(np.array([round((image.time_s or 0.0) * 1e9) for image in images], np.int64))
    time, sigma = autopilot_time(vehicle, host)
    events = Events("time of receipt in file names", time, np.arange(len(images)), sigma)
    placed = vehicle_positions(vehicle, time)
    names = [image.name for image in images]
    angles = attitude_at(vehicle, time)
    exposures = Exposures(time, events.number, placed, angles, names, SEA_LEVEL)
    return ExposureRun(exposures, None, [], _figures(exposures, events, [], None))


def _replaced(placed: Placed, lat: Floats, lon: Floats, height: Floats) -> Placed:
    from dataclasses import replace

    return replace(placed, lat_deg=lat, lon_deg=lon, height_m=height)


def _figures(
    exposures: Exposures, events: Events, cameras: list[CameraMatch], ppk: dict[str, Any] | None
) -> dict[str, Any]:
    placed = exposures.placed
    status = placed.status[placed.placed]
    return {
        "schema": "photocal.exposures/1",
        "events": len(events),
        "events_from": events.source,
        "remarks": events.remarks,
        "placed": int(placed.placed.sum()),
        **{name: int((status == name).sum()) for name in ("fixed", "float", "single")},
        "not_placed": [
            {"event": int(exposures.number[i]), "time_gps": exposures.time[[i]].iso()[0],
             "reason": exposures.reason(i)}
            for i in np.flatnonzero(~placed.placed).tolist()
        ],
        "with_attitude": int(np.isfinite(exposures.angles).all(axis=1).sum()),
        "height": exposures.height_kind,
        "cameras": [_camera(found, events) for found in cameras],
        "ppk": ppk,
    }  # fmt: skip


def _camera(found: CameraMatch, events: Events) -> dict[str, Any]:
    m = found.matching
    return {
        "camera": found.camera,
        "matched": len(m.image),
        "unmatched_images": [found.names[i] for i in m.unmatched_images.tolist()],
        "ambiguous_images": [found.names[i] for i in m.ambiguous_images.tolist()],
        "unmatched_events": [int(events.number[i]) for i in m.unmatched_events.tolist()],
        "clock_offset_s": m.offset_s,
        "clock_offset_sigma_s": m.offset_sigma_s,
        "clock_drift_ppm": m.drift * 1e6,
        "clock_drift_sigma_ppm": m.drift_sigma * 1e6,
        "residual_s": m.scatter_s,
    }


def exposures_text(figures: dict[str, Any]) -> str:
    """Return the summary in words."""
    counts = ", ".join(f"{figures[name]} {name}" for name in ("fixed", "float", "single"))
    lines = [
        f"{figures['events']} events from {figures['events_from']}, {figures['placed']} placed: {counts}",
        f"heights {figures['height']}; {figures['with_attitude']} with attitude",
        *figures["remarks"],
    ]
    for camera in figures["cameras"]:
        rest = f"{len(camera['unmatched_images'])} images, {len(camera['unmatched_events'])} events"
        lines.append(f"{camera['camera']}: {camera['matched']} matched, without a partner {rest}")
    lines += [f"event {x['event']} at {x['time_gps']}: {x['reason']}" for x in figures["not_placed"]]
    return "\n".join(lines)
