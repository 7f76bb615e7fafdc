"""Repair of flight logs that were cut or damaged, seen through the published reader."""

from __future__ import annotations

import io
import json
import subprocess
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from mcap.reader import make_reader
from mcap.records import Chunk, Statistics
from mcap.stream_reader import StreamReader

from acquire.importing.importer import import_recordings
from acquire.importing.recovery import recover
from acquire.log.chunk import Channel
from acquire.log.writer import LogWriter
from photocal.base.errors import InputMalformedError

Acquire = Callable[..., subprocess.CompletedProcess[str]]
RAW = Channel("/rover/raw", "ubx")


def small_log() -> bytes:
    stream = io.BytesIO()
    writer = LogWriter(stream)
    writer.metadata("site", {"name": "field"})
    for number in range(5):
        times = np.array([number, number + 1]) * 10**9
        writer.messages(
            RAW, [bytes([number]) * 4, b"x"], times, times, np.array([2 * number, 2 * number + 1])
        )
        writer.end_chunk()
    writer.attachment("rig.toml", "application/toml", b"a = 1", 1, 2)
    writer.close()
    return stream.getvalue()


def payloads(path: Path) -> list[bytes]:
    with path.open("rb") as stream:
        reader = make_reader(stream, validate_crcs=True)
        assert reader.get_summary() is not None
        return [m.data for _, _, m in reader.iter_messages(log_time_order=False)]


def chunk_ends(data: bytes) -> list[int]:
    """Where the published reader sees the chunks end."""
    stream = io.BytesIO(data)
    found = StreamReader(stream, emit_chunks=True).records
    return [stream.tell() for record in found if isinstance(record, Chunk)]


def statistics(data: bytes) -> Statistics | None:
    summary = make_reader(io.BytesIO(data)).get_summary()
    assert summary is not None
    return summary.statistics


def test_a_log_cut_at_every_byte_keeps_every_whole_chunk(tmp_path: Path) -> None:
    data = small_log()
    ends = chunk_ends(data)
    assert len(ends) == 5
    whole = [bytes([number]) * 4 if first else b"x" for number in range(5) for first in (True, False)]
    cut, fixed = tmp_path / "cut.mcap", tmp_path / "fixed.mcap"
    refused = 0
    for end in range(len(data) + 1):
        cut.write_bytes(data[:end])
        kept = sum(last <= end for last in ends)
        try:
            result = recover(cut, fixed)
        except InputMalformedError:
            assert kept == 0
            refused += 1
            continue
        assert result["chunks"] == kept
        assert payloads(fixed) == whole[: 2 * kept]
        assert (result["had_its_end"] and not result["damaged"]) == (end >= len(data) - 8)
    assert refused == ends[0]


def test_a_damaged_chunk_costs_only_itself(tmp_path: Path) -> None:
    data = bytearray(small_log())
    middle = (chunk_ends(bytes(data))[1] + chunk_ends(bytes(data))[2]) // 2
    data[middle] ^= 0x10
    log, fixed = tmp_path / "log.mcap", tmp_path / "fixed.mcap"
    log.write_bytes(data)
    result = recover(log, fixed)
    assert result["chunks"] in (4, 5)
    assert len(result["damaged"]) == 5 - result["chunks"]
    found = payloads(fixed)
    for number in (0, 1, 3, 4):
        assert bytes([number]) * 4 in found


def test_notes_and_files_survive(tmp_path: Path) -> None:
    log, fixed = tmp_path / "log.mcap", tmp_path / "fixed.mcap"
    data = small_log()
    log.write_bytes(data[:-40])
    assert not recover(log, fixed)["had_its_end"]
    with fixed.open("rb") as stream:
        reader = make_reader(stream)
        assert [(m.name, m.metadata) for m in reader.iter_metadata()] == [("site", {"name": "field"})]
        assert [(a.name, a.data, a.log_time, a.create_time) for a in reader.iter_attachments()] == [
            ("rig.toml", b"a = 1", 1, 2)
        ]


def test_the_command_repairs_and_says_what_was_lost(
    acquire: Acquire, tmp_path: Path, demo_flight: bytes
) -> None:
    source, log = tmp_path / "flight.tlog", tmp_path / "flight.mcap"
    source.write_bytes(demo_flight)
    import_recordings([], [source], log, lambda _: None)
    data = log.read_bytes()
    log.write_bytes(data[:-100])
    done = acquire("recover", log)
    assert done.returncode == 0
    assert "was not closed" in done.stdout
    fixed = tmp_path / "flight.recovered.mcap"
    assert statistics(fixed.read_bytes()) == statistics(data)
    done = acquire("recover", fixed, "-o", tmp_path / "again.mcap", "--json")
    assert json.loads(done.stdout)["had_its_end"]


@pytest.mark.parametrize("content", [b"", b"\x89MCAP0\r\n", b"something else"])
def test_what_holds_nothing_is_refused(content: bytes, acquire: Acquire, tmp_path: Path) -> None:
    log = tmp_path / "log.mcap"
    log.write_bytes(content)
    done = acquire("recover", log, "-o", tmp_path / "fixed.mcap")
    assert done.returncode == 4
    assert done.stderr.count("\n") == 1
    assert [p.name for p in tmp_path.iterdir()] == ["log.mcap"]
    done = acquire("recover", log, "-o", log)
    assert done.returncode == 5


def test_notes_alone_are_nothing_to_save(acquire: Acquire, tmp_path: Path) -> None:
    """A log that was cut within its first chunk, behind what its head says of the site."""
    log = tmp_path / "log.mcap"
    log.write_bytes(small_log()[: chunk_ends(small_log())[0] - 1])
    done = acquire("recover", log, "-o", tmp_path / "fixed.mcap")
    assert done.returncode == 4
    assert "has no intact chunk" in done.stderr
    assert [p.name for p in tmp_path.iterdir()] == ["log.mcap"]
