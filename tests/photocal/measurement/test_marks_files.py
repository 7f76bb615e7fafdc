"""Marks of other programs: their columns, origins and names of images, and what is refused."""

from __future__ import annotations

from pathlib import Path

import pytest

from photocal.base.errors import InputMalformedError
from photocal.exchange.parts import Mark
from photocal.measurement.marks import BY_HAND_PX, named_after, read_any_marks

from .test_control_files import MARKERS

SIZES = {"a.jpg": (4000, 3000), "B.JPG": (4000, 3000)}
# All of them mark the centre of the upper-left pixel in a.jpg, and (10, 20) of our own origin in B.JPG.
TRUTH = [("a.jpg", "G1", 0.0, 0.0), ("B.JPG", "G2", 10.0, 20.0)]
SAME = {
    "pix4d_matic.csv": "a.jpg,G1,0.5,0.5,1.22678\nB.JPG,G2,10.5,20.5,0.8\n",
    "pix4d_mapper.txt": "D:\\flight 1\\images\\a.jpg,G1,0.5,0.5\nD:\\flight 1\\images\\B.JPG,G2,10.5,20.5\n",
    "pix4d_tabs.txt": "images/a.jpg\tG1\t0.5\t0.5\nimages/B.JPG\tG2\t10.5\t20.5\n",
    "metashape.csv": "image_label,gcp_name,image_u,image_v\na,G1,0.5,0.5\nB,G2,10.5,20.5\n",
    "metashape_quoted.csv": 'Marker label;Camera label;X;Y\n"G1";"a";0.5;0.5\n"G2";"B";10.5;20.5\n',
    "own.csv": "image,point,x,y\na.jpg,G1,0,0\nB.JPG,G2,10,20\n",
    "proj.txt": "+proj=utm +zone=33 +datum=WGS84 +units=m +no_defs\n"
    "1 2 3 0 0 a.jpg G1 0.01 bolt\n4 5 6 10 20 B.JPG G2 0.01 nail in a kerb\n",
    "gcp_list.txt": "EPSG:32633\n1 2 3 0 0 a.jpg G1\n4 5 6 10 20 B.JPG G2\n",
}


@pytest.mark.parametrize("name", SAME)
def test_the_same_marks_from_all_programs(name: str, tmp_path: Path) -> None:
    (tmp_path / name).write_text(SAME[name], encoding="utf-8")
    marks = read_any_marks(tmp_path / name, SIZES)
    assert [(m.image, m.point, m.x, m.y) for m in marks] == TRUTH
    assert {m.sigma for m in marks} == {(BY_HAND_PX, BY_HAND_PX)}


def test_all_markers_of_metashape_with_their_files(tmp_path: Path) -> None:
    """Also those without coordinates: a control table has them. Cameras may stand in groups."""
    text = MARKERS.replace("a.jpg", "a").replace('<camera id="7" label="b.jpg"/>', "")
    text = text.replace("</cameras>", '<group><camera id="7" label="B"/></group></cameras>')
    (tmp_path / "markers.xml").write_text(text)
    marks = read_any_marks(tmp_path / "markers.xml", SIZES)
    assert [(m.image, m.point, m.x, m.y) for m in marks] == [
        ("a.jpg", "G1", 100.0, 50.0),
        ("B.JPG", "G2", 9.75, 19.5),
        ("B.JPG", "T1", 0.5, 1.5),
    ]


def test_cameras_of_several_sensors_are_one_list(tmp_path: Path) -> None:
    """Cameras name their sensor; marks name the camera alone."""
    text = MARKERS.replace('label="a.jpg"', 'label="a.jpg" sensor_id="0"')
    text = text.replace('label="b.jpg"', 'label="B.JPG" sensor_id="1"')
    sensors = '<sensors><sensor id="0" label="wide"/><sensor id="1" label="tele"/></sensors>'
    (tmp_path / "markers.xml").write_text(text.replace("<cameras>", sensors + "<cameras>"))
    marks = read_any_marks(tmp_path / "markers.xml", SIZES)
    assert [(m.image, m.point) for m in marks] == [("a.jpg", "G1"), ("B.JPG", "G2"), ("B.JPG", "T1")]


def test_names_in_doubt_stay_as_they_are() -> None:
    marks = [Mark(name, "P", 1, 2, (1, 1), "") for name in ("a", "b", "c", "c.png", "x/c.png")]
    found = named_after(marks, ["a.jpg", "a.tif", "b.jpg", "c.png"])
    assert [m.image for m in found] == ["a", "b.jpg", "c.png", "c.png", "c.png"]


@pytest.mark.parametrize(
    ("name", "content", "said"),
    [
        ("m.csv", "photo,gcp,left,top\na.jpg,G1,1,2\n", "does not say which column is the x"),
        ("m.csv", "a.jpg,G1,1\n", "does not say which column is the image"),
        ("m.csv", "a.jpg,G1,1,2\nB.JPG,G2,3\n", r"line 2: has 3 cells where image, point, x, y"),
        ("m.csv", "a.jpg,G1,1,2\nB.JPG,G2,three,4\n", r"line 2"),
        ("m.csv", "a.jpg,G1,1,2\na.jpg,G1,1,2\n", "point G1 in image a.jpg is listed twice"),
        ("m.csv", "a.jpg,G1,nan,2\nB.JPG,G1,1,inf\n", "line 1"),
        ("m.csv", "image_name,gcp_name,image_u,image_v\n", "has no marks"),
        ("m.txt", "nothing at all\n", "coordinate system"),
        ("m.xml", "<document><chunk><cameras/></chunk></document>", "has no marks"),
        ("m.xml", "<document>", "m.xml"),
        ("m.xml", "<document><chunk/><chunk/></document>", "has 2 chunks where one was expected"),
        (
            "m.xml",
            "<gcps><GCP label='1'/></gcps>",
            "is not an XML file of Metashape.*marks as CSV",
        ),
        ("m.json", "[]", "is not a ground_control_points"),
    ],
)
def test_wrong_files_are_named(name: str, content: str, said: str, tmp_path: Path) -> None:
    (tmp_path / name).write_text(content)
    with pytest.raises(InputMalformedError, match=said) as caught:
        read_any_marks(tmp_path / name, SIZES)
    assert name in str(caught.value)
