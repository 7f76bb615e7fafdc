"""The search for frames in a stream: one pass in which every place is tested in constant time.

Each checksum is linear or additive, so that of any part of a piece follows from running ones at its ends
(`_running`). So a stream made to deceive costs no more than a good one. A MAVLink frame that the tables do
not know (another dialect, a private message, another definition of a known number) cannot be tested with its
seed and is accepted as unknown when

- a seed exists that explains its checksum (one in 256 frames of noise has one),
- it ends where a frame may end: at the start of another one or at the end of the stream, or an earlier frame
  of the same number had the same seed, and
- no intact frame of a known message begins inside it. So an accepted unknown never costs a known one.

Once a number has shown the same seed twice, frames of that number with a seed never seen are refused.

The functions are plain; `compile_search` compiles them. In all of them a length of 0 means that no frame
begins at a place, and a negative one that so many bytes from there on are needed to tell.
"""

from functools import cache
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from drivers.checksums import crc24q_contributions
from drivers.mavlink.dialect import SIGNATURE_BYTES, SIGNED, V1, V2, Dialect, ardupilotmega
from photocal.base.arrays import Flags, Integers

# The protocols of the compiled search with the bytes that their frames begin with; `drivers.frames.Wire`
# takes the numbers from here.
STREAMS = {"mavlink": bytes((V1, V2)), "ubx": b"\xb5", "rtcm3": b"\xd3", "nmea": b"$"}
MAVLINK, UBX, RTCM3, NMEA = range(len(STREAMS))
NO_WIRE = 255
# A stamp of a telemetry log is believed from 2000 to 2100: microseconds since 1970, UTC, big-endian.
STAMP_BYTES, EARLIEST_US, LATEST_US = 8, 946_684_800_000_000, 4_102_444_800_000_000
# How many unknown messages are remembered: a flood of ever new ones must not fill the memory.
_REMEMBERED, _LONGEST_LOOK = 1 << 14, 32

# Classes of the characters of NMEA sentences.
_CAPITAL, _DIGIT, _TEXT, _HEX = 1, 2, 4, 8


# What is 8 to 24 bits wide, in a width in which nothing runs over.
Octets = NDArray[np.int32]
Rows = Integers


class Tables(NamedTuple):
    """What the search looks up: of MAVLink messages seed, size and ends of fields; steps of the checksums."""

    seeds: Octets
    sizes: Octets
    boundaries: Flags
    crc16_far: Integers
    seed_step: Octets
    crc24_far: Octets
    letters: Integers


class Running(NamedTuple):
    """Checksums of a piece up to each place: both of Fletcher, CRC-24Q and CRC-16/MCRF4XX begun with zero."""

    first: Octets
    second: Octets
    crc24: Octets
    crc16: Octets


@cache
def tables_of(dialect: Dialect) -> Tables:
    """Return the tables for the messages of a dialect."""
    seeds, sizes = np.full(1 << 16, -1, np.int32), np.zeros(1 << 16, np.int32)
    boundaries = np.zeros((256, 256), bool)
    for message, seed in dialect.seeds.items():
        seeds[message], sizes[message] = seed, dialect.layout(message).itemsize
        if message < 256:
            # A payload of MAVLink 1 ends where a field ends. The tables do not say which fields are
            # extensions, so every end of a field is possible.
            row = dialect.layout(message)
            boundaries[message, np.cumsum([row[name].itemsize for name in row.names or ()])] = True
    step = np.arange(256)
    for _ in range(8):
        step = np.where(step & 1, step >> 1 ^ 0x8408, step >> 1)
    far = np.empty((300, 256), np.int64)
    far[0] = step
    for distance in range(1, len(far)):
        far[distance] = far[distance - 1] >> 8 ^ step[far[distance - 1] & 0xFF]
    inverse = np.full(1 << 16, -1, np.int32)
    inverse[step] = np.arange(256)
    letters = np.zeros(256, np.int64)
    letters[[*range(0x20, 0x24), *range(0x25, 0x2A), *range(0x2B, 0x7F)]] |= _TEXT
    letters[ord("A") : ord("Z") + 1] |= _CAPITAL
    letters[ord("0") : ord("9") + 1] |= _DIGIT
    letters[list(b"0123456789ABCDEFabcdef")] |= _HEX
    return Tables(seeds, sizes, boundaries, far, inverse, crc24q_contributions().view(np.int32), letters)


def new_memory() -> Integers:
    """Return the empty memory of unknown messages: rows of a hash table, key and count."""
    return np.zeros((_REMEMBERED, 2), np.int64)


def search_stream(
    data: Octets, closed: bool, starts: Octets, others: Integers, memory: Integers, tables: Tables
) -> tuple[Integers, Integers, int, int]:
    """Find the frames of a piece of a stream.

    others (n, 4): frames of protocols that are not searched for here, where no frame of one that is begins:
        place, length, protocol and kind, in the order of their places.
    """
    end = len(data)
    running = _running(data, starts[V2] == MAVLINK, starts[0xD3] == RTCM3, starts[0xB5] == UBX, tables)
    ahead = np.zeros(2, np.int64)
    frames = np.empty((end // 6 + 1, 5), np.int64)
    damage = np.empty((end // 6 + 2, 2), np.int64)
    count, runs, at, clean, needed, other = 0, 0, 0, 0, 1, 0
    while at < end:
        length, kind, known = 0, 0, True
        wire = starts[data[at]]
        if wire == UBX:
            length, kind = _ubx(data, at, running)
        elif wire == RTCM3:
            length, kind = _rtcm3(data, at, running, tables)
        elif wire == NMEA:
            length, kind = _nmea(data, at, tables)
        elif wire == MAVLINK:
            length, kind, known = _mavlink(data, at, closed, starts, memory, ahead, running, tables)
        if length == 0 or (length < 0 and closed):
            other, length = _other(others, other, at)
            if length:
                wire, kind, known = others[other, 2], others[other, 3], True
        if length < 0 and not closed:
            needed = -length
            break
        if length <= 0:
            at += 1
            continue
        if at > clean:
            damage[runs, 0], damage[runs, 1] = clean, at - clean
            runs += 1
        frames[count, 0], frames[count, 1], frames[count, 2] = at, length, wire
        frames[count, 3], frames[count, 4] = kind, known
        count += 1
        at += length
        clean = at
    if at > clean:
        damage[runs, 0], damage[runs, 1] = clean, at - clean
        runs += 1
    return frames[:count].copy(), damage[:runs].copy(), at, needed


def search_records(
    data: Octets, closed: bool, stamp_us: int, memory: Integers, tables: Tables
) -> tuple[Integers, Integers, int]:
    """As `search_stream`, of a telemetry log: rows are place, length, kind, known and the last good stamp."""
    end = len(data)
    running = _running(data, True, False, False, tables)
    ahead = np.zeros(2, np.int64)
    frames = np.empty((end // 8 + 1, 5), np.int64)
    damage = np.empty((end // 8 + 2, 2), np.int64)
    count, runs, clean = 0, 0, 0
    while True:
        # A record begins at the end of the one before; only where none does, every byte is examined.
        place = clean + STAMP_BYTES
        length, kind, known, stamp = _record(data, place, clean, closed, memory, ahead, running, tables)
        if length == 0:
            place = clean
            ahead[0] = 0
            while place < end:
                length, kind, known, stamp = _record(
                    data, place, clean, closed, memory, ahead, running, tables
                )
                if length != 0:
                    break
                place += 1
        if length == 0:
            # The stamp of the next record may have begun already.
            rest = end if closed else max(clean, end - STAMP_BYTES)
        else:
            rest = place - STAMP_BYTES if stamp or length < 0 else place
            rest = max(clean, rest)
        if rest > clean:
            damage[runs, 0], damage[runs, 1] = clean, rest - clean
            runs += 1
        if length <= 0:
            return frames[:count].copy(), damage[:runs].copy(), rest
        if stamp:
            stamp_us = stamp
        frames[count, 0], frames[count, 1], frames[count, 2] = place, length, kind
        frames[count, 3], frames[count, 4] = known, stamp_us
        count += 1
        clean = place + length


def _other(others: Integers, row: int, at: int) -> tuple[int, int]:
    """Return the first row that is not before a place, and the length of the frame that begins there."""
    while row < len(others) and others[row, 0] < at:
        row += 1
    return row, (int(others[row, 1]) if row < len(others) and others[row, 0] == at else 0)


def _running(data: Octets, mavlink: bool, rtcm3: bool, ubx: bool, tables: Tables) -> Running:
    """Return the running checksums of the protocols that are looked for."""
    size = len(data) + 1
    first, second = np.zeros(size if ubx else 1, np.int32), np.zeros(size if ubx else 1, np.int32)
    crc24, crc16 = np.zeros(size if rtcm3 else 1, np.int32), np.zeros(size if mavlink else 1, np.int32)
    a, b, long, short = 0, 0, 0, 0
    for i in range(len(data)):
        octet = int(data[i])
        if ubx:
            a = (a + octet) & 0xFF
            b = (b + a) & 0xFF
            first[i + 1], second[i + 1] = a, b
        if rtcm3:
            long = ((long << 8) & 0xFFFFFF) ^ int(tables.crc24_far[0, (long >> 16) ^ octet])
            crc24[i + 1] = long
        if mavlink:
            short = (short >> 8) ^ int(tables.crc16_far[0, (short & 0xFF) ^ octet])
            crc16[i + 1] = short
    return Running(first, second, crc24, crc16)


def _ubx(data: Octets, at: int, running: Running) -> tuple[int, int]:
    """Return length and kind of the UBX frame at a place."""
    # The longest message of the interface descriptions is RXM-RAWX with 255 signals, 8176 bytes. Without a
    # bound a damaged length would hold back up to 64 kB of good frames.
    ubx_longest_payload = 8192
    room = len(data) - at
    if room > 1 and data[at + 1] != 0x62:
        return 0, 0
    if room < 6:
        return -6, 0
    payload = data[at + 4] | data[at + 5] << 8
    if payload > ubx_longest_payload:
        return 0, 0
    if payload + 8 > room:
        return -(payload + 8), 0
    begin, end = at + 2, at + payload + 6
    first = running.first[end] - running.first[begin]
    second = running.second[end] - running.second[begin] - (end - begin) * running.first[begin]
    if first & 0xFF != data[end] or second & 0xFF != data[end + 1]:
        return 0, 0
    return payload + 8, data[at + 2] << 8 | data[at + 3]


def _rtcm3(data: Octets, at: int, running: Running, tables: Tables) -> tuple[int, int]:
    """Return length and kind of the RTCM 3 frame at a place."""
    room = len(data) - at
    if room > 1 and data[at + 1] > 3:
        return 0, 0
    if room < 3:
        return -3, 0
    payload = data[at + 1] << 8 | data[at + 2]
    if payload + 6 > room:
        return -(payload + 6), 0
    end, before = at + payload + 3, running.crc24[at]
    shifted = tables.crc24_far[payload + 2, before >> 16] ^ tables.crc24_far[payload + 1, before >> 8 & 0xFF]
    remainder = running.crc24[end] ^ shifted ^ tables.crc24_far[payload, before & 0xFF]
    if remainder != data[end] << 16 | data[end + 1] << 8 | data[end + 2]:
        return 0, 0
    return payload + 6, (data[at + 3] << 4 | data[at + 4] >> 4) if payload >= 2 else 0


def _nmea(data: Octets, at: int, tables: Tables) -> tuple[int, int]:
    """Return length and kind of the NMEA sentence at a place: $, address, text, *, two digits, line end."""
    # The standard allows 82 characters, receivers send longer ones of their own.
    nmea_longest = 1024
    end = min(len(data), at + nmea_longest)
    wait = -(len(data) - at + 1) if end < at + nmea_longest else 0
    stop = at + 1
    while stop < end and tables.letters[data[stop]] & (_CAPITAL | (_DIGIT if stop > at + 1 else 0)):
        stop += 1
    address = stop - at - 1
    if address > 8 or (stop == end and not wait):
        return 0, 0
    if stop == end:
        return wait, 0
    if address < 2:
        return 0, 0
    if data[stop] == 0x2C:
        while stop < end and tables.letters[data[stop]] & _TEXT:
            stop += 1
    if stop + 5 > end:
        return (wait if _sentence_ends(data, stop, end, tables) else 0), 0
    if not _sentence_ends(data, stop, end, tables):
        return 0, 0
    check, kind = 0, 0
    for i in range(at + 1, stop):
        check ^= data[i]
    low, high = data[stop + 2], data[stop + 1]
    stated = (low & 15) + 9 * (low >> 6) | ((high & 15) + 9 * (high >> 6)) << 4
    if check != stated:
        return 0, 0
    # Of standard sentences the two letters of the talker are left out.
    for i in range(at + 1 if data[at + 1] == 0x50 else at + 3, at + 1 + address):
        kind = kind << 8 | int(data[i])
    return stop + 5 - at, kind


def _sentence_ends(data: Octets, at: int, end: int, tables: Tables) -> bool:
    """Tell whether what is there from a place on can be the end of a sentence."""
    for i in range(at, min(at + 5, end)):
        octet, place = data[i], i - at
        if place == 0:
            fits = octet == 0x2A
        elif place < 3:
            fits = tables.letters[octet] & _HEX != 0
        else:
            fits = octet == (0x0D if place == 3 else 0x0A)
        if not fits:
            return False
    return True


def _extent(data: Octets, at: int) -> tuple[int, int]:
    """Return the length and the number of the message that a MAVLink header claims."""
    room = len(data) - at
    if data[at] == V1:
        return (int(data[at + 1] + 8), int(data[at + 5])) if room >= 6 else (-6, 0)
    if room < 3:
        return -3, 0
    # The standard: a receiver must discard what has incompatibility flags that it does not know.
    if data[at + 2] & ~SIGNED:
        return 0, 0
    if room < 10:
        return -10, 0
    length = data[at + 1] + 12 + (SIGNATURE_BYTES if data[at + 2] & SIGNED else 0)
    return int(length), int(data[at + 7] | data[at + 8] << 8 | data[at + 9] << 16)


def _remainder(data: Octets, at: int, length: int, running: Running, tables: Tables) -> tuple[int, int]:
    """Return the checksum of a MAVLink frame without its seed, and the one on the wire."""
    signed = data[at] == V2 and data[at + 2] & SIGNED
    end = at + length - 2 - (SIGNATURE_BYTES if signed else 0)
    before, size = running.crc16[at + 1] ^ 0xFFFF, end - at - 1
    shifted = tables.crc16_far[size - 1, before & 0xFF] ^ tables.crc16_far[size - 2, before >> 8]
    return int(running.crc16[end] ^ shifted), int(data[end] | data[end + 1] << 8)


def _known_mavlink(data: Octets, at: int, running: Running, tables: Tables) -> tuple[int, int]:
    """Return length and number of the MAVLink frame of a message in the tables at a place."""
    length, kind = _extent(data, at)
    if length <= 0:
        return length, kind
    seed = tables.seeds[kind] if kind < 65536 else -1
    if seed < 0:
        return 0, kind
    if length > len(data) - at:
        return -length, kind
    remainder, check = _remainder(data, at, length, running, tables)
    agrees = (remainder >> 8) ^ tables.crc16_far[0, (remainder & 0xFF) ^ seed] == check
    return (length if agrees else 0), kind


def _mavlink(
    data: Octets,
    at: int,
    closed: bool,
    starts: Octets,
    memory: Integers,
    ahead: Integers,
    running: Running,
    tables: Tables,
) -> tuple[int, int, bool]:
    """Return length, number and whether the tables have it of the MAVLink frame of any message at a place."""
    length, kind = _known_mavlink(data, at, running, tables)
    if length > 0 or (length < 0 and not closed):
        return length, kind, True
    length, kind = _extent(data, at)
    if length <= 0:
        return length, kind, True
    if _contradicts(data, at, kind, tables):
        return 0, kind, True
    if length > len(data) - at:
        return -length, kind, True
    remainder, check = _remainder(data, at, length, running, tables)
    step = tables.seed_step[check ^ (remainder >> 8)]
    if step < 0:
        return 0, kind, True
    seed = step ^ (remainder & 0xFF)
    if not _recall(memory, kind << 8 | seed, 0):
        if _recall(memory, -1 - kind, 0):
            return 0, kind, True
        ends = _may_end(data, at + length, closed, starts)
        if ends <= 0:
            return (-(length + 1) if ends < 0 else 0), kind, True
    inside = _known_inside(data, at, at + length, closed, ahead, running, tables)
    if inside:
        return min(inside, 0), kind, True
    recall_unknown(memory, kind, seed)
    return length, kind, False


def recall_unknown(memory: NDArray[np.int64], kind: int, seed: int) -> bool:
    """Remember an unknown message with its seed; False where the number has shown another one twice."""
    if not _recall(memory, kind << 8 | seed, 0) and _recall(memory, -1 - kind, 0):
        return False
    if _recall(memory, kind << 8 | seed, 1) > 1:
        _recall(memory, -1 - kind, 1)
    return True


def _contradicts(data: Octets, at: int, kind: int, tables: Tables) -> bool:
    """Tell whether a frame of a known number whose checksum disagrees can be no other definition of it."""
    if kind > 65535 or tables.seeds[kind] < 0:
        return False
    payload = data[at + 1]
    return bool(tables.boundaries[kind, payload] if data[at] == V1 else payload <= tables.sizes[kind])


def _may_end(data: Octets, at: int, closed: bool, starts: Octets) -> int:
    """Tell whether a frame may end before a place: 1 yes, 0 no, -1 more bytes are needed."""
    if len(starts):
        if at < len(data):
            return 1 if starts[data[at]] != NO_WIRE else 0
        return 1 if closed else -1
    # In a log a stamp and a start byte follow, or its end.
    if at == len(data) and closed:
        return 1
    if at + STAMP_BYTES >= len(data):
        return 0 if closed else -1
    follows = data[at + STAMP_BYTES] == V1 or data[at + STAMP_BYTES] == V2
    return 1 if follows and _stamp(data, at) else 0


def _known_inside(
    data: Octets, at: int, end: int, closed: bool, ahead: Integers, running: Running, tables: Tables
) -> int:
    """Return 0 when no frame of a known message begins between two places, 1 when one does, or the need."""
    if ahead[0] <= at:
        ahead[0], ahead[1] = at + 1, 0
    while ahead[1] == 0 and ahead[0] < end:
        place = int(ahead[0])
        if data[place] == V1 or data[place] == V2:
            length, _ = _known_mavlink(data, place, running, tables)
            if length > 0 or (length < 0 and not closed):
                ahead[1] = length
                break
        ahead[0] = place + 1
    if ahead[1] == 0 or ahead[0] >= end:
        return 0
    return 1 if ahead[1] > 0 else int(ahead[1] - (ahead[0] - at))


def _recall(memory: Integers, key: int, more: int) -> int:
    """Return how often a key was remembered, `more` included; once the memory is full no key is added."""
    mask = len(memory) - 1
    # Fibonacci hashing (Knuth, The Art of Computer Programming 3, section 6.4).
    row = ((int(key) & 0xFFFFFFFF) * 2654435769 >> 16) & mask
    looked = 0
    while memory[row, 1] and memory[row, 0] != key:
        row = (row + 1) & mask
        looked += 1
        if looked > _LONGEST_LOOK:
            return 0
    if more:
        memory[row, 0] = key
        memory[row, 1] += more
    return int(memory[row, 1])


def _record(
    data: Octets,
    place: int,
    clean: int,
    closed: bool,
    memory: Integers,
    ahead: Integers,
    running: Running,
    tables: Tables,
) -> tuple[int, int, bool, int]:
    """Return length, number, known and stamp of the record of a log whose frame begins at a place."""
    if place >= len(data) or (data[place] != V1 and data[place] != V2):
        return 0, 0, True, 0
    stamp = _stamp(data, place - STAMP_BYTES) if place - STAMP_BYTES >= clean else 0
    known = True
    if stamp:
        nothing = np.zeros(0, np.int32)
        length, kind, known = _mavlink(data, place, closed, nothing, memory, ahead, running, tables)
    else:
        length, kind = _known_mavlink(data, place, running, tables)
    return (0 if length < 0 and closed else length), kind, known, stamp


def _stamp(data: Octets, at: int) -> int:
    """Return the time in a stamp, microseconds since 1970; 0 when it is not valid."""
    stamp = 0
    for i in range(at, at + STAMP_BYTES):
        stamp = stamp << 8 | int(data[i])
    return stamp if EARLIEST_US < stamp < LATEST_US else 0


_SEARCH = (
    _other, _running, _ubx, _rtcm3, _sentence_ends, _nmea, _extent, _remainder, _known_mavlink, _contradicts,
    _stamp, _may_end, _known_inside, _recall, recall_unknown, _mavlink, _record, search_stream,
    search_records,
)  # fmt: skip


@cache
def compile_search() -> None:
    """Compile the search, once for this machine: loading it takes half a second. Plain without numba."""
    try:
        import numba
    except ModuleNotFoundError:
        return

    for function in _SEARCH:
        globals()[function.__name__] = numba.njit(cache=True, nogil=True)(function)
    tables, nothing, memory = tables_of(ardupilotmega()), np.zeros(0, np.int32), new_memory()
    others = np.empty((0, 4), np.int64)
    search_stream(nothing, False, np.full(256, NO_WIRE, np.int32), others, memory, tables)
    search_records(nothing, False, 0, memory, tables)
