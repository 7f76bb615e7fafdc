"""Records of DataFlash and PX4 logs and of event lists, against the makers' own readers."""

from __future__ import annotations

import itertools
import struct
from collections import Counter
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from pymavlink import DFReader
from pyulog import ULog  # type: ignore[import-untyped]

from drivers import mrk
from drivers.dataflash import DataflashFormats, DataflashFramer
from drivers.frames import Batch, Framer
from drivers.ulog import UlogFormats, UlogFramer

FRAMERS = (DataflashFramer, UlogFramer, mrk.MrkFramer)


def batches(framer: Framer, data: bytes, cuts: list[int]) -> list[Batch]:
    edges = [0, *sorted(cut % (len(data) + 1) for cut in cuts), len(data)]
    return [*(framer.feed(data[a:b]) for a, b in itertools.pairwise(edges)), framer.close()]


def counted(found: list[Batch]) -> bytes:
    pieces = [(f.offset, f.data) for b in found for f in b] + [d for b in found for d in b.damaged()]
    return b"".join(piece for _, piece in sorted(pieces))


def dataflash_record(kind: int, payload: bytes) -> bytes:
    return b"\xa3\x95" + bytes([kind]) + payload


def definition(kind: int, name: str, form: str, columns: str) -> bytes:
    size = 3 + struct.calcsize("<" + form.replace("L", "i").replace("c", "h").replace("Z", "64s"))
    return dataflash_record(
        128, struct.pack("<BB4s16s64s", kind, size, name.encode(), form.encode(), columns.encode())
    )


def ulog_record(kind: str, payload: bytes) -> bytes:
    return struct.pack("<HB", len(payload), ord(kind)) + payload


ULOG_HEAD = b"ULog\x01\x12\x35\x01" + bytes(8)
DEFINED: dict[type[Framer], list[bytes]] = {
    DataflashFramer: [definition(10, "AB", "QIf", "TimeUS,N,V"), definition(11, "C", "Qc", "TimeUS,W")],
    UlogFramer: [
        ULOG_HEAD,
        ulog_record("F", b"ab:uint64_t timestamp;uint32_t n;float v;"),
        ulog_record("A", b"\0\x07\0ab"),
    ],
}


def numbered(framer: type[Framer], number: int) -> bytes:
    content = struct.pack("<QIf", 1000 * number, number, 0.5)
    if framer is UlogFramer:
        return ulog_record("D", b"\x07\0" + content)
    return dataflash_record(10, content) if number % 3 else dataflash_record(11, content[:8] + b"\1\2")


@pytest.mark.shared
def test_dataflash_records_are_those_of_pymavlink(shared: Path) -> None:
    path = shared / "data/autopilot-logs/log171.bin"
    found = batches(DataflashFramer(), path.read_bytes(), list(range(0, 3_000_000, 400_000)))
    assert sum(map(len, found)) == 91_530  # README of the recording
    log = DFReader.DFReader_binary(str(path))
    names = {
        "ATT": ["TimeMS", "Roll", "Yaw"],
        "GPS": ["Week", "TimeMS", "Lat", "Alt", "T"],
        "MSG": ["Message"],
    }
    theirs: dict[tuple[str, str], list[object]] = {(n, c): [] for n, cs in names.items() for c in cs}
    while (message := log.recv_match(type=list(names))) is not None:
        for column in names[message.get_type()]:
            theirs[message.get_type(), column].append(getattr(message, column))
    log.close()
    formats = DataflashFormats()
    ours: dict[tuple[str, str], list[object]] = {key: [] for key in theirs}
    for batch in found:
        formats.learn(batch)
        for name, column in theirs:
            values = formats.decode(batch, name)
            if len(values):
                ours[name, column] += values[column].tolist()
    for key, expected in theirs.items():
        if key[1] == "Message":
            assert [text.decode() for text in ours[key]] == expected  # type: ignore[attr-defined]
        else:
            np.testing.assert_allclose(ours[key], expected, rtol=0, atol=1e-9)  # type: ignore[arg-type]
    assert len(ours["GPS", "Lat"]) == 1199


@pytest.mark.shared
def test_px4_records_are_those_of_pyulog(shared: Path) -> None:
    path = shared / "data/autopilot-logs/sample_log_small.ulg"
    found = batches(UlogFramer(), path.read_bytes(), list(range(0, 900_000, 100_000)))
    assert not any(len(batch.damage) for batch in found)
    theirs = ULog(str(path))
    formats = UlogFormats()
    ours: dict[tuple[str, str], list[object]] = {}
    for batch in found:
        formats.learn(batch)
        for data in theirs.data_list:
            name = f"{data.name}[{data.multi_id}]" if data.multi_id else data.name
            records = formats.decode(batch, name)
            for column in records.columns:
                ours.setdefault((name, column), []).extend(records[column].tolist())
    for data in theirs.data_list:
        name = f"{data.name}[{data.multi_id}]" if data.multi_id else data.name
        for column, expected in data.data.items():
            member, _, element = column.partition("[")
            if "." in column:
                continue
            values = np.array(ours[name, member])
            values = values[:, int(element[:-1])] if element else values
            np.testing.assert_array_equal(values, expected, f"{name}.{column}")
    texts = [t for batch in found for t in formats.texts(batch)["text"].tolist()]
    assert texts == [message.message for message in theirs.logged_messages]


@pytest.mark.parametrize("framer", [DataflashFramer, UlogFramer])
@pytest.mark.parametrize("harm", ["flip", "drop", "insert", "cut"])
def test_damage_costs_no_record_but_its_own(framer: type[Framer], harm: str) -> None:
    chance = np.random.default_rng(7)
    head = DEFINED[framer]
    for _ in range(150):
        put = [numbered(framer, n) for n in range(1, 12)]
        victim, place = int(chance.integers(0, 9)), int(chance.integers(0, 10))
        if harm == "cut" and place + len(put[victim + 1]) == len(put[victim]):
            continue  # the rest and the next record together are as long as the record: none can tell
        broken = bytearray(put[victim])
        if harm == "flip":
            broken[place] ^= int(chance.integers(1, 0x7F))
        elif harm == "drop":
            del broken[place : place + 3]
        elif harm == "cut":
            del broken[place:]
        else:
            broken[place:place] = bytes(chance.integers(200, 250, 5).tolist())
        data = b"".join([*head, *put[:victim], bytes(broken), *put[victim + 1 :]])
        found = batches(framer(), data, chance.integers(0, 400, 3).tolist())
        assert counted(found) == data
        rest = Counter(put[:victim] + put[victim + 1 :])
        lost = rest - Counter(f.data for b in found for f in b)
        assert not lost, (victim, place)


@settings(max_examples=150)
@given(
    st.sampled_from(FRAMERS),
    st.lists(st.one_of(st.integers(0, 40), st.binary(max_size=40)), max_size=12),
    st.lists(st.integers(0, 3000), max_size=5),
    st.booleans(),
)
def test_nothing_is_an_error_and_every_byte_is_counted(
    framer: type[Framer], parts: list[int | bytes], cuts: list[int], defined: bool
) -> None:
    head = DEFINED.get(framer, []) if defined else []
    data = b"".join([*head, *(p if isinstance(p, bytes) else numbered(framer, p) for p in parts)])
    found = batches(framer(), data, cuts)
    assert counted(found) == data
    whole = [(f.offset, f.data, f.kind) for b in batches(framer(), data, []) for f in b]
    assert [(f.offset, f.data, f.kind) for b in found for f in b] == whole
    for formats in (DataflashFormats(), UlogFormats()):
        for batch in found:
            formats.learn(batch)
            formats.boot_ns(batch)
            formats.told_utc(batch)


@pytest.mark.parametrize("framer", [DataflashFramer, UlogFramer])
def test_the_end_of_a_log_inside_a_record_is_told(framer: type[Framer]) -> None:
    data = b"".join([*DEFINED[framer], numbered(framer, 1), numbered(framer, 2)])
    made = framer()
    found = batches(made, data[:-6], [])
    assert counted(found) == data[:-6]
    assert made.cut == len(numbered(framer, 2)) - 6


@pytest.mark.parametrize(
    ("name", "form", "columns"),
    [("BAD", "QX", "TimeUS,A"), ("BAD", "QI", "TimeUS"), ("BAD", "QI", "A,A"), ("BAD", "Qa", "A,B")],
)
def test_formats_that_cannot_be_meant_are_not_decoded(name: str, form: str, columns: str) -> None:
    record = bytearray(definition(20, name, "QI", "TimeUS,A"))
    record[9:25] = form.encode().ljust(16, b"\0")
    record[25:89] = columns.encode().ljust(64, b"\0")
    data = bytes(record) + dataflash_record(20, bytes(12))
    formats = DataflashFormats()
    (batch, rest) = batches(DataflashFramer(), data, [])
    formats.learn(batch)
    assert len(batch) + len(rest) == 2
    assert not len(formats.decode(batch, name))


def test_a_format_within_itself_ends() -> None:
    data = (
        ULOG_HEAD + ulog_record("F", b"a:a x;") + ulog_record("A", b"\0\1\0a") + ulog_record("D", b"\1\0" * 4)
    )
    found = batches(UlogFramer(), data, [])
    assert counted(found) == data
