"""Almanacs of I/NAV: words 7 to 10, which bring three satellites in two subframes.

Source: Galileo OS SIS ICD 2.1, tables 48 to 51 (words) and 75 (almanac parameters).
"""

from __future__ import annotations

from collections.abc import Sequence

from acquire.simulate.gnss.bits import joined
from acquire.simulate.gnss.ephemeris import Ephemeris
from acquire.simulate.gnss.signals import SEMICIRCLE_RAD

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
