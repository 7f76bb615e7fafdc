"""A caster of virtual reference stations is told where the rover is."""

from __future__ import annotations

import socket
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any

import pytest
from pymavlink.dialects.v20 import ardupilotmega as tables
from pynmeagps import NMEAReader

from acquire.recording.caster_position import CasterPosition, caster_positions
from acquire.recording.configuration import RecordingConfiguration
from acquire.recording.recorder import sources_of
from drivers import nmea, rtcm3
from drivers.frames import GNSS, Batch, StreamFramer, Wire
from drivers.mavlink.dialect import ardupilotmega
from tests.acquire.devices import Receiver
from tests.acquire.live import PATIENCE_S
from tests.acquire.scripted import Script, configured, messages, run

NOON_NS = 1_777_636_800_000_000_000


def framed(data: bytes) -> Batch:
    return StreamFramer((*GNSS, Wire.MAVLINK)).feed(data)


def test_a_caster_is_told_where_the_rover_is(tmp_path: Path) -> None:
    pvt = Receiver(9).due(0.0)
    base = Script([])
    links: list[dict[str, Any]] = [
        {"name": "rover", "protocol": "ubx", "url": "file:x"},
        {
            "name": "base", "protocol": "rtcm3", "url": "ntrip://127.0.0.1/M",
            "position_from": "rover", "position_every_s": 0.1,
        },
    ]  # fmt: skip
    sources = {"rover": Script([pvt]), "base": base}
    done, _ = run(configured(*links), tmp_path, lambda _: len(base.written) >= 3, sources=sources)
    told = NMEAReader.parse(base.written[0])
    assert (told.msgID, told.lat, told.lon, told.alt, told.quality) == ("GGA", 47.5, 8.5, 462.0, 4)
    assert messages(done.paths[0], "/base/sent") == base.written


def test_a_caster_that_waits_for_a_position_gets_it_with_the_request(tmp_path: Path) -> None:
    """Over a real port, from the configuration to the corrections in the log."""
    frame = rtcm3.encode(b"\x43\x50" + bytes(100))

    def serve(server: socket.socket) -> bytes:
        line, _ = server.accept()
        line.settimeout(PATIENCE_S)
        with line:
            asked = b""
            while not asked.endswith(b"\r\n\r\n"):
                asked += line.recv(4096)
            line.sendall(b"HTTP/1.1 200 OK\r\nContent-Type: gnss/data\r\n\r\n")
            line.sendall(frame if b"Ntrip-GGA: $GPGGA," in asked else b"")
            # Until the recorder has gone.
            while line.recv(4096):
                pass
        return asked

    with socket.create_server(("127.0.0.1", 0)) as server, ThreadPoolExecutor(1) as pool:
        server.settimeout(PATIENCE_S)
        served = pool.submit(serve, server)
        caster = {
            "name": "base", "protocol": "rtcm3", "position": [-22.7, -43.2, 30.0],
            "url": f"ntrip://127.0.0.1:{server.getsockname()[1]}/VRS", "corrections_to": ["rover"],
        }  # fmt: skip
        rover = {"name": "rover", "protocol": "ubx", "url": "file:x"}
        listening = Script([])
        settings = configured(caster, rover)
        positions = caster_positions(RecordingConfiguration.model_validate(settings), ardupilotmega())
        told_at_noon = sources_of(RecordingConfiguration.model_validate(settings), positions, lambda: NOON_NS)
        done, _ = run(
            settings,
            tmp_path,
            lambda _: bool(listening.written),
            sources={**told_at_noon, "rover": listening},
        )
        header = next(line for line in served.result().split(b"\r\n") if line.startswith(b"Ntrip-GGA: "))
    told = NMEAReader.parse(header.removeprefix(b"Ntrip-GGA: ") + b"\r\n")
    assert (told.lat, told.lon, told.alt) == (-22.7, -43.2, 30.0)
    assert listening.written == [frame]
    assert messages(done.paths[0], "/base/raw") == [frame]


@pytest.mark.parametrize(
    ("sentence", "kept"),
    [
        (nmea.encode("GNGGA,120000.00,4730.0,N,00830.0,E,1,08,1.0,400.0,M,47.0,M,,"), True),
        (nmea.encode("GNGGA,120000.00,,,,,0,00,99.9,,M,,M,,"), False),
    ],
)
def test_sentences_of_a_receiver_go_to_the_caster_as_they_are(sentence: bytes, kept: bool) -> None:
    position = CasterPosition(ardupilotmega(), 10.0)
    position.hear(framed(sentence))
    assert position.due(5.0, NOON_NS) == ((sentence,) if kept else ())
    assert position.due(14.9, NOON_NS) == ()
    assert position.due(15.1, NOON_NS) == ((sentence,) if kept else ())


def test_a_device_knows_better_than_the_configuration_and_the_time_is_that_of_sending() -> None:
    position = CasterPosition(ardupilotmega(), 10.0, (47.0, 8.0, 400.0))
    given = NMEAReader.parse(position.sentence(NOON_NS))
    assert (given.lat, given.lon, given.alt, given.quality) == (47.0, 8.0, 400.0, 1)
    # Casters refuse a position that was found without satellites.
    assert given.numSV > 3
    mav = tables.MAVLink(None, srcSystem=1, srcComponent=1)
    raw = tables.MAVLink_gps_raw_int_message(0, 6, 475000000, 85000000, 462000, 80, 120, 0, 0, 17).pack(mav)
    position.hear(framed(raw))
    heard = NMEAReader.parse(position.sentence(NOON_NS + 61 * 10**9))
    assert (heard.lat, heard.lon, heard.alt, heard.quality) == (47.5, 8.5, 462.0, 4)
    assert (heard.numSV, heard.HDOP) == (17, 0.8)
    assert heard.time.isoformat() == "12:01:01"
    position.hear(framed(tables.MAVLink_gps_raw_int_message(0, 1, 0, 0, 0, 0, 0, 0, 0, 0).pack(mav)))
    assert NMEAReader.parse(position.sentence(NOON_NS)).lat == 47.5
