"""Flight logs as files: written by us, read by the published reader."""

from __future__ import annotations

import io
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from mcap.reader import NonSeekingReader, make_reader

from acquire.log.chunk import Channel, Schema
from acquire.log.reader import LogReader
from acquire.log.writer import LogWriter
from photocal.base.errors import InputMalformedError, InputNotFoundError

SCHEMA = Schema("test.Thing", "jsonschema", b'{"type":"object"}')
CHANNELS = [
    Channel("/a/raw", "ubx"),
    Channel("/a/raw", "nmea"),
    Channel("/thing", "json", SCHEMA, {"k": "v"}),
]
START_NS = 1_700_000_000_000_000_000

MESSAGES = st.lists(
    st.tuples(
        st.integers(0, 2),
        st.binary(max_size=40),
        st.integers(0, 10**10),
        st.integers(0, 10**10),
        st.booleans(),
    ),
    max_size=30,
)


def write(messages: list[tuple[int, bytes, int, int, bool]]) -> bytes:
    stream = io.BytesIO()
    writer = LogWriter(stream)
    writer.metadata("site", {"name": "field", "empty": ""})
    for number, (channel, payload, log, publish, ends) in enumerate(messages):
        writer.messages(
            CHANNELS[channel],
            [payload],
            np.array([START_NS + log]),
            np.array([START_NS + publish]),
            np.array([number]),
        )
        if ends:
            writer.end_chunk()
    writer.attachment("rig.toml", "application/toml", b"lever = 1\n", START_NS, START_NS)
    writer.close()
    return stream.getvalue()


@settings(max_examples=100)
@given(MESSAGES)
def test_the_published_reader_reads_what_was_written(
    messages: list[tuple[int, bytes, int, int, bool]],
) -> None:
    data = write(messages)
    expected = sorted(
        (
            START_NS + log,
            number,
            CHANNELS[channel].topic,
            CHANNELS[channel].encoding,
            payload,
            START_NS + publish,
        )
        for number, (channel, payload, log, publish, _) in enumerate(messages)
    )
    for reader in (
        make_reader(io.BytesIO(data), validate_crcs=True),
        NonSeekingReader(io.BytesIO(data), validate_crcs=True),
    ):
        found = sorted(
            (m.log_time, m.sequence, c.topic, c.message_encoding, m.data, m.publish_time)
            for _, c, m in reader.iter_messages()
        )
        assert found == expected
    reader = make_reader(io.BytesIO(data), validate_crcs=True)
    summary = reader.get_summary()
    assert summary is not None
    assert summary.statistics is not None
    assert summary.statistics.message_count == len(messages)
    assert [(m.name, m.metadata) for m in reader.iter_metadata()] == [
        ("site", {"name": "field", "empty": ""})
    ]
    assert [(a.name, a.data) for a in reader.iter_attachments()] == [("rig.toml", b"lever = 1\n")]


@settings(max_examples=60)
@given(MESSAGES)
def test_our_reader_gives_back_what_was_written(messages: list[tuple[int, bytes, int, int, bool]]) -> None:
    import tempfile

    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "log.mcap"
        path.write_bytes(write(messages))
        reader = LogReader(path)
        found = sorted(
            (number, part.channel, payload, log - START_NS, publish - START_NS)
            for chunk in reader.chunks()
            for part in chunk
            for payload, log, publish, number in zip(
                part.payloads,
                part.log_ns.tolist(),
                part.publish_ns.tolist(),
                part.sequence.tolist(),
                strict=True,
            )
        )
    assert found == [
        (number, CHANNELS[channel], payload, log, publish)
        for number, (channel, payload, log, publish, _) in enumerate(messages)
    ]
    assert reader.complete
    assert reader.metadata == {"site": {"name": "field", "empty": ""}}
    assert {name: a.data for name, a in reader.attachments.items()} == {"rig.toml": b"lever = 1\n"}


def test_a_log_that_ends_anywhere_gives_its_whole_chunks(tmp_path: Path) -> None:
    messages = [(0, bytes([n]) * 5, n, n, n % 3 == 2) for n in range(12)]
    data = write(messages)
    path = tmp_path / "log.mcap"
    seen = set()
    for end in range(len(data)):
        path.write_bytes(data[:end])
        reader = LogReader(path)
        if end < 8:
            with pytest.raises(InputMalformedError):
                list(reader.chunks())
            continue
        found = [payload for chunk in reader.chunks() for part in chunk for payload in part.payloads]
        assert found == [payload for _, payload, *_ in messages[: len(found)]]
        assert len(found) % 3 == 0
        seen.add(len(found))
    assert seen == {0, 3, 6, 9, 12}


def test_a_log_that_grows_is_read_on_where_it_ended(tmp_path: Path) -> None:
    messages = [(n % 3, bytes([n]) * 5, n, n, n % 2 == 1) for n in range(12)]
    data = write(messages)
    path = tmp_path / "log.mcap"
    path.write_bytes(data[:20])
    reader = LogReader(path)
    found: list[bytes] = []
    for end in [*range(20, len(data), 37), len(data), len(data)]:
        with path.open("ab") as stream:
            stream.write(data[stream.tell() : end])
        found += [p for chunk in reader.chunks() for part in chunk for p in part.payloads]
    assert sorted(found) == [payload for _, payload, *_ in messages]
    assert reader.complete
    assert reader.metadata == {"site": {"name": "field", "empty": ""}}


@settings(max_examples=200)
@given(st.data())
def test_a_damaged_log_is_refused_in_words(draw: st.DataObject) -> None:
    import tempfile

    data = bytearray(write([(n % 3, bytes([n]) * 9, n, n, n % 4 == 3) for n in range(12)]))
    for place in draw.draw(st.lists(st.integers(0, len(data) - 1), min_size=1, max_size=4)):
        data[place] ^= draw.draw(st.integers(1, 255))
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "log.mcap"
        path.write_bytes(data)
        try:
            list(LogReader(path).chunks())
        except InputMalformedError as refusal:
            assert "\n" not in str(refusal)  # noqa: PT017


def test_what_is_no_log_is_refused(tmp_path: Path) -> None:
    (tmp_path / "empty.mcap").touch()
    (tmp_path / "text.mcap").write_text("no log")
    for name, kind in (("empty.mcap", InputMalformedError), ("text.mcap", InputMalformedError)):
        with pytest.raises(kind, match=name):
            list(LogReader(tmp_path / name).chunks())
    with pytest.raises(InputNotFoundError, match="folder"):
        list(LogReader(tmp_path).chunks())
    with pytest.raises(InputNotFoundError, match="missing"):
        list(LogReader(tmp_path / "missing.mcap").chunks())
