"""Decoded channels: the same however the frames came, and right where sources mix."""

from __future__ import annotations

import gzip
import json
from collections import defaultdict
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from acquire.channels.decoded import Decoder
from acquire.channels.receiver import ReceiverClock, ReceiverDecoder
from acquire.channels.vehicle import VehicleDecoder
from acquire.log.chunk import Channel
from drivers import nmea
from drivers.frames import GNSS, Batch, Framer, StreamFramer, Wire
from drivers.mavlink.decode import encode
from drivers.mavlink.dialect import ardupilotmega
from drivers.tlog import TlogFramer
from tests.telemetry import SYSTEM, telemetry_log

DIALECT = ardupilotmega()
DEMO = telemetry_log(DIALECT)
Content = dict[Channel, list[tuple[bytes, int]]]


def decode(framer: Framer, decoder: Decoder, data: bytes, cuts: list[int]) -> tuple[Content, list[int]]:
    edges = [0, *sorted(cut % (len(data) + 1) for cut in cuts), len(data)]
    content: Content = defaultdict(list)
    published: list[int] = []

    def take(batch: Batch) -> None:
        log_ns = batch.host_ns if batch.host_ns is not None else np.full(len(batch), 5 * 10**17)
        publish, made = decoder(batch, log_ns)
        published.extend(publish.tolist())
        for part in made:
            content[part.channel] += zip(part.payloads, part.publish_ns.tolist(), strict=True)

    for a, b in pairwise(edges):
        take(framer.feed(data[a:b]))
    take(framer.close())
    return {channel: rows for channel, rows in content.items() if rows}, published


@settings(max_examples=40)
@given(st.lists(st.integers(0, len(DEMO)), max_size=10))
def test_vehicle_channels_do_not_depend_on_the_batches(cuts: list[int]) -> None:
    whole = decode(TlogFramer(), VehicleDecoder("vehicle", DIALECT).feed, DEMO, [])
    assert decode(TlogFramer(), VehicleDecoder("vehicle", DIALECT).feed, DEMO, cuts) == whole


@pytest.mark.shared
@pytest.mark.parametrize(
    "name",
    [
        "gnss-f9p-lossy-ubx-rtcm/20210809-121012-ubx-nmea-data.ubx",
        "gnss-ubx-m8p-base-rover/rover-20181009-1221.ubx.gz",
    ],
)
def test_receiver_channels_do_not_depend_on_the_batches(shared: Path, name: str) -> None:
    raw = (shared / "data" / name).read_bytes()
    data = (gzip.decompress(raw) if name.endswith(".gz") else raw)[:120_000]
    whole = decode(StreamFramer(GNSS), ReceiverDecoder("rover").feed, data, [])
    for step in (997, 20_011):
        cuts = list(range(0, len(data), step))
        assert decode(StreamFramer(GNSS), ReceiverDecoder("rover").feed, data, cuts) == whole


def record(time_us: int, name: str, values: dict[str, float], system: int) -> bytes:
    frame = encode(DIALECT, DIALECT.number(name), values, sequence=0, system=system, component=1)
    return time_us.to_bytes(8, "big") + frame


def test_a_second_vehicle_does_not_get_into_the_channel_of_the_first() -> None:
    start = 1_777_626_000_000_000
    data = b"".join(
        record(start + n, "ATTITUDE", {"roll": 0.1 * system}, system) for n in range(4) for system in (1, 2)
    )
    content, _ = decode(TlogFramer(), VehicleDecoder("vehicle", DIALECT).feed, data, [])
    topics = {channel.topic: len(rows) for channel, rows in content.items()}
    assert topics == {"/vehicle/attitude": 4, "/vehicle/attitude/system-2-1": 4}


def test_times_since_boot_become_utc_by_the_system_time_before_them() -> None:
    start = 1_777_626_000_000_000
    data = record(start, "ATTITUDE", {"time_boot_ms": 900}, 1)
    data += record(start, "SYSTEM_TIME", {"time_boot_ms": 1000, "time_unix_usec": start - 250_000}, 1)
    data += record(start, "ATTITUDE", {"time_boot_ms": 1500}, 1)
    data += record(start, "ATTITUDE", {"time_boot_ms": 1500}, 9)
    _, published = decode(TlogFramer(), VehicleDecoder("vehicle", DIALECT).feed, data, [])
    host = start * 1000
    assert published == [host, host - 250_000_000, host + 250_000_000, host]
    assert SYSTEM == 1


def test_exposures_tell_time_and_place() -> None:
    content, _ = decode(TlogFramer(), VehicleDecoder("vehicle", DIALECT).feed, DEMO, [])
    rows = next(rows for channel, rows in content.items() if channel.topic == "/camera/exposure")
    events = [json.loads(payload) for payload, _ in rows]
    assert [event["sequence"] for event in events] == list(range(1, 30))
    # Every 2 s from 09:00:02 UTC on, at 10 m/s to the north: 20 m on a mean sphere of 6371 km.
    assert [event["time"]["sec"] for event in events[:3]] == [1777626002, 1777626004, 1777626006]
    step = events[1]["latitude_deg"] - events[0]["latitude_deg"]
    assert np.radians(step) * 6_371_000 == pytest.approx(20, abs=0.05)


def test_a_sentence_with_a_wrong_date_does_not_move_the_clock() -> None:
    def rmc(time: str, date: str) -> bytes:
        return nmea.encode(f"GNRMC,{time},A,4730.0,N,00830.0,E,0.0,0.0,{date},,,A")

    data = rmc("120000.00", "040525") + rmc("120001.00", "040599") + rmc("120002.00", "040525")
    clock = ReceiverClock()
    framer = StreamFramer((Wire.NMEA,))
    times = clock.feed(framer.feed(data))
    assert ((times - times[0]) // 10**9).tolist() == [0, 0, 2]
    later = rmc("130000.00", "040525") + rmc("130001.00", "040525") + rmc("130002.00", "040525")
    moved = clock.feed(framer.feed(later))
    # A real step is believed once the next message confirms it.
    assert ((moved - times[0]) // 10**9).tolist() == [2, 3601, 3602]
