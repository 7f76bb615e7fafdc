"""What the autopilot sends: its filter's view of the flight, by its own clock, as MAVLink messages."""

import itertools
from collections import defaultdict
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from acquire.simulate.gnss.observations import correlated
from acquire.simulate.world.exposures import antenna_at, antenna_velocity
from acquire.simulate.world.world import World
from drivers.mavlink.decode import encode
from drivers.mavlink.dialect import ardupilotmega
from photocal.base.arrays import Floats, Integers

Fields = Mapping[str, Any]

AUTOPILOT, RADIO = (1, 1), (51, 68)
LABEL = "SIMULATED FLIGHT, made by photocal"
_POSITION_SIGMA_M = np.array([0.6, 0.6, 1.0])
_WAYPOINT, _TAKE_OFF, _LAND = 16, 22, 21


@dataclass(frozen=True)
class SentMessage:
    """A message: when it leaves the autopilot (s since the start), who sends it, what it says."""

    time_s: float
    source: tuple[int, int]
    name: str
    fields: Fields


@dataclass(frozen=True)
class Filter:
    """Where the autopilot believes to be: the truth a little late, with errors that come and go."""

    world: World
    position_error_m: Floats
    angle_error: Floats
    step_s: float

    def place(self, time_s: Floats) -> tuple[Floats, Floats]:
        """Give latitude, longitude (rad), height (m), and velocity east, north, up."""
        late = time_s - self.world.configuration.telemetry.lag_s
        local = antenna_at(self.world.motion, self.world.rig, late) + self._error(
            self.position_error_m, time_s
        )
        velocity = antenna_velocity(self.world.motion, self.world.rig, late)
        return self.world.place.to_geodetic(local), velocity

    def angles(self, time_s: Floats) -> Floats:
        """Give roll, pitch, yaw, rad."""
        late = time_s - self.world.configuration.telemetry.lag_s
        return np.asarray(self.world.motion.angles(late) + self._error(self.angle_error, time_s))

    def _error(self, values: Floats, time_s: Floats) -> Floats:
        at = np.arange(len(values)) * self.step_s
        return np.column_stack([np.interp(time_s, at, axis) for axis in values.T])


def make_filter(world: World) -> Filter:
    """Draw the errors of the autopilot's filter."""
    random, step = world.random("telemetry"), 0.05
    count = int(world.motion.duration_s / step) + 2
    sigma = np.radians(world.configuration.rig.attitude_sigma_deg)
    positions, angles = (random.standard_normal((count, 3)) for _ in range(2))
    # How long an error of the filter stays; exposures are farther apart.
    correlation_s = 0.8
    return Filter(
        world,
        correlated(positions.T, step / 30.0).T * _POSITION_SIGMA_M,
        correlated(angles.T, step / correlation_s).T * sigma,
        step,
    )


def messages(world: World) -> list[SentMessage]:
    """Give all messages of a flight in the order of sending."""
    view = make_filter(world)
    parts = itertools.chain(
        _status(world),
        _attitudes(world, view),
        _positions(world, view),
        _pictures(world, view),
        _mission(world),
    )
    return sorted(parts, key=lambda sent: sent.time_s)


def frames(sent: list[SentMessage]) -> list[bytes]:
    """Give the frames of messages; every source numbers its own."""
    dialect = ardupilotmega()
    numbers = {name: dialect.number(name) for name in {message.name for message in sent}}
    counts: defaultdict[tuple[int, int], Iterator[int]] = defaultdict(itertools.count)
    made = []
    for message in sent:
        (system, component), sequence = message.source, next(counts[message.source])
        kind, fields = numbers[message.name], dict(message.fields)
        made.append(encode(dialect, kind, fields, sequence=sequence, system=system, component=component))
    return made


def _every(world: World, rate_hz: float, phase_s: float) -> Floats:
    return np.asarray(np.arange(phase_s, world.motion.duration_s, 1 / rate_hz))


def _rows(name: str, time_s: Floats, columns: Mapping[str, Any]) -> Iterator[SentMessage]:
    values = [np.broadcast_to(column, len(time_s)).tolist() for column in columns.values()]
    for moment, *row in zip(time_s.tolist(), *values, strict=True):
        yield SentMessage(moment, AUTOPILOT, name, dict(zip(columns, row, strict=True)))


def _whole(values: Any) -> Integers:
    return np.asarray(np.rint(values), dtype=np.int64)


def _where(place: Floats, lon: str = "lon") -> dict[str, Integers]:
    """Give latitude and longitude (rad) as messages tell them, in 1e-7 degrees."""
    return {"lat": _whole(np.degrees(place[:, 0]) * 1e7), lon: _whole(np.degrees(place[:, 1]) * 1e7)}


def _since_boot(world: World, time_s: Floats, unit_s: float) -> Integers:
    """Give the autopilot's own time: it is measured from its start, a little fast or slow."""
    given = world.configuration.telemetry
    return _whole((given.boot_s + time_s * (1 + given.clock_drift_ppm * 1e-6)) * unit_s)


def _status(world: World) -> Iterator[SentMessage]:
    random = world.random("telemetry")
    yield SentMessage(0.0, AUTOPILOT, "STATUSTEXT", {"severity": 6, "text": LABEL.encode()})
    time = _every(world, 1.0, 0.01)
    flying = (time > world.configuration.plan.on_ground_s).tolist()
    # Armed with a mode of its own, active; or standing by.
    state = {"base_mode": np.where(flying, 209, 81), "system_status": np.where(flying, 4, 3)}
    fixed = {"type": 2, "autopilot": 3, "custom_mode": 3, "mavlink_version": 3}
    yield from _rows("HEARTBEAT", time, {**fixed, **state})
    clock_jitter_s = 0.0003
    read = time + random.standard_normal(len(time)) * clock_jitter_s
    utc_us = world.utc_ns(read) // 1000
    yield from _rows(
        "SYSTEM_TIME", time + 0.003, {"time_unix_usec": utc_us, "time_boot_ms": _since_boot(world, time, 1e3)}
    )
    used = time / world.motion.duration_s
    battery = {
        "voltage_battery": _whole(16_600 - 1_500 * used),
        "current_battery": np.where(flying, 1_430, 90),
        "battery_remaining": _whole(98 - 55 * used),
        "load": 312,
    }
    yield from _rows("SYS_STATUS", time + 0.006, battery)
    yield from _rows("TIMESYNC", time + 0.009, {"tc1": 0, "ts1": _since_boot(world, time, 1e9)})
    for moment in time.tolist():
        radio = {"rssi": 190, "remrssi": 185, "txbuf": 100, "noise": 60, "remnoise": 62}
        yield SentMessage(moment + 0.4, RADIO, "RADIO_STATUS", radio)


def _attitudes(world: World, view: Filter) -> Iterator[SentMessage]:
    rate = world.configuration.telemetry.attitude_hz
    time = _every(world, rate, 0.02)
    angles = view.angles(time)
    speed = np.gradient(angles, time, axis=0)
    rates = {name: speed[:, k] for k, name in enumerate(("rollspeed", "pitchspeed", "yawspeed"))}
    turned = np.remainder(angles + np.pi, 2 * np.pi) - np.pi
    named = {name: turned[:, k] for k, name in enumerate(("roll", "pitch", "yaw"))}
    yield from _rows("ATTITUDE", time, {"time_boot_ms": _since_boot(world, time, 1e3), **named, **rates})
    slow = time[::4] + 0.001
    quaternions = Rotation.from_euler("ZYX", view.angles(slow)[:, ::-1]).as_quat(scalar_first=True)
    parts = {f"q{k + 1}": quaternions[:, k] for k in range(4)}
    yield from _rows("ATTITUDE_QUATERNION", slow, {"time_boot_ms": _since_boot(world, slow, 1e3), **parts})


def _positions(world: World, view: Filter) -> Iterator[SentMessage]:
    rate, geoid = world.configuration.telemetry.position_hz, world.configuration.place.geoid_m
    time = _every(world, rate, 0.03)
    place, velocity = view.place(time)
    yaw = view.angles(time)[:, 2]
    home = world.place.height_m + world.motion.ground_m
    yield from _rows(
        "GLOBAL_POSITION_INT",
        time,
        {
            "time_boot_ms": _since_boot(world, time, 1e3),
            **_where(place),
            "alt": _whole((place[:, 2] - geoid) * 1e3),
            "relative_alt": _whole((place[:, 2] - home) * 1e3),
            "vx": _whole(velocity[:, 1] * 100),
            "vy": _whole(velocity[:, 0] * 100),
            "vz": _whole(-velocity[:, 2] * 100),
            "hdg": _whole(np.degrees(yaw) % 360 * 100) % 36_000,
        },
    )
    later = time + 0.05
    place, velocity = view.place(later)
    yield from _rows(
        "GPS_RAW_INT",
        later,
        {
            "time_usec": _since_boot(world, later, 1e6),
            "fix_type": 4,
            **_where(place),
            "alt": _whole((place[:, 2] - geoid) * 1e3),
            "alt_ellipsoid": _whole(place[:, 2] * 1e3),
            "eph": 70,
            "epv": 110,
            "vel": _whole(np.hypot(velocity[:, 0], velocity[:, 1]) * 100),
            "cog": _whole(np.degrees(np.arctan2(velocity[:, 0], velocity[:, 1])) % 360 * 100) % 36_000,
            "satellites_visible": 21,
            "h_acc": 600,
            "v_acc": 1000,
        },
    )


def _pictures(world: World, view: Filter) -> Iterator[SentMessage]:
    event, geoid = world.exposures.event_s, world.configuration.place.geoid_m
    # From the autopilot's trigger to the pulse of the camera's hot shoe.
    trigger_lead_s = 0.065
    trigger = event - trigger_lead_s
    numbers = np.arange(1, len(event) + 1)
    yield from _rows("CAMERA_TRIGGER", trigger, {"time_usec": world.utc_ns(trigger) // 1000, "seq": numbers})
    place, _ = view.place(event)
    angles = np.degrees(view.angles(event))
    home = world.place.height_m + world.motion.ground_m
    yield from _rows(
        "CAMERA_FEEDBACK",
        event + 0.015,
        {
            "time_usec": world.utc_ns(event) // 1000,
            "img_idx": numbers,
            **_where(place, "lng"),
            "alt_msl": place[:, 2] - geoid,
            "alt_rel": place[:, 2] - home,
            "roll": angles[:, 0],
            "pitch": angles[:, 1],
            "yaw": (angles[:, 2] + 180) % 360 - 180,
            "completed_captures": numbers,
        },
    )


def _mission(world: World) -> Iterator[SentMessage]:
    """Give the plan as it is sent before the take-off, and how it is followed."""
    strips = world.motion.strip
    ends = np.array([moment for _, begin, end in strips for moment in (begin, end)])
    place = world.place.to_geodetic(world.motion.position(ends))
    home = world.place.to_geodetic(world.motion.position(np.zeros(1)))
    route = np.vstack([home, place, home])
    commands = [_TAKE_OFF, *([_WAYPOINT] * len(place)), _LAND]
    yield SentMessage(5.0, AUTOPILOT, "MISSION_COUNT", {"count": len(route), "target_system": 255})
    global_relative = 6
    for number, (where, command) in enumerate(zip(route.tolist(), commands, strict=True)):
        item = {
            "target_system": 255,
            "seq": number,
            "frame": global_relative,
            "command": command,
            "autocontinue": 1,
            "x": round(np.degrees(where[0]) * 1e7),
            "y": round(np.degrees(where[1]) * 1e7),
            "z": where[2] - float(home[0, 2]),
        }
        yield SentMessage(5.1 + 0.05 * number, AUTOPILOT, "MISSION_ITEM_INT", item)
    for number, moment in enumerate(ends.tolist(), 1):
        yield SentMessage(moment, AUTOPILOT, "MISSION_ITEM_REACHED", {"seq": number})
    for moment in np.arange(6.5, world.motion.duration_s, 2.0).tolist():
        following = int(np.searchsorted(ends, moment)) + 1
        yield SentMessage(moment, AUTOPILOT, "MISSION_CURRENT", {"seq": following})
