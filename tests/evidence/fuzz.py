"""Study: a million damaged frames through every framer and decoder.

Writes `docs/evidence/fuzz.md`. Streams alternate damaged frames with intact ones that carry a number, and
come in pieces of random length. Every byte must come out once, every intact frame must be found, nothing may
raise, hang or keep memory. An intact frame may only be missing where a damaged one became a frame that agrees
with its own checksum and reaches over it: such accidents are tested with the checksums of other programs.

Run: `make evidence`, or `python -m tests.evidence.fuzz [FRAMES]`.
"""

from __future__ import annotations

import resource
import struct
import sys
import time
import warnings
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from acquire.channels.decoded import Decoder
from acquire.channels.log_decoder import dataflash_decoder, event_list_decoder, ulog_decoder
from acquire.channels.receiver import ReceiverDecoder
from acquire.channels.vehicle import VehicleDecoder
from drivers import nmea, rtcm3, ubx
from drivers.dataflash import DataflashFramer
from drivers.frames import GNSS, Batch, Framer, StreamFramer, Wire
from drivers.mavlink.decode import encode as encode_mavlink
from drivers.mavlink.dialect import ardupilotmega
from drivers.mrk import MrkFramer
from drivers.tlog import TlogFramer
from drivers.ubx import decode as ubx_decode
from drivers.ulog import UlogFramer
from tests.drivers.conftest import _nmea, _rtcm3, _ubx

FRAMES = 1_000_000
PER_STREAM = 200
OUTPUT = Path(__file__).parents[2] / "docs" / "evidence" / "fuzz.md"
DIALECT = ardupilotmega()
DECODED = (0x0102, 0x0107, 0x0114, 0x0120, 0x0121, 0x013B, 0x0213, 0x0215, 0x0D03)
MESSAGES = (
    "HEARTBEAT", "ATTITUDE", "GPS_RAW_INT", "SYSTEM_TIME", "CAMERA_FEEDBACK", "STATUSTEXT", "TIMESYNC",
    "GLOBAL_POSITION_INT", "CAMERA_TRIGGER", "SYS_STATUS",
)  # fmt: skip
BOOT_NS = 1_700_000_000 * 10**9
Chance = np.random.Generator


@dataclass(frozen=True)
class Target:
    """What is fuzzed: frames of a stream, the numbered intact ones, what finds and what decodes them."""

    name: str
    framer: Callable[[], Framer]
    decoders: Callable[[], Sequence[Decoder]]
    frame: Callable[[Chance], bytes]
    numbered: Callable[[int], bytes]
    head: bytes = b""


@dataclass
class Tally:
    """What became of a target."""

    damaged: int = 0
    intact: int = 0
    lost: int = 0
    accidents: int = 0
    size: int = 0
    slowest_s: float = 0.0
    memory_mb: list[float] = field(default_factory=list)


def _some(chance: Chance, longest: int) -> bytes:
    return chance.bytes(int(chance.integers(0, longest)))


def _gnss(chance: Chance) -> bytes:
    which = int(chance.integers(0, 4))
    if which == 0:
        kind = int(chance.choice(DECODED))
        return ubx.encode(kind, chance.bytes(ubx_decode.layout(kind).itemsize + int(chance.integers(-3, 40))))
    if which == 1:
        return ubx.encode(int(chance.integers(0, 1 << 16)), _some(chance, 120))
    if which == 2:
        number = int(chance.choice([1005, 1006, 1013, 1077, 1087, 1230]))
        return rtcm3.encode(struct.pack(">H", number << 4) + _some(chance, 120))
    fields = ",".join(chance.choice(["", "120000.00", "4730.1", "N", "E", "1", "99", "-1e9", "A"], 14))
    return nmea.encode(str(chance.choice(["GPGGA,", "GNRMC,", "GPZDA,", "PUBX,00,"])) + fields)


def _mavlink(chance: Chance) -> bytes:
    kind = DIALECT.number(str(chance.choice(MESSAGES)))
    layout = DIALECT.layout(kind)
    values = np.frombuffer(chance.bytes(layout.itemsize), layout)[0]
    named = {name: values[name] for name in layout.names or () if layout[name].kind in "iu"}
    return encode_mavlink(
        DIALECT,
        kind,
        {n: int(v) for n, v in named.items() if np.ndim(v) == 0},
        sequence=0,
        system=1,
        component=1,
    )


def _mavlink_numbered(number: int) -> bytes:
    values = {"tc1": number, "ts1": number}
    return encode_mavlink(DIALECT, DIALECT.number("TIMESYNC"), values, sequence=number, system=1, component=1)


def _stamped(frame: bytes) -> bytes:
    return (1_700_000_000_000_000).to_bytes(8, "big") + frame


def _dataflash_definitions() -> bytes:
    found = b""
    for kind, name, form, columns in (
        (10, "GPS", "QBIHBcLLf", "TimeUS,Status,GMS,GWk,NSats,HDop,Lat,Lng,Alt"),
        (11, "ATT", "QccC", "TimeUS,Roll,Pitch,Yaw"),
        (12, "CAM", "QIHLLffff", "TimeUS,GPSTime,GPSWeek,Lat,Lng,Alt,Roll,Pitch,Yaw"),
    ):
        sizes = {"Q": 8, "I": 4, "H": 2, "B": 1, "L": 4, "f": 4, "c": 2, "C": 2}
        size = 3 + sum(sizes[letter] for letter in form)
        body = struct.pack("<BB4s16s64s", kind, size, name.encode(), form.encode(), columns.encode())
        found += b"\xa3\x95\x80" + body
    return found


_DATAFLASH_SIZES = {10: 33 - 3 + 1, 11: 14, 12: 38}


def _without(data: bytes, first: int) -> bytes:
    return data.replace(bytes([first]), bytes([first ^ 1]))


def _dataflash(chance: Chance) -> bytes:
    kind = int(chance.choice(list(_DATAFLASH_SIZES)))
    return b"\xa3\x95" + bytes([kind]) + _without(chance.bytes(_DATAFLASH_SIZES[kind]), 0xA3)


def _dataflash_numbered(number: int) -> bytes:
    return b"\xa3\x95\x0b" + _without(struct.pack("<Qhhh", number << 8, 1, 2, 3), 0xA3)


def _ulog_record(kind: str, payload: bytes) -> bytes:
    return struct.pack("<HB", len(payload), ord(kind)) + payload


_ULOG_HEAD = (
    b"ULog\x01\x12\x35\x01" + bytes(8)
    + _ulog_record("F", b"vehicle_attitude:uint64_t timestamp;float[4] q;")
    + _ulog_record("F", b"camera_capture:uint64_t timestamp;uint64_t timestamp_utc;uint32_t seq;")
    + _ulog_record("A", b"\0\x01\0vehicle_attitude") + _ulog_record("A", b"\0\x02\0camera_capture")
)  # fmt: skip


def _ulog(chance: Chance) -> bytes:
    which = int(chance.integers(0, 3))
    if which == 2:
        return _ulog_record("L", b"4" + chance.bytes(8) + b"text " * int(chance.integers(1, 9)))
    return _ulog_record("D", bytes([which + 1, 0]) + chance.bytes((24, 20)[which]))


def _ulog_numbered(number: int) -> bytes:
    return _ulog_record("D", b"\x01\0" + struct.pack("<Qffff", number, 1, 0, 0, 0))


def _event(number: int) -> bytes:
    place = "47.6436873208,Lat\t16.4759271684,Lon\t512.998,Ellh\t0.014391, 0.013698, 0.029694\t50,Q\n"
    return f"{number}\t296288.242869\t[2211]\t     3,N\t     0,E\t    75,V\t{place}".encode()


TARGETS = (
    Target("GNSS stream (UBX, RTCM 3, NMEA)", lambda: StreamFramer(GNSS),
           lambda: [ReceiverDecoder("rover").feed],
           _gnss, lambda n: ubx.encode(0x0213, struct.pack("<Q", n))),
    Target("all four protocols on one stream", lambda: StreamFramer((Wire.MAVLINK, *GNSS)),
           lambda: [ReceiverDecoder("x").feed, VehicleDecoder("x", DIALECT).feed],
           lambda c: _gnss(c) if c.integers(0, 2) else _mavlink(c),
           lambda n: rtcm3.encode(b"\x43\x50" + struct.pack("<Q", n)) if n % 2 else _mavlink_numbered(n)),
    Target("MAVLink stream", lambda: StreamFramer((Wire.MAVLINK,)),
           lambda: [VehicleDecoder("v", DIALECT).feed],
           _mavlink, _mavlink_numbered),
    Target("telemetry log", TlogFramer, lambda: [VehicleDecoder("v", DIALECT).feed],
           lambda c: _stamped(_mavlink(c)), lambda n: _stamped(_mavlink_numbered(n))),
    Target("DataFlash log", DataflashFramer, lambda: [dataflash_decoder("v", BOOT_NS)], _dataflash,
           _dataflash_numbered, _dataflash_definitions()),
    Target("PX4 log", UlogFramer, lambda: [ulog_decoder("v", BOOT_NS)], _ulog, _ulog_numbered, _ULOG_HEAD),
    Target("event list", MrkFramer, lambda: [event_list_decoder("c")],
           lambda c: _event(int(c.integers(0, 999))), lambda n: b"\n" + _event(n)),
)  # fmt: skip


def harmed(frame: bytes, chance: Chance) -> bytes:
    """Return a frame with one to three harms: bits, bytes taken out, put in, doubled, lengths, ends."""
    data = bytearray(frame)
    for _ in range(int(chance.integers(1, 4))):
        if not data:
            break
        at, kind = int(chance.integers(0, len(data))), int(chance.integers(0, 6))
        if kind == 0:
            data[at] ^= 1 << int(chance.integers(0, 8))
        elif kind == 1:
            del data[at : at + int(chance.integers(1, 8))]
        elif kind == 2:
            data[at:at] = chance.bytes(int(chance.integers(1, 8)))
        elif kind == 3:
            data[at:at] = data[at : at + int(chance.integers(1, 30))]
        elif kind == 4:
            place = int(chance.integers(0, min(6, len(data))))
            data[place] = int(chance.integers(0, 256))
        else:
            del data[at:]
    return bytes(data)


def stream(target: Target, chance: Chance, first: int) -> tuple[bytes, list[bytes]]:
    """Return a stream and its intact frames."""
    intact = [target.numbered(first + n) for n in range(2 * PER_STREAM)]
    # Logs without a checksum tell an intact record by what follows it: so two in a row.
    parts = [
        harmed(target.frame(chance), chance) + intact[2 * n] + intact[2 * n + 1] for n in range(PER_STREAM)
    ]
    return target.head + b"".join(parts), intact


def run_one(target: Target, chance: Chance, first: int, tally: Tally) -> None:
    """Put one stream through a target."""
    data, intact = stream(target, chance, first)
    framer, decoders = target.framer(), target.decoders()
    begun = time.perf_counter()
    found: list[Batch] = []
    at = 0
    while at < len(data):
        size = int(chance.integers(1, 8000))
        found.append(framer.feed(data[at : at + size]))
        at += size
    found.append(framer.close())
    for batch in found:
        log_ns = np.full(len(batch), BOOT_NS, np.int64)
        for decoder in decoders:
            decoder(batch, log_ns)
    tally.slowest_s = max(tally.slowest_s, time.perf_counter() - begun)
    tally.damaged += PER_STREAM
    tally.intact += len(intact)
    tally.size += len(data)
    frames = [(f.offset, f.data) for batch in found for f in batch]
    out = sorted(frames + [lost for batch in found for lost in batch.damaged()])
    assert _whole(out, data, framer.stamped), f"{target.name}: bytes lost"
    there = {frame for _, frame in frames}
    for frame in (frame[8:] if framer.stamped else frame for frame in intact):
        if frame.strip() not in there and frame not in there and frame.lstrip() not in there:
            swallowed = _swallowed(frames, data.find(frame), framer)
            tally.accidents += swallowed
            tally.lost += not swallowed


def _whole(out: list[tuple[int, bytes]], data: bytes, stamped: bool) -> bool:
    if not stamped:
        return b"".join(piece for _, piece in out) == data
    # Of telemetry logs the stamps before the frames are taken for times.
    end = 0
    for offset, piece in out:
        if offset - end not in (0, 8) or data[offset : offset + len(piece)] != piece:
            return False
        end = offset + len(piece)
    return end == len(data)


def _swallowed(frames: list[tuple[int, bytes]], at: int, framer: Framer) -> bool:
    """Tell whether an intact frame lies in one that agrees with its own checksum, or has none."""
    cover = next((piece for offset, piece in frames if offset <= at < offset + len(piece)), b"")
    if isinstance(framer, DataflashFramer | UlogFramer):
        return bool(cover)
    if cover[:1] in (b"\xfe", b"\xfd"):
        return True  # of a message that is in no table: its checksum depends on a byte that nobody knows
    return any(test(cover, 0) == len(cover) for test in (_ubx, _rtcm3, _nmea) if cover)


def resident_mb() -> float:
    """Return the memory that is in use now."""
    pages = int(Path("/proc/self/statm").read_text(encoding="ascii").split()[1])
    return pages * resource.getpagesize() / 1e6


def main() -> None:
    """Run the study and write its table."""
    warnings.simplefilter("error")
    frames = int(sys.argv[1]) if len(sys.argv) > 1 else FRAMES
    streams = -(-frames // (PER_STREAM * len(TARGETS)))
    rows = []
    total = 0
    for number, target in enumerate(TARGETS):
        tally, chance = Tally(), np.random.default_rng(number)
        for turn in range(streams):
            run_one(target, chance, 2 * PER_STREAM * turn, tally)
            if turn % max(1, streams // 10) == 0:
                tally.memory_mb.append(resident_mb())
        total += tally.damaged
        memory: NDArray[np.float64] = np.array(tally.memory_mb[1:] or tally.memory_mb)
        rows.append(
            f"| {target.name} | {tally.damaged:,} | {tally.intact:,} | {tally.size / 1e6:.0f} MB | "
            f"{tally.lost} | {tally.accidents} | {tally.slowest_s:.2f} s | "
            f"{memory[0]:.0f} to {memory.max():.0f} MB |"
        )
        sys.stderr.write(rows[-1] + "\n")
    lines = [
        "# A million damaged frames",
        "",
        f"{total:,} damaged frames (bits flipped; bytes removed, inserted or doubled; lengths changed;",
        f"ends cut off), {PER_STREAM} to a stream, each followed by two intact, numbered ones. The streams",
        "arrive in pieces of random length and go through framer and decoders, with warnings as errors.",
        "Required: no exception, no hang, constant memory, and no valid frame after the damage lost. Every",
        "byte came out once, in a frame or as damage. `covered`: intact frames inside a damaged one that",
        "happens to agree with its own checksum (verified by pyubx2, pyrtcm and pynmeagps), or whose",
        "format has none.",
        "",
        "| | damaged | intact | bytes | lost | covered | slowest stream | memory |",
        "|---|---|---|---|---|---|---|---|",
        *rows,
        "",
        "Made by `python -m tests.evidence.fuzz`.",
        "",
    ]
    OUTPUT.write_text("\n".join(lines), encoding="utf-8")


if __name__ == "__main__":
    main()
