"""What cannot be imported: one line, the exit code of its class, nothing half-written."""

from __future__ import annotations

import gzip
import io
import json
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import lz4.frame
import numpy as np
import pytest
import zstandard
from mcap.records import Chunk

from acquire.importing.importer import import_recordings
from acquire.log.chunk import Channel, Schema, encoded
from acquire.log.reader import LogReader
from acquire.log.writer import LogWriter
from photocal.base.errors import InputMalformedError

Acquire = Callable[..., subprocess.CompletedProcess[str]]


def raw_frames(path: Path) -> list[bytes]:
    reader = LogReader(path)
    return [
        payload
        for chunk in reader.chunks()
        for part in chunk
        if part.channel.topic.endswith("/raw")
        for payload in part.payloads
    ]


@pytest.mark.parametrize(
    ("content", "code", "word"),
    [
        (b"", 3, "empty"),
        (b"no recording at all\n" * 50, 4, "no complete MAVLink record"),
        (gzip.compress(b"\0" * 5000, mtime=0), 4, "no complete MAVLink record"),
        (b"\x1f\x8b\x08\0\0\0\0\0\0\0garbage and more garbage", 4, "gzip"),
    ],
)
def test_content_that_is_no_recording(
    content: bytes, code: int, word: str, acquire: Acquire, tmp_path: Path
) -> None:
    source = tmp_path / "recording.tlog"
    source.write_bytes(content)
    done = acquire("import", source, "-o", tmp_path / "out.mcap")
    assert done.returncode == code
    assert done.stderr.count("\n") == 1
    assert word in done.stderr
    assert "recording.tlog" in done.stderr
    assert [p.name for p in tmp_path.iterdir()] == ["recording.tlog"]


@pytest.mark.parametrize(
    ("arguments", "code", "word"),
    [
        (["{here}", "-o", "{here}/out.mcap"], 3, "folder"),
        (["{here}/missing.ubx", "-o", "{here}/out.mcap"], 3, "cannot be read"),
        (["{here}/good.tlog", "-o", "{here}/"], 8, "folder"),
        (["-o", "{here}/out.mcap"], 5, "no recording"),
        (["--link", "rover", "-o", "{here}/out.mcap"], 5, "NAME=FILE"),
        (["--link", "a/b={here}/good.tlog", "-o", "{here}/out.mcap"], 5, "NAME=FILE"),
        (["{here}/good.tlog", "{here}/good.tlog", "-o", "{here}/out.mcap"], 5, "two recordings"),
        (
            ["--link", "a={here}/good.tlog", "--link", "b={here}/good.tlog", "-o", "{here}/out.mcap"],
            5,
            "is named twice",
        ),
    ],
)
def test_arguments_that_cannot_be_meant(
    arguments: list[str], code: int, word: str, acquire: Acquire, tmp_path: Path, demo_flight: bytes
) -> None:
    (tmp_path / "good.tlog").write_bytes(demo_flight)
    done = acquire("import", *(a.format(here=tmp_path) for a in arguments))
    assert done.returncode == code, done.stderr
    assert done.stderr.count("\n") == 1
    assert word in done.stderr
    assert [p.name for p in tmp_path.iterdir()] == ["good.tlog"]


def test_a_recording_cut_at_any_byte_is_imported_to_its_last_whole_frame(
    tmp_path: Path, demo_flight: bytes
) -> None:
    source, log = tmp_path / "cut.tlog", tmp_path / "cut.mcap"
    whole, at = [], 0
    while at < 200:
        size = 8 + demo_flight[at + 9] + 12
        whole.append((at + size, demo_flight[at + 8 : at + size]))
        at += size
    for end in range(1, at + 1):
        source.write_bytes(demo_flight[:end])
        expected = [frame for last, frame in whole if last <= end]
        if not expected:
            with pytest.raises(InputMalformedError):
                import_recordings([], [source], log, lambda _: None)
            continue
        (result,) = import_recordings([], [source], log, lambda _: None)
        assert raw_frames(log) == expected
        assert result.cut == end - max(last for last, _ in whole if last <= end)
        assert result.tally.damage_bytes == result.cut


def test_a_cut_recording_says_so(acquire: Acquire, tmp_path: Path, demo_flight: bytes) -> None:
    source = tmp_path / "cut.tlog"
    source.write_bytes(demo_flight[:1000])
    done = acquire("import", source, "-o", tmp_path / "cut.mcap")
    assert done.returncode == 0
    assert "ends in the middle of a frame" in done.stdout
    packed = tmp_path / "cut.tlog.gz"
    packed.write_bytes(gzip.compress(demo_flight)[:-300])
    done = acquire("import", packed, "-o", tmp_path / "packed.mcap", "--json")
    assert done.returncode == 0
    (link,) = json.loads(done.stdout)["links"]
    assert link["packing_cut"]
    assert link["frames"] > 100


def test_a_stream_without_a_date_is_refused(acquire: Acquire, tmp_path: Path) -> None:
    from drivers import nmea

    source = tmp_path / "rover.nmea"
    source.write_bytes(nmea.encode("GPGGA,120000.00,4730.0,N,00830.0,E,1,08,1.0,400.0,M,47.0,M,,") * 3)
    done = acquire("import", source, "-o", tmp_path / "out.mcap")
    assert done.returncode == 4
    assert "date" in done.stderr


@pytest.mark.parametrize("command", ["import", "export", "recover"])
def test_no_command_writes_over_a_file(
    acquire: Acquire, tmp_path: Path, demo_flight: bytes, command: str
) -> None:
    given, log = tmp_path / "given.tlog", tmp_path / "flight.mcap"
    given.write_bytes(demo_flight)
    if command != "import":
        assert acquire("import", given, "-o", tmp_path / "given.mcap").returncode == 0
        given = tmp_path / "given.mcap"
    log.write_bytes(b"precious")
    done = acquire(command, given, "-o", log)
    assert (done.returncode, done.stderr.count("\n")) == (5, 1)
    assert "exists" in done.stderr
    assert log.read_bytes() == b"precious"


@pytest.mark.parametrize("command", [[], ["import"], ["record"], ["replay"], ["info"], ["recover"]])
def test_help_imports_nothing_heavy(command: list[str]) -> None:
    """Help answers at once because nothing that is slow to import is imported for it."""
    script = (
        "import sys\n"
        "from acquire.commands.cli import app\n"
        "try:\n    app(sys.argv[1:])\nexcept SystemExit as end:\n    assert not end.code\n"
        "heavy = {'numpy', 'pyarrow', 'pymavlink', 'matplotlib', 'numba', 'rich', 'serial'}\n"
        "print('imported:', sorted(heavy & set(sys.modules)))\n"
    )
    done = subprocess.run(
        [sys.executable, "-c", script, *command, "--help"], capture_output=True, text=True, check=False
    )
    assert done.stdout.endswith("imported: []\n"), done.stdout + done.stderr


def _log_with_chunk(path: Path, compression: str, packed: bytes, size: int) -> None:
    stream = io.BytesIO()
    LogWriter(stream)
    chunk = encoded(Chunk(compression, packed, 1, 1, 0, size))
    path.write_bytes(stream.getvalue() + chunk)


def _zstd_bomb(frames: int, megabytes: int) -> bytes:
    packer = zstandard.ZstdCompressor(write_content_size=False)
    one = packer.compress(bytes(megabytes << 20))
    return one * frames


BOMBS: dict[str, Callable[[], tuple[str, bytes, int]]] = {
    "zstd, one frame": lambda: ("zstd", _zstd_bomb(1, 256), 1000),
    "zstd, many frames": lambda: ("zstd", _zstd_bomb(4096, 1), 1000),
    "zstd that says so": lambda: ("zstd", _zstd_bomb(4096, 1), 1 << 32),
    "lz4": lambda: ("lz4", lz4.frame.compress(bytes(256 << 20)), 1000),
    "lz4 that says so": lambda: ("lz4", lz4.frame.compress(bytes(1 << 20)), 1 << 40),
}


@pytest.mark.parametrize("name", BOMBS)
def test_what_unpacks_to_gigabytes_is_refused_in_little_memory(name: str, tmp_path: Path) -> None:
    log = tmp_path / "bomb.mcap"
    _log_with_chunk(log, *BOMBS[name]())
    code = (
        "import sys\nfrom acquire.commands.cli import main\n"
        f"sys.argv = ['acquire', 'info', {str(log)!r}]\n"
        "try:\n    main()\nexcept SystemExit as end:\n"
        "    lines = open('/proc/self/status').read().splitlines()\n"
        "    print(end.code, next(line.split()[1] for line in lines if line.startswith('VmHWM')))\n"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    exit_code, memory_kb = map(int, done.stdout.split())
    assert exit_code == 4
    assert "cannot be unpacked" in done.stderr
    assert memory_kb < 300_000


def test_texts_of_a_log_do_not_steer_the_terminal(acquire: Acquire, tmp_path: Path) -> None:
    log = tmp_path / "escape.mcap"
    one = np.array([1], np.int64)
    with log.open("wb") as stream:
        writer = LogWriter(stream)
        writer.messages(Channel("evil\x1b[2J", "\x1b]0;x\x07"), [b"x"], one, one, one)
        writer.messages(Channel("bare", "nmea"), [b"$GPGGA,1*5B\r\n"], one, one, one)
        writer.close()
    done = acquire("info", log)
    assert done.returncode == 0, done.stderr
    assert "\x1b" not in done.stdout
    assert "evil·[2J" in done.stdout


def test_a_status_that_nests_without_end_is_no_traceback(acquire: Acquire, tmp_path: Path) -> None:
    log = tmp_path / "deep.mcap"
    one = np.array([1], np.int64)
    schema = Schema("photocal.GnssStatus", "jsonschema", b"{}")
    with log.open("wb") as stream:
        writer = LogWriter(stream)
        writer.messages(Channel("/gnss/a/status", "json", schema), [b"[" * 200_000], one, one, one)
        writer.close()
    done = acquire("info", log)
    assert done.returncode == 4
    assert "is not JSON" in done.stderr
