"""Time scales against published epochs, and clocks that cannot be mixed."""

from __future__ import annotations

import datetime as dt

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from photocal.base.errors import InputMalformedError
from photocal.navigation.time import WEEK_NS, GpsTime, HostTime, UtcTime, leap_seconds

SECOND = 1_000_000_000


def unix_ns(text: str) -> int:
    return int(dt.datetime.fromisoformat(text).replace(tzinfo=dt.UTC).timestamp()) * SECOND


@pytest.mark.parametrize(
    ("utc", "week", "tow"),
    [
        # navcen.uscg.gov: week 1024 began on 1999-08-22, week 2048 on 2019-04-07, in GPS time.
        ("1999-08-21T23:59:47", 1024, 0),
        ("2019-04-06T23:59:42", 2048, 0),
        # RINEX header of the static rover: 2024-06-24 08:20:00 GPST is week 2320, Monday.
        ("2024-06-24T08:19:42", 2320, 86400 + 8 * 3600 + 20 * 60),
    ],
)
def test_published_epochs(utc: str, week: int, tow: int) -> None:
    gps = UtcTime(np.array([unix_ns(utc)])).to_gps()
    assert gps.ns[0] == week * WEEK_NS + tow * 10**9
    assert GpsTime.from_week([week], [tow]) == gps


@pytest.mark.parametrize(("day", "leap"), [("2016-12-31T23:59:59", 17), ("2017-01-01T00:00:00", 18)])
def test_the_last_leap_second(day: str, leap: int) -> None:
    utc = UtcTime(np.array([unix_ns(day)]))
    assert leap_seconds(utc.to_gps())[0] == leap
    assert utc.to_gps().to_utc() == utc


@given(st.integers(unix_ns("1980-01-06T00:00:01"), unix_ns("2026-06-27T00:00:00")))
def test_utc_and_back(ns: int) -> None:
    assert UtcTime(np.array([ns])).to_gps().to_utc().ns[0] == ns


def test_the_table_knows_its_end() -> None:
    later = UtcTime(np.array([unix_ns("2031-01-01T00:00:00")]))
    with pytest.raises(InputMalformedError, match="leap seconds ends on"):
        later.to_gps()


def test_clocks_do_not_mix() -> None:
    one = np.array([1])
    for other in (UtcTime(one), HostTime(one)):
        with pytest.raises(TypeError):
            _ = GpsTime(one) - other  # type: ignore[operator]
        with pytest.raises(TypeError, match="cannot be compared"):
            _ = GpsTime(one) == other
    with pytest.raises(TypeError, match="whole nanoseconds"):
        GpsTime(np.array([1.5]))


def test_week_zero_is_no_time() -> None:
    with pytest.raises(InputMalformedError, match="week 0"):
        GpsTime.from_week([0], [0.0])
