"""Telemetry logs against pymavlink's reader and against what was put in."""

from __future__ import annotations

from collections import Counter
from itertools import pairwise
from pathlib import Path

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from pymavlink import mavutil

from drivers.checksums import x25
from drivers.frames import Batch
from drivers.mavlink.dialect import ardupilotmega
from drivers.tlog import TlogFramer
from tests.telemetry import telemetry_log

DIALECT = ardupilotmega()
DEMO = telemetry_log(DIALECT)
START_US = 1_777_626_000_000_000


def batches(data: bytes, cuts: list[int] | None = None) -> tuple[list[Batch], TlogFramer]:
    framer = TlogFramer()
    edges = [0, *sorted(cut % (len(data) + 1) for cut in cuts or []), len(data)]
    parts = [framer.feed(data[a:b]) for a, b in pairwise(edges)]
    return [*parts, framer.close()], framer


def stamped(found: list[Batch]) -> list[tuple[int, bytes]]:
    result = []
    for batch in found:
        assert batch.host_ns is not None
        result += [(t // 1000, f.data) for t, f in zip(batch.host_ns.tolist(), batch, strict=True)]
    return result


def unaccounted(found: list[Batch], size: int) -> int:
    return size - sum(len(b) * 8 + int(b.length.sum()) + int(b.damage[:, 1].sum()) for b in found)


def record(time_us: int, frame: bytes) -> bytes:
    return time_us.to_bytes(8, "big") + frame


def unknown_frame(sequence: int, message: int = 142, seed: int = 113, size: int = 5) -> bytes:
    body = bytes([size, sequence & 255, 255, 0, message]) + bytes(range(size))
    return b"\xfe" + body + x25(body, seed).to_bytes(2, "little")


def records_of(data: bytes) -> list[bytes]:
    """Cut an intact MAVLink 2 log by its lengths."""
    found, at = [], 0
    while at < len(data):
        size = 8 + data[at + 9] + 12
        found.append(data[at : at + size])
        at += size
    return found


def read_by_pymavlink(path: Path) -> Counter[str]:
    peer: Counter[str] = Counter()
    log = mavutil.mavlink_connection(str(path))
    while (message := log.recv_match()) is not None:
        peer[message.get_type()] += 1
    log.close()
    return peer


@pytest.mark.shared
def test_dronekit_flight_has_the_messages_that_pymavlink_reads(shared: Path) -> None:
    path = shared / "data/mavlink-tlog-dronekit/flight.tlog"
    data = path.read_bytes()
    found, framer = batches(data, list(range(0, len(data), 1 << 18)))
    kinds = Counter(
        DIALECT.name(f.kind) if f.known else f"unknown {f.kind}" for batch in found for f in batch
    )
    peer = read_by_pymavlink(path)
    refused = peer.pop("BAD_DATA", 0) + sum(
        peer.pop(name) for name in list(peer) if name.startswith("UNKNOWN")
    )
    # Its description: 75 477 messages, 1 314 frames of message 142 that the dialect refuses, one cut frame.
    assert sum(peer.values()) == 75_477
    assert refused in (1314, 1315)
    assert kinds.pop("unknown 142") == 1314
    assert kinds == peer
    assert framer.cut == len(data) - sum(int(d[0]) for b in found for d in b.damage) > 0
    assert unaccounted(found, len(data)) == 0
    odd = [f for batch in found for f in batch if not f.known]
    assert {(f.data[1], f.data[3], f.data[4]) for f in odd} == {(5, 255, 0)}


@pytest.mark.shared
def test_cuav_flight_has_the_messages_that_pymavlink_reads(shared: Path) -> None:
    path = shared / "data/mavlink-tlog-cuav-images/flight.tlog"
    found, _ = batches(path.read_bytes())
    kinds = Counter(DIALECT.name(f.kind) for batch in found for f in batch)
    peer = read_by_pymavlink(path)
    # pymavlink's reader loses two frames where the log changes from MAVLink 1 to 2; both are intact records
    # in an unbroken row, so nothing of the file is damage.
    assert peer.pop("BAD_DATA") == 2
    assert kinds - peer == Counter({"COMMAND_LONG": 1, "HEARTBEAT": 1})
    assert not peer - kinds
    assert sum(len(b.damage) for b in found) == 0
    assert unaccounted(found, path.stat().st_size) == 0
    assert (kinds["GPS_RAW_INT"], kinds["GPS2_RAW"], kinds["ATTITUDE"]) == (1129, 1130, 1088)


def test_unknown_frames_between_known_ones_are_kept_as_unknown() -> None:
    parts = []
    for number, known in enumerate(records_of(DEMO)[:60]):
        parts += [known, record(START_US + number, unknown_frame(number))]
    data = b"".join(parts)
    found, _ = batches(data)
    assert [part[8:] for part in parts] == [f.data for batch in found for f in batch]
    assert sum(not f.known for batch in found for f in batch) == 60
    assert unaccounted(found, len(data)) == 0


def test_noise_that_looks_like_an_unknown_frame_does_not_swallow_known_ones() -> None:
    whole = records_of(DEMO)
    # A header that claims an unknown message over the next records, for every seed that could explain it.
    for lie in range(256):
        head = bytes([0xFE, 60, lie, 1, 1, 205])
        data = b"".join([*whole[:5], record(START_US, head), *whole[5:12]])
        known = [f.data for batch in batches(data)[0] for f in batch if f.known]
        assert known == [part[8:] for part in whole[:12]]


@settings(max_examples=200)
@given(st.integers(0, len(DEMO)), st.lists(st.integers(0, len(DEMO)), max_size=8))
def test_a_log_cut_anywhere_gives_its_whole_records_however_it_is_fed(end: int, cuts: list[int]) -> None:
    whole, at = [], 0
    for part in records_of(DEMO):
        at += len(part)
        if at > end:
            break
        whole.append((int.from_bytes(part[:8], "big"), part[8:]))
    found, framer = batches(DEMO[:end], cuts)
    assert stamped(found) == whole
    assert unaccounted(found, end) == 0
    rest = end - sum(len(frame) + 8 for _, frame in whole)
    assert framer.cut in (0, rest)
    assert rest < 9 or framer.cut == rest


@settings(max_examples=300)
@given(st.data())
def test_damage_costs_only_the_frames_that_it_touches(draw: st.DataObject) -> None:
    first = draw.draw(st.integers(0, 700))
    parts = records_of(DEMO)[first : first + 40]
    victim = draw.draw(st.integers(0, 38))
    place = draw.draw(st.integers(0, len(parts[victim]) - 1))
    kind = draw.draw(st.sampled_from(["flip", "drop", "insert", "stamp"]))
    broken = bytearray(parts[victim])
    if kind == "flip":
        broken[8 + place % (len(broken) - 8)] ^= draw.draw(st.integers(1, 255))
    elif kind == "drop":
        del broken[place:]
    elif kind == "insert":
        broken[place:place] = draw.draw(st.binary(min_size=1, max_size=40))
    else:
        broken[0] ^= 0x80
    data = b"".join([*parts[:victim], bytes(broken), *parts[victim + 1 :]])
    cuts = draw.draw(st.lists(st.integers(0, len(data)), max_size=5))
    found, _ = batches(data, cuts)
    expected = Counter(part[8:] for i, part in enumerate(parts) if i != victim or kind == "stamp")
    assert not expected - Counter(f.data for batch in found for f in batch if f.known)


@settings(max_examples=200)
@given(st.binary(max_size=1500), st.lists(st.integers(0, 1500), max_size=4))
def test_noise_is_never_an_error(data: bytes, cuts: list[int]) -> None:
    found, _ = batches(data, cuts)
    pieces = sum(int(b.damage[:, 1].sum()) + int(b.length.sum()) for b in found)
    frames = sum(len(b) for b in found)
    assert len(data) - 8 * frames <= pieces <= len(data)
