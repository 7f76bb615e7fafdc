"""Moments at which a camera exposed, from every source that recorded them."""

import json
from dataclasses import dataclass, field, replace
from functools import lru_cache
from pathlib import Path
from typing import Any, Self

import numpy as np

from drivers.frames import Wire
from drivers.identify import batch_of_payloads
from drivers.mavlink.decode import decode
from drivers.mavlink.dialect import ardupilotmega
from drivers.receiver import BASE_RECEIVER, BASE_UTC, TIME_BASES, TimeMarks
from photocal.base.arrays import Floats, Integers
from photocal.base.errors import InputMalformedError, reading
from photocal.base.time_scales import SECOND_NS
from photocal.findings.finding import Finding
from photocal.findings.texts import catalogue, finding_text, plain
from photocal.measurement.listed_positions import judge_listed, listed_events, read_event_lines
from photocal.navigation.device_clocks import ComparedClocks
from photocal.navigation.flight_log import EXPOSURES, FlightLog
from photocal.navigation.time import GpsTime, UtcTime, refuse_expired
from photocal.navigation.trajectory import InterpolatedPositions

RISING, FALLING = "rising", "falling"
_COUNTER = 1 << 16
_MAVLINK = ("CAMERA_FEEDBACK", "CAMERA_IMAGE_CAPTURED", "CAMERA_TRIGGER")
_CLAIMED = ("latitude_deg", "longitude_deg", "altitude_msl_m", "roll_deg", "pitch_deg", "yaw_deg")
# Member with the time, its unit in nanoseconds, and the member with the count.
_KINDS = {
    "CAMERA_FEEDBACK": ("time_usec", 1000, "img_idx"),
    "CAMERA_TRIGGER": ("time_usec", 1000, "seq"),
    "CAMERA_IMAGE_CAPTURED": ("time_boot_ms", 1_000_000, "image_index"),
}
# From 2000 on a time is UTC, below it is measured from the start of the autopilot.
_EARLIEST_UTC_NS = 946_684_800 * 1_000_000_000
# Flag of the receiver: 50 fixed, 34 float, 16 single.
_STATUS = {50: "fixed", 34: "float"}


@dataclass(frozen=True)
class Events:
    """Exposures in the order of time.

    source: what noted them, for example ``TIM-TM2 rising of rover``.
    number (n,): the device's own count.
    accuracy_s (n,): accuracy of the time that the device claims; 0 where it claims none.
    remarks: what is odd: jumps of the counter, edges without a time.
    claimed (n, 6): latitude, longitude (deg), height above sea level (m), roll, pitch, yaw (deg) that the
        device told with each; NaN where it told none.
    stream_ns (n,): last RXM-RAWX epoch before each time mark in the receiver's stream (GPS ns); -1 before the
        first.
    delay_ns: delay that is contained in the times.
    """

    source: str
    time: GpsTime
    number: Integers
    accuracy_s: Floats
    remarks: list[str] = field(default_factory=list)
    claimed: Floats | None = None
    stream_ns: Integers | None = None
    delay_ns: int = 0

    @property
    def noted_ns(self) -> Integers:
        """Times as the device noted them, GPS nanoseconds."""
        return np.asarray(self.time.ns - self.delay_ns)

    def __len__(self) -> int:
        return len(self.time)

    def delayed(self, delay_s: float, sigma_s: float = 0.0) -> Self:
        """Return the exposures themselves, `delay_s` after what was noted (trigger, cable, shutter)."""
        # `sigma_s` is the standard deviation of the delay from exposure to exposure.
        shift = round(delay_s * 1e9)
        return replace(
            self,
            time=GpsTime(self.time.ns + shift),
            accuracy_s=np.hypot(self.accuracy_s, sigma_s),
            delay_ns=self.delay_ns + shift,
        )


def time_marks(
    marks: TimeMarks, edge: str, link: str, stream_ns: Integers | None = None, source: str = "TIM-TM2"
) -> Events:
    """Return the events of one edge from a receiver's time marks, such as TIM-TM2 messages.

    stream_ns: of each mark the last epoch before it in the stream (GPS ns); -1: none yet.

    raises InputMalformedError: when the marks are in the receiver's own time, which nothing ties to GPS time,
        or in UTC beyond the table of leap seconds.
    """
    of_edge = marks.rising == (edge == RISING)
    new = marks.rows(of_edge)
    receiver_time = new.valid & (new.base == BASE_RECEIVER)
    if receiver_time.any():
        raise InputMalformedError(
            f"{int(receiver_time.sum())} time marks are in the receiver's own time base",
            "set the time base of CFG-TIMEx or TIM-TM2 to GNSS or UTC",
            where=f"link {link}",
        )
    refuse_expired(GpsTime(new.gps_ns[new.valid & (new.base == BASE_UTC)]))
    remarks = counter_jumps(new.count, edge)
    if not new.valid.all():
        remarks.append(f"{int((~new.valid).sum())} {edge} edges without a valid time left out")
    bases = (TIME_BASES[base].upper() for base in np.unique(new.base[new.valid]).tolist())
    remarks.append("time base " + " and ".join(bases))
    kept = np.flatnonzero(new.valid)
    order = kept[np.argsort(new.gps_ns[kept], kind="stable")]
    return Events(
        f"{source} {edge} of {link}",
        GpsTime(new.gps_ns[order]),
        new.count[order],
        np.asarray(new.accuracy_ns[order] * 1e-9, float),
        remarks,
        stream_ns=None if stream_ns is None else stream_ns[of_edge][order],
    )


def counter_jumps(count: Integers, edge: str) -> list[str]:
    """Return a sentence for each place where a counter (modulo 65536) does not go on by one."""
    step = np.diff(count) % _COUNTER
    # Falling edges share the counter of the rising ones: a step of 0 between them is no loss.
    return [
        f"{edge} edges: the counter goes from {int(count[i])} to {int(count[i + 1])}, "
        f"{int(step[i]) - 1} missing"
        for i in np.flatnonzero(step > 1).tolist()
    ]


@lru_cache(maxsize=1)
def logged_exposures(log: FlightLog) -> tuple[list[Events], dict[tuple[str, str], TimeMarks]]:
    """Read `/camera/exposure` of a flight log.

    Exposures without a device time are left out and counted: the time of receipt is not that of the
    exposure. An exposure that came twice (over two links) counts once.

    returns: exposures that autopilot or camera reported, one `Events` per message; and edges that were
        decoded when they were logged, by the link and the message that told them.
    """
    exposures: dict[str, dict[tuple[int, int], tuple[float, ...]]] = {}
    untimed: dict[str, int] = {}
    marks: dict[tuple[str, str], list[tuple[int, ...]]] = {}
    for messages in log.topic(EXPOSURES):
        columns = (messages.log_ns, messages.publish_ns, messages.sequence)
        rows = zip(messages.payloads, *(column.tolist() for column in columns), strict=True)
        for payload, log_ns, publish_ns, number in rows:
            try:
                row = json.loads(payload)
                if row.get("edge") not in (RISING, FALLING):
                    _note(row, log_ns == publish_ns, exposures, untimed)
                elif "time_base" in row:
                    # Older logs tell no time base: their edges are decoded from the raw frames.
                    marks.setdefault((str(row["link"]), str(row["source"])), []).append(_mark(number, row))
            except (LookupError, TypeError, ValueError, OverflowError, RecursionError) as damage:
                raise InputMalformedError(
                    f"holds an exposure that cannot be read ({type(damage).__name__})",
                    "run acquire recover",
                    where=log,
                ) from damage
    told = [_logged(source, rows, untimed.get(source, 0)) for source, rows in exposures.items()]
    return told, {source: _as_marks(rows) for source, rows in marks.items()}


def _mark(number: int, row: dict[str, Any]) -> tuple[int, ...]:
    """Columns of `TimeMarks` of one edge; `number` is that of its frame."""
    base, time = row["time_base"], row["gps_time"]
    place = BASE_RECEIVER if base is None else TIME_BASES.index(base)
    gps_ns = -1 if time is None and place == BASE_RECEIVER else _nanoseconds(time)
    edge = row["edge"] == RISING, int(row["sequence"]), gps_ns, place, base is not None
    return number, *edge, int(row["accuracy_ns"])


def _as_marks(rows: list[tuple[int, ...]]) -> TimeMarks:
    index, rising, count, gps_ns, base, valid, accuracy = np.array(rows, np.int64).T
    return TimeMarks(index, rising != 0, count, gps_ns, base, valid != 0, accuracy)


def _nanoseconds(time: dict[str, Any]) -> int:
    return int(time["sec"]) * SECOND_NS + int(time["nsec"])


def _note(
    row: dict[str, Any],
    arrived_as_told: bool,
    exposures: dict[str, dict[tuple[int, int], tuple[float, ...]]],
    untimed: dict[str, int],
) -> None:
    """Take one exposure of the log."""
    source = str(row["source"])
    rows = exposures.setdefault(source, {})
    time = row.get("time")
    # MAVLink without a time of the device repeats the time of arrival.
    if time is None or (arrived_as_told and source in _MAVLINK):
        untimed[source] = untimed.get(source, 0) + 1
        return
    key = (_nanoseconds(time), int(row.get("sequence", -1)))
    claimed = [row.get(name) for name in _CLAIMED]
    rows[key] = tuple(np.nan if v is None else float(v) for v in (row.get("accuracy_ns"), *claimed))


def _logged(source: str, rows: dict[tuple[int, int], tuple[float, ...]], untimed: int) -> Events:
    keys = sorted(rows)
    stamp = np.array(keys, np.int64).reshape(-1, 2)
    values = np.array([rows[key] for key in keys]).reshape(-1, 1 + len(_CLAIMED))
    remarks = counter_jumps(stamp[:, 1], source)
    if untimed:
        remarks.append(f"{source}: {untimed} exposures without a device time left out")
    time = UtcTime(stamp[:, 0]).to_gps()
    accuracy = np.nan_to_num(values[:, 0], nan=0.0) * 1e-9
    return Events(source, time, stamp[:, 1], accuracy, remarks, values[:, 1:])


def boot_exposures(log: FlightLog, link: str | None, clock: ComparedClocks) -> dict[str, Events]:
    """Return the exposures whose only device time is that since boot, by the message that told them."""
    dialect = ardupilotmega()
    by_message: dict[str, list[list[Integers]]] = {}
    for _, messages in log.raw(Wire.MAVLINK, link=link):
        batch = batch_of_payloads(Wire.MAVLINK, messages.payloads, dialect)
        for name, (member, unit_ns, count) in _KINDS.items():
            got = decode(batch, dialect.number(name), dialect)
            boot = got.fields[member].astype(np.int64) * unit_ns
            boot_only = boot < _EARLIEST_UTC_NS
            if name == "CAMERA_IMAGE_CAPTURED":
                boot_only &= got.fields["time_utc"] == 0
            if boot_only.any():
                columns = (boot, messages.log_ns[got.index], got.fields[count].astype(np.int64))
                by_message.setdefault(name, []).append([column[boot_only] for column in columns])
    joined = {
        name: [np.concatenate(column) for column in zip(*parts, strict=True)]
        for name, parts in by_message.items()
    }
    return {name: _placed(name, boot, host, number, clock) for name, (boot, host, number) in joined.items()}


def _placed(name: str, boot: Integers, host: Integers, number: Integers, clock: ComparedClocks) -> Events:
    utc, sigma = clock.convert(boot, host)
    # An exposure that came twice, over two links, counts once.
    _, first = np.unique(np.stack([boot, number]), axis=1, return_index=True)
    order = first[np.argsort(utc[first], kind="stable")]
    remarks = [*counter_jumps(number[order], name), f"{name}: placed by {clock.name}"]
    return Events(name, UtcTime(utc[order]).to_gps(), number[order], sigma[order], remarks)


@dataclass(frozen=True)
class CameraEventList:
    """Events with the position that the vehicle computed in flight.

    offset_enu_m (n, 3): from the antenna's phase centre to the camera's sensor, east, north, up.
    placed: the camera as the vehicle computed it (the maker: after compensation of the offset).
    lines: of the file, for each event.
    findings: what is wrong with the list by itself; positions and sigmas that are wrong are not known.
    """

    events: Events
    offset_enu_m: Floats
    placed: InterpolatedPositions
    lines: tuple[str, ...] = ()
    findings: tuple[Finding, ...] = ()


def read_mrk(path: Path) -> CameraEventList:
    """Read a `Timestamp.MRK` file: the columns are described in `drivers.mrk`."""
    with reading(path):
        text = path.read_text("latin-1")
    return _listed(path.name, text.splitlines(), path)


def listed_in(log: FlightLog) -> CameraEventList | None:
    """Return the event list that was imported into a flight log; None when there is none."""
    lines = [payload.decode("latin-1") for _, messages in log.raw(Wire.MRK) for payload in messages.payloads]
    return _listed("MRK", lines, log) if lines else None


def _listed(name: str, lines: list[str], path: object) -> CameraEventList:
    t, lines_of = read_event_lines(lines, path)
    if not len(t):
        raise InputMalformedError("has no events", "check the flight's folder", where=path)
    listed = listed_events(t, lines_of)
    judged = judge_listed(listed)
    if not judged.placed.any():
        raise InputMalformedError(
            f"has no valid position: {finding_text(judged.findings[0], catalogue('en'), plain)}",
            "take the positions of the pictures, or compute them with the receiver's raw data",
            where=path,
        )
    rows_kept = np.flatnonzero(judged.kept)
    order = rows_kept[np.argsort(listed.time_s[rows_kept], kind="stable")]
    t, count = t[order], listed.number[order]
    time = GpsTime.from_week(t[:, 2].astype(np.int64), t[:, 1])
    events = Events(name, time, count, np.zeros(len(t)), counter_jumps(count, "events"))
    status = [_STATUS.get(int(q), "single") for q in t[:, 12]]
    # What cannot be believed is not known.
    place = np.where(judged.placed[:, None], listed.place, np.nan)[order]
    sigma = np.where(judged.sigma_known[:, None], listed.sigma_m, np.nan)[order]
    return CameraEventList(
        events,
        np.stack([t[:, 4], t[:, 3], -t[:, 5]], axis=1) * 1e-3,
        InterpolatedPositions.stated(place, sigma, status),
        tuple(lines_of[k] for k in order.tolist()),
        judged.findings,
    )
