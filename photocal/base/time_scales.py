"""GNSS time and UTC for the stamps of the flight log: weeks, days and leap seconds."""

import datetime as dt
import re
from dataclasses import dataclass
from importlib import resources
from typing import Any

import numpy as np

from photocal.base.arrays import Integers

_MONTHS = ("Jan", "Feb", "Mar", "Apr", "May", "Jun", "Jul", "Aug", "Sep", "Oct", "Nov", "Dec")
_LEAP = re.compile(r"^Leap\s+(\d+)\s+(\w+)\s+(\d+)\s+\S+\s+([+-])\s", re.MULTILINE)
_EXPIRES = re.compile(r"^#expires\s+(\d+)", re.MULTILINE)
GPS_BEGAN = dt.date(1980, 1, 6)


@dataclass(frozen=True)
class LeapSeconds:
    """The table.

    dates: from the beginning of which, UTC, an offset holds; the first is that of GPS time itself.
    offsets_s: GPS time minus UTC from then on.
    expires: until when the table is known to be complete.
    """

    dates: tuple[dt.date, ...]
    offsets_s: tuple[int, ...]
    expires: dt.date


def parse_leap_seconds(text: str) -> LeapSeconds:
    """Read a table in the form of the time zone database (`leapseconds`)."""
    expires = _EXPIRES.search(text)
    leaps = [
        (dt.date(int(year), 1 + _MONTHS.index(month), int(day)) + dt.timedelta(days=1), int(f"{sign}1"))
        for year, month, day, sign in _LEAP.findall(text)
    ]
    if expires is None or not leaps:
        raise ValueError("no table of leap seconds")
    dates, offsets = [GPS_BEGAN], [0]
    for date, step in sorted(leaps):
        if date > GPS_BEGAN:
            dates.append(date)
            offsets.append(offsets[-1] + step)
    end = dt.datetime.fromtimestamp(int(expires[1]), dt.UTC).date()
    return LeapSeconds(tuple(dates), tuple(offsets), end)


def installed_leap_seconds() -> LeapSeconds:
    """Return the table of the installed time zone database."""
    table = resources.files("tzdata") / "zoneinfo" / "leapseconds"
    return parse_leap_seconds(table.read_text(encoding="ascii"))


SECOND_NS = 1_000_000_000
WEEK_S = 604_800
DAY_NS = 86_400 * SECOND_NS
GPS_EPOCH_NS = 315_964_800 * SECOND_NS

# Receivers announce leap seconds that come after the table's expiry themselves.
_TABLE = installed_leap_seconds()
EXPIRES = _TABLE.expires

_FROM_NS = np.array(
    [int(dt.datetime.combine(date, dt.time(), dt.UTC).timestamp()) * SECOND_NS for date in _TABLE.dates],
    np.int64,
)
_OFFSET_S = np.array(_TABLE.offsets_s, np.int64)


def gps_to_utc_ns(gps_ns: Integers, leap_s: Integers | None = None) -> Integers:
    """Convert GPS time to UTC.

    gps_ns (n,): nanoseconds of GPS time since its epoch, 1980-01-06.
    leap_s (n,): GPS minus UTC where the receiver has told it; where it is negative or missing the table
        decides.
    returns (n,): UTC, nanoseconds since 1970 without leap seconds.
    """
    civil = gps_ns + GPS_EPOCH_NS
    # In GPS time each step of the table comes later by the offset that it brings.
    place = np.searchsorted(_FROM_NS + _OFFSET_S * SECOND_NS, civil, side="right") - 1
    offset_s = _OFFSET_S[np.maximum(place, 0)]
    if leap_s is not None:
        offset_s = np.where(leap_s >= 0, leap_s, offset_s)
    return np.asarray(civil - offset_s * SECOND_NS, np.int64)


def utc_to_gps_ns(utc_ns: Integers) -> Integers:
    """Convert UTC to GPS time, the inverse of `gps_to_utc_ns`; a leap second itself counts as the next.

    utc_ns (n,): nanoseconds since 1970 without leap seconds.
    returns (n,): nanoseconds of GPS time since its epoch.
    """
    civil = utc_ns - GPS_EPOCH_NS
    before, after = (civil + t + GPS_EPOCH_NS - gps_to_utc_ns(t) for t in (civil, civil + 60 * SECOND_NS))
    # The larger offset holds from the step on, that is where it leads back to the same UTC.
    return np.where(gps_to_utc_ns(after) == utc_ns, after, before)


def expiry_warning(utc_ns: int) -> str:
    """Return what to say when a time lies beyond the table of leap seconds; empty while it is good.

    utc_ns: the latest time in question, UTC nanoseconds since 1970.
    """
    end = dt.datetime(EXPIRES.year, EXPIRES.month, EXPIRES.day, tzinfo=dt.UTC)
    if utc_ns < int(end.timestamp()) * SECOND_NS:
        return ""
    return (
        f"the table of leap seconds ends on {EXPIRES.isoformat()}: later times agree with UTC only if no "
        "leap second has come since; update the package tzdata or trust what the receiver announces"
    )


def week_to_ns(week: Any, seconds: Any) -> Integers:
    """Return GPS time in nanoseconds from the GPS week and the seconds of the week."""
    whole = np.asarray(week).astype(np.int64) * (WEEK_S * SECOND_NS)
    return np.asarray(whole + np.rint(np.asarray(seconds, np.float64) * 1e9).astype(np.int64), np.int64)


def utc_date_ns(year: Any, month: Any, day: Any) -> Integers:
    """Return midnight (UTC, nanoseconds since 1970) of calendar dates given as arrays."""
    months = 12 * np.asarray(year, np.int64) + np.asarray(month, np.int64) - (12 * 1970 + 1)
    firsts = months.astype("datetime64[M]").astype("datetime64[D]").astype(np.int64)
    return np.asarray((firsts + np.asarray(day, np.int64) - 1) * DAY_NS, np.int64)
