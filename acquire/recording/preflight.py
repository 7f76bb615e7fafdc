"""Before the flight: do all links speak, is the fix good, are rates, disk and clock as they should be."""

import contextlib
import json
import math
import threading
from collections import Counter
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from acquire.channels.decoded import Decoder
from acquire.recording.caster_position import CasterPosition
from acquire.recording.configuration import LinkConfiguration, RecordingConfiguration
from acquire.recording.link_session import decoder_of
from acquire.recording.reader import MOST_AT_ONCE, left_behind, start_readers
from acquire.recording.recorder import Host
from acquire.transports.sources import LinkLostError, Source
from drivers.frames import Batch, StreamFramer, Wire
from drivers.mavlink.decode import autopilots
from drivers.mavlink.dialect import Dialect
from drivers.protocols import wires_of
from drivers.ubx.decode import NAV_PVT, RXM_RAWX
from photocal.base.console import Check
from photocal.base.errors import reason
from photocal.base.time_scales import SECOND_NS

_NOT_IN_SPACE = ("none", "time_only", "dead_reckoning", "2d")
# What a receiver sends once for each solution; the other messages come when there is something to tell.
_PERIODIC = {"NAV-PVT": NAV_PVT, "RXM-RAWX": RXM_RAWX}


@dataclass
class _Heard:
    frames: int = 0
    damage_bytes: int = 0
    event: str = ""
    counts: Counter[str] = field(default_factory=Counter)
    autopilots: set[tuple[int, int]] = field(default_factory=set)
    fix: str = ""
    fix_good: bool = False
    host_minus_device_s: float | None = None
    first_s: float = math.inf


def check(
    configuration: RecordingConfiguration,
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
    decoders = {link.name: decoder_of(link, dialect, lambda _: None) for link in configuration.link}
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
                _hear(heard[name], name, batch, arrival.time_ns, decoders[name], dialect)
                for link in configuration.link:
                    if link.position_from == name:
                        _tell(positions[link.name], sources[link.name], batch, host)
        stop.wait(0.02)
    stop.set()
    left_behind(readers, 0.5)
    # A port may take a while to open: rates are measured from the first byte, over at least half of the time.
    checks = [
        seen
        for link in configuration.link
        for seen in _judge(
            link, heard[link.name], min(max(until - heard[link.name].first_s, seconds / 2), seconds)
        )
    ]
    return [*checks, *_disk(configuration, base, host)]


def _tell(position: CasterPosition, caster: Source, batch: Batch, host: Host) -> None:
    """Tell a caster where the rover is: one of virtual stations sends nothing before."""
    position.hear(batch)
    with contextlib.suppress(LinkLostError):
        for sentence in position.due(host.steady_s(), host.clock_ns()):
            caster.write(sentence)


def _hear(heard: _Heard, link: str, batch: Batch, time_ns: int, decoder: Decoder, dialect: Dialect) -> None:
    heard.frames += len(batch)
    heard.damage_bytes += int(batch.damage[:, 1].sum())
    known = (batch.wire == Wire.MAVLINK) & batch.known
    heard.counts.update(map(dialect.name, batch.kind[known].tolist()))
    heard.counts.update({name: len(batch.where(Wire.UBX, kind)) for name, kind in _PERIODIC.items()})
    if known.any():
        heard.autopilots.update(autopilots(batch, dialect))
    _, decoded = decoder(batch, np.full(len(batch), time_ns))
    by_topic = {part.channel.topic: part for part in decoded}
    status = by_topic.get(f"/gnss/{link}/status")
    for part in filter(None, (status, by_topic.get("/clock"))):
        # What has no time of its own has that of its receipt.
        if part.publish_ns[-1] != time_ns:
            heard.host_minus_device_s = (time_ns - int(part.publish_ns[-1])) / SECOND_NS
    if status is not None:
        fix = json.loads(status.payloads[-1])
        heard.fix = f"{fix['fix']}, {fix['satellites']} satellites"
        # A receiver that doubts its position tells its status alone.
        heard.fix_good = fix["fix"] not in _NOT_IN_SPACE and f"/gnss/{link}/fix" in by_topic


def _judge(link: LinkConfiguration, heard: _Heard, seconds: float) -> list[Check]:
    # A receiver's message comes some tenths of a second after its time; more is a wrong clock.
    clock_limit_s = 1.0
    # Short of the wanted rate by more is a wrong setting, no jitter.
    least_rate = 0.8
    name = link.name
    if heard.event and not heard.frames:
        return [Check(f"{name}: port", "bad", heard.event)]
    checks = [
        _check(
            f"{name}: frames",
            heard.frames > 0,
            f"{heard.frames / seconds:.1f} per second, {heard.damage_bytes} bytes of damage"
            if heard.frames
            else f"no data for {seconds:g} s",
        )
    ]
    if link.protocol == "mavlink":
        systems = ", ".join(f"system {s} component {c}" for s, c in sorted(heard.autopilots))
        checks.append(_check(f"{name}: heartbeat", bool(systems), systems or "no autopilot"))
    rates_hz = dict(link.vehicle.rates_hz) if link.vehicle else {}
    if link.ublox is not None:
        periodic = [message for message in _PERIODIC if message in link.ublox.messages]
        rates_hz |= dict.fromkeys(periodic, 1000 / link.ublox.rate_ms)
    for message, wanted in rates_hz.items():
        rate = heard.counts[message] / seconds
        good = rate >= least_rate * wanted
        checks.append(_check(f"{name}: rate of {message}", good, f"{rate:.1f} of {wanted:g} Hz"))
    if heard.fix or link.protocol == "mavlink" or link.ublox is not None:
        checks.append(_check(f"{name}: fix", heard.fix_good, heard.fix or "none reported"))
    if heard.host_minus_device_s is not None:
        offset = heard.host_minus_device_s
        good = abs(offset) <= clock_limit_s
        checks.append(_check(f"{name}: clock", good, f"this computer {offset:+.2f} s against the device"))
    return checks


def _disk(configuration: RecordingConfiguration, base: Path, host: Host) -> list[Check]:
    checks = []
    mb, gb = 1e6, 1e9
    for folder in (configuration.recording.output, *configuration.recording.spare):
        place = (base / folder).resolve()
        while not place.exists():
            place = place.parent
        try:
            free = host.free_bytes(place)
        except OSError as failure:
            checks.append(Check(f"disk {folder}", "bad", reason(failure)))
            continue
        good = free >= configuration.recording.least_free_mb * mb
        checks.append(_check(f"disk {folder}", good, f"{free / gb:.1f} GB free"))
    return checks


def _check(part: str, good: bool, text: str) -> Check:
    return Check(part, "good" if good else "bad", text)


def as_json(checks: list[Check]) -> dict[str, Any]:
    """Return the checks for programs."""
    listed = [{"subject": c.part, "good": c.state == "good", "seen": c.text} for c in checks]
    return {"schema": "acquire.check/1", "good": all(row["good"] for row in listed), "findings": listed}
