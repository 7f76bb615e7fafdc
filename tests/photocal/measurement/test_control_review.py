"""Slips of single points, and what each of them is called."""

from __future__ import annotations

import numpy as np
import pytest
from pyproj import Transformer

from photocal.block.model import ObjectPoints
from photocal.findings.texts import catalogue
from photocal.measurement.control_review import heights_apart, stray_points, stray_text, twins

SAY = catalogue("en")
PLACES = np.array([[634600.0 + 40 * k, 485300.0 - 25 * (k % 3), 110.0 + k] for k in range(6)])


def points(places: np.ndarray) -> ObjectPoints:
    names = tuple(f"P{k}" for k in range(len(places)))
    return ObjectPoints(names, places, np.full(places.shape, 0.02), np.zeros(len(places), np.int64))


def test_a_site_as_it_should_be() -> None:
    assert stray_points(points(PLACES), "EPSG:2180") == {}
    assert [*twins(points(PLACES), SAY), *heights_apart(points(PLACES), SAY)] == []


@pytest.mark.parametrize(
    "slip", ["its E and N are exchanged", "it is in feet", "it is in EPSG:31983 (SIRGAS 2000"]
)
def test_a_slip_is_named_and_a_wrong_digit_has_none(slip: str) -> None:
    places = PLACES + np.array([43264.0, 6698931.0, 800.0])
    if "exchanged" in slip:
        places[2, :2] = places[2, 1::-1]
    elif "feet" in slip:
        places[2, :2] /= 0.3048
    else:
        way = Transformer.from_crs("EPSG:31982", "EPSG:31983", always_xy=True)
        places[2, :2] = way.transform(*places[2, :2])
    places[4, 0] += 100_000.0
    found = stray_points(points(places), "EPSG:31982")
    assert list(found) == [2, 4]
    assert f"from the others: {slip}" in stray_text(found[2], SAY)
    assert found[4].clauses == ()
    assert found[4].figures["km"] == pytest.approx(100, rel=0.01)


def test_two_heaps_of_which_neither_is_the_site() -> None:
    places = PLACES.copy()
    places[:3, 0] += 90_000.0
    assert stray_points(points(places), "EPSG:2180") == {}


def test_twins_and_heights() -> None:
    places = np.vstack([PLACES, PLACES[0], PLACES[1] + [0.4, 0.3, 0.0], PLACES[2] + [0, 0, 0.5]])
    told = list(twins(points(places), SAY))
    assert told == [
        "P0 and P6 have one position: two names of one point",
        "P1 and P7 are 0.50 m apart: are they one point?",
        "P2 and P8 have one position, with the heights 112 and 112.5: which is right?",
    ]
    feet = PLACES.copy()
    feet[3, 2] /= 0.3048
    (one,) = heights_apart(points(feet), SAY)
    assert "P3" in one
    assert "in feet" in one
    level = PLACES * [1.0, 1.0, 0.0] + [0.0, 0.0, 30.0]
    assert list(heights_apart(points(level), SAY)) == [
        "the heights of all 6 points are 30, which is improbable"
    ]
