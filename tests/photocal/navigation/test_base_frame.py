"""The base's frame and epoch beside those of the control."""

import datetime as dt

import numpy as np
import pytest

from photocal.base.geodesy import geocentric
from photocal.findings.texts import catalogue, finding_text
from photocal.geometry.realizations import realization
from photocal.navigation.base_frame import BaseFrame, decimal_year
from photocal.navigation.time import GpsTime

CURITIBA = geocentric(-25.45, -49.23, 925.8)


def at(year: int, month: int, day: int) -> GpsTime:
    """An hour of one day."""
    start = (dt.date(year, month, day) - dt.date(1980, 1, 6)).days * 86_400
    return GpsTime(np.array([start, start + 3600], np.int64) * 1_000_000_000)


TODAY = decimal_year(at(2026, 11, 24))


def said(frame: BaseFrame) -> dict[str, str]:
    """Code and text of each finding."""
    return {finding.code: finding_text(finding, catalogue("en")) for finding in frame.findings()}


def test_epochs_are_years_and_their_parts() -> None:
    assert decimal_year(at(2024, 12, 31)) == pytest.approx(2024 + 365 / 366, abs=1e-3)
    assert decimal_year(at(2025, 1, 1)) == pytest.approx(2025.0, abs=1e-3)


def test_a_base_of_today_is_moved_to_sirgas_and_the_size_is_told() -> None:
    frame = BaseFrame.of(CURITIBA, realization("IGS20"), "EPSG:31982", TODAY)
    assert frame.moved is not None
    # 26.5 years of about 13 mm a year (IBGE: 1.1 to 1.3 cm a year to the north-west).
    assert 0.30 < frame.moved.size_m < 0.40
    assert frame.moved.shift_enu_m[0] > 0 > frame.moved.shift_enu_m[1]
    assert "SIRGAS 2000, epoch 2000.4" in said(frame)["base-moved"]
    assert f"{frame.moved.size_m:.3f} m" in said(frame)["base-moved"]


def test_a_base_of_unknown_frame_stays_and_the_size_is_told() -> None:
    frame = BaseFrame.of(CURITIBA, None, "EPSG:31982", TODAY)
    assert frame.moved is None
    assert list(said(frame)) == ["base-frame-untold"]


def test_a_base_in_the_frame_of_the_control_is_nothing_to_tell() -> None:
    for source, crs in (("SIRGAS2000", "EPSG:31982"), ("ETRF2000", "EPSG:7930"), ("IGS20@2026.9", None)):
        assert not said(BaseFrame.of(CURITIBA, realization(source), crs, TODAY))
    # Systems whose realization is not told say nothing either.
    assert not said(BaseFrame.of(CURITIBA, None, "EPSG:32722", TODAY))


def test_where_no_way_is_known_nothing_is_moved() -> None:
    frame = BaseFrame.of(CURITIBA, realization("POSGAR 2007"), "EPSG:31982", TODAY)
    assert frame.moved is None
    assert list(said(frame)) == ["base-other-frame"]
