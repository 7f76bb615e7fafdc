"""Galileo navigation message I/NAV: words of 128 bits in nominal pages with CRC-24Q.

Source: Galileo OS SIS ICD 2.1, sections 4.3.2 (pages), 4.3.4 (sequence), 4.3.5 (words) and 5.1.9.4 (CRC).
"""

from __future__ import annotations

from collections.abc import Sequence

from acquire.simulate.gnss.bits import field, joined
from acquire.simulate.gnss.ephemeris import Ephemeris
from acquire.simulate.gnss.signals import SEMICIRCLE_RAD
from drivers.checksums import crc24q

_NOMINAL_ROOT = 29_600_000.0**0.5
_NOMINAL_TILT = 56.0 / 180.0
_GST_BEHIND_WEEKS = 1024
_ISSUE = (1, 4)
_SUBFRAME_S = 30

Bits = list[tuple[int, int]]


def almanac_word(second: bool, tow: int, almanacs: Sequence[Ephemeris]) -> str:
    """Return word 7 or 9 (first of its subframe) or 8 or 10 (second), 128 bits."""
    count = tow // _SUBFRAME_S
    first = 3 * (count // 2) % len(almanacs)
    one, two, three = (almanacs[(first + k) % len(almanacs)] for k in range(3))
    reference = [((one.week - _GST_BEHIND_WEEKS) % 4, 2), (round(one.value("toe")) // 600, 10)]
    if count % 2 == 0:
        if not second:
            return joined([(7, 6), _ISSUE, *reference, *_shape(one), *_node(one), _anomaly(one), (0, 6)])
        return joined([(8, 6), _ISSUE, *_clock(one), *_shape(two), *_node(two), (0, 1)])
    if not second:
        return joined([(9, 6), _ISSUE, *reference, _anomaly(two), *_clock(two), *_shape(three)])
    # The difference to GPS time is zero here.
    offset = [(0, 16), (0, 12), (0, 8), (0, 6)]
    return joined([(10, 6), _ISSUE, *_node(three), _anomaly(three), *_clock(three), *offset])


def _shape(e: Ephemeris) -> Bits:
    root = round((e.value("sqrt_a") - _NOMINAL_ROOT) * 2**9)
    tilt = round((e.value("i0") / SEMICIRCLE_RAD - _NOMINAL_TILT) * 2**14)
    return [(e.number, 6), (root, 13), (round(e.value("e") * 2**16), 11), _angle(e, "omega"), (tilt, 11)]


def _node(e: Ephemeris) -> Bits:
    return [_angle(e, "omega0"), (round(e.value("omega_dot") / SEMICIRCLE_RAD * 2**33), 11)]


def _anomaly(e: Ephemeris) -> tuple[int, int]:
    return _angle(e, "m0")


def _clock(e: Ephemeris) -> Bits:
    return [
        (round(e.value("af0") * 2**19), 16),
        (round(e.value("af1") * 2**38), 13),
        (e.health, 2),
        (e.health, 2),
    ]


def _angle(e: Ephemeris, name: str) -> tuple[int, int]:
    number = round(e.value(name) / SEMICIRCLE_RAD * 2**15)
    return (number + 2**15) % 2**16 - 2**15, 16


PAGE_S = 2
GST_BEHIND_WEEKS = 1024
_SUBFRAME_PAGES = 15
# Word types of one subframe of 30 s (tables 42 and 43). 0 is the spare word, which carries the time; in the
# places of 7 and 8 every other subframe has 9 and 10.
_E1B = (2, 4, 6, 7, 8, 0, 0, 0, 0, 0, 1, 3, 5, 0, 0)
_E5B = (1, 3, 5, 7, 8, 0, 0, 0, 0, 0, 2, 4, 6, 0, 0)
_SEQUENCE = {"E1B": _E1B, "E5b": _E5B}
_TAIL = "0" * 6


def page(
    ephemeris: Ephemeris, gps_s: int, band: str, leap_s: int, almanacs: Sequence[Ephemeris]
) -> list[int]:
    """Return the page that begins at a time, as u-blox hands it over."""
    week, tow = divmod(gps_s, 604_800)
    kind = _SEQUENCE[band][tow // PAGE_S % _SUBFRAME_PAGES]
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
    r = e.raw
    issue = field(kind, 6) + field(e.issue, 10)
    time = field(week % 4096, 12) + field(tow, 20)
    if kind == 0:
        return field(0, 6) + "10" + "10" * 44 + time
    if kind == 1:
        return issue + joined([(r["toe"], 14), (r["m0"], 32), (r["e"], 32), (r["sqrt_a"], 32), (0, 2)])
    if kind == 2:
        return issue + joined([(r["omega0"], 32), (r["i0"], 32), (r["omega"], 32), (r["idot"], 14), (0, 2)])
    if kind == 3:
        harmonics = [(r[name], 16) for name in ("cuc", "cus", "crc", "crs")]
        return issue + joined([(r["omega_dot"], 24), (r["delta_n"], 16), *harmonics, (e.accuracy, 8)])
    if kind == 4:
        clock = [(r["toc"], 14), (r["af0"], 31), (r["af1"], 21), (r["af2"], 6), (0, 2)]
        return issue + joined([(e.number, 6), (r["cic"], 16), (r["cis"], 16), *clock])
    if kind == 5:
        # Effective ionisation a0 of a quiet sun (NeQuick G), no disturbed region.
        ionosphere = [(240, 11), (0, 11), (0, 14), (0, 5)]
        health = [(e.health, 2), (e.health, 2), (int(e.health != 0), 1), (int(e.health != 0), 1)]
        delays = [(r["bgd_e5a"], 10), (r["bgd_e5b"], 10)]
        return field(5, 6) + joined([*ionosphere, *delays, *health]) + time + "0" * 23
    utc = [(0, 32), (0, 24), (leap_s, 8), (0, 8), (week % 256, 8), (905 % 256, 8), (7, 3), (leap_s, 8)]
    return field(6, 6) + joined(utc) + field(tow, 20) + "0" * 3
