"""Before the flight: do all links speak, is the fix good, are rates, disk and clock as they should be."""

import contextlib
import math
import threading
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from acquire.console import Check
from acquire.recording.caster_position import CasterPosition
from acquire.recording.configuration import Configuration, Link
from acquire.recording.reader import MOST_AT_ONCE, left_behind, start_readers
from acquire.recording.recorder import Host
from acquire.transports.sources import LinkLostError, Source
from drivers.frames import Batch, StreamFramer, Wire, wires_of
from drivers.mavlink.decode import autopilots, decode
from drivers.mavlink.dialect import Dialect
from drivers.ubx.decode import NAV_PVT, RXM_RAWX, civil_utc_ns
from drivers.ubx.decode import decode as decode_ubx

_MB = 1_000_000
# A receiver's message comes some tenths of a second after its time; more is a wrong clock.
_CLOCK_LIMIT_S = 1.0
_LEAST_RATE = 0.8
_MAVLINK_FIXES = ("no receiver", "none", "2d", "3d", "differential", "rtk_float", "rtk_fixed")
# What a receiver sends once for each solution; the other messages come when there is something to tell.
_PERIODIC = {"NAV-PVT": NAV_PVT, "RXM-RAWX": RXM_RAWX}


@dataclass
class _Heard:
    frames: int = 0
    damage_bytes: int = 0
    event: str = ""
    counts: dict[str, int] = field(default_factory=dict)
    autopilots: set[tuple[int, int]] = field(default_factory=set)
    fix: str = ""
    fix_good: bool = False
    host_minus_device_s: float | None = None
    first_s: float = math.inf


def check(
    configuration: Configuration,
    base: Path,
    sources: dict[str, Source],
    positions: dict[str, CasterPosition],
    seconds: float,
    host: Host,
    dialect: Dialect,
) -> list[Check]:
    """Listen to all links for a while and judge what was heard."""
    stop = threading.Event()
    framers = {link.name: StreamFramer(wires_of(link.protocol), dialect) for link in configuration.link}
    heard = {link.name: _Heard() for link in configuration.link}
    until = host.steady_s() + seconds
    inboxes, readers = start_readers(sources, stop, host.clock_ns)
    while host.steady_s() < until:
        for name, inbox in inboxes.items():
            for arrival in inbox.take(MOST_AT_ONCE):
                if arrival.event:
                    heard[name].event = arrival.event
                    continue
                heard[name].first_s = min(heard[name].first_s, host.steady_s())
                batch = framers[name].feed(arrival.data)
                _hear(heard[name], batch, arrival.time_ns, dialect)
                for link in configuration.link:
                    if link.position_from == name:
                        _tell(positions[link.name], sources[link.name], batch, host)
        stop.wait(0.02)
    stop.set()
    left_behind(readers, 0.5)
    # A port may take a while to open: rates count from the first byte, but over half of the time at least.
    found = [
        seen
        for link in configuration.link
        for seen in _judge(
            link, heard[link.name], min(max(until - heard[link.name].first_s, seconds / 2), seconds)
        )
    ]
    return [*found, *_disk(configuration, base, host)]


def _tell(position: CasterPosition, caster: Source, batch: Batch, host: Host) -> None:
    """Tell a caster where the rover is: one of virtual stations sends nothing before."""
    position.hear(batch)
    with contextlib.suppress(LinkLostError):
        for sentence in position.due(host.steady_s(), host.clock_ns()):
            caster.write(sentence)


def _hear(heard: _Heard, batch: Batch, time_ns: int, dialect: Dialect) -> None:
    heard.frames += len(batch)
    heard.damage_bytes += int(batch.damage[:, 1].sum())
    known = (batch.wire == Wire.MAVLINK) & batch.known
    for kind in batch.kind[known].tolist():
        name = dialect.name(kind)
        heard.counts[name] = heard.counts.get(name, 0) + 1
    if known.any():
        heard.autopilots.update(autopilots(batch, dialect))
        fixes = decode(batch, dialect.number("GPS_RAW_INT"), dialect)
        if len(fixes):
            fix = int(fixes.fields["fix_type"][-1])
            name = _MAVLINK_FIXES[fix] if fix < len(_MAVLINK_FIXES) else f"type {fix}"
            heard.fix = f"{name}, {int(fixes.fields['satellites_visible'][-1])} satellites"
            heard.fix_good = fix >= 3
        clocks = decode(batch, dialect.number("SYSTEM_TIME"), dialect)
        if len(clocks) and clocks.fields["time_unix_usec"][-1] > 0:
            device_ns = int(clocks.fields["time_unix_usec"][-1]) * 1000
            heard.host_minus_device_s = (time_ns - device_ns) / 1e9
    for message, kind in _PERIODIC.items():
        heard.counts[message] = heard.counts.get(message, 0) + len(batch.where(Wire.UBX, kind))
    _hear_receiver(heard, batch, time_ns)


def _hear_receiver(heard: _Heard, batch: Batch, time_ns: int) -> None:
    pvt = decode_ubx(batch, NAV_PVT)
    if not len(pvt):
        return
    last = pvt.fields[-1]
    carrier = ("", ", rtk_float", ", rtk_fixed", "")[int(last["flags"]) >> 6]
    heard.fix_good = int(last["fixType"]) in (3, 4) and bool(int(last["flags"]) & 1)
    heard.fix = f"{'3d' if heard.fix_good else 'none'}{carrier}, {int(last['numSV'])} satellites"
    if int(last["valid"]) & 3 == 3:
        heard.host_minus_device_s = (time_ns - int(civil_utc_ns(last))) / 1e9


def _judge(link: Link, heard: _Heard, seconds: float) -> list[Check]:
    name = link.name
    if heard.event and not heard.frames:
        return [Check(f"{name}: port", "bad", heard.event)]
    found = [
        _check(
            f"{name}: frames",
            heard.frames > 0,
            f"{heard.frames / seconds:.1f} per second, {heard.damage_bytes} bytes of damage"
            if heard.frames
            else f"silent for {seconds:g} s",
        )
    ]
    if link.protocol == "mavlink":
        systems = ", ".join(f"system {s} component {c}" for s, c in sorted(heard.autopilots))
        found.append(_check(f"{name}: heartbeat", bool(systems), systems or "no autopilot"))
    rates_hz = dict(link.vehicle.rates_hz) if link.vehicle else {}
    if link.ublox is not None:
        periodic = [message for message in _PERIODIC if message in link.ublox.messages]
        rates_hz |= dict.fromkeys(periodic, 1000 / link.ublox.rate_ms)
    for message, wanted in rates_hz.items():
        rate = heard.counts.get(message, 0) / seconds
        good = rate >= _LEAST_RATE * wanted
        found.append(_check(f"{name}: rate of {message}", good, f"{rate:.1f} of {wanted:g} Hz"))
    if heard.fix or link.protocol == "mavlink" or link.ublox is not None:
        found.append(_check(f"{name}: fix", heard.fix_good, heard.fix or "none told"))
    if heard.host_minus_device_s is not None:
        offset = heard.host_minus_device_s
        good = abs(offset) <= _CLOCK_LIMIT_S
        found.append(_check(f"{name}: clock", good, f"this computer {offset:+.2f} s against the device"))
    return found


def _disk(configuration: Configuration, base: Path, host: Host) -> list[Check]:
    found = []
    for folder in (configuration.recording.output, *configuration.recording.spare):
        place = (base / folder).resolve()
        while not place.exists():
            place = place.parent
        try:
            free_mb = host.free_bytes(place) / _MB
        except OSError as failure:
            found.append(Check(f"disk {folder}", "bad", failure.strerror or str(failure)))
            continue
        good = free_mb >= configuration.recording.least_free_mb
        found.append(_check(f"disk {folder}", good, f"{free_mb:.0f} MB are free"))
    return found


def _check(part: str, good: bool, text: str) -> Check:
    return Check(part, "good" if good else "bad", text)


def as_json(checks: list[Check]) -> dict[str, Any]:
    """Return the checks for programs."""
    listed = [{"subject": c.part, "good": c.state == "good", "seen": c.text} for c in checks]
    return {"schema": "acquire.check/1", "good": all(one["good"] for one in listed), "findings": listed}
