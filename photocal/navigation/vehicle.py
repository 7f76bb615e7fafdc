"""What the autopilot itself recorded: its positions and attitudes, by its own clock.

The autopilot's clock and that of the recording computer by TIMESYNC exchanges.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from acquire.channels.mounting import AutopilotMounting, mounting_of
from acquire.log.reader import read_json
from drivers.frames import Wire
from drivers.identify import batch_of_payloads
from drivers.mavlink.decode import decode, sources
from drivers.mavlink.dialect import ardupilotmega
from photocal.base.arrays import Flags, Floats, Integers
from photocal.base.errors import IllPosedError
from photocal.base.time_scales import SECOND_NS
from photocal.geometry.rotation import object_to_body
from photocal.navigation.attitude import AttitudeTrack, rotations_of_quaternions
from photocal.navigation.device_clocks import (
    ComparedClocks,
    autopilot_clock,
    converted,
    device_by_arrival,
    fit_clock,
)
from photocal.navigation.flight_log import FlightLog
from photocal.navigation.time import GpsTime, HostTime, UtcTime
from photocal.navigation.trajectory import Trajectory

# A receiver sends an epoch up to a tenth of a second after it: computation and transmission.
_RECEIVER_LATE_S, _RECEIVER_LATE_SIGMA_S = 0.05, 0.03
Received = tuple[Integers, Integers, NDArray[Any]]


@dataclass(frozen=True)
class TimeSync:
    """Two clocks by exchanges of messages, both ways round.

    host_of_boot, boot_of_host: the recording computer's clock by the autopilot's time since boot, and the
        reverse.
    """

    host_of_boot: ComparedClocks
    boot_of_host: ComparedClocks

    def boot(self, host_ns: Integers) -> tuple[Integers, Floats]:
        """Return the autopilot's time since boot (ns) at moments of the host's clock, and the sigma (s)."""
        time, sigma = converted(self.boot_of_host.cycles[0], host_ns)
        return time, np.hypot(sigma, self.boot_of_host.constant_sigma_s)


def time_sync(boot_ns: Integers, host_ns: Integers, round_trip_ns: Integers) -> TimeSync | None:
    """Fit the recording computer's clock to the autopilot's by TIMESYNC exchanges."""
    if not len(boot_ns):
        return None
    # Answers that took longer than this multiple of the shortest waited in a queue on one way.
    slow_answer = 3.0
    least_trip_ns = 1_000_000
    shortest = max(int(round_trip_ns.min()), least_trip_ns)
    quick = round_trip_ns <= slow_answer * shortest
    boot, trip = boot_ns[quick], round_trip_ns[quick]
    middle = host_ns[quick] - trip // 2
    # A single middle is uncertain by what its trip goes over the shortest.
    resolution = max(float(np.median(trip - round_trip_ns.min())) / 1e9, 1e-4)
    # Clocks of computers are set by milliseconds at a time; what stands out of the scatter by more is a jump.
    jump_trips = 3.0
    jump = jump_trips * shortest / 1e9
    try:
        models = [fit_clock(a, b, resolution, jump) for a, b in ((boot, middle), (middle, boot))]
    except IllPosedError:
        return None
    names = (
        "recording computer by the autopilot's time since boot (TIMESYNC)",
        "autopilot's time since boot by the recording computer (TIMESYNC)",
    )
    constant = float(round_trip_ns.min()) / 1e9 / np.sqrt(12)
    compared = (ComparedClocks(name, (model,), constant) for name, model in zip(names, models, strict=True))
    return TimeSync(*compared)


def clock_through_host(
    boot_ns: Integers, host_ns: Integers, round_trip_ns: Integers, gnss: ComparedClocks
) -> ComparedClocks | None:
    """Return the UTC of an autopilot that does not tell it, by the recording computer and a GNSS receiver."""
    sync = time_sync(boot_ns, host_ns, round_trip_ns)
    if sync is None or sync.host_of_boot.played_back or gnss.played_back:
        return None
    boot = np.sort(boot_ns)
    host, _ = converted(sync.host_of_boot.cycles[0], boot)
    epoch, _ = converted(gnss.cycles[0], host)
    late = round(_RECEIVER_LATE_S * 1e9)
    utc = GpsTime(epoch + late).to_utc().ns
    try:
        fitted = fit_clock(boot, utc, sync.host_of_boot.scatter_s)
    except IllPosedError:
        return None
    constant = float(np.hypot(sync.host_of_boot.constant_sigma_s, _RECEIVER_LATE_SIGMA_S))
    name = "autopilot's UTC by TIMESYNC and the epochs of a GNSS receiver"
    return ComparedClocks(name, (fitted,), constant, host_ns[:1])


@dataclass(frozen=True)
class VehicleClocks:
    """The clocks of a vehicle.

    clock: UTC of its time since boot.
    sync: its time since boot against the recording computer's clock.
    utc_told: whether the autopilot itself told UTC (SYSTEM_TIME).
    """

    clock: ComparedClocks | None = None
    sync: TimeSync | None = None
    compared: tuple[ComparedClocks, ...] = ()
    utc_told: bool = False


def vehicle_clocks(
    system: Received | None, exchanges: Received | None, gnss: ComparedClocks | None
) -> VehicleClocks:
    """Fit an autopilot's clock to UTC and to the recording computer's clock."""
    millisecond_ns = 1_000_000
    # An answer after ten seconds belongs to a question before a restart.
    longest_trip_ns = 10_000_000_000
    clocks: list[ComparedClocks] = []
    clock, synced, utc_told = None, None, False
    if system is not None:
        host, _, fields = system
        boot = fields["time_boot_ms"].astype(np.int64) * millisecond_ns
        utc = fields["time_unix_usec"].astype(np.int64) * 1000
        # A bit error that a checksum of 16 bits passed shows as a time of another year.
        good = utc > 0
        good &= np.abs(utc - np.median(utc[good])) < 86_400 * 10**9 if good.any() else False
        clock = autopilot_clock(boot[good], utc[good], host[good])
        arrival = device_by_arrival(
            "autopilot's UTC by the recording computer's clock (SYSTEM_TIME)", utc[good], host[good]
        )
        clocks += [compared for compared in (clock, arrival) if compared is not None]
        utc_told = clock is not None
    if exchanges is not None:
        host, _, fields = exchanges
        trip = host - fields["ts1"]
        answered = (fields["tc1"] > 0) & (trip >= 0) & (trip < longest_trip_ns)
        boot, trip = (values[answered].astype(np.int64) for values in (fields["tc1"], trip))
        synced = time_sync(boot, host[answered], trip)
        clocks += [] if synced is None else [synced.host_of_boot]
        if clock is None and gnss is not None:
            clock = clock_through_host(boot, host[answered], trip, gnss)
            clocks += [] if clock is None else [clock]
    return VehicleClocks(clock, synced, tuple(clocks), utc_told)


# Logs from an autopilot's card take UTC from when positions of its receiver were noted: late by up to 0.1 s.
_CARD_SIGMA_S = 0.05
_TRACKS = ("GLOBAL_POSITION_INT", "ATTITUDE", "ATTITUDE_QUATERNION")
_KINDS = (*_TRACKS, "SYSTEM_TIME", "TIMESYNC", "GPS_RAW_INT")


@dataclass(frozen=True)
class VehicleTrack:
    """Positions and attitudes of the first autopilot of a log, in the order of its own clock.

    path: by the autopilot's clock, never by arrival; heights above sea level as the autopilot computes them.
    position_host: arrival of its positions.
    attitude: rotations; of ATTITUDE and ATTITUDE_QUATERNION the one with more messages.
    clock_sigma_s: standard deviation of the autopilot's UTC.
    geoid_m: height above the ellipsoid less height above sea level that the autopilot's GNSS receiver tells.
    mounting: what its parameters tell of antenna and camera mount.
    """

    path: Trajectory
    position_host: HostTime
    attitude: AttitudeTrack | None
    clock_sigma_s: float = 0.0
    clocks: VehicleClocks = field(default_factory=VehicleClocks)
    geoid_m: float | None = None
    mounting: AutopilotMounting = field(default_factory=lambda: AutopilotMounting(()))


def read_vehicle(log: FlightLog, link: str | None = None, gnss: ComparedClocks | None = None) -> VehicleTrack:
    """Read positions, attitudes and clocks of the autopilot from a flight log."""
    # Raw MAVLink frames go first; what was imported from an autopilot's own log stands in decoded topics.
    received = _received(log, link)
    if not received:
        return _of_topics(log, link or "vehicle")
    clocks = vehicle_clocks(received.get("SYSTEM_TIME"), received.get("TIMESYNC"), gnss)
    tracks = {name: _timed(received.get(name), clocks) for name in _TRACKS}
    p = tracks["GLOBAL_POSITION_INT"]
    none = np.empty(0, np.int64)
    scale = {"lat": 1e-7, "lon": 1e-7, "alt": 1e-3}
    place = [np.empty(0) if p is None else p[2][key] * unit for key, unit in scale.items()]
    return VehicleTrack(
        path_of(UtcTime(none if p is None else p[1]).to_gps(), place),
        HostTime(none if p is None else p[0]),
        _attitude(tracks),
        0.0 if clocks.clock is None else clocks.clock.sigma_s,
        clocks,
        _geoid(received.get("GPS_RAW_INT")),
        told_mounting(log, link or "vehicle"),
    )


def _of_topics(log: FlightLog, link: str) -> VehicleTrack:
    utc, host, place = decoded_positions(log, link)
    return VehicleTrack(
        path_of(UtcTime(utc).to_gps(), place.T),
        HostTime(host),
        decoded_attitude(log, link),
        _CARD_SIGMA_S,
        mounting=told_mounting(log, link),
    )


def path_of(time: GpsTime, place: Sequence[Floats] | Floats) -> Trajectory:
    """Return the autopilot's own latitudes, longitudes and heights as a path; their sigma is not known."""
    n, (lat, lon, height) = len(time), place
    unknown = np.full((n, 3, 3), np.nan)
    return Trajectory(time, lat, lon, height, np.full(n, "single"), unknown, unknown[:, 0], np.nan)


def _received(log: FlightLog, link: str | None) -> dict[str, Received]:
    """Messages by their kinds: arrival, the device's UTC as the log has it, and fields."""
    dialect = ardupilotmega()
    kinds = {name: dialect.number(name) for name in _KINDS}
    received: dict[str, list[Received]] = {}
    owner: int | None = None
    for _, messages in log.raw(Wire.MAVLINK, link=link):
        batch = batch_of_payloads(Wire.MAVLINK, messages.payloads, dialect)
        for name, kind in kinds.items():
            got = decode(batch, kind, dialect)
            if not len(got):
                continue
            if owner is None and name in _TRACKS:
                owner = int(sources(batch, got.index)[0][0])
            of_owner = np.ones(len(got), bool) if owner is None else sources(batch, got.index)[0] == owner
            rows = got.index[of_owner]
            parts = received.setdefault(name, [])
            parts.append((messages.log_ns[rows], messages.publish_ns[rows], got.fields[of_owner]))
    columns = {name: zip(*parts, strict=True) for name, parts in received.items()}
    return {
        name: (np.concatenate(host), np.concatenate(device), np.concatenate(fields))
        for name, (host, device, fields) in columns.items()
    }


def _timed(received: Received | None, clocks: VehicleClocks) -> Received | None:
    """Return arrival, UTC and fields in the order of UTC, without the messages that had no time."""
    if received is None:
        return None
    host, device, fields = received
    # Where the device told no time the log repeats the time of arrival.
    timed = np.ones(len(host), bool) if clocks.clock is not None and not clocks.utc_told else host != device
    host, device, fields = host[timed], device[timed], fields[timed]
    kept = np.flatnonzero(~_strays(device))
    host, device, fields = host[kept], device[kept], fields[kept]
    if clocks.clock is not None and len(host):
        millisecond_ns = 1_000_000
        device, _ = clocks.clock.convert(fields["time_boot_ms"].astype(np.int64) * millisecond_ns, host)
    _, first = np.unique(device, return_index=True)
    return host[first], device[first], fields[first]


def _attitude(tracks: Mapping[str, Received | None]) -> AttitudeTrack | None:
    made = []
    angles = tracks["ATTITUDE"]
    if angles is not None and len(angles[0]):
        rpy = np.stack([angles[2][name].astype(float) for name in ("roll", "pitch", "yaw")], axis=1)
        made.append(AttitudeTrack(UtcTime(angles[1]).to_gps(), object_to_body(rpy)[0]))
    quaternions = tracks["ATTITUDE_QUATERNION"]
    if quaternions is not None and len(quaternions[0]):
        wxyz = np.stack([quaternions[2][name].astype(float) for name in ("q1", "q2", "q3", "q4")], axis=1)
        sound = np.abs(np.linalg.norm(wxyz, axis=1) - 1) < 0.01
        time = UtcTime(quaternions[1][sound]).to_gps()
        made.append(AttitudeTrack(time, rotations_of_quaternions(wxyz[sound])))
    return max(made, key=len, default=None)


def _geoid(received: Received | None) -> float | None:
    if received is None or "alt_ellipsoid" not in (received[2].dtype.names or ()):
        return None
    fields = received[2]
    known = (fields["alt_ellipsoid"] != 0) & (fields["fix_type"] >= 3)
    if not known.any():
        return None
    return float(np.median(fields["alt_ellipsoid"][known].astype(float) - fields["alt"][known])) * 1e-3


def _strays(device: Integers) -> Flags:
    """Tell which single times stand out of the order of arrival: damage that a checksum of 16 bits passed."""
    # In a sequence that grows the middle of five is its own median.
    if len(device) < 5:
        return np.zeros(len(device), bool)
    padded = np.concatenate([device[:1].repeat(2), device, device[-1:].repeat(2)])
    windows = np.lib.stride_tricks.sliding_window_view(padded, 5)
    stray_ns = 5_000_000_000
    return np.asarray(np.abs(device - np.median(windows, axis=1).astype(np.int64)) > stray_ns)


def decoded_positions(log: FlightLog, link: str) -> tuple[Integers, Integers, Floats]:
    """Return the positions in `/<link>/position`, or where there are none in `/gnss/<link>/fix`."""
    positions = _fixes(log, f"/{link}/position")
    return positions if len(positions[0]) else _fixes(log, f"/gnss/{link}/fix")


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

    stamps, turns = [], []
    for messages in log.topic(f"/{link}/attitude"):
        for payload in messages.payloads:
            transform = FrameTransform.FromString(payload)
            stamps.append(transform.timestamp.seconds * SECOND_NS + transform.timestamp.nanos)
            q = transform.rotation
            turns.append((q.w, q.x, q.y, q.z))
    wxyz = np.array(turns).reshape(-1, 4)
    sound = np.abs(np.linalg.norm(wxyz, axis=1) - 1) < 0.01
    if not sound.any():
        return None
    utc, first = np.unique(np.array(stamps, np.int64)[sound], return_index=True)
    return AttitudeTrack(UtcTime(utc).to_gps(), rotations_of_quaternions(wxyz[sound][first]))


def told_mounting(log: FlightLog, link: str) -> AutopilotMounting:
    """Return what the autopilot's parameters in `/<link>/parameter` tell of its mounting."""
    parameters: dict[str, float] = {}
    for messages in log.topic(f"/{link}/parameter"):
        for payload in messages.payloads:
            parameter = read_json(bytes(payload), log.paths[0])
            if isinstance(parameter.get("value"), int | float):
                parameters[str(parameter.get("name"))] = float(parameter["value"])
    return mounting_of(parameters)


def autopilot_time(track: VehicleTrack, host: HostTime) -> tuple[GpsTime, Floats]:
    """Return the autopilot's time at moments of the recording computer's clock, and its sigma (s)."""
    # By TIMESYNC exchanges where there are some. Else: between two messages that arrived around a moment the
    # autopilot's clock is taken to run evenly: so an uneven playback does no harm beyond the distance of the
    # messages.
    clock, sync = track.clocks.clock, track.clocks.sync
    if sync is not None and clock is not None and not sync.host_of_boot.played_back:
        boot, sigma = sync.boot(host.ns)
        utc, more = clock.convert(boot, host.ns)
        return UtcTime(utc).to_gps(), np.hypot(sigma, more)
    arrival = track.position_host.ns
    order = np.argsort(arrival, kind="stable")
    arrival, device = arrival[order], track.path.time.ns[order]
    after = np.clip(np.searchsorted(arrival, host.ns, side="right"), 1, max(len(arrival) - 1, 1))
    before = after - 1
    share = (host.ns - arrival[before]) / np.maximum(arrival[after] - arrival[before], 1)
    step = device[after] - device[before]
    time = device[before] + np.rint(share * step).astype(np.int64)
    inside = (host.ns >= arrival[0]) & (host.ns <= arrival[-1])
    return GpsTime(time), np.where(inside, np.abs(step) / 4e9, np.inf)
