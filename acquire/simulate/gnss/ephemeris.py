"""Broadcast ephemerides: the fields of the navigation messages and their quantisation.

An ephemeris is kept as the integers that are transmitted; everything that is computed with it uses the values
that these integers stand for, so that a receiver of the message works with the very same numbers.

Sources: IS-GPS-200N, tables 20-I and 20-III; Galileo OS SIS ICD 2.1, tables 63 to 67 (I/NAV).
"""

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np

from acquire.simulate.gnss.settings import EARTH_RATE_RAD_S, GPS, SEMICIRCLE_RAD
from photocal.base.time_scales import SECOND_NS, WEEK_S

_WEEK_NS = WEEK_S * SECOND_NS


@dataclass(frozen=True)
class Field:
    """How a number is transmitted: `bits` long, in units of `scale`, with a sign or without."""

    bits: int
    scale: float
    signed: bool = True

    def quantise(self, value: float) -> int:
        """Return the nearest integer that can be transmitted."""
        number = round(value / self.scale)
        low, high = (-(1 << self.bits - 1), 1 << self.bits - 1) if self.signed else (0, 1 << self.bits)
        if not low <= number < high:
            raise OverflowError(f"{value:g} needs more than {self.bits} bits of {self.scale:g}")
        return number


def _angle(bits: int, power: int) -> Field:
    return Field(bits, 2.0**power * SEMICIRCLE_RAD)


_ORBIT = {
    "m0": _angle(32, -31),
    "delta_n": _angle(16, -43),
    "e": Field(32, 2.0**-33, signed=False),
    "sqrt_a": Field(32, 2.0**-19, signed=False),
    "omega0": _angle(32, -31),
    "i0": _angle(32, -31),
    "omega": _angle(32, -31),
    "omega_dot": _angle(24, -43),
    "idot": _angle(14, -43),
    **dict.fromkeys(("cuc", "cus", "cic", "cis"), Field(16, 2.0**-29)),
    **dict.fromkeys(("crc", "crs"), Field(16, 2.0**-5)),
}
GPS_FIELDS = _ORBIT | {
    **dict.fromkeys(("toe", "toc"), Field(16, 16.0, signed=False)),
    "af0": Field(22, 2.0**-31),
    "af1": Field(16, 2.0**-43),
    "af2": Field(8, 2.0**-55),
    "tgd": Field(8, 2.0**-31),
}
GALILEO_FIELDS = _ORBIT | {
    **dict.fromkeys(("toe", "toc"), Field(14, 60.0, signed=False)),
    "af0": Field(31, 2.0**-34),
    "af1": Field(21, 2.0**-46),
    "af2": Field(6, 2.0**-59),
    **dict.fromkeys(("bgd_e5a", "bgd_e5b"), Field(10, 2.0**-32)),
}


def fields_of(system: str) -> Mapping[str, Field]:
    """Return the scaled fields of a system's message."""
    return GPS_FIELDS if system == GPS else GALILEO_FIELDS


@dataclass(frozen=True)
class Ephemeris:
    """One set of orbit and clock parameters.

    week: GPS week of `toe`, counted on through the rollovers (Galileo's own count is 1024 less).
    issue: IODC of GPS (10 bits, its lower 8 are IODE), IODnav of Galileo (10 bits).
    health: 6 bits of GPS subframe 1, 0 is good; of Galileo 2 bits, for both of its signals, 0 is good.
    accuracy: URA index of GPS, SISA index of Galileo.
    raw: the transmitted integers by the names of `fields_of`.
    """

    system: str
    number: int
    week: int
    issue: int
    health: int
    accuracy: int
    raw: Mapping[str, int]
    from_gps_ns: int

    def value(self, name: str) -> float:
        """Return a parameter in SI units and radians."""
        return self.raw[name] * fields_of(self.system)[name].scale

    def bits(self, names: str) -> list[tuple[int, int]]:
        """Return what is transmitted of some fields, whose names stand between blanks, and their lengths."""
        fields = fields_of(self.system)
        return [(self.raw[name], fields[name].bits) for name in names.split()]

    @property
    def name(self) -> str:
        """Satellite as RINEX names it."""
        return f"{self.system}{self.number:02d}"

    @property
    def toe_gps_ns(self) -> int:
        """Reference time of orbit and clock, GPS nanoseconds."""
        return self.week * _WEEK_NS + round(self.value("toe") * SECOND_NS)


def quantised(system: str, wished: Mapping[str, float], toe_gps_ns: int) -> tuple[int, dict[str, int]]:
    """Return the week and the transmitted integers that come nearest to wished parameters."""
    week, of_week = divmod(toe_gps_ns, _WEEK_NS)
    seconds = of_week / SECOND_NS
    fields = fields_of(system)
    circles = {"m0", "omega0", "omega"}
    whole = {
        name: _within_half_turn(value, fields[name]) if name in circles else value
        for name, value in wished.items()
    }
    whole |= {"toe": seconds, "toc": seconds}
    return int(week), {name: fields[name].quantise(value) for name, value in whole.items()}


def _within_half_turn(angle: float, field: Field) -> float:
    """Return the angle between -180 degrees and what comes just before +180, which has no code."""
    half = SEMICIRCLE_RAD - field.scale / 2
    return half - (half - angle) % (2 * SEMICIRCLE_RAD)


def renewed(old: Ephemeris, toe_gps_ns: int, *, issue: int, from_gps_ns: int) -> Ephemeris:
    """Return the same orbit and clock for a later reference time.

    The parameters are carried over exactly and quantised anew: the two sets differ by the quantisation,
    a few centimetres, as the sets of real satellites do (by more).
    """
    passed = (toe_gps_ns - old.toe_gps_ns) / SECOND_NS
    wished = {name: old.value(name) for name in fields_of(old.system) if name not in ("toe", "toc")}
    motion = np.sqrt(gravity(old.system)) / wished["sqrt_a"] ** 3 + wished["delta_n"]
    wished["m0"] += float(motion) * passed
    wished["omega0"] += wished["omega_dot"] * passed
    wished["i0"] += wished["idot"] * passed
    wished["af0"] += (wished["af1"] + wished["af2"] * passed) * passed
    wished["af1"] += 2 * wished["af2"] * passed
    # omega0 is counted from the Greenwich meridian at the beginning of the week that toe lies in.
    weeks = toe_gps_ns // _WEEK_NS - old.week
    wished["omega0"] -= weeks * WEEK_S * EARTH_RATE_RAD_S
    week, raw = quantised(old.system, wished, toe_gps_ns)
    return replace(old, week=week, issue=issue, raw=raw, from_gps_ns=from_gps_ns)


def gravity(system: str) -> float:
    """Return the gravitational parameter that a system's algorithm fixes, m^3/s^2."""
    return 3.986005e14 if system == GPS else 3.986004418e14
