"""Ground control of recorded flights: sound as it stands, and every planted mistake is named."""

from __future__ import annotations

import csv
import json
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray
from pyproj import Transformer

from photocal.analysis.accuracy.ground_points import (
    control_in_few_images,
    geodesic_m,
    heights_all_equal,
    latitude_longitude_swapped,
    wrong_utm_zone,
)
from photocal.block.model import ObjectPoints
from tests.photocal.findings.english import english

FloatArray = NDArray[np.float64]
pytestmark = pytest.mark.shared


@pytest.fixture(scope="module")
def helenenschacht(shared: Path) -> Path:
    return shared / "data" / "rtk-mrk-gcp-helenenschacht"


@pytest.fixture(scope="module")
def exposures(helenenschacht: Path) -> FloatArray:
    """Latitude, longitude and ellipsoidal height of the 176 exposures."""
    places = []
    for line in (helenenschacht / "101FTASK_Timestamp.mrk").read_text(encoding="utf-8").splitlines():
        fields = [field.split(",")[0].strip() for field in line.split("\t")]
        places.append([float(fields[6]), float(fields[7]), float(fields[8])])
    return np.array(places)


@pytest.fixture(scope="module")
def survey(helenenschacht: Path) -> list[dict[str, str]]:
    text = (helenenschacht / "latlon-easting_northing.csv").read_text(encoding="utf-8-sig")
    return list(csv.DictReader(text.splitlines(), delimiter=";"))


def utm(survey: list[dict[str, str]]) -> ObjectPoints:
    return ObjectPoints(
        tuple(row["Name"] for row in survey),
        np.array([[float(row[name]) for name in ("Easting", "Northing", "Elevation")] for row in survey]),
    )


def test_helenenschacht_is_sound(survey: list[dict[str, str]], exposures: FloatArray) -> None:
    latitude, longitude = (
        np.array([float(row[name]) for row in survey]) for name in ("Latitude", "Longitude")
    )
    assert len(exposures) == 176
    assert latitude_longitude_swapped(latitude, longitude, exposures[:, :2]) == ()
    assert wrong_utm_zone(utm(survey), 33, southern=False, exposures_deg=exposures[:, :2]) == ()
    assert heights_all_equal(utm(survey), "control") == ()
    # Both forms of the survey are the same places, to 4 cm: more than their digits would excuse (1 mm),
    # so one of them was not computed from the other on this ellipsoid and zone alone.
    east, north = Transformer.from_crs(4326, 32633).transform(latitude, longitude)
    assert np.hypot(*(np.column_stack((east, north)) - utm(survey).values[:, :2]).T).max() < 0.04


def test_helenenschacht_with_planted_mistakes(survey: list[dict[str, str]], exposures: FloatArray) -> None:
    latitude, longitude = (
        np.array([float(row[name]) for row in survey]) for name in ("Latitude", "Longitude")
    )
    swapped = latitude_longitude_swapped(longitude, latitude, exposures[:, :2])
    assert [finding.code for finding in swapped] == ["latitude-longitude-swapped"]
    wrong = wrong_utm_zone(utm(survey), 32, southern=False, exposures_deg=exposures[:, :2])
    assert [finding.code for finding in wrong] == ["wrong-utm-zone"]
    assert "zone 33 N" in english(wrong[0])


def test_helenenschacht_control_is_measured_in_seven_images(helenenschacht: Path) -> None:
    lines = (helenenschacht / "gcp_list.txt").read_text(encoding="utf-8-sig").splitlines()[1:]
    rows = [line.split("\t") for line in lines if line.strip()]
    observations = tuple((row[5], f"G{row[0]}") for row in rows)
    names = tuple(sorted({point for _, point in observations}))
    assert len(names) == 5
    assert control_in_few_images(names, observations, "control") == ()
    # The first point loses all but its first measurement.
    others = tuple(entry for entry in observations if entry[1] != observations[0][1])
    found = control_in_few_images(names, (observations[0], *others), "control")
    assert [finding.code for finding in found] == ["one-image-only"]
    assert f"Control point {observations[0][1]}:" in english(found[0])


def test_berlin_control(shared: Path) -> None:
    folder = shared / "data" / "opensfm-berlin-gcp"
    points = json.loads((folder / "ground_control_points.json").read_text(encoding="utf-8"))["points"]
    placed = [point for point in points if "position" in point]
    assert 0 < len(placed) < len(points)
    observations = tuple(
        (entry["shot_id"], point["id"]) for point in points for entry in point["observations"]
    )
    found = control_in_few_images(tuple(point["id"] for point in placed), observations, "control")
    # True of the file: point 3 is marked in 02.jpg only.
    assert [finding.code for finding in found] == ["one-image-only"]
    assert english(found[0]).startswith("Control point 3:")
    reference = json.loads((folder / "reconstruction_example.json").read_text(encoding="utf-8"))[0][
        "reference_lla"
    ]
    latitude, longitude = (
        np.array([point["position"][key] for point in placed]) for key in ("latitude", "longitude")
    )
    flight = np.array([[reference["latitude"], reference["longitude"]]])
    assert latitude_longitude_swapped(latitude, longitude, flight) == ()
    assert [f.code for f in latitude_longitude_swapped(longitude, latitude, flight)] == [
        "latitude-longitude-swapped"
    ]
    assert geodesic_m(float(latitude[0]), float(longitude[0]), *flight[0].tolist()) < 200.0
    heights = ObjectPoints(
        tuple(point["id"] for point in placed),
        np.array([[0.0, 0.0, point["position"]["altitude"]] for point in placed]),
    )
    assert heights_all_equal(heights, "control") == ()
