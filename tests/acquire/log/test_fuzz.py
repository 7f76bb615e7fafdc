"""Damaged and hostile logs through every reader of them: refusals in one line, in bounded memory."""

from __future__ import annotations

import io
import random
import struct
from pathlib import Path

import numpy as np
import pytest

from acquire.channels.layouts import EXPOSURE, GNSS_STATUS
from acquire.channels.summary import summarise
from acquire.importing.recovery import recover
from acquire.log.chunk import ARRIVED_ENCODING, Channel
from acquire.log.reader import LogReader
from acquire.log.replay import links_of
from acquire.log.writer import LogWriter
from acquire.monitor.reducer import state_after
from acquire.monitor.state import RecordingState
from acquire.monitor.view_model import view_of
from drivers import ubx
from drivers.mavlink.decode import encode
from drivers.mavlink.dialect import ardupilotmega
from photocal.base.errors import PhotocalError
from photocal.navigation.events import logged_exposures
from photocal.navigation.flight_log import FlightLog
from photocal.navigation.receiver_recording import read_receivers
from photocal.navigation.vehicle import read_vehicle

CASES = 150
START_NS = 1_777_626_000_000_000_000


def plain_log() -> bytes:
    """Return a small log without compression, so that damage reaches what is in it."""
    dialect = ardupilotmega()
    stream = io.BytesIO()
    writer = LogWriter(stream)
    writer.metadata("site", {"name": "field"})
    exposure = (
        b'{"link":"v","source":"CAM","edge":"feedback","sequence":1,"time":{"sec":1777626000,"nsec":0}}'
    )
    status = b'{"link":"v","source":"NAV-PVT","fix":"3d","satellites":9}'
    beat = encode(dialect, 0, {"type": 2, "autopilot": 3}, sequence=1, system=1, component=1)
    place = encode(dialect, 33, {"lat": 1, "lon": 1}, sequence=2, system=1, component=1)
    messages = [
        (Channel("/v/raw", "mavlink"), beat),
        (Channel("/v/raw", "mavlink"), place),
        (Channel("/r/raw", "ubx"), ubx.encode(0x0215, bytes(16))),
        (Channel("/r/raw", "nmea"), b"$GPGGA,1,2*5C\r\n"),
        (Channel("/r/damage", "octets"), b"noise"),
        (Channel("/r/arrived", ARRIVED_ENCODING, None, {"protocol": "ubx"}), bytes(16) + b"abc"),
        (Channel("/camera/exposure", "json", EXPOSURE.schema()), exposure),
        (Channel("/gnss/v/status", "json", GNSS_STATUS.schema()), status),
    ]
    for number, (channel, payload) in enumerate(messages):
        one = np.array([START_NS + number])
        writer.messages(channel, [payload], one, one, np.array([number]))
    writer.attachment("rig.toml", "application/toml", b"lever = 1\n", START_NS)
    writer.close()
    return stream.getvalue()


def hostile(data: bytes, chance: random.Random) -> bytes:
    """Return a log with some bytes changed, cut out, doubled, or made the largest number."""
    octets = bytearray(data)
    for _ in range(chance.randint(1, 6)):
        place, act = chance.randrange(len(octets)), chance.random()
        if act < 0.4:
            octets[place] = chance.randrange(256)
        elif act < 0.6:
            del octets[place : place + chance.randint(1, 40)]
        elif act < 0.75:
            octets[place:place] = octets[place : place + chance.randint(1, 60)]
        else:
            value = chance.choice([0xFFFFFFFF, 0x7FFFFFFF, 1 << 20, 0])
            form = chance.choice(["<I", "<Q"])
            octets[place : place + struct.calcsize(form)] = struct.pack(form, value)
    return bytes(octets)


@pytest.fixture(scope="module")
def plain() -> bytes:
    import lz4.frame

    # Chunks as other programs write them without compression, with no checksum that would stop the damage.
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("acquire.log.writer.COMPRESSION", "")
        patch.setattr(lz4.frame, "compress", lambda content: content)
        patch.setattr("acquire.log.writer.zlib.crc32", lambda *_: 0)
        return plain_log()


def test_hostile_logs_are_refused_or_read_by_every_reader(plain: bytes, tmp_path: Path) -> None:
    chance = random.Random(11)  # noqa: S311 - no secrets
    log = tmp_path / "log.mcap"
    resource = pytest.importorskip("resource", reason="only POSIX systems tell the memory of a process")
    before_kb = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    refused = 0

    def monitored() -> None:
        state = RecordingState()
        for chunk in LogReader(log).chunks(lambda _: None):
            state = state_after(state, chunk)
        view_of(state).as_json()

    readers = (
        lambda: summarise(log),
        lambda: recover(log, tmp_path / "fixed.mcap"),
        lambda: links_of(log),
        monitored,
        lambda: read_receivers(FlightLog((log,))),
        lambda: read_vehicle(FlightLog((log,))),
        lambda: logged_exposures(FlightLog((log,))),
    )
    for _ in range(CASES):
        log.write_bytes(hostile(plain, chance))
        for read in readers:
            try:
                read()
            except PhotocalError:
                refused += 1
    assert 0 < refused < CASES * len(readers)
    assert resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - before_kb < 300_000
