"""The streams of the three devices of a flight: autopilot, rover, base."""

from dataclasses import dataclass, replace

import numpy as np

from acquire.simulate.gnss.constellation import Antenna
from acquire.simulate.gnss.observations import Session, simulate
from acquire.simulate.gnss.settings import BASE, ROVER, SkySettings
from acquire.simulate.gnss.streams import Pulses, Stream, base_rtcm, base_ubx, rover_ubx
from acquire.simulate.world import telemetry
from acquire.simulate.world.block_folder import telemetry_gap
from acquire.simulate.world.exposures import antenna_at, antenna_velocity
from acquire.simulate.world.world import World
from photocal.base.arrays import Floats, Integers


@dataclass(frozen=True)
class RecordedWire:
    """What arrived over one link.

    arrival_s (n,): when each frame had arrived, s since the start of the flight; never decreasing.
    damaged: frames that arrived with a wrong bit; 0 where it is not known.
    """

    arrival_s: Floats
    frames: tuple[bytes, ...]
    damaged: int = 0

    @property
    def data(self) -> bytes:
        """All bytes one after another."""
        return b"".join(self.frames)

    @property
    def end_s(self) -> float:
        """When the last frame is complete."""
        return float(self.arrival_s[-1]) if len(self.arrival_s) else 0.0


def carry(
    time_s: Floats,
    frames: list[bytes],
    random: np.random.Generator,
    *,
    latency_s: float = 0.0,
    loss: float = 0.0,
    damage: float = 0.0,
    gap_s: tuple[float, float] = (np.inf, np.inf),
) -> RecordedWire:
    """Carry frames from a device to the recording; `time_s` (n,): when they are sent."""
    late = latency_s * (0.6 + 0.4 * random.exponential(size=len(frames)))
    arrival = np.maximum.accumulate(np.asarray(time_s) + late)
    kept = (random.random(len(frames)) >= loss) & ~((time_s >= gap_s[0]) & (time_s < gap_s[1]))
    hurt = kept & (random.random(len(frames)) < damage)
    arrived = list(frames)
    for number in np.flatnonzero(hurt).tolist():
        arrived[number] = _turned(frames[number], random)
    rows = np.flatnonzero(kept)
    return RecordedWire(arrival[rows], tuple(arrived[row] for row in rows.tolist()), int(hurt.sum()))


def _turned(frame: bytes, random: np.random.Generator) -> bytes:
    bit = int(random.integers(8 * len(frame)))
    octets = bytearray(frame)
    octets[bit // 8] ^= 1 << bit % 8
    return bytes(octets)


def telemetry_log(world: World, wire: RecordedWire) -> bytes:
    """Give the bytes of a `.tlog`: each frame after the UTC of its arrival, microseconds, big-endian."""
    utc_start_us = int(world.utc_ns(np.zeros(1))[0]) // 1000
    stamps = utc_start_us + np.rint(wire.arrival_s * 1e6).astype(np.int64)
    pairs = zip(stamps.tolist(), wire.frames, strict=True)
    return b"".join(stamp.to_bytes(8, "big") + frame for stamp, frame in pairs)


def make_streams(world: World) -> dict[str, RecordedWire]:
    """Let the devices of a flight send: what the recording receives over vehicle, rover and base."""
    given = world.configuration
    random = world.random("wires")
    vehicle = vehicle_wire(world, random)
    session, chance = _session(world)
    rover = rover_ubx(session, _events(world), given.place.geoid_m, rng=chance)
    base = base_ubx(session) if given.gnss.base_protocol == "ubx" else base_rtcm(session)
    return {
        "vehicle": vehicle,
        "rover": _carried(world, rover, random, given.wires.rover_loss, given.wires.rover_damage),
        "base": _carried(world, base, random, 0.0, 0.0),
    }


def vehicle_wire(world: World, random: np.random.Generator) -> RecordedWire:
    """Let the autopilot send over its radio."""
    given, sent = world.configuration, telemetry.messages(world)
    return carry(
        np.array([message.time_s for message in sent]),
        telemetry.frames(sent),
        random,
        latency_s=given.telemetry.latency_s,
        loss=given.wires.vehicle_loss,
        damage=given.wires.vehicle_damage,
        gap_s=telemetry_gap(world),
    )


def _carried(
    world: World, stream: Stream, random: np.random.Generator, loss: float, damage: float
) -> RecordedWire:
    return carry(world.seconds(stream.time_gps_ns), stream.frames, random, loss=loss, damage=damage)


def _session(world: World) -> tuple[Session, np.random.Generator]:
    given, chance = world.configuration.gnss, world.random("sky")
    rover_model = replace(ROVER, interval_s=given.rover_interval_s)
    base_model = replace(BASE, interval_s=given.base_interval_s)
    if world.has("cycle_slips"):
        slips = world.configuration.fault_sizes.slips_per_hour
        rover_model, base_model = (replace(m, slips_per_hour=slips) for m in (rover_model, base_model))
    east, north, up = world.base_error_m.tolist()
    session = simulate(
        _rover(world),
        Antenna.still(world.place.to_geocentric(world.base_antenna_m[None])[0]),
        (world.start_gps_ns, int(world.gps_ns(np.array(world.motion.duration_s)))),
        rng=chance,
        sky=SkySettings(**world.configuration.air.model_dump()),
        rover_model=rover_model,
        base_model=base_model,
        base_shift_m=(east, north, up),
    )
    return session, chance


def _rover(world: World) -> Antenna:
    def position(time_gps_ns: Integers) -> Floats:
        """Earth-centred position of the antenna, m."""
        local = antenna_at(world.motion, world.rig, world.seconds(time_gps_ns))
        return world.place.to_geocentric(local)

    def velocity(time_gps_ns: Integers) -> Floats:
        """Earth-centred velocity of the antenna, m/s."""
        local = antenna_velocity(world.motion, world.rig, world.seconds(time_gps_ns))
        return np.asarray(local @ world.place.axes)

    return Antenna(position, velocity)


def _events(world: World) -> Pulses:
    rising = world.gps_ns(world.exposures.event_s)
    pulse_s = 0.02
    falling = world.gps_ns(world.exposures.event_s + pulse_s)
    if world.has("event_time_base"):
        # The receiver was set to mark in UTC and says GNSS.
        return Pulses(rising, falling, time_base="gnss", stamped_in="utc")
    return Pulses(rising, falling)
