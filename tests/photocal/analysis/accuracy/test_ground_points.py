from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray
from pyproj import Transformer

from photocal.analysis.accuracy.ground_points import (
    check_points_used_as_control,
    control_in_few_images,
    feet_for_metres,
    heights_all_equal,
    latitude_longitude_swapped,
    wrong_utm_zone,
)
from photocal.block.model import ObjectPoints
from photocal.findings.finding import Finding
from tests.photocal.findings.english import english

FloatArray = NDArray[np.float64]

# A block near Presidente Prudente, UTM 22 south; six targets with 40 m of relief.
CENTRE = np.array([457_000.0, 7_553_000.0, 410.0])
OFFSETS = np.array(
    [[0, 0, 0], [310, 40, 12], [620, -35, 25], [15, 480, -8], [330, 500, 31], [640, 470, 5]], dtype=float
)
NAMES = tuple(f"P{number}" for number in range(1, 7))


def points(offsets: FloatArray = OFFSETS, names: tuple[str, ...] = NAMES) -> ObjectPoints:
    return ObjectPoints(names, CENTRE + offsets)


def exposures_deg() -> FloatArray:
    transformer = Transformer.from_crs(31982, 4674)
    places = CENTRE[:2] + np.array([[0.0, 0.0], [300.0, 200.0], [600.0, 400.0]])
    return np.column_stack(transformer.transform(places[:, 0], places[:, 1]))


def codes(found: tuple[Finding, ...]) -> list[str]:
    return [finding.code for finding in found]


def test_check_point_that_is_control_by_name() -> None:
    found = check_points_used_as_control(points(), points(OFFSETS[2:3] + 50.0, ("P3",)))
    assert codes(found) == ["check-as-control"]
    assert "P3" in english(found[0])


def test_check_point_that_is_control_by_place() -> None:
    found = check_points_used_as_control(points(), points(OFFSETS[4:5] + 0.001, ("C1",)))
    assert codes(found) == ["check-at-control"]
    assert "C1" in english(found[0])
    assert "P5" in english(found[0])


def test_independent_check_points_raise_nothing() -> None:
    assert check_points_used_as_control(points(), points(OFFSETS + 30.0, tuple("abcdef"))) == ()


def test_heights_of_zero_everywhere() -> None:
    table = points()
    flat = ObjectPoints(table.names, table.values * [1.0, 1.0, 0.0])
    found = heights_all_equal(flat, "control")
    assert codes(found) == ["heights-equal"]
    assert "Z = 0" in english(found[0])
    assert heights_all_equal(table, "control") == ()


def test_heights_that_are_missing_are_not_heights_of_zero() -> None:
    table = points()
    assert heights_all_equal(ObjectPoints(table.names, table.values * [1.0, 1.0, np.nan]), "control") == ()


def test_swapped_latitude_and_longitude_near_the_flight() -> None:
    flight = exposures_deg()
    latitude, longitude = flight.T
    assert latitude_longitude_swapped(latitude, longitude, flight) == ()
    found = latitude_longitude_swapped(longitude, latitude, flight)
    assert codes(found) == ["latitude-longitude-swapped"]
    assert "swapped" in english(found[0])


def test_impossible_latitude_needs_no_flight() -> None:
    found = latitude_longitude_swapped(np.array([138.6]), np.array([-34.9]), None)
    assert codes(found) == ["latitude-longitude-swapped"]


@pytest.mark.parametrize(
    ("factors", "expected"),
    [
        ((1.0, 1.0, 1.0), []),
        ((1 / 0.3048, 1 / 0.3048, 1.0), ["feet-for-metres-plane"]),
        ((1.0, 1.0, 1 / 0.3048), ["feet-for-metres-height"]),
        ((1 / 0.3048,) * 3, ["feet-for-metres-plane", "feet-for-metres-height"]),
        ((0.3048,) * 3, ["feet-for-metres-plane", "feet-for-metres-height"]),
    ],
)
def test_feet_for_metres(factors: tuple[float, float, float], expected: list[str]) -> None:
    block = points()
    noise = np.random.default_rng(3).normal(0.0, 0.05, OFFSETS.shape)
    surveyed = ObjectPoints(NAMES, block.values * factors + noise)
    assert codes(feet_for_metres(surveyed, block)) == expected


def test_feet_of_flat_ground_are_not_guessed() -> None:
    flat = OFFSETS * [1.0, 1.0, 0.0]
    surveyed = points(flat + np.random.default_rng(1).normal(0.0, 0.05, flat.shape))
    assert feet_for_metres(surveyed, points(flat)) == ()


@pytest.mark.parametrize(
    ("zone", "southern", "expected"),
    [
        (22, True, []),
        (21, True, ["wrong-utm-zone"]),
        (23, True, ["wrong-utm-zone"]),
        (22, False, ["wrong-utm-zone"]),
    ],
)
def test_wrong_utm_zone(zone: int, southern: bool, expected: list[str]) -> None:
    found = wrong_utm_zone(points(), zone, southern=southern, exposures_deg=exposures_deg())
    assert codes(found) == expected
    assert all("zone 22 S" in english(finding) for finding in found)


def test_a_flight_over_the_date_line_is_in_its_zone() -> None:
    """Zone 1 begins at 180 degrees: 10 km east of it, at 17.8 degrees south."""
    place = ObjectPoints(("A",), np.array([[182_100.0, 8_029_700.0, 5.0]]))
    exposures = np.array([[-17.8, 179.999], [-17.8, -179.999]])
    assert wrong_utm_zone(place, 1, southern=True, exposures_deg=exposures) == ()


def test_points_of_another_country_are_no_wrong_zone() -> None:
    elsewhere = ObjectPoints(NAMES, points().values - np.array([0.0, 2_000_000.0, 0.0]))
    found = wrong_utm_zone(elsewhere, 22, southern=True, exposures_deg=exposures_deg())
    assert codes(found) == ["points-far-from-flight"]


def test_points_in_one_image_only() -> None:
    observations = (("i1", "P1"), ("i2", "P1"), ("i1", "P2"), ("i1", "P2"))
    found = control_in_few_images(("P1", "P2", "P3"), observations, "control")
    assert codes(found) == ["one-image-only", "no-image"]
    assert "P2" in english(found[0])
    assert "blunder" in english(found[0])
    assert "P3" in english(found[1])
    assert "checks nothing" in english(control_in_few_images(("P2",), observations, "check")[0])
