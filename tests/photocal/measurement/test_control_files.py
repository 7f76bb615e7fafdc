"""Marked control points from other programs, and marks tables."""

from __future__ import annotations

import json
from pathlib import Path

import pytest
from pyproj import Transformer

from photocal.base.errors import ConfigurationError, InputMalformedError, PhotocalError
from photocal.measurement.marks import BY_HAND_PX, in_map_system, read_control_marks, read_marks

SIGMA = (0.02, 0.03)
MARKERS = """<?xml version="1.0" encoding="UTF-8"?>
<document version="2.0.0"><chunk label="c" enabled="true">
<cameras><camera id="4" label="a.jpg"/><camera id="7" label="b.jpg"/></cameras>
<markers next_id="3">
<marker id="0" label="G1"><reference x="500000" y="7000000" z="30.5" sx="0.01" sy="0.01" sz="0.02"
enabled="true"/></marker>
<marker id="1" label="G2"><reference x="500010" y="7000000" z="31" enabled="false"/></marker>
<marker id="2" label="T1"/>
</markers>
<frames><frame id="0"><markers>
<marker marker_id="0"><location camera_id="4" pinned="true" x="100.5" y="50.5"/>
<location camera_id="7" pinned="false" x="80" y="60"/></marker>
<marker marker_id="1"><location camera_id="7" pinned="1" x="10.25" y="20"/></marker>
<marker marker_id="2"><location camera_id="7" pinned="1" x="1" y="2"/></marker>
</markers></frame></frames>
<reference>EPSG:31982</reference></chunk></document>
"""


def test_markers_of_metashape(tmp_path: Path) -> None:
    """Half a pixel is taken off, predicted places are left out, markers that are off are check points."""
    path = tmp_path / "markers.xml"
    path.write_text(MARKERS)
    found = read_control_marks(path, SIGMA, {})
    assert found.crs == "EPSG:31982"
    assert found.points.names == ("G1", "G2")
    assert found.points.of_role("control").tolist() == [True, False]
    assert found.points.sigma.tolist() == [[0.01, 0.01, 0.02], [0.02, 0.02, 0.03]]
    assert [(m.image, m.point, m.x, m.y) for m in found.marks] == [
        ("a.jpg", "G1", 100.0, 50.0),
        ("b.jpg", "G2", 9.75, 19.5),
    ]
    assert found.without_coordinates == ("T1",)
    path.write_text(MARKERS.replace("<location", "<elsewhere"))
    with pytest.raises(InputMalformedError, match="no placed markers"):
        read_control_marks(path, SIGMA, {})


@pytest.mark.shared
def test_the_list_of_a_recorded_flight_in_its_zone(shared: Path) -> None:
    """The table beside it has the same points in UTM zone 33 north."""
    folder = shared / "data/rtk-mrk-gcp-helenenschacht"
    found = in_map_system(read_control_marks(folder / "gcp_list.txt", SIGMA, {}))
    assert found.crs == "EPSG:32633"
    assert len(found.points.names) == 5
    assert len(found.marks) == 35
    table = (folder / "latlon-easting_northing.csv").read_text(encoding="utf-8-sig").splitlines()[1:]
    rows = {cells[0]: [float(c) for c in cells[1:4]] for cells in (line.split(";") for line in table)}
    # The two tables of the survey differ by up to 35 mm.
    for name, place in zip(found.points.names, found.points.values, strict=True):
        assert place == pytest.approx(rows[name], abs=0.05)


@pytest.mark.shared
def test_control_of_opensfm(shared: Path) -> None:
    """Against the conversion its documentation gives: from the middle, over the longer side."""
    path = shared / "data/opensfm-berlin-gcp/ground_control_points.json"
    sizes = {f"0{k}.jpg": (3264, 2448) for k in (1, 2, 3)}
    found = read_control_marks(path, SIGMA, sizes)
    first = next(m for m in found.marks if (m.point, m.image) == ("0", "02.jpg"))
    assert first.x == pytest.approx(-0.015689 * 3264 + 3263 / 2)
    assert first.y == pytest.approx(-0.0625362 * 3264 + 2447 / 2)
    assert "1" in found.without_coordinates
    moved = in_map_system(found)
    back = Transformer.from_crs(moved.crs, "EPSG:4326", always_xy=True).transform(*moved.points.values[0, :2])
    assert back == pytest.approx(tuple(found.points.values[0, :2]), abs=1e-9)


@pytest.mark.parametrize(
    ("name", "content", "said"),
    [
        ("g.json", "{}", "is not a ground_control_points"),
        ("g.json", json.dumps({"points": [{"id": 1}]}), "no point with coordinates"),
        ("g.xml", "<document><chunk/><chunk/></document>", "has 2 chunks"),
        ("g.txt", "EPSG:31982\n1 2 3 4\n", "has 4 cells"),
    ],
)
def test_wrong_files_are_named(name: str, content: str, said: str, tmp_path: Path) -> None:
    (tmp_path / name).write_text(content)
    with pytest.raises(PhotocalError, match=said) as caught:
        read_control_marks(tmp_path / name, SIGMA, {})
    assert name in str(caught.value)


def test_impossible_systems(tmp_path: Path) -> None:
    path = tmp_path / "gcp_list.txt"
    path.write_text("EPSG:4326\n-22.9 943.2 30 100 100 a.jpg P1\n")
    with pytest.raises(ConfigurationError, match="latitude and longitude exchanged"):
        in_map_system(read_control_marks(path, SIGMA, {}))
    path.write_text("EPSG:999999\n1 2 3 100 100 a.jpg P1\n")
    with pytest.raises(ConfigurationError, match="is not known"):
        in_map_system(read_control_marks(path, SIGMA, {}))


def test_tables_of_marks(tmp_path: Path) -> None:
    path = tmp_path / "marks.csv"
    path.write_text("image,point,x,y,sx,sy\na.jpg,P1,1.5,2.5,0.1,0.2\nb.jpg,P1,3,4,,\n")
    first, second = read_marks(path)
    assert (first.image, first.point, first.x, first.y, first.sigma) == ("a.jpg", "P1", 1.5, 2.5, (0.1, 0.2))
    assert second.sigma == (BY_HAND_PX, BY_HAND_PX)
    path.write_text("image,point,x,y\na.jpg,P1,1,2\na.jpg,P1,3,4\n")
    with pytest.raises(InputMalformedError, match="already marked"):
        read_marks(path)
