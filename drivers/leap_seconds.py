"""GPS time minus UTC, from the table of leap seconds that the package tzdata carries (IERS Bulletin C)."""

from __future__ import annotations

import datetime as dt
import re
from dataclasses import dataclass
from importlib import resources

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
