from __future__ import annotations

import json
import re
import zipfile
from contextlib import suppress
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from pyproj import Geod

from photocal.base.errors import InputMalformedError, InputNotFoundError, PhotocalError
from photocal.planning.area import Area, LocalPlane, area_from_corners, inside, polygon_area, read_area

# Longitude and latitude of the target field of the Phantom 4 Pro study, its convex hull in order.
FIELD = [
    (-51.29483, -28.85172),
    (-51.29598, -28.85312),
    (-51.29588, -28.85446),
    (-51.29575, -28.85586),
    (-51.29408, -28.8554),
    (-51.29339, -28.85368),
    (-51.29357, -28.85211),
]
RING = [*FIELD, FIELD[0]]
POLYGON = {"type": "Polygon", "coordinates": [RING]}
KML = """<?xml version="1.0" encoding="UTF-8"?>
<kml xmlns="http://www.opengis.net/kml/2.2"><Document><Placemark><name>field</name><Polygon><outerBoundaryIs>
<LinearRing><coordinates>{}</coordinates></LinearRing></outerBoundaryIs></Polygon></Placemark></Document></kml>"""


def written(tmp_path: Path, name: str, content: str) -> Path:
    path = tmp_path / name
    path.write_text(content, encoding="utf-8")
    return path


def texts() -> dict[str, str]:
    feature: dict[str, Any] = {"type": "Feature", "geometry": POLYGON, "properties": {}}
    return {
        "a.geojson": json.dumps({"type": "FeatureCollection", "features": [feature]}),
        "b.geojson": json.dumps(feature),
        "c.json": json.dumps(POLYGON),
        "e.geojson": json.dumps({"type": "GeometryCollection", "geometries": [POLYGON]}),
        "d.geojson": json.dumps({"type": "MultiPolygon", "coordinates": [[RING]]}),
        "e.kml": KML.format(" ".join(f"{lon},{lat},0" for lon, lat in RING)),
        "f.kml": KML[KML.index("<Polygon") : KML.index("</Placemark")].format(
            " ".join(f"{lon},{lat}" for lon, lat in RING)
        ),
        "f.csv": "lat_deg,lon_deg\n" + "".join(f"{lat},{lon}\n" for lon, lat in FIELD),
    }


@pytest.mark.parametrize("name", sorted(texts()))
def test_every_form_gives_the_same_area(tmp_path: Path, name: str) -> None:
    area = read_area(written(tmp_path, name, texts()[name]))
    assert list(zip(area.longitude_deg.tolist(), area.latitude_deg.tolist(), strict=True)) == FIELD


def test_a_place_as_google_earth_saves_it(tmp_path: Path) -> None:
    with zipfile.ZipFile(tmp_path / "field.kmz", "w") as packed:
        packed.writestr("files/camera.png", b"")
        packed.writestr("doc.kml", texts()["e.kml"])
    assert read_area(tmp_path / "field.kmz").longitude_deg.tolist() == [lon for lon, _ in FIELD]
    with pytest.raises(InputMalformedError, match="is not KMZ"):
        read_area(written(tmp_path, "b.kmz", texts()["e.kml"]))


def test_area_of_the_published_target_field() -> None:
    area = area_from_corners(list(FIELD), "field")
    corners = LocalPlane(*area.centre_deg).to_plane(area.latitude_deg, area.longitude_deg)
    assert abs(polygon_area(corners)) / 1e4 == pytest.approx(8.51, abs=0.005)
    assert np.ptp(corners, axis=0) == pytest.approx([252.7, 458.9], abs=0.06)
    # A second method: the geodesic polygon on the ellipsoid.
    geodesic = Geod(ellps="WGS84").polygon_area_perimeter(area.longitude_deg, area.latitude_deg)[0]
    assert abs(polygon_area(corners)) == pytest.approx(abs(geodesic), rel=1e-6)


@given(
    st.floats(-80.0, 80.0), st.floats(-179.0, 179.0), st.floats(-2000.0, 2000.0), st.floats(-2000.0, 2000.0)
)
def test_the_plane_keeps_distances_and_comes_back(lat: float, lon: float, east: float, north: float) -> None:
    plane = LocalPlane(lat, lon)
    latitude, longitude = plane.to_degrees(np.array([[0.0, 0.0], [east, north]]))
    distance = Geod(ellps="WGS84").inv(longitude[0], latitude[0], longitude[1], latitude[1])[2]
    assert distance == pytest.approx(float(np.hypot(east, north)), abs=1e-3)
    assert plane.to_plane(latitude, longitude)[1] == pytest.approx([east, north], abs=1e-3)


def test_inside_agrees_with_a_hand_drawn_polygon() -> None:
    corners = np.array([[0.0, 0.0], [10.0, 0.0], [10.0, 10.0], [5.0, 2.0], [0.0, 10.0]])
    points = np.array([[5.0, 1.0], [5.0, 5.0], [1.0, 5.0], [9.0, 5.0], [-1.0, 1.0], [11.0, 1.0]])
    assert inside(points, corners).tolist() == [True, False, True, True, False, False]


def swapped() -> str:
    return json.dumps({"type": "Polygon", "coordinates": [[[lat, lon * 2] for lon, lat in RING]]})


@pytest.mark.parametrize(
    ("name", "content", "message"),
    [
        ("a.geojson", "", "not JSON"),
        ("a.geojson", "[1]", "not GeoJSON"),
        ("a.geojson", "{}", "0 polygons"),
        ("a.geojson", json.dumps({"type": "Point", "coordinates": [0, 0]}), "0 polygons"),
        ("a.geojson", json.dumps({"type": "MultiPolygon", "coordinates": [[RING], [RING]]}), "2 polygons"),
        ("a.geojson", json.dumps({"type": "Polygon", "coordinates": [RING, RING]}), "holes"),
        ("a.geojson", json.dumps({"type": "Polygon", "coordinates": [[["x", 1]]]}), "not a position"),
        ("a.geojson", json.dumps({"type": "Polygon", "coordinates": [RING[:2]]}), "fewer than three"),
        ("a.geojson", swapped(), "swapped"),
        ("a.geojson", json.dumps({"type": "Polygon", "coordinates": [[[0, 0], [9, 0], [9, 9]]]}), "100 km"),
        (
            "a.geojson",
            json.dumps({"type": "Polygon", "coordinates": [[[0, 0], [0.01, 0.01], [0.01, 0], [0, 0.01]]]}),
            "cross",
        ),
        ("a.kml", "<kml>", "not KML"),
        ("a.kml", "<kml/>", "0 polygons"),
        ("a.kml", KML.format("1 2 3"), "lon,lat"),
        ("a.csv", "lat,lon\n1,2\n", "lat_deg"),
        ("a.csv", "lat_deg,lon_deg\n1,x\n", "line 2"),
        ("a.shp", "x", "unknown kind"),
    ],
)
def test_what_is_no_area_is_refused_in_one_line(
    tmp_path: Path, name: str, content: str, message: str
) -> None:
    with pytest.raises(InputMalformedError, match=re.escape(message)) as failure:
        read_area(written(tmp_path, name, content))
    assert "\n" not in str(failure.value)


def test_entities_in_kml_are_refused(tmp_path: Path) -> None:
    bomb = '<!DOCTYPE x [<!ENTITY a "aaaa"><!ENTITY b "&a;&a;">]><kml>&b;</kml>'
    with pytest.raises(InputMalformedError, match="not KML"):
        read_area(written(tmp_path, "bomb.kml", bomb))


def test_missing_and_binary_files(tmp_path: Path) -> None:
    with pytest.raises(InputNotFoundError):
        read_area(tmp_path / "none.kml")
    (tmp_path / "b.kml").write_bytes(b"\xff\xfe\x00\x9d")
    with pytest.raises(InputMalformedError, match="UTF-8"):
        read_area(tmp_path / "b.kml")


numbers = st.one_of(st.floats(-200, 200), st.integers(-1000, 1000), st.none(), st.text(max_size=3))
anything = st.recursive(
    numbers,
    lambda children: (
        st.lists(children, max_size=4)
        | st.dictionaries(
            st.sampled_from(["type", "coordinates", "geometry", "features"]), children, max_size=3
        )
    ),
    max_leaves=12,
)


@given(st.sampled_from(["Polygon", "MultiPolygon", "Feature", "FeatureCollection", "Point"]), anything)
def test_any_json_is_read_or_refused(
    tmp_path_factory: pytest.TempPathFactory, kind: str, content: Any
) -> None:
    path = tmp_path_factory.getbasetemp() / "fuzz.geojson"
    body = {"type": kind, "coordinates": content, "geometry": content, "features": content}
    path.write_text(json.dumps(body), encoding="utf-8")
    with suppress(PhotocalError):
        assert isinstance(read_area(path), Area)
