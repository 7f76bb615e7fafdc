"""The table of leap seconds against what is known of them."""

from __future__ import annotations

import datetime as dt

import pytest

from photocal.base.time_scales import installed_leap_seconds, parse_leap_seconds


def test_the_installed_table() -> None:
    """18 leap seconds between the beginning of GPS time and 2017 (IERS Bulletin C 52)."""
    table = installed_leap_seconds()
    known = dict(zip(table.dates, table.offsets_s, strict=True))
    assert known[dt.date(1980, 1, 6)] == 0
    assert known[dt.date(1981, 7, 1)] == 1
    assert known[dt.date(1999, 1, 1)] == 13
    assert known[dt.date(2006, 1, 1)] == 14
    assert known[dt.date(2017, 1, 1)] == 18
    assert list(table.dates) == sorted(table.dates)
    assert table.expires > dt.date(2026, 12, 31)


def test_a_negative_leap_second() -> None:
    text = (
        "Leap\t2016\tDec\t31\t23:59:60\t+\tS\nLeap\t2029\tJun\t30\t23:59:58\t-\tS\n#expires 1909094400 (x)\n"
    )
    table = parse_leap_seconds(text)
    assert table.dates == (dt.date(1980, 1, 6), dt.date(2017, 1, 1), dt.date(2029, 7, 1))
    assert table.offsets_s == (0, 1, 0)
    assert table.expires == dt.date(2030, 7, 1)


@pytest.mark.parametrize("text", ["", "Leap\t2016\tDec\t31\t23:59:60\t+\tS\n", "#expires 1909094400\n"])
def test_what_is_no_table(text: str) -> None:
    with pytest.raises(ValueError, match="no table"):
        parse_leap_seconds(text)
