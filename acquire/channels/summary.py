"""What a flight log holds: links, rates, gaps, damage, fixes, sources and clocks.

What the figures of a flight log mean before packing up: whether it is complete and can be processed.
"""

from collections import Counter
from dataclasses import dataclass, field
from itertools import combinations
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from acquire.channels.mounting import mounting_of
from acquire.log.chunk import DAMAGE_ENCODING
from acquire.log.reader import LogReader, link_of, read_json
from drivers.frames import Batch, Wire
from drivers.identify import batch_of_payloads, kind_name
from drivers.mavlink.decode import decode, sequences, sources
from drivers.mavlink.dialect import Dialect, ardupilotmega
from drivers.protocols import known_wire
from photocal.base.arrays import Bytes, Floats, Integers, picked
from photocal.base.sentences import Texts

# Raw observations, and the orbits that a trajectory needs as well, by protocol.
# RTCM: 1004, 1012, and MSM 4 to 7 of GPS, GLONASS, Galileo, QZSS and BeiDou.
_MSM = tuple(str(system + kind) for system in (1070, 1080, 1090, 1110, 1120) for kind in (4, 5, 6, 7))
_OBSERVATIONS = frozenset(("RXM-RAWX", "1004", "1012", *_MSM))
_ORBITS = ("RXM-SFRBX", "1019", "1020", "1042", "1045", "1046")
# How an exposure is seen, in the order in which a person thinks of it.
_SEEN = ("trigger", "feedback", "mark")
_LACKS = {
    "trigger": "were triggered",
    "feedback": "were reported by the autopilot",
    "mark": "have a time mark",
}
# A pause of a link counts as a gap from here on.
GAP_S = 2.0


def verdict_on(figures: dict[str, Any], exposures: dict[str, int]) -> dict[str, Any]:
    """Judge what `summarise` found: how many pictures were seen, and what lacks for processing the log.

    exposures: edges by kind: trigger, feedback, rising, falling.
    """
    seen = {key: exposures[key] for key in ("trigger", "feedback") if exposures.get(key)}
    # A pulse has two edges; which of them is the exposure is a matter of the camera.
    if marks := max((count for edge, count in exposures.items() if edge not in seen), default=0):
        seen["mark"] = marks
    links = {link["link"]: link for link in figures["links"]}
    raw = {name: _raw(link) for name, link in links.items()}
    steady = {name: _steady(kinds) for name, kinds in raw.items() if kinds}
    apart = _apart(links)
    raw_apart = [pair for pair in apart if steady.keys() >= set(pair)]
    remarks = [*_of_exposures(seen), *_of_damage(links.values()), *map(_do_not_overlap, apart)]
    blind = {name: link["exposures"] for name, link in links.items() if link.get("exposures")}
    remarks += [_blind(name, **counts) for name, counts in blind.items() if counts["without_observations"]]
    never = [_blind(name, **now) for name, now in blind.items() if now["without_observations"] == now["seen"]]
    remarks += [f"{name}: the imported file ends early" for name in _cut(figures.get("metadata", {}), links)]
    gaps = any((now["longest_gap_s"] or 0.0) > GAP_S for now in steady.values())
    faultless = not remarks and not gaps and figures["complete"]
    if not figures["complete"]:
        remarks.append("the log ends early: acquire recover saves its intact part")
    orbits = any(kind["type"] in _ORBITS for link in links.values() for kind in link["types"])
    missing = _lacks_for_ppk([*steady], orbits=orbits)
    missing += map(_do_not_overlap, raw_apart) if raw_apart else never
    no_exposure = [] if seen.get("mark") or seen.get("feedback") else ["no time mark and no camera feedback"]
    return {
        "complete": faultless and bool(seen),
        "exposures": seen,
        "receivers": steady,
        "ppk": _possible(missing),
        "exposures_possible": _possible(no_exposure),
        "remarks": remarks,
    }


def _possible(missing: list[str]) -> dict[str, Any]:
    return {"possible": not missing, "missing": missing}


def verdict_lines(said: dict[str, Any], say: Texts) -> list[str]:
    """Write a verdict as the paragraph that comes first."""
    seen = said["exposures"]
    counts = ", ".join(say(f"info.seen_{key}", count=seen[key]) for key in _SEEN if key in seen)
    ppk, exposures = (_answer(said[key], say) for key in ("ppk", "exposures_possible"))
    told = [
        say("info.pictures", counts=counts or say("info.no_pictures")),
        *(say("info.steady", name=name, **_rate_words(now, say)) for name, now in said["receivers"].items()),
        *map(say.stored, said["remarks"]),
        say("info.processed", ppk=ppk, exposures=exposures),
    ]
    state = say("info.complete" if said["complete"] else "info.check")
    return [say("info.verdict", state=state), *map("  ".__add__, told)]


def _steady(kinds: list[dict[str, Any]]) -> dict[str, float | None]:
    """Rate and longest gap of a receiver, by its steadiest message: of RTCM one system may be out of view."""
    steadiest = min(kinds, key=lambda kind: kind["longest_gap_s"] or 0.0)
    return {"rate_hz": steadiest["rate_hz"], "longest_gap_s": steadiest["longest_gap_s"]}


def _rate_words(steady: dict[str, float | None], say: Texts) -> dict[str, str]:
    rate, longest = steady["rate_hz"], steady["longest_gap_s"] or 0.0
    gaps = say("info.gaps", longest=say.row([longest], ".1f")) if longest > GAP_S else say("info.no_gaps")
    return {"rate": "" if rate is None else say("info.rate", rate=say.row([rate], ".3g")), "gaps": gaps}


def _answer(possible: dict[str, Any], say: Texts) -> str:
    missing = ", ".join(map(say.stored, possible["missing"]))
    return say("info.yes") if possible["possible"] else say("info.no", missing=missing)


def _raw(link: dict[str, Any]) -> list[dict[str, Any]]:
    return [kind for kind in link["types"] if kind["type"] in _OBSERVATIONS]


def _of_exposures(seen: dict[str, int]) -> list[str]:
    most = max(seen.values(), default=0)
    return [f"only {count} of {most} pictures {_LACKS[key]}" for key, count in seen.items() if count < most]


def _of_damage(links: Any) -> list[str]:
    return [
        f"{link['link']}: {link['damage_bytes']} bytes belong to no valid frame"
        for link in links
        if link["damage_bytes"] > 0.01 * max(link["frame_bytes"], 1)
    ]


def _blind(name: str, seen: int, without_observations: int) -> str:
    return f"{name}: no raw observations at {without_observations} of {seen} exposures"


def _apart(links: dict[str, dict[str, Any]]) -> list[tuple[str, str]]:
    """Pairs of links without a common moment, as those of two flights."""
    spans = {name: link["span_ns"] for name, link in links.items() if link.get("span_ns")}
    return [
        (a, b)
        for a, b in combinations(spans, 2)
        if max(spans[a][0], spans[b][0]) > min(spans[a][1], spans[b][1])
    ]


def _do_not_overlap(pair: tuple[str, str]) -> str:
    return f"{pair[0]} and {pair[1]} do not overlap in time"


def _cut(metadata: dict[str, dict[str, str]], links: dict[str, dict[str, Any]]) -> list[str]:
    """Links of packed recordings whose end is missing."""
    return [name for name in links if metadata.get(f"import {name}", {}).get("packing_cut") == "True"]


def _lacks_for_ppk(receivers: list[str], *, orbits: bool) -> list[str]:
    if not receivers:
        return ["no raw observations"]
    lacks = []
    if len(receivers) == 1:
        lacks.append(f"raw observations of {receivers[0]} only: give the base as a file of its own")
    if not orbits:
        lacks.append("no satellite orbits: give a navigation file")
    return lacks


# SYSTEM_TIME messages: the systems that sent them, their fields, and their times of receipt.
ClockReadings = tuple[Bytes, NDArray[Any], Integers]


def clock_figures(readings: list[ClockReadings]) -> dict[str, Any] | None:
    """Return offset, rate and a verdict in words; the first system that tells the date counts, None for none.

    readings: of the clocks of one link, in the order of their receipt.
    """
    earliest_us = 946_684_800_000_000
    if not readings:
        return None
    system, fields, received = (np.concatenate(parts) for parts in zip(*readings, strict=True))
    good = fields["time_unix_usec"] > earliest_us
    if not good.any():
        return None
    telling = int(system[np.argmax(good)])
    good &= system == telling
    host, device = received[good], fields["time_unix_usec"][good].astype(np.int64) * 1000
    offset = (host - device) / 1e9
    samples = 24
    shown = np.unique(np.linspace(0, len(offset) - 1, samples).astype(int))
    ratio = _ratio(host, fields["time_boot_ms"][good].astype(np.int64) * 1_000_000)
    return {
        "system": telling,
        "readings": len(offset),
        "host_minus_device_s": {
            "first": float(offset[0]),
            "last": float(offset[-1]),
            "least": float(offset.min()),
            "greatest": float(offset.max()),
        },
        "over_time": [[int(host[i]), float(offset[i])] for i in shown.tolist()],
        "device_seconds_per_host_second": ratio,
        "verdict": verdict(offset, ratio),
    }


def verdict(offset_s: Floats, ratio: float | None) -> str:
    """Say what the readings mean; `ratio`: seconds of the autopilot's clock per second of the host's."""
    span = f"host minus autopilot clock from {offset_s.min():+.2f} s to {offset_s.max():+.2f} s"
    # A clock is wrong from 1 % on: good ones stay below 0.01 %.
    rate_limit = 0.01
    if ratio is None or abs(ratio - 1) <= rate_limit:
        return span
    factor, word = (ratio, "slower") if ratio > 1 else (1 / ratio, "faster")
    return (
        f"the host clock ran {factor:.1f} times {word} than the autopilot's: times of receipt are not flight "
        f"times, use the autopilot's times; {span}"
    )


def _ratio(host: Integers, boot: Integers) -> float | None:
    """Return the rate of the autopilot's clock over the longest stretch without a restart."""
    edges = np.concatenate([[0], np.flatnonzero(np.diff(boot) < 0) + 1, [len(boot)]])
    longest = int(np.argmax(np.diff(edges)))
    first, last = int(edges[longest]), int(edges[longest + 1]) - 1
    elapsed = float(host[last] - host[first]) / 1e9
    least_span_s = 10.0
    return float(boot[last] - boot[first]) / 1e9 / elapsed if elapsed > least_span_s else None


@dataclass
class LinkSummary:
    """What came over one link.

    dialect: names of MAVLink messages.
    """

    name: str
    dialect: Dialect
    frames: int = 0
    frame_bytes: int = 0
    damage_bytes: int = 0
    times: list[Integers] = field(default_factory=list)
    by_type: dict[tuple[str, str], list[Integers]] = field(default_factory=dict)
    senders: dict[tuple[int, int], list[Bytes]] = field(default_factory=dict)
    clock: list[ClockReadings] = field(default_factory=list)

    def add(self, batch: Batch, log_ns: Integers) -> None:
        """Count frames of one protocol."""
        self.frames += len(batch)
        self.frame_bytes += int(batch.length.sum())
        self.times.append(log_ns)
        wire = Wire(int(batch.wire[0]))
        codes = batch.kind * 2 + batch.known
        for code in np.unique(codes).tolist():
            name = kind_name(wire, code >> 1, bool(code & 1), self.dialect)
            self.by_type.setdefault((wire.encoding, name), []).append(log_ns[codes == code])
        if wire == Wire.MAVLINK:
            index = np.arange(len(batch))
            system, component = sources(batch, index)
            number = sequences(batch, index)
            both = system.astype(np.int64) * 256 + component
            for code in np.unique(both).tolist():
                self.senders.setdefault(divmod(code, 256), []).append(number[both == code])
            system_time = decode(batch, self.dialect.number("SYSTEM_TIME"), self.dialect)
            at = system_time.index
            self.clock.append((system[at], system_time.fields, log_ns[at]))

    def as_json(self, exposures_ns: Integers) -> dict[str, Any]:
        """Return the figures; of a receiver also at how many exposures its observations lack."""
        times = np.sort(np.concatenate([np.empty(0, np.int64), *self.times]))
        duration = _seconds(times[-1] - times[0]) if len(times) else 0.0
        return {
            "link": self.name,
            **picked(self, "frames", "frame_bytes", "damage_bytes"),
            "duration_s": duration,
            "span_ns": [int(times[0]), int(times[-1])] if len(times) else None,
            "rate_hz": _rate(len(times), duration),
            "gaps": _gaps(times),
            "types": [self._type(key, parts) for key, parts in sorted(self.by_type.items())],
            "sources": [_sender(*item) for item in sorted(self.senders.items())],
            "clock": clock_figures(self.clock),
            "exposures": self._at(exposures_ns),
        }

    def _at(self, exposures_ns: Integers) -> dict[str, int] | None:
        raw = [part for (_, name), parts in self.by_type.items() if name in _OBSERVATIONS for part in parts]
        if not raw or not len(exposures_ns):
            return None
        times = np.sort(np.concatenate(raw))
        after = np.searchsorted(times, exposures_ns)
        inside = (after > 0) & (after < len(times))
        step = times[after[inside]] - times[after[inside] - 1]
        covered = int((step <= GAP_S * 1e9).sum())
        return {"seen": len(exposures_ns), "without_observations": len(exposures_ns) - covered}

    @staticmethod
    def _type(key: tuple[str, str], parts: list[Integers]) -> dict[str, Any]:
        times = np.sort(np.concatenate(parts))
        steps = np.diff(times)
        return {
            "encoding": key[0],
            "type": key[1],
            "frames": len(times),
            "rate_hz": _rate(len(times), _seconds(times[-1] - times[0])),
            "longest_gap_s": _seconds(steps.max()) if len(steps) else None,
        }


def summarise(path: Path) -> dict[str, Any]:
    """Read a flight log, count what it holds, and judge it.

    raises InputNotFoundError, InputMalformedError: see `LogReader.chunks`.
    """
    reader, dialect = LogReader(path), ardupilotmega()
    links: dict[str, LinkSummary] = {}
    fixes: dict[str, Counter[str]] = {}
    topics: Counter[tuple[str, str, str]] = Counter()
    parameters: dict[str, dict[str, float]] = {}
    exposed: dict[str, list[int]] = {}
    for chunk in reader.chunks():
        for messages in chunk:
            channel = messages.channel
            schema = channel.schema.name if channel.schema else ""
            topics[channel.topic, channel.encoding, schema] += len(messages.payloads)
            if schema == "photocal.GnssStatus":
                receiver = channel.topic.removeprefix("/gnss/").removesuffix("/status")
                counts = fixes.setdefault(receiver, Counter())
                counts.update(str(read_json(payload, path).get("fix")) for payload in messages.payloads)
            elif schema == "photocal.Exposure":
                for payload, log_ns in zip(messages.payloads, messages.log_ns.tolist(), strict=True):
                    exposed.setdefault(str(read_json(payload, path).get("edge")), []).append(log_ns)
            elif schema == "photocal.Parameter":
                contents = [read_json(payload, path) for payload in messages.payloads]
                values = {str(p["name"]): float(p["value"]) for p in contents if p.get("value") is not None}
                parameters.setdefault(channel.topic.removeprefix("/"), {}).update(values)
            elif channel.schema is None:
                name, encoding = link_of(channel), channel.encoding
                summary = links.setdefault(name, LinkSummary(name, dialect))
                if encoding == DAMAGE_ENCODING:
                    summary.damage_bytes += sum(map(len, messages.payloads))
                elif (wire := known_wire(encoding)) is not None:
                    batch = batch_of_payloads(wire, messages.payloads, dialect)
                    summary.add(batch, messages.log_ns)
    figures = {
        "schema": "acquire.info/1",
        "file": str(path),
        "bytes": path.stat().st_size,
        "complete": reader.complete,
        "links": [link.as_json(_moments(exposed)) for _, link in sorted(links.items())],
        "fixes": {receiver: dict(counts) for receiver, counts in sorted(fixes.items())},
        "topics": [
            {"topic": topic, "encoding": encoding, "schema": schema, "messages": count}
            for (topic, encoding, schema), count in sorted(topics.items())
        ],
        "metadata": reader.metadata,
        "mounting": {
            source: {"parameters": len(told), **mounting_of(told).as_json()}
            for source, told in sorted(parameters.items())
        },
    }
    return {**figures, "verdict": verdict_on(figures, {edge: len(times) for edge, times in exposed.items()})}


def _moments(exposed: dict[str, list[int]]) -> Integers:
    """Times of the exposures, by marks of a receiver where there are any: those have its clock."""
    marks = [times for edge, times in exposed.items() if edge not in ("trigger", "feedback")]
    best = max(marks, key=len) if marks else exposed.get("feedback", exposed.get("trigger", []))
    return np.array(best, np.int64)


def _sender(source: tuple[int, int], parts: list[Bytes]) -> dict[str, int]:
    # Each source numbers its frames modulo 256: what the steps skip was sent but did not arrive.
    numbers = np.concatenate(parts).astype(np.int64)
    steps = (numbers[1:] - numbers[:-1]) & 0xFF
    lost = int((steps[steps > 0] - 1).sum())
    return {
        "system": source[0],
        "component": source[1],
        "frames": sum(map(len, parts)),
        "missing_numbers": lost,
    }


def _gaps(times: Integers) -> dict[str, Any]:
    # The longest ones say where to look.
    listed_gaps = 20
    steps = np.diff(times) / 1e9
    long = np.flatnonzero(steps > GAP_S)
    worst = long[np.argsort(-steps[long], kind="stable")][:listed_gaps]
    return {
        "longer_than_s": GAP_S,
        "count": len(long),
        "longest_s": float(steps.max()) if len(steps) else 0.0,
        "longest": [{"utc_ns": int(times[i]), "seconds": float(steps[i])} for i in worst.tolist()],
    }


def _seconds(nanoseconds: Any) -> float:
    return float(nanoseconds) / 1e9


def _rate(count: int, duration_s: float) -> float | None:
    return (count - 1) / duration_s if duration_s > 0 else None
