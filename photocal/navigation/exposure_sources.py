"""Where events, positions and attitudes of exposures come from, the best source first."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from photocal.base.arrays import Flags
from photocal.base.errors import ConfigurationError
from photocal.measurement.image_metadata import ImageMetadata, clock_time_s, stated_places
from photocal.navigation.attitude import LINE_OF_SIGHT, AttitudeSeries, at_instants, from_angles, no_attitudes
from photocal.navigation.events import (
    CameraEventList,
    Events,
    boot_exposures,
    logged_exposures,
    time_marks,
)
from photocal.navigation.ppk_inputs import Sources
from photocal.navigation.receiver_recording import ReceiverRecording
from photocal.navigation.rig import CameraOnBody
from photocal.navigation.time import GpsTime, UtcTime
from photocal.navigation.trajectory import InterpolatedPositions, Trajectory, interpolate, plainly
from photocal.navigation.vehicle import VehicleTrack

ELLIPSOIDAL, SEA_LEVEL = "ellipsoidal", "above mean sea level, as the autopilot computes it"
OF_IMAGES = "as the images state it (makers mostly write the height above mean sea level)"
# By priority: the hot shoe, the camera's own message, the trigger of the autopilot.
_LOGGED = (
    "CAMERA_FEEDBACK", "CAM", "camera_capture", "CAMERA_IMAGE_CAPTURED", "CAMERA_TRIGGER", "TRIG",
    "camera_trigger",
)  # fmt: skip
_LISTED = "MRK"


def events_of(
    sources: Sources, edge: str, receivers: dict[str, ReceiverRecording], vehicle: VehicleTrack | None
) -> Events | None:
    """Return the best events of the logs; None where there are none."""
    rover = receivers.get(sources.rover_link)
    if rover is not None:
        before, source = rover.epochs_before_marks(), rover.mark_source
        marks = time_marks(rover.marks(), edge, rover.link, before, source)
        if len(marks):
            return marks
    logged = {events.source: events for events in logged_exposures(sources.log)[0] if len(events)}
    clock_sigma_s = 0.0 if vehicle is None else vehicle.clock_sigma_s
    logged = {
        name: replace(events, accuracy_s=np.hypot(events.accuracy_s, clock_sigma_s))
        for name, events in logged.items()
    }
    if vehicle is not None and vehicle.clocks.clock is not None and not logged:
        logged = boot_exposures(sources.log, sources.vehicle_link, vehicle.clocks.clock)
    order = (*_LOGGED, *(name for name in logged if name not in _LOGGED))
    # The whole of an imported event list is read elsewhere.
    return next((logged[source] for source in order if source in logged and source != _LISTED), None)


def placed_by(
    events: Events,
    trajectory: Trajectory | None,
    listed: CameraEventList | None,
    vehicle: VehicleTrack | None,
) -> tuple[InterpolatedPositions, str]:
    """Return positions at events and their kind of height: PPK, else an event list, else the autopilot."""
    if trajectory is not None:
        placed = interpolate(trajectory, events.time, events.accuracy_s)
        if listed is None:
            return placed, ELLIPSOIDAL
        # The file's own offsets lead from the antenna, which PPK gives, to the camera.
        return placed.moved(listed.offset_enu_m), ELLIPSOIDAL
    if listed is not None:
        return listed.placed, ELLIPSOIDAL
    if vehicle is None or len(vehicle.path) < 2:
        raise ConfigurationError(
            "there are no positions: neither raw frames of a rover and a base nor an autopilot's positions",
            "give RINEX files, or a log with GLOBAL_POSITION_INT",
        )
    return plainly(vehicle.path, events.time), SEA_LEVEL


def attitudes_of_vehicle(vehicle: VehicleTrack | None, time: GpsTime, rig: CameraOnBody) -> AttitudeSeries:
    """Return the autopilot's attitudes at instants, with what its own clock adds to their uncertainty."""
    if vehicle is None or vehicle.attitude is None:
        return no_attitudes(len(time))
    attitudes = at_instants(vehicle.attitude, time, rig.angle_sigma)
    turn = attitudes.rate[:, :, None] * attitudes.rate[:, None, :] * vehicle.clock_sigma_s**2
    return replace(attitudes, covariance=attitudes.covariance + turn)


def attitudes_of_images(
    images: Sequence[ImageMetadata | None], rig: CameraOnBody
) -> tuple[AttitudeSeries, AttitudeSeries, Flags]:
    """Return the attitudes that the images themselves state (XMP of gimbal and vehicle)."""
    facts = [None if image is None else image.facts for image in images]
    unknown = (np.nan, np.nan, np.nan)
    gimbal = np.radians([unknown if f is None else f.gimbal_deg for f in facts]).reshape(-1, 3)
    vehicle = np.radians([unknown if f is None else f.vehicle_deg for f in facts]).reshape(-1, 3)
    line_of_sight = from_angles(gimbal, None)
    body = line_of_sight.turned(rig.axes.T @ LINE_OF_SIGHT)
    camera = from_angles(body.angles, rig.angle_sigma)
    return camera, from_angles(vehicle, rig.angle_sigma), camera.known


def events_of_images(images: list[ImageMetadata]) -> tuple[Events, InterpolatedPositions]:
    """Return the events and positions that the images state by themselves."""
    time_s = np.array([clock_time_s(image) for image in images])
    order = np.argsort(time_s, kind="stable")
    facts = [images[i].facts for i in order.tolist()]
    place = stated_places(facts)
    sigma = np.array([[np.nan] * 3 if f is None else f.position_sigma_m for f in facts])
    if not np.isfinite(place).all(axis=1).any():
        raise ConfigurationError(
            "no image states a position, and there are no events to match them to",
            "give a flight log or an event list with --mrk",
        )
    n = len(images)
    time = UtcTime(np.array([round(t * 1e9) for t in time_s[order].tolist()], np.int64)).to_gps()
    remark = "times are the camera's own clock, taken for UTC: zone and offset are not known"
    events = Events("the images themselves", time, np.arange(n), np.zeros(n), [remark])
    return events, InterpolatedPositions.stated(place, sigma, ["single"] * n)
