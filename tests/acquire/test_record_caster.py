"""A caster of virtual reference stations is told where the rover is."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest
from pynmeagps import NMEAReader

from acquire.recording.caster_position import CasterPosition
from acquire.simulate.receiver import Receiver
from drivers import nmea
from drivers.framing import GNSS, StreamFramer
from drivers.mavlink.dialect import ardupilotmega
from tests.acquire.scripted import Script, configured, messages, run


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


@pytest.mark.parametrize(
    ("sentence", "kept"),
    [
        (nmea.encode("GNGGA,120000.00,4730.0,N,00830.0,E,1,08,1.0,400.0,M,47.0,M,,"), True),
        (nmea.encode("GNGGA,120000.00,,,,,0,00,99.9,,M,,M,,"), False),
    ],
)
def test_sentences_of_a_receiver_go_to_the_caster_as_they_are(sentence: bytes, kept: bool) -> None:
    position = CasterPosition(ardupilotmega(), 10.0)
    position.hear(StreamFramer(GNSS).feed(sentence), 0)
    assert position.due(5.0) == ((sentence,) if kept else ())
    assert position.due(14.9) == ()
    assert position.due(15.1) == ((sentence,) if kept else ())
