"""Streams with several protocols and damage, against a slow scanner and against what was put in."""

from __future__ import annotations

import gzip
import random
from collections import Counter
from collections.abc import Callable
from itertools import pairwise
from pathlib import Path

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from drivers import nmea, rtcm3, ubx
from drivers.checksums import x25
from drivers.frames import GNSS, Batch, Frame, StreamFramer, Wire
from drivers.identify import kind_name
from drivers.mavlink.decode import encode as encode_mavlink
from drivers.mavlink.dialect import ardupilotmega

Scanner = Callable[[bytes], list[tuple[str, int, int]]]
DIALECT = ardupilotmega()


def batches(data: bytes, wires: tuple[Wire, ...] = GNSS, cuts: list[int] | None = None) -> list[Batch]:
    framer = StreamFramer(wires)
    edges = [0, *sorted(cut % (len(data) + 1) for cut in cuts or []), len(data)]
    parts = [framer.feed(data[a:b]) for a, b in pairwise(edges)]
    return [*parts, framer.close()]


def frames(found: list[Batch]) -> list[Frame]:
    return [frame for batch in found for frame in batch]


def assert_every_byte_is_counted(found: list[Batch], data: bytes) -> None:
    pieces = [(f.offset, f.data) for f in frames(found)] + [d for b in found for d in b.damaged()]
    assert b"".join(piece for _, piece in sorted(pieces)) == data


def counts(data: bytes) -> Counter[str]:
    return Counter(kind_name(f.wire, f.kind, f.known, DIALECT) for f in frames(batches(data)))


@pytest.mark.shared
def test_all_small_fixtures_agree_with_the_plain_scanner(shared: Path, scan: Scanner) -> None:
    paths = sorted((shared / "data" / "gnss-stream-fixtures").glob("*.log"))
    assert len(paths) == 22
    for path in paths:
        data = path.read_bytes()
        found = batches(data, cuts=[100, 333])
        assert_every_byte_is_counted(found, data)
        assert [(f.wire.name, f.offset, len(f.data)) for f in frames(found)] == scan(data), path.name


@pytest.mark.shared
def test_large_damaged_streams_agree_with_the_plain_scanner(shared: Path, scan: Scanner) -> None:
    path = shared / "data/gnss-f9p-lossy-ubx-rtcm/20210809-121012-ubx-nmea-data.ubx"
    data = path.read_bytes()[:400_000]
    assert [(f.wire.name, f.offset, len(f.data)) for f in frames(batches(data))] == scan(data)


# The counts of the recordings' own descriptions, made by other programs.
RECORDINGS = {
    "gnss-ubx-m8p-base-rover/rover-20181004-1237.ubx.gz": {
        "RXM-RAWX": 1205, "RXM-SFRBX": 7341, "TIM-TM2": 7, "GGA": 1204,
    },
    "gnss-ubx-m8p-base-rover/base-20181004-1236.ubx.gz": {
        "RXM-RAWX": 321, "RXM-SFRBX": 4228, "1005": 648, "1077": 607, "1087": 623, "1230": 685,
    },
    "gnss-ubx-m8p-base-rover/base-20181009-1220.ubx.gz": {"RXM-RAWX": 529, "RXM-SFRBX": 9378, "1005": 1346},
    "gnss-ubx-m8p-base-rover/rover-20181009-1221.ubx.gz": {
        "RXM-RAWX": 2072, "RXM-SFRBX": 11488, "TIM-TM2": 1178,
    },
    "gnss-f9p-lossy-ubx-rtcm/20210809-121012-ubx-nmea-data.ubx": {
        "RXM-RAWX": 132, "RXM-SFRBX": 1937, "NAV-HPPOSLLH": 633, "GGA": 606,
    },
    "gnss-f9p-lossy-ubx-rtcm/20210809-111055-rtcm3-base-corrections.rtcm3": {
        "1077": 867, "1087": 867, "1097": 867, "1127": 867, "1006": 87,
        "1008": 87, "1013": 87, "1033": 87, "1230": 87,
    },
}  # fmt: skip


@pytest.mark.shared
@pytest.mark.parametrize("name", RECORDINGS)
def test_recordings_have_the_counts_of_their_descriptions(shared: Path, name: str) -> None:
    raw = (shared / "data" / name).read_bytes()
    data = gzip.decompress(raw) if name.endswith(".gz") else raw
    found = batches(data, cuts=list(range(0, len(data), 65536)))
    assert_every_byte_is_counted(found, data)
    kinds = Counter(kind_name(f.wire, f.kind, f.known, DIALECT) for f in frames(found))
    expected = RECORDINGS[name]
    assert {kind: kinds[kind] for kind in expected} == expected


def mavlink_frames() -> st.SearchStrategy[bytes]:
    return st.builds(
        lambda message, seed, sequence, system: encode_mavlink(
            DIALECT,
            message,
            {name: seed % 100 for name in DIALECT.layout(message).names or () if name != "text"},
            sequence=sequence,
            system=system,
            component=1,
        ),
        st.sampled_from([0, 1, 24, 30, 33]),
        st.integers(0, 1000),
        st.integers(0, 255),
        st.integers(1, 255),
    )


FRAMES = {
    Wire.UBX: st.builds(ubx.encode, st.integers(0, 0xFFFF), st.binary(max_size=120)),
    Wire.RTCM3: st.binary(min_size=2, max_size=120).map(rtcm3.encode),
    Wire.NMEA: st.text("ABC019,.", max_size=60).map(lambda text: nmea.encode("GPGGA," + text)),
    Wire.MAVLINK: mavlink_frames(),
}
PIECES: st.SearchStrategy[list[tuple[Wire | None, bytes]]] = st.lists(
    st.one_of(
        *(st.tuples(st.just(wire), strategy) for wire, strategy in FRAMES.items()),
        st.tuples(st.none(), st.binary(min_size=1, max_size=60)),
    ),
    max_size=12,
)
ALL = (Wire.MAVLINK, *GNSS)


@settings(max_examples=300)
@given(PIECES, st.lists(st.integers(0, 5000), max_size=6))
def test_frames_between_noise_are_all_found_however_the_stream_is_cut(
    pieces: list[tuple[Wire | None, bytes]], cuts: list[int]
) -> None:
    data = b"".join(piece for _, piece in pieces)
    found = batches(data, ALL, cuts)
    assert_every_byte_is_counted(found, data)
    whole = frames(batches(data, ALL))
    assert [(f.offset, f.data, f.kind, f.known) for f in frames(found)] == [
        (f.offset, f.data, f.kind, f.known) for f in whole
    ]
    put = Counter(piece for wire, piece in pieces if wire is not None)
    assert not put - Counter(f.data for f in whole)


@settings(max_examples=300)
@given(st.sampled_from(ALL), st.data())
def test_damage_costs_no_frame_but_its_own(wire: Wire, draw: st.DataObject) -> None:
    put = draw.draw(st.lists(FRAMES[wire], min_size=3, max_size=8))
    victim = draw.draw(st.integers(0, len(put) - 2))
    place = draw.draw(st.integers(0, len(put[victim]) - 1))
    broken = bytearray(put[victim])
    kind = draw.draw(st.sampled_from(["flip", "drop", "insert"]))
    if kind == "flip":
        broken[place] ^= draw.draw(st.integers(1, 255))
    elif kind == "drop":
        del broken[place:]
    else:
        broken[place:place] = draw.draw(st.binary(min_size=1, max_size=30))
    data = b"".join([*put[:victim], bytes(broken), *put[victim + 1 :]])
    found = batches(data, (wire,))
    assert_every_byte_is_counted(found, data)
    expected = Counter([*put[:victim], *put[victim + 1 :]])
    assert not expected - Counter(f.data for f in frames(found) if f.known)


@settings(max_examples=300)
@given(st.binary(max_size=2000), st.lists(st.integers(0, 2000), max_size=4))
def test_noise_is_never_an_error(data: bytes, cuts: list[int]) -> None:
    assert_every_byte_is_counted(batches(data, ALL, cuts), data)


def test_a_damaged_length_holds_back_no_more_than_the_longest_message() -> None:
    lying = b"\xb5\x62\x02\x15" + (9000).to_bytes(2, "little")
    good = ubx.encode(0x0107, bytes(92))
    framer = StreamFramer(GNSS)
    assert [f.data for f in framer.feed(lying + good)] == [good]


def test_the_end_of_a_recording_inside_a_frame_is_told() -> None:
    frame = ubx.encode(0x0107, bytes(92))
    framer = StreamFramer(GNSS)
    assert len(framer.feed(frame + frame[:50])) == 1
    rest = framer.close()
    assert framer.cut == 50
    assert rest.damage.tolist() == [[len(frame), 50]]


# Each place of these begins a frame whose checksum must be tested, or makes all that follows be looked at.
DECEIVING = (b"\xd3\x03\xff", b"\xfd\xff", b"\xfd", b"\xfe", b"\xfe\x00", b"$A", b"\xb5\x62\x00\x00\x00\x20")


@pytest.mark.parametrize("pattern", DECEIVING)
def test_streams_made_to_deceive_are_searched_to_their_end(pattern: bytes) -> None:
    """A search that looked at what follows from each place again would take hours for these."""
    data = (pattern * 2**21)[: 2**21]
    assert_every_byte_is_counted(batches(data, ALL, list(range(2**16, 2**21, 2**16))), data)


def test_plain_and_compiled_search_find_the_same() -> None:
    chance = random.Random(3)  # noqa: S311 - no secrets
    letters = b"\xfe\xfd\xb5\x62\xd3\x00\x03$GP*\r\n\x01\x09"
    noise = bytes(chance.choice(letters) for _ in range(4000))
    data = b"".join([noise[:2000], ubx.encode(0x0107, bytes(92)), noise[2000:], nmea.encode("GPGGA,1")])
    pieces = [frames(batches(data, ALL, cuts)) for cuts in ([], list(range(0, len(data), 500)))]
    assert pieces[0] == pieces[1]
    assert len(pieces[0]) >= 2


def test_a_flood_of_ever_new_unknown_messages_fills_no_memory() -> None:
    known = set(DIALECT.seeds)
    framer = StreamFramer((Wire.MAVLINK,))
    before = framer._memory.nbytes
    unknown = [kind for kind in range(100_000, 160_000) if kind not in known]
    stream = []
    for kind in unknown:
        body = bytes((0, 0, 0, 0, 1, 1)) + kind.to_bytes(3, "little")
        stream.append(b"\xfd" + body + x25(body, 7).to_bytes(2, "little"))
    found = framer.feed(b"".join(stream))
    assert not found.known.any()
    assert len(found) > 0.99 * len(unknown)
    assert framer._memory.nbytes == before
