"""A receiver's protocol from an installed package: one file and one entry point, through all commands."""

from __future__ import annotations

import itertools
import json
import os
import socket
import subprocess
import sys
import time
from pathlib import Path

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from drivers import nmea, ubx
from drivers.checksums import fletcher8
from drivers.frames import GNSS, Framing, StreamFramer, Wire
from tests.drivers import toy_receiver
from tests.drivers.toy_receiver import position, pulse

ROOT = Path(__file__).parents[2]
UTC_NS, GPS_NS = 1_700_000_000 * 10**9, (1_700_000_000 - 315_964_800 + 18) * 10**9
STREAM = b"".join(
    position(UTC_NS + k * 10**9, 50.0 + k * 1e-5, 14.0, 300.0) + pulse(GPS_NS + k * 10**9 + 5, k)
    for k in range(20)
)
TWIN = Wire.named(
    "ubx-by-table",
    framing=Framing(
        start=b"\xb5\x62",
        longest=8200,
        length=lambda data: int.from_bytes(data[4:6], "little") + 8 if len(data) > 5 else -6,
        intact=lambda frame: fletcher8(frame[2:-2]) == frame[-2:],
        kind=lambda frame: frame[2] << 8 | frame[3],
    ),
)
PIECES = st.lists(
    st.one_of(
        st.binary(max_size=20),
        st.builds(ubx.encode, st.integers(0, 0xFFFF), st.binary(max_size=40)),
        st.builds(lambda k, b: ubx.encode(k, b)[:-1], st.integers(0, 0xFFFF), st.binary(max_size=40)),
        st.text("ABC019,.", max_size=20).map(lambda text: nmea.encode("GPGGA," + text)),
    ),
    max_size=12,
)


def framed(wires: tuple[Wire, ...], data: bytes, cuts: list[int]) -> list[tuple[int, int, int]]:
    framer, places = StreamFramer(wires), sorted({0, len(data), *(cut % (len(data) + 1) for cut in cuts)})
    batches = [framer.feed(data[a:b]) for a, b in itertools.pairwise(places)]
    found, covered = [], 0
    for batch in [*batches, framer.close()]:
        covered += int(batch.length.sum() + batch.damage[:, 1].sum())
        rows = zip(batch.start.tolist(), batch.length.tolist(), batch.kind.tolist(), strict=True)
        found += [(batch.base + start, length, kind) for start, length, kind in rows]
    assert covered == len(data)
    return found


@given(pieces=PIECES, cuts=st.lists(st.integers(0, 500), max_size=6))
@settings(max_examples=200, deadline=None)
def test_a_protocol_of_the_table_is_framed_as_the_compiled_one(pieces: list[bytes], cuts: list[int]) -> None:
    data = b"".join(pieces)
    assert framed((TWIN, Wire.NMEA), data, cuts) == framed((Wire.UBX, Wire.NMEA), data, [])


@pytest.mark.shared
def test_a_damaged_recording_is_framed_as_by_the_compiled_search(shared: Path) -> None:
    data = (shared / "data/gnss-f9p-lossy-ubx-rtcm/20210809-121012-ubx-nmea-data.ubx").read_bytes()[:300_000]
    compiled = framed(GNSS, data, [])
    assert len(compiled) > 100
    assert framed((TWIN, Wire.RTCM3, Wire.NMEA), data, [77_777]) == compiled


@pytest.fixture
def installed(tmp_path: Path) -> dict[str, str]:
    """A folder on the path with the package, as pip would leave it."""
    site = tmp_path / "site"
    (site / "toy-1.0.dist-info").mkdir(parents=True)
    (site / "toy_receiver.py").write_text(Path(toy_receiver.__file__).read_text())
    (site / "toy-1.0.dist-info/METADATA").write_text("Metadata-Version: 2.1\nName: toy\nVersion: 1.0\n")
    entry = "[photocal.protocols]\ntoy = toy_receiver:PROTOCOL\n"
    (site / "toy-1.0.dist-info/entry_points.txt").write_text(entry)
    return {**os.environ, "PYTHONPATH": os.pathsep.join((str(site), str(ROOT)))}


def run(environment: dict[str, str], *command: str | Path) -> str:
    made = subprocess.run(
        [sys.executable, *map(str, command)], env=environment, capture_output=True, text=True, timeout=120
    )
    assert made.returncode == 0, made.stderr
    return made.stdout


FLOWN = """
import sys
from pathlib import Path
from drivers.protocols import receiver_wires
from photocal.navigation.exposure_sources import events_of
from photocal.navigation.flight_log import FlightLog
from photocal.navigation.ppk_inputs import Sources
from photocal.navigation.receiver_recording import read_receivers
log = FlightLog((Path(sys.argv[1]),))
toy = receiver_wires()[-1]
print(sum(len(part.payloads) for _, part in log.raw(toy)))
best = events_of(Sources(log), "rising", read_receivers(log), None)
print(best.source, *best.time.ns.tolist())
"""


def test_it_goes_through_import_info_and_the_flight_log(tmp_path: Path, installed: dict[str, str]) -> None:
    recording, log = tmp_path / "rover.toy", tmp_path / "flight.mcap"
    recording.write_bytes(b"noise" + STREAM[:900] + b"!T\x10" + STREAM[900:])
    run(installed, "-m", "acquire", "import", "--link", f"rover={recording}", "-o", log)
    told = json.loads(run(installed, "-m", "acquire", "info", log, "--json"))
    types = {row["type"]: row["frames"] for row in told["links"][0]["types"]}
    topics = {row["topic"]: row["messages"] for row in told["topics"]}
    lost = 40 - sum(types.values())
    assert set(types) == {"TOY-POSITION", "TOY-PULSE"}
    assert lost == 1  # the one that the damage lies in
    assert topics["/camera/exposure"] == types["TOY-PULSE"]
    assert topics["/gnss/rover/fix"] == types["TOY-POSITION"]
    frames, events = run(installed, "-c", FLOWN, log).splitlines()
    assert int(frames) == 39
    *source, first, second = events.split()[: 4 + 2]
    assert " ".join(source) == "TOY-PULSE rising of rover"
    assert [int(first), int(second)] == [GPS_NS + 5, GPS_NS + 10**9 + 5]


def test_it_is_recorded_from_a_port(tmp_path: Path, installed: dict[str, str]) -> None:
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as free:
        free.bind(("127.0.0.1", 0))
        port = free.getsockname()[1]
    configuration = tmp_path / "record.toml"
    configuration.write_text(
        f'[recording]\noutput = "logs"\n[[link]]\nname = "rover"\nprotocol = "toy"\n'
        f'url = "udp://127.0.0.1:{port}"\n'
    )
    command = [sys.executable, "-m", "acquire", "record", str(configuration)]
    with subprocess.Popen(command, env=installed, cwd=tmp_path, stdout=subprocess.DEVNULL) as recorder:
        until, size, empty = time.monotonic() + 60, 0, 0
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as device:
            # A datagram before the port is open is lost: the device goes on until the log has some.
            while size < empty + 2000:
                assert time.monotonic() < until
                device.sendto(STREAM, ("127.0.0.1", port))
                time.sleep(0.5)
                size = max((path.stat().st_size for path in tmp_path.glob("logs/*.mcap")), default=0)
                empty = empty or size
        recorder.terminate()
        recorder.wait(60)
    (log,) = tmp_path.glob("logs/*.mcap")
    told = json.loads(run(installed, "-m", "acquire", "info", log, "--json"))
    types = {row["type"]: row["frames"] for row in told["links"][0]["types"]}
    assert set(types) == {"TOY-POSITION", "TOY-PULSE"}
    assert types["TOY-POSITION"] == types["TOY-PULSE"] >= 20
    topics = {row["topic"]: row["messages"] for row in told["topics"]}
    assert topics["/camera/exposure"] == types["TOY-PULSE"]
