"""Decoders of autopilots' own logs (ULog, DataFlash) and of event lists, records by their names."""

from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass
from typing import Any, Generic, TypeVar

import numpy as np

from acquire.channels.decoded import Decoded, Decoder, in_order, times
from acquire.channels.layouts import ELLIPSOIDAL, PARAMETER, SourceMessages
from acquire.channels.vehicle import fix_names
from acquire.log import foxglove
from drivers import mrk
from drivers.dataflash import DataflashFormats, receiver_utc_ns
from drivers.frames import Batch
from drivers.logged import Records
from drivers.ulog import UlogFormats, told_utc_ns
from photocal.base.arrays import Floats, Integers
from photocal.base.time_scales import gps_to_utc_ns

Formats = TypeVar("Formats", UlogFormats, DataflashFormats)
_RECEIVERS = {"vehicle_gps_position": "", "sensor_gps": "-sensor", "sensor_gps[1]": "-sensor-2"}
# Flag of the receiver.
_FIXES = {50: "rtk_fixed", 34: "rtk_float", 16: "3d"}


@dataclass(frozen=True)
class Logged(SourceMessages):
    """Records of one kind."""

    records: Records

    def whole(self, **members: str) -> dict[str, Integers]:
        """Return members that count something under names of ours, where every record has a number."""
        counts = {name: self.records.number(member) for name, member in members.items()}
        return {name: v.astype(np.int64) for name, v in counts.items() if np.isfinite(v).all()}

    def clock_of(self, device_utc_ns: Integers, boot_ns: Integers) -> Decoded:
        """Return UTC of a receiver beside the running time of the autopilot."""
        return self.clock({"device": times(device_utc_ns), "boot_s": boot_ns / 1e9})

    def battery(self, voltage: str, current: str) -> Decoded:
        """Return the state of the battery from members in V and A."""
        return self.health(
            {"voltage_v": self.records.number(voltage), "current_a": self.records.number(current)}
        )

    def parameters(self, name: str, value: str) -> Decoded:
        """Return the autopilot's parameters from members with their names and values."""
        logged = self if name in self.records else self.rows(np.zeros(len(self), bool))
        columns = {"name": logged.records.columns.get(name, ()), "value": logged.records.number(value)}
        return logged.json(f"/{self.link}/parameter", PARAMETER, columns)


def since_start(boot_ns: Integers, start_ns: int) -> Integers:
    """Return UTC of times since the start of an autopilot, nanoseconds since 1970; -1 stays -1."""
    return np.where(boot_ns >= 0, start_ns + boot_ns, -1)


def boot_time(
    batches: Iterable[Batch], definitions: UlogFormats | DataflashFormats
) -> tuple[int, int] | None:
    """Find when the autopilot started; None when no receiver told UTC.

    A record of a receiver is written some time after the epoch that it tells, never before: so the largest
    difference of UTC and running time is the nearest to the truth. It is early by the shortest delay of the
    receiver, some hundredths to a tenth of a second.

    returns: UTC of the start, nanoseconds since 1970, and from how many times of a receiver it was found.
    """
    offsets = [np.empty(0, np.int64)]
    for batch in batches:
        definitions.learn(batch)
        boot, utc = definitions.told_utc(batch)
        offsets.append(utc - boot)
    every = np.concatenate(offsets)
    if not len(every):
        return None
    middle = np.sort(every)[len(every) // 2]
    # A receiver's time further than this from the middle of all is a lag or a leap, not what ties the clocks.
    likely_ns = 500_000_000
    return int(every[np.abs(every - middle) <= likely_ns].max()), len(every)


@dataclass(frozen=True)
class Part(Generic[Formats]):
    """A batch of a log.

    formats: what the log has said of its records so far.
    utc_ns, boot_ns (n,): UTC of each, nanoseconds since 1970, and time since the start of the autopilot; -1
        where it has none.
    earlier: kinds of records of which some have come by now, as far as that matters.
    """

    link: str
    formats: Formats
    batch: Batch
    utc_ns: Integers
    boot_ns: Integers
    earlier: set[str]

    def logged(self, name: str) -> Logged:
        """Return the records of a kind."""
        return self.of(name, self.formats.decode(self.batch, name))

    def of(self, name: str, records: Records) -> Logged:
        """Return records under a name."""
        return Logged(self.link, name, records.index, self.utc_ns[records.index], records)


def _decoder(
    link: str, start_ns: int, formats: Formats, decode: Callable[[Part[Formats]], Iterator[Decoded]]
) -> Decoder:
    earlier = set[str]()

    def feed(batch: Batch, log_ns: Integers) -> tuple[Integers, list[Decoded]]:
        """Take over what a batch defines and decode its records."""
        formats.learn(batch)
        boot = formats.boot_ns(batch)
        utc = np.where(boot >= 0, start_ns + boot, log_ns)
        return utc, in_order(decode(Part(link, formats, batch, utc, boot, earlier)))

    return feed


def ulog_decoder(link: str, start_ns: int) -> Decoder:
    """Return what decodes a PX4 log from its beginning; `start_ns`: UTC of the start of the autopilot."""
    return _decoder(link, start_ns, UlogFormats(), _of_ulog)


def dataflash_decoder(link: str, start_ns: int) -> Decoder:
    """Return what decodes a DataFlash log, see `ulog_decoder`."""
    return _decoder(link, start_ns, DataflashFormats(), _of_dataflash)


def _of_ulog(part: Part[UlogFormats]) -> Iterator[Decoded]:
    for topic, receiver in _RECEIVERS.items():
        yield from _receiver(part.logged(topic), receiver, part)
    position = part.logged("vehicle_global_position")
    records = position.records
    place = records.number("lat"), records.number("lon"), records.number("alt")
    yield position.location(f"/{part.link}/position", place)
    attitude = part.logged("vehicle_attitude")
    # PX4 turns body vectors (forward, right, down) into north, east, down, as the log does.
    yield attitude.attitude(_quaternion(attitude)[:, [1, 2, 3, 0]])
    for topic, edge in (("camera_capture", "feedback"), ("camera_trigger", "trigger")):
        yield _exposure(part.logged(topic), edge)
    texts = part.formats.texts(part.batch)
    yield part.of("logging", texts).health({"severity": texts["severity"], "text": texts["text"]})
    yield part.of("parameter", part.formats.parameters(part.batch)).parameters("name", "value")
    yield part.logged("battery_status").battery("voltage_v", "current_a")


def _receiver(logged: Logged, receiver: str, part: Part[UlogFormats]) -> Iterator[Decoded]:
    records = logged.records
    if not len(records):
        return
    fix = records.number("fix_type")
    kept = logged.rows(fix >= 2)
    claimed = kept.records.number("eph"), kept.records.number("epv")
    yield kept.location(f"/gnss/{part.link}{receiver}/fix", _gps_place(kept), claimed)
    quality = {"hdop": "hdop", "horizontal_m": "eph", "vertical_m": "epv"}
    columns = {name: records.number(member) for name, member in quality.items()}
    satellites = logged.whole(satellites="satellites_used")
    yield logged.status(receiver, {"fix": fix_names(fix), **satellites, **columns})
    device = told_utc_ns(records.number("time_utc_usec"), earliest_us=0.0)
    yield logged.clock_of(device, part.boot_ns[records.index])


def _gps_place(logged: Logged) -> tuple[Floats, Floats, Floats]:
    records = logged.records
    if "latitude_deg" in records:  # since 1.15
        height = records.number("altitude_msl_m")
        return records.number("latitude_deg"), records.number("longitude_deg"), height
    return records.number("lat") * 1e-7, records.number("lon") * 1e-7, records.number("alt") * 1e-3


def _quaternion(logged: Logged) -> Floats:
    records = logged.records
    if "q" not in records or records["q"].shape[1:] != (4,):
        return np.full((len(records), 4), np.nan)
    with np.errstate(invalid="ignore"):  # a damaged number may be a signalling NaN
        return np.asarray(records["q"], float)


def _exposure(logged: Logged, edge: str) -> Decoded:
    records = logged.records
    gps = told_utc_ns(records.number("timestamp_utc"))
    columns: dict[str, Any] = {"time": times(np.where(gps >= 0, gps, logged.utc_ns))}
    names = {"latitude_deg": "lat", "longitude_deg": "lon", "altitude_msl_m": "alt"}
    columns |= {name: records.number(member) for name, member in names.items() if member in records}
    return logged.exposure(edge, {**columns, **logged.whole(sequence="seq")})


def event_utc_ns(batch: Batch) -> Integers:
    """Return UTC of each event of a list, nanoseconds since 1970; -1 where it is unknown."""
    events = mrk.decode(batch)
    utc = np.full(len(batch), -1, np.int64)
    gps = mrk.event_gps_ns(events)
    utc[events.index] = np.where(gps >= 0, gps_to_utc_ns(gps), -1)
    return utc


def event_list_decoder(link: str) -> Decoder:
    """Return what decodes the events of a list."""

    def feed(batch: Batch, log_ns: Integers) -> tuple[Integers, list[Decoded]]:
        """Decode events."""
        event_utc = event_utc_ns(batch)
        utc = np.where(event_utc >= 0, event_utc, log_ns)
        marks = mrk.decode(batch)
        events = SourceMessages(link, "MRK", marks.index, utc[marks.index])
        if not len(events):
            return utc, []
        horizontal = np.hypot(marks["sigma_north_m"], marks["sigma_east_m"])
        place = marks["latitude_deg"], marks["longitude_deg"], marks["height_m"]
        claimed = horizontal, marks["sigma_up_m"]
        columns = {
            "sequence": marks["number"].astype(np.int64),
            "time": times(event_utc),
            "latitude_deg": marks["latitude_deg"],
            "longitude_deg": marks["longitude_deg"],
        }
        fix = [_FIXES.get(int(flag), "3d") for flag in marks["flag"].tolist()]
        quality = {"fix": fix, "horizontal_m": horizontal, "vertical_m": marks["sigma_up_m"]}
        return utc, [
            events.exposure("feedback", columns),
            events.location(f"/gnss/{link}/fix", place, claimed, ELLIPSOIDAL),
            events.status("", quality),
        ]

    return feed


def _of_dataflash(part: Part[DataflashFormats]) -> Iterator[Decoded]:
    for name in ("GPS", "GPS2"):
        yield from _dataflash_receiver(part.logged(name), part)
    for position in _dataflash_positions(part):
        yield position.location(f"/{part.link}/position", _place(position))
    attitude = part.logged("ATT")
    angles = (np.deg2rad(attitude.records.number(name)) for name in ("Roll", "Pitch", "Yaw"))
    yield attitude.attitude(foxglove.quaternion_from_euler(*angles))
    for name, edge in (("CAM", "feedback"), ("TRIG", "trigger")):
        yield _dataflash_exposure(part.logged(name), edge, part)
    texts = part.logged("MSG")
    if "Message" in texts.records:
        yield texts.health({"text": texts.records["Message"]})
    yield part.logged("PARM").parameters("Name", "Value")
    yield part.logged("BAT").battery("Volt", "Curr")


def _dataflash_positions(part: Part[DataflashFormats]) -> Iterator[Logged]:
    position = part.logged("POS")
    # Logs of before POS have the place beside the attitude of the second filter: good until POS comes.
    second = part.logged("AHR2")
    first = min([0] * ("POS" in part.earlier) + position.records.index.tolist(), default=len(part.batch))
    if len(position):
        part.earlier.add("POS")
    yield second.rows(second.records.index < first)
    yield position


def _dataflash_receiver(every: Logged, part: Part[DataflashFormats]) -> Iterator[Decoded]:
    instance = every.records.number("I")
    for number in np.unique(instance[np.isfinite(instance)]).tolist() or [-1.0]:
        receiver = "-2" if every.source == "GPS2" else f"-{number + 1:.0f}" if number > 0 else ""
        logged = every.rows(instance == number) if number >= 0 else every
        records = logged.records
        fix = records.number("Status")
        kept = logged.rows(fix >= 2)
        yield kept.location(f"/gnss/{part.link}{receiver}/fix", _place(kept))
        quality = {**logged.whole(satellites="NSats"), "hdop": records.number("HDop")}
        yield logged.status(receiver, {"fix": fix_names(fix), **quality})
        yield logged.clock_of(receiver_utc_ns(records), part.boot_ns[records.index])


def _place(logged: Logged) -> tuple[Floats, Floats, Floats]:
    records = logged.records
    return records.number("Lat"), records.number("Lng"), records.number("Alt")


def _dataflash_exposure(logged: Logged, edge: str, part: Part[DataflashFormats]) -> Decoded:
    records = logged.records
    # GPSTime is that of the last fix before: the record's own time is nearer, where it has one.
    timed, fix_utc_ns = part.boot_ns[records.index] >= 0, receiver_utc_ns(records, ("GPSWeek",), ("GPSTime",))
    return logged.exposure(
        edge,
        {
            "time": times(np.where(timed, logged.utc_ns, fix_utc_ns)),
            "latitude_deg": records.number("Lat"),
            "longitude_deg": records.number("Lng"),
            "altitude_msl_m": records.number("Alt"),
            "roll_deg": records.number("Roll", "R"),
            "pitch_deg": records.number("Pitch", "P"),
            "yaw_deg": records.number("Yaw", "Y"),
            **logged.whole(sequence="Img"),
        },
    )
