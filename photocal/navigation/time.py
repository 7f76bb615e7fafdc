"""Instants of four clocks that cannot be mixed: GPS time, UTC, time since boot and the host's clock.

Inside the package every time is GPS time in integer nanoseconds. A conversion is always written out; the
arithmetic of two different scales is an error of type, for the type checker and at run time.
"""

import datetime as dt
from dataclasses import dataclass
from typing import Any, Self

import numpy as np
from numpy.typing import ArrayLike

from photocal.base.arrays import Integers
from photocal.base.errors import InputMalformedError
from photocal.base.time_scales import (
    EXPIRES,
    GPS_EPOCH_NS,
    SECOND_NS,
    WEEK_S,
    gps_to_utc_ns,
    utc_to_gps_ns,
    week_to_ns,
)

WEEK_NS = WEEK_S * SECOND_NS


@dataclass(frozen=True, eq=False)
class Instants:
    """Instants on one scale; `ns` (n,): nanoseconds since the scale's own origin."""

    ns: Integers

    def __post_init__(self) -> None:
        given = np.asarray(self.ns)
        if given.dtype.kind not in "iu":
            raise TypeError(f"{type(self).__name__} takes whole nanoseconds, not {given.dtype}")
        object.__setattr__(self, "ns", np.atleast_1d(given.astype(np.int64)))

    def __len__(self) -> int:
        return len(self.ns)

    def __getitem__(self, rows: Any) -> Self:
        return type(self)(self.ns[rows])

    def __eq__(self, other: object) -> bool:
        if type(other) is not type(self):
            raise TypeError(f"{type(self).__name__} and {type(other).__name__} cannot be compared")
        return np.array_equal(self.ns, other.ns)

    __hash__ = None  # type: ignore[assignment]


class HostTime(Instants):
    """Times of receipt by the clock of the recording computer, nanoseconds since 1970."""


class GpsTime(Instants):
    """GPS time, nanoseconds since 1980-01-06 without leap seconds."""

    @classmethod
    def from_week(cls, week: ArrayLike, seconds: ArrayLike) -> Self:
        """Return GPS time of week numbers (not modulo 1024) and seconds of the week."""
        weeks, tow = np.asarray(week), np.asarray(seconds, np.float64)
        bad = (weeks <= 0) | ~((tow >= 0) & (tow <= WEEK_S))
        if np.any(bad):
            raise InputMalformedError(
                "GPS week 0 or a time of week outside the week",
                "leave out what the receiver sent before it knew the time",
            )
        return cls(week_to_ns(weeks, tow))

    def to_utc(self) -> "UtcTime":
        """Convert to UTC."""
        utc = UtcTime(gps_to_utc_ns(self.ns))
        refuse_expired(utc)
        return utc

    def iso(self) -> list[str]:
        """Return calendar dates in GPS time, to the millisecond, for messages."""
        return _calendar(self.ns + GPS_EPOCH_NS)


class UtcTime(Instants):
    """UTC, nanoseconds since 1970 without leap seconds, as POSIX counts."""

    def to_gps(self) -> GpsTime:
        """Convert to GPS time, the inverse of `GpsTime.to_utc`; a leap second itself counts as the next."""
        refuse_expired(self)
        return GpsTime(utc_to_gps_ns(self.ns))

    def iso(self) -> list[str]:
        """Return calendar dates, UTC, to the millisecond, for messages."""
        return _calendar(self.ns)


def leap_seconds(time: GpsTime) -> Integers:
    """Return GPS time minus UTC in seconds by the table."""
    return (time.ns + GPS_EPOCH_NS - time.to_utc().ns) // SECOND_NS


def refuse_expired(time: "UtcTime | GpsTime") -> None:
    """Refuse instants beyond the table of leap seconds."""
    last = int(dt.datetime.combine(EXPIRES, dt.time(), dt.UTC).timestamp()) * SECOND_NS
    epoch_ns = GPS_EPOCH_NS if isinstance(time, GpsTime) else 0
    if len(time) and int(time.ns.max()) + epoch_ns >= last:
        raise InputMalformedError(
            f"the table of leap seconds ends on {EXPIRES}, a time in the data is later",
            "update the package tzdata, which has the table",
        )


def _calendar(unix_ns: Integers) -> list[str]:
    stamps = np.datetime_as_string(unix_ns.astype("datetime64[ns]"), unit="ms")
    return [stamp.replace("T", " ") for stamp in stamps.tolist()]


def exact_ns(text: str) -> int:
    """Return the nanoseconds of seconds that stand as decimals: a double would not hold all of a week's."""
    whole, _, part = text.partition(".")
    return int(whole) * SECOND_NS + int(part.ljust(9, "0")[:9])
