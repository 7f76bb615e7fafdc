"""Channels decoded from MAVLink: position, attitude, GNSS, exposures, clock and health.

What each MAVLink message becomes in the flight log.
"""

from collections.abc import Callable, Iterable
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from acquire.channels.decoded import Decoded, in_order, tables, times
from acquire.channels.layouts import PARAMETER, SourceMessages
from acquire.log import foxglove
from drivers.frames import Batch, Messages, Wire
from drivers.mavlink.decode import decode, sources
from drivers.mavlink.dialect import Dialect
from photocal.base.arrays import Floats, Integers

# Receivers of the vehicle, as their topics tell them apart.
_RECEIVERS = {"GPS_RAW_INT": "", "GPS2_RAW": "-2"}
# Topics that all sources share, since each message names its own.
COMMON_TOPICS = ("/camera/exposure", "/clock", "/health")
_FIX_NAMES = ("none", "none", "2d", "3d", "differential", "rtk_float", "rtk_fixed", "3d", "3d")


@dataclass(frozen=True)
class SentMessages(SourceMessages):
    """Messages of one kind from one source.

    fields (n,): the fields, see `drivers.frames.Messages`.
    log_ns (n,): time of receipt, UTC.
    """

    address: tuple[int, int]
    fields: NDArray[Any]
    log_ns: Integers

    @property
    def names(self) -> dict[str, Any]:
        """Members of a JSON message that tell its source."""
        system, component = (np.full(len(self), number) for number in self.address)
        return {**super().names, "system": system, "component": component}

    @property
    def place(self) -> tuple[Floats, Floats, Floats]:
        """Latitude, longitude (deg) and height (m)."""
        return self.fields["lat"] * 1e-7, self.fields["lon"] * 1e-7, self.fields["alt"] * 1e-3


def position(sent: SentMessages) -> Decoded:
    """Make positions of the autopilot's own filter."""
    return sent.location(f"/{sent.link}/position", sent.place)


def attitude(sent: SentMessages) -> Decoded:
    """Make the rotation from body to north-east-down."""
    angles = (sent.fields[name].astype(float) for name in ("roll", "pitch", "yaw"))
    return sent.attitude(foxglove.quaternion_from_euler(*angles))


def gnss_fix(sent: SentMessages) -> Decoded:
    """Make the positions of a receiver of the vehicle."""
    fixed = sent.rows(sent.fields["fix_type"] >= 2)
    claimed = _claimed(fixed.fields, "h_acc"), _claimed(fixed.fields, "v_acc")
    return fixed.location(f"/gnss/{sent.link}{_RECEIVERS[sent.source]}/fix", fixed.place, claimed)


def fix_names(types: Floats | Integers) -> list[str]:
    """Return the names of types of fixes as MAVLink's GPS_RAW_INT and both logs number them; NaN is none."""
    last = len(_FIX_NAMES) - 1
    return [_FIX_NAMES[min(int(v), last)] if v == v else _FIX_NAMES[0] for v in types.tolist()]


def gnss_status(sent: SentMessages) -> Decoded:
    """Make the quality of the fixes of a receiver of the vehicle."""
    f = sent.fields
    columns: dict[str, Any] = {
        "fix": fix_names(f["fix_type"]),
        "satellites": np.where(f["satellites_visible"] == 255, -1, f["satellites_visible"].astype(int)),
        "hdop": np.where(f["eph"] == 65535, np.nan, f["eph"] * 0.01),
        "horizontal_m": _claimed(f, "h_acc"),
        "vertical_m": _claimed(f, "v_acc"),
    }
    if "dgps_age" in (f.dtype.names or ()):
        columns["correction_age_s"] = np.where(f["dgps_age"] > 0, f["dgps_age"] * 1e-3, np.nan)
    return sent.status(_RECEIVERS[sent.source], columns)


def camera_captured(sent: SentMessages) -> Decoded:
    """Make the exposures that a MAVLink camera reported."""
    f = sent.fields
    utc = f["time_utc"].astype(np.int64)
    time = times(np.where(utc > 0, utc * 1000, sent.utc_ns))
    place = dict(zip(("latitude_deg", "longitude_deg", "altitude_msl_m"), sent.place, strict=True))
    return sent.exposure("feedback", {"sequence": f["image_index"], "time": time, **place})


def system_time(sent: SentMessages) -> Decoded:
    """Make the readings of the autopilot's clock."""
    device = sent.fields["time_unix_usec"].astype(np.int64) * 1000
    known = device > 0
    return sent.clock(
        {
            "device": times(np.where(known, device, -1)),
            "host_minus_device_s": np.where(known, (sent.log_ns - device) / 1e9, np.nan),
            "boot_s": sent.fields["time_boot_ms"] * 1e-3,
        }
    )


def timesync(sent: SentMessages) -> Decoded:
    """Make the duration of the comparisons of clocks that we began ourselves: they carry our own UTC."""
    round_trip = sent.log_ns - sent.fields["ts1"]
    answered = (sent.fields["tc1"] > 0) & (round_trip >= 0) & (round_trip < 10_000_000_000)
    ours = sent.rows(answered)
    return ours.clock({"boot_s": ours.fields["tc1"] / 1e9, "round_trip_ns": round_trip[answered]})


def parameter(sent: SentMessages) -> Decoded:
    """Make the autopilot's parameters."""
    sent_value = sent.fields["param_value"]
    # MAV_PARAM_TYPE: what is before are whole numbers.
    first_real_type = 9
    whole = sent.fields["param_type"] < first_real_type
    # ArduPilot sends whole numbers as such, PX4 their bytes, which as a real number are next to nothing.
    with np.errstate(invalid="ignore"):
        bytewise = whole & (sent_value != 0) & ~(np.abs(sent_value) >= 1)
    value = np.where(bytewise, sent_value.view("<i4").astype(float), sent_value.astype(float))
    columns = {"name": sent.fields["param_id"], "value": value}
    return sent.json(f"/{sent.link}/parameter", PARAMETER, columns)


def state(sent: SentMessages) -> Decoded:
    """Make the exposures, texts and states of battery, links and radio whose members are all like theirs."""
    columns = {}
    for name, member in _STATES[sent.source]["members"].items():
        given = sent.fields[member["field"]]
        values = given * member["unit"] if "unit" in member else given
        columns[name] = (
            np.where(given == member["unknown"], np.nan, values) if "unknown" in member else values
        )
    edge = _STATES[sent.source].get("edge")
    return sent.exposure(edge, columns) if edge else sent.health(columns)


# What each of these messages becomes, by its name.
_STATES = tables("states.toml")
MAKERS: dict[str, tuple[Callable[[SentMessages], Decoded], ...]] = {
    "GPS_RAW_INT": (gnss_fix, gnss_status),
    "GPS2_RAW": (gnss_fix, gnss_status),
    "GLOBAL_POSITION_INT": (position,),
    "ATTITUDE": (attitude,),
    **dict.fromkeys(_STATES, (state,)),
    "CAMERA_IMAGE_CAPTURED": (camera_captured,),
    "SYSTEM_TIME": (system_time,),
    "TIMESYNC": (timesync,),
    "PARAM_VALUE": (parameter,),
}


def _claimed(fields: NDArray[Any], name: str) -> Floats:
    """Return an accuracy in metres; zero is what devices send that do not know it."""
    value = fields[name].astype(float) * 1e-3
    return np.where(value > 0, value, np.nan)


# From 2000 on a time of an autopilot is taken for UTC, below for time since boot.
EARLIEST_UTC_NS = 946_684_800 * 1_000_000_000

# Members that tell the time of a message, and their unit in nanoseconds.
_TIMES = {"time_boot_ms": 1_000_000, "time_usec": 1000}


class VehicleDecoder:
    """Decodes the MAVLink frames of one link; `feed` is a `Decoder`.

    Several systems can speak on one link. The plain topic of a message belongs to the source that sent it
    first; further sources get topics with their numbers.
    """

    def __init__(self, link: str, dialect: Dialect) -> None:
        self._link = link
        self._dialect = dialect
        self._owners: dict[str, tuple[int, int]] = {}
        self._clock_system: int | None = None
        self._boot_utc_ns: int | None = None
        self._made = {dialect.number(name) for name in MAKERS}
        self._system_time = dialect.number("SYSTEM_TIME")

    def feed(self, batch: Batch, log_ns: Integers) -> tuple[Integers, list[Decoded]]:
        """Return the device's time of each frame and the decoded messages."""
        publish = log_ns.copy()
        kinds = sorted(set(batch.kind[(batch.wire == Wire.MAVLINK) & batch.known].tolist()))
        boot = self._boot_offsets(batch)
        decoded: list[Decoded] = []
        for kind in kinds:
            members = self._dialect.layout(kind).names or ()
            timed = next((name for name in _TIMES if name in members), None)
            if timed is None and kind not in self._made:
                continue
            messages = decode(batch, kind, self._dialect)
            if timed is not None:
                device = self._device_ns(batch, messages, timed, boot)
                known = device >= 0
                publish[messages.index[known]] = device[known]
            if kind in self._made:
                decoded.extend(self._decode(batch, kind, messages, log_ns, publish))
        return publish, in_order(decoded)

    def _boot_offsets(self, batch: Batch) -> tuple[Integers, Integers]:
        """Return from which frame on which UTC of boot holds (-1: unknown)."""
        messages = decode(batch, self._system_time, self._dialect)
        utc = _ns(messages.fields["time_unix_usec"], 1000)
        boot = utc - _ns(messages.fields["time_boot_ms"], 1_000_000)
        good = utc > EARLIEST_UTC_NS
        system, _ = sources(batch, messages.index)
        if self._clock_system is None and good.any():
            self._clock_system = int(system[np.argmax(good)])
        good &= system == (-1 if self._clock_system is None else self._clock_system)
        start = -1 if self._boot_utc_ns is None else self._boot_utc_ns
        offsets = np.concatenate([[start], boot[good]]).astype(np.int64)
        self._boot_utc_ns = int(offsets[-1]) if len(offsets) > 1 else self._boot_utc_ns
        return np.concatenate([[-1], messages.index[good]]).astype(np.int64), offsets

    def _device_ns(
        self, batch: Batch, messages: Messages, member: str, boot: tuple[Integers, Integers]
    ) -> Integers:
        time = _ns(messages.fields[member], _TIMES[member])
        since, offsets = boot
        offset = offsets[np.searchsorted(since, messages.index, side="right") - 1]
        timed = (sources(batch, messages.index)[0] == self._clock_system) & (offset >= 0)
        return np.where(time > EARLIEST_UTC_NS, time, np.where(timed, offset + time, -1))

    def _decode(
        self, batch: Batch, kind: int, messages: Messages, log_ns: Integers, publish: Integers
    ) -> Iterable[Decoded]:
        system, component = sources(batch, messages.index)
        senders = system.astype(np.int64) * 256 + component
        for sender in dict.fromkeys(senders.tolist()):
            of_sender = senders == sender
            index = messages.index[of_sender]
            source = divmod(sender, 256)
            name, fields = self._dialect.name(kind), messages.fields[of_sender]
            sent = SentMessages(self._link, name, index, publish[index], source, fields, log_ns[index])
            for make in MAKERS[name]:
                made = make(sent)
                topic = self._topic(made.channel.topic, source)
                yield replace(made, channel=replace(made.channel, topic=topic))

    def _topic(self, topic: str, source: tuple[int, int]) -> str:
        owner = source if topic in COMMON_TOPICS else self._owners.setdefault(topic, source)
        return topic if owner == source else f"{topic}/system-{source[0]}-{source[1]}"


def _ns(values: NDArray[Any], unit_ns: int) -> Integers:
    """Return times in nanoseconds; what no date of ours can be becomes 0."""
    largest = np.uint64(4_102_444_800_000_000_000 // unit_ns)
    wide = values.astype(np.uint64)
    return np.where(wide < largest, wide, 0).astype(np.int64) * unit_ns
