"""Import of a telemetry log against pymavlink's mavlogdump, RXM-RAWX against pyubx2."""

from __future__ import annotations

import gzip
import os
import subprocess
import sys
import time
from pathlib import Path
from typing import Any

import pytest
from pyubx2 import UBXReader

from drivers.frames import StreamFramer, Wire
from drivers.ubx.decode import RXM_RAWX, decode_rawx
from tests.drivers.test_framing import ALL, DECEIVING

pytestmark = [pytest.mark.shared, pytest.mark.benchmark(group="acquire")]


def test_import_against_mavlogdump(
    shared: Path, tmp_path: Path, benchmark: Any, capsys: pytest.CaptureFixture[str]
) -> None:
    """Both as a person runs them, whole processes compiled once; the best of five each, by turns."""
    flight = shared / "data/mavlink-tlog-dronekit/flight.tlog"
    log = tmp_path / "flight.mcap"
    ours = [sys.executable, "-m", "acquire", "import", str(flight), "-o", str(log)]
    dump = [sys.executable, str(Path(sys.executable).parent / "mavlogdump.py"), str(flight)]

    # An installed program has its bytecode, whatever this environment says about that.
    environment = {name: value for name, value in os.environ.items() if not name.startswith("PYTHON")}
    environment["PYTHONPYCACHEPREFIX"] = str(tmp_path / "bytecode")

    def run(command: list[str]) -> float:
        # A log that is there is not overwritten.
        log.unlink(missing_ok=True)
        start = time.perf_counter()
        subprocess.run(command, check=True, stdout=subprocess.DEVNULL, env=environment)
        return time.perf_counter() - start

    run(ours)
    others = [run(dump)]
    # What the others do in between keeps a busy machine from favouring either.
    benchmark.pedantic(lambda: run(ours), setup=lambda: others.append(run(dump)), rounds=5)
    theirs, best = min(others), benchmark.stats.stats.min
    benchmark.extra_info.update(mavlogdump_s=theirs, times_as_fast=theirs / best)
    with capsys.disabled():
        sys.stderr.write(
            f"\nimport {best:.3f} s, mavlogdump {theirs:.3f} s: {theirs / best:.1f} times as fast\n"
        )
    assert log.stat().st_size > flight.stat().st_size / 2


def test_raw_observations_against_pyubx2(
    shared: Path, benchmark: Any, capsys: pytest.CaptureFixture[str]
) -> None:
    """Bytes of RXM-RAWX frames to the times of their epochs, framing and checksums included."""
    path = shared / "data/gnss-ubx-m8p-base-rover/rover-20181009-1221.ubx.gz"
    everything = StreamFramer((Wire.UBX,)).feed(gzip.decompress(path.read_bytes()))
    frames = [everything.frame(i).data for i in everything.where(Wire.UBX, RXM_RAWX).tolist()]
    stream = b"".join(frames)

    def decode() -> int:
        return len(decode_rawx(StreamFramer((Wire.UBX,)).feed(stream)))

    assert benchmark(decode) == len(frames)
    start = time.perf_counter()
    for frame in frames[:300]:
        UBXReader.parse(frame)
    theirs = 300 / (time.perf_counter() - start)
    rate = len(frames) / benchmark.stats.stats.min
    benchmark.extra_info.update(messages_per_s=rate, pyubx2_per_s=theirs)
    with capsys.disabled():
        sys.stderr.write(f"\nRXM-RAWX {rate:,.0f}/s, pyubx2 {theirs:,.0f}/s\n")


@pytest.mark.parametrize("pattern", DECEIVING)
def test_streams_made_to_deceive(pattern: bytes, benchmark: Any, capsys: pytest.CaptureFixture[str]) -> None:
    """Search of bytes each of which begins a frame; asked are 5 MB/s of one thread."""
    piece, framer = (pattern * 65536)[:65536], StreamFramer(ALL)
    framer.feed(piece)
    took_s = list[float]()

    def search() -> None:
        start = time.thread_time()
        framer.feed(piece)
        took_s.append(time.thread_time() - start)

    benchmark(search)
    with capsys.disabled():
        print(f"\n{pattern!r}: {len(piece) / min(took_s) / 1e6:.1f} MB/s")
