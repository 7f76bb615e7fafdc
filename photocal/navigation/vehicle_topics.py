"""Positions and attitudes of a vehicle as decoded in the flight log, whatever they came from.

Logs of autopilots that were imported (DataFlash, ULog) have no MAVLink frames; their positions and attitudes
stand in the log's own topics, by the device's UTC.
"""

from __future__ import annotations

import numpy as np

from acquire.channels.mounting import Mounting, mounting_of
from acquire.log.reader import read_json
from drivers.arrays import Floats, Integers
from drivers.gnsstime import SECOND_NS
from photocal.navigation.attitude import AttitudeTrack, rotations_of_quaternions
from photocal.navigation.flight_log import FlightLog
from photocal.navigation.time import UtcTime


def decoded_positions(log: FlightLog, link: str) -> tuple[Integers, Integers, Floats]:
    """Return the positions in `/<link>/position`, or where there are none in `/gnss/<link>/fix`."""
    found = _fixes(log, f"/{link}/position")
    return found if len(found[0]) else _fixes(log, f"/gnss/{link}/fix")


def _fixes(log: FlightLog, topic: str) -> tuple[Integers, Integers, Floats]:
    from foxglove_schemas_protobuf.LocationFix_pb2 import LocationFix

    stamps, logged, places = [], [], []
    for messages in log.topic(topic):
        for payload, log_ns in zip(messages.payloads, messages.log_ns.tolist(), strict=True):
            fix = LocationFix.FromString(payload)
            stamps.append(fix.timestamp.seconds * SECOND_NS + fix.timestamp.nanos)
            logged.append(log_ns)
            places.append((fix.latitude, fix.longitude, fix.altitude))
    utc, first = np.unique(np.array(stamps, np.int64), return_index=True)
    return utc, np.array(logged, np.int64)[first], np.array(places).reshape(-1, 3)[first]


def decoded_attitude(log: FlightLog, link: str) -> AttitudeTrack | None:
    """Return the rotations in `/<link>/attitude`: body (forward, right, down) to north, east, down."""
    from foxglove_schemas_protobuf.FrameTransform_pb2 import FrameTransform

    stamps, turns, source = [], [], ""
    for messages in log.topic(f"/{link}/attitude"):
        source = messages.channel.metadata.get("source", "attitude")
        for payload in messages.payloads:
            found = FrameTransform.FromString(payload)
            stamps.append(found.timestamp.seconds * SECOND_NS + found.timestamp.nanos)
            q = found.rotation
            turns.append((q.w, q.x, q.y, q.z))
    wxyz = np.array(turns).reshape(-1, 4)
    sound = np.abs(np.linalg.norm(wxyz, axis=1) - 1) < 0.01
    if not sound.any():
        return None
    utc, first = np.unique(np.array(stamps, np.int64)[sound], return_index=True)
    return AttitudeTrack(UtcTime(utc).to_gps(), rotations_of_quaternions(wxyz[sound][first]), source)


def told_mounting(log: FlightLog, link: str) -> Mounting:
    """Return what the autopilot's parameters in `/<link>/parameter` tell of its mounting."""
    parameters: dict[str, float] = {}
    for messages in log.topic(f"/{link}/parameter"):
        for payload in messages.payloads:
            told = read_json(bytes(payload), log.paths[0])
            if isinstance(told.get("value"), int | float):
                parameters[str(told.get("name"))] = float(told["value"])
    return mounting_of(parameters)
