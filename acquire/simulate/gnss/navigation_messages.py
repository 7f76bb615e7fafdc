"""Navigation messages as broadcast: LNAV of GPS in subframes with parity, I/NAV of Galileo in pages.

Sources: IS-GPS-200N, figures 20-1 (subframes), 20-2 (TLM and HOW), sections 20.3.3.5 (pages), 20.3.5
(parity); Galileo OS SIS ICD 2.1, sections 4.3.2 (pages), 4.3.4 (sequence), 4.3.5 (words) and 5.1.9.4 (CRC).
"""

import struct
from collections.abc import Iterable, Iterator, Sequence

import numpy as np

from acquire.simulate.gnss.ephemeris import Ephemeris
from acquire.simulate.gnss.observations import SatelliteObservations
from acquire.simulate.gnss.settings import GALILEO, GPS, SEMICIRCLE_RAD, UBX_SYSTEM, SkySettings
from drivers.checksums import crc24q
from photocal.base.arrays import Floats, Integers
from photocal.base.time_scales import SECOND_NS

SUBFRAME_S, PAGE_S = 6, 2
GST_BEHIND_WEEKS = 1024
_PREAMBLE = "10001011"
# Which of D29*, D30* and which data bits each parity bit sums (IS-GPS-200N, table 20-XIV).
_PARITY = (
    (29, (1, 2, 3, 5, 6, 10, 11, 12, 13, 14, 17, 18, 20, 23)),
    (30, (2, 3, 4, 6, 7, 11, 12, 13, 14, 15, 18, 19, 21, 24)),
    (29, (1, 3, 4, 5, 7, 8, 12, 13, 14, 15, 16, 19, 20, 22)),
    (30, (2, 4, 5, 6, 8, 9, 13, 14, 15, 16, 17, 20, 21, 23)),
    (30, (1, 3, 5, 6, 7, 9, 10, 14, 15, 16, 17, 18, 21, 22, 24)),
    (29, (3, 5, 6, 8, 9, 10, 11, 13, 15, 19, 22, 23, 24)),
)
_HEALTH_PAGE, _IONOSPHERE_PAGE = 63, 56
# Satellite or page identity of the pages of subframe 4 (IS-GPS-200N, table 20-V); 0 is a dummy.
_SUBFRAME_4 = (
    *(57, 25, 26, 27, 28, 57, 29, 30, 31, 32, 57, 62, 52, 53, 54, 57, 55),
    *(56, 58, 59, 57, 60, 61, 62, 63),
)
KIND = 0x0213
_NOMINAL_ROOT = 29_600_000.0**0.5
_NOMINAL_TILT = 56.0 / 180.0
_ISSUE = (1, 4)

Bits = list[tuple[int, int]]
# Word types of one subframe of 30 s (tables 42 and 43). 0 is the spare word, which carries the time; in the
# places of 7 and 8 every other subframe has 9 and 10.
_E1B = (2, 4, 6, 7, 8, 0, 0, 0, 0, 0, 1, 3, 5, 0, 0)
_E5B = (1, 3, 5, 7, 8, 0, 0, 0, 0, 0, 2, 4, 6, 0, 0)
_SEQUENCE = {"E1B": _E1B, "E5b": _E5B}
_TAIL = "0" * 6


def field(value: int, width: int) -> str:
    """Return the bits of a number, two's complement where it is negative."""
    if not -(1 << width - 1 if width else 0) <= value < 1 << width:
        raise OverflowError(f"{value} does not fit {width} bits")
    return format(value & (1 << width) - 1, f"0{width}b") if width else ""


def joined(fields: Iterable[tuple[int, int]]) -> str:
    """Return the bits of (value, width) pairs one after another."""
    return "".join(field(value, width) for value, width in fields)


def octets(bits: str) -> bytes:
    """Return whole bytes, the last one filled up with zeros."""
    length = (len(bits) + 7) // 8
    return int(bits.ljust(8 * length, "0"), 2).to_bytes(length, "big") if bits else b""


def subframe(ephemeris: Ephemeris, gps_s: int, sky: SkySettings, almanacs: Sequence[Ephemeris]) -> list[int]:
    """Return the subframe that begins at a time, as u-blox hands it over."""
    week, tow = divmod(gps_s, 604_800)
    number = tow // SUBFRAME_S % 5 + 1
    count = (tow // SUBFRAME_S + 1) % 100_800
    handover = field(count, 17) + "00" + field(number, 3)
    pages = 25
    page = tow // 30 % pages
    e, issue = ephemeris, (ephemeris.issue & 0xFF, 8)
    if number == 1:
        # After the week: P code on L2.
        head = [(week % 1024, 10), (1, 2), (e.accuracy, 4), (e.health, 6), (e.issue >> 8, 2), (0, 88)]
        words = _split(joined([*head, *e.bits("tgd"), issue, *e.bits("toc af2 af1 af0")]))
    elif number == 2:
        orbit = e.bits("crs delta_n m0 cuc e cus sqrt_a toe")
        words = _split(joined([issue, *orbit, (0, 1), (27, 5)]))
    elif number == 3:
        orbit = e.bits("cic omega0 cis i0 crc omega omega_dot")
        words = _split(joined([*orbit, issue, *e.bits("idot")]))
    elif number == 4:
        words = _subframe_4(page, week, sky, almanacs)
    else:
        words = _subframe_5(page, almanacs)
    return with_parity([_PREAMBLE + "0" * 16, handover, *words])


def with_parity(words: Sequence[str]) -> list[int]:
    """Return the words with parity as u-blox has them: D29* and D30* in front, turned where D30* is set."""
    coded, last = [], (0, 0)
    for word in words:
        for tail in [""] if len(word) == 24 else ["00", "01", "10", "11"]:
            check = parity(word + tail, last)
            if not tail or check.endswith("00"):
                break
        turn = 0xFFFF_FFFF if last[1] else 0
        sent = int(word + tail, 2) << 6
        coded.append((last[0] << 31 | last[1] << 30 | int(check, 2)) ^ (turn & 0xC000_003F) | sent)
        last = int(check[4]), int(check[5])
    return coded


def parity(data: str, last: tuple[int, int]) -> str:
    """Return the six parity bits of 24 data bits after a word that ended in D29*, D30*."""
    return "".join(
        str((last[before - 29] + sum(int(data[bit - 1]) for bit in bits)) % 2) for before, bits in _PARITY
    )


def _subframe_4(page: int, week: int, sky: SkySettings, almanacs: Sequence[Ephemeris]) -> list[str]:
    identity = _SUBFRAME_4[page]
    if identity == _IONOSPHERE_PAGE:
        return _ionosphere_and_utc(week, sky)
    if identity == _HEALTH_PAGE:
        configuration = "1001" * 32  # antispoofing on, Block IIR-M and later
        health = "".join(field(_health(almanacs, n), 6) for n in range(25, 33))
        return _split(_page(identity) + configuration + "00" + health + "0" * 4)
    if 25 <= identity <= 32:
        return _almanac(identity, almanacs)
    return _split(_page(identity) + ("10" * 88)[:176] + "00" * 3)


def _subframe_5(page: int, almanacs: Sequence[Ephemeris]) -> list[str]:
    if page < 24:
        return _almanac(page + 1, almanacs)
    health = "".join(field(_health(almanacs, n), 6) for n in range(1, 25))
    reference = almanacs[0]
    toa = field(round(reference.value("toe")) // 4096, 8) + field(reference.week % 256, 8)
    return _split(_page(51) + toa + health + "0" * 22)


def _page(identity: int) -> str:
    return "01" + field(identity, 6)


def _health(almanacs: Sequence[Ephemeris], number: int) -> int:
    return next((e.health for e in almanacs if e.number == number), 0b111111)


def _ionosphere_and_utc(week: int, sky: SkySettings) -> list[str]:
    bits = _page(_IONOSPHERE_PAGE) + joined((value, 8) for value in sky.klobuchar)
    leap = field(sky.leap_s, 8)
    # A1, A0, t_ot, WN_t, leap seconds, WN_LSF, DN and the leap seconds after an event that is past.
    bits += joined([(0, 24), (1, 32), (61, 8), (week % 256, 8)]) + leap + field(137, 8) + field(7, 8) + leap
    return _split(bits + "0" * 14)


def _almanac(number: int, almanacs: Sequence[Ephemeris]) -> list[str]:
    """Return the reduced orbit of one satellite (IS-GPS-200N, table 20-VI), or a dummy page."""
    e = next((e for e in almanacs if e.number == number), None)
    if e is None:
        return _split(_page(0) + "10" * 91)
    toa = round(e.value("toe")) // 4096 * 4096
    passed = toa - e.value("toe")
    motion = (3.986005e14**0.5) / e.value("sqrt_a") ** 3
    anomaly = e.value("m0") + motion * passed
    clock = round((e.value("af0") + e.value("af1") * passed) * 2**20)
    bits = _page(number) + joined(
        [
            (round(e.value("e") * 2**21), 16),
            (toa // 4096, 8),
            (round((e.value("i0") / SEMICIRCLE_RAD - 0.30) * 2**19), 16),
            (round(e.value("omega_dot") / SEMICIRCLE_RAD * 2**38), 16),
            (e.health << 2 & 0xFF if e.health else 0, 8),
            (round(e.value("sqrt_a") * 2**11), 24),
            *(_wrapped(angle, 24) for angle in (e.value("omega0"), e.value("omega"), anomaly)),
        ]
    )
    coded = field(clock, 11)
    return _split(bits + coded[:8] + field(round(e.value("af1") * 2**38), 11) + coded[8:])


def _wrapped(angle: float, width: int) -> tuple[int, int]:
    """Return an angle in so many bits of a turn, from half a turn back to half a turn ahead."""
    half = 1 << width - 1
    return (round(angle / SEMICIRCLE_RAD * half) + half) % (2 * half) - half, width


def _split(bits: str) -> list[str]:
    """Cut words 3 to 10 out of 190 bits; the last word is left with 22, see `with_parity`."""
    if len(bits) != 190:
        raise ValueError(f"{len(bits)} bits instead of 190")
    return [bits[at : at + 24] for at in range(0, 168, 24)] + [bits[168:]]


# Signals with data: place among those tracked, `sigId`, length of their parts, and their shift in time, s.
_SOURCES = {
    GPS: (("L1CA", 0, 0, SUBFRAME_S, 0),),
    # Pages of E1B begin a second after those of E5b.
    GALILEO: (("E1B", 0, 1, PAGE_S, 1), ("E5b", 1, 5, PAGE_S, 0)),
}


def messages(
    observations: SatelliteObservations, span_gps_ns: tuple[int, int], sky: SkySettings
) -> Iterator[tuple[int, bytes]]:
    """Yield time of sending (GPS ns) and payload of all that was received whole."""
    # Travel time of the signal and the work of the receiver.
    latency_ns = 120_000_000
    seconds = (observations.clock.tag_gps_ns - span_gps_ns[0]) / SECOND_NS
    almanacs = {
        system: tuple(s.truth for s in observations.satellites if s.system == system) for system in _SOURCES
    }
    for index, satellite in enumerate(observations.satellites):
        for band, signal, ubx, length_s, shift_s in _SOURCES[satellite.system]:
            count = _tracked(observations, index, signal)
            for gps_s in _beginnings(length_s, shift_s, span_gps_ns):
                if not _whole(count, seconds, gps_s - span_gps_ns[0] / SECOND_NS, length_s):
                    continue
                sent = satellite.transmitted(gps_s * SECOND_NS)
                if sent.system == GPS:
                    words = subframe(sent, gps_s, sky, almanacs[GPS])
                else:
                    words = page(sent, gps_s, band, sky.leap_s, almanacs[GALILEO])
                head = struct.pack(
                    "8B", UBX_SYSTEM[sent.system], sent.number, ubx, 0, len(words), index % 60, 2, 0
                )
                received = (gps_s + length_s) * SECOND_NS + latency_ns
                yield received, head + struct.pack(f"<{len(words)}I", *words)


def _tracked(observations: SatelliteObservations, satellite: int, signal: int) -> Integers:
    """Return at how many epochs before each one a signal was there; int64 (n + 1,)."""
    rows = observations.rows
    there = np.zeros(len(observations.clock) + 1, np.int64)
    there[rows["epoch"][(rows["satellite"] == satellite) & (rows["signal"] == signal)] + 1] = 1
    return np.cumsum(there)


def _beginnings(length_s: int, shift_s: int, span_gps_ns: tuple[int, int]) -> range:
    """Return when parts begin that lie within the session, GPS seconds."""
    start, stop = -(-span_gps_ns[0] // SECOND_NS), span_gps_ns[1] // SECOND_NS
    first = start + (shift_s - start) % length_s
    return range(first, stop - length_s + 1, length_s)


def _whole(count: Integers, seconds: Floats, begin: float, length: float) -> bool:
    """Tell whether the signal was tracked at all epochs of a stretch, of which there must be one."""
    first, after = np.searchsorted(seconds, [begin, begin + length])
    return bool(after > first and count[after] - count[first] == after - first)


def almanac_word(second: bool, tow: int, almanacs: Sequence[Ephemeris]) -> str:
    """Return word 7 or 9 (first of its subframe) or 8 or 10 (second), 128 bits."""
    # Five subframes of 6 s.
    frame_s = 30
    count = tow // frame_s
    first = 3 * (count // 2) % len(almanacs)
    sv1, sv2, sv3 = (almanacs[(first + k) % len(almanacs)] for k in range(3))
    reference = [((sv1.week - GST_BEHIND_WEEKS) % 4, 2), (round(sv1.value("toe")) // 600, 10)]
    if count % 2 == 0:
        if not second:
            return joined([(7, 6), _ISSUE, *reference, *_shape(sv1), *_node(sv1), _angle(sv1, "m0"), (0, 6)])
        return joined([(8, 6), _ISSUE, *_clock(sv1), *_shape(sv2), *_node(sv2), (0, 1)])
    if not second:
        return joined([(9, 6), _ISSUE, *reference, _angle(sv2, "m0"), *_clock(sv2), *_shape(sv3)])
    # The difference to GPS time is zero here.
    offset = [(0, 16), (0, 12), (0, 8), (0, 6)]
    return joined([(10, 6), _ISSUE, *_node(sv3), _angle(sv3, "m0"), *_clock(sv3), *offset])


def _shape(e: Ephemeris) -> Bits:
    root = round((e.value("sqrt_a") - _NOMINAL_ROOT) * 2**9)
    tilt = round((e.value("i0") / SEMICIRCLE_RAD - _NOMINAL_TILT) * 2**14)
    return [(e.number, 6), (root, 13), (round(e.value("e") * 2**16), 11), _angle(e, "omega"), (tilt, 11)]


def _node(e: Ephemeris) -> Bits:
    return [_angle(e, "omega0"), (round(e.value("omega_dot") / SEMICIRCLE_RAD * 2**33), 11)]


def _clock(e: Ephemeris) -> Bits:
    bias, rate = round(e.value("af0") * 2**19), round(e.value("af1") * 2**38)
    return [(bias, 16), (rate, 13), (e.health, 2), (e.health, 2)]


def _angle(e: Ephemeris, name: str) -> tuple[int, int]:
    return _wrapped(e.value(name), 16)


def page(
    ephemeris: Ephemeris, gps_s: int, band: str, leap_s: int, almanacs: Sequence[Ephemeris]
) -> list[int]:
    """Return the page that begins at a time, as u-blox hands it over."""
    week, tow = divmod(gps_s, 604_800)
    subframe_pages = 15
    kind = _SEQUENCE[band][tow // PAGE_S % subframe_pages]
    if kind in (7, 8):
        data = almanac_word(kind == 8, tow, almanacs)
    else:
        data = _word(kind, ephemeris, week - GST_BEHIND_WEEKS, tow, leap_s)
    even = "00" + data[:112]
    # E1B carries 40 reserved, 22 search and rescue and 2 spare bits here; a message for nobody is all ones.
    between = "10" * 20 + "1" + "0" * 21 + "00" if band == "E1B" else "10" * 32
    odd = "10" + data[112:] + between
    check = crc24q(int(even + odd, 2).to_bytes(25, "big"))
    final = "00000100" if band == "E1B" else "10101010"  # SSP configuration 1 / reserved
    odd += field(check, 24) + final
    parts = [(part + _TAIL).ljust(128, "0") for part in (even, odd)]
    return [int(part[at : at + 32], 2) for part in parts for at in range(0, 128, 32)] + [1]


def _word(kind: int, e: Ephemeris, week: int, tow: int, leap_s: int) -> str:
    issue = field(kind, 6) + field(e.issue, 10)
    time = field(week % 4096, 12) + field(tow, 20)
    if kind == 0:
        return field(0, 6) + "10" + "10" * 44 + time
    if kind == 1:
        return issue + joined([*e.bits("toe m0 e sqrt_a"), (0, 2)])
    if kind == 2:
        return issue + joined([*e.bits("omega0 i0 omega idot"), (0, 2)])
    if kind == 3:
        return issue + joined([*e.bits("omega_dot delta_n cuc cus crc crs"), (e.accuracy, 8)])
    if kind == 4:
        return issue + joined([(e.number, 6), *e.bits("cic cis toc af0 af1 af2"), (0, 2)])
    if kind == 5:
        # Effective ionisation a0 of a quiet sun (NeQuick G), no disturbed region.
        ionosphere = [(240, 11), (0, 11), (0, 14), (0, 5)]
        health = [(e.health, 2), (e.health, 2), (int(e.health != 0), 1), (int(e.health != 0), 1)]
        return field(5, 6) + joined([*ionosphere, *e.bits("bgd_e5a bgd_e5b"), *health]) + time + "0" * 23
    utc = [(0, 32), (0, 24), (leap_s, 8), (0, 8), (week % 256, 8), (905 % 256, 8), (7, 3), (leap_s, 8)]
    return field(6, 6) + joined(utc) + field(tow, 20) + "0" * 3
