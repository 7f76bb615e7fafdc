"""ODM's gcp_list.txt and geo.txt."""

from __future__ import annotations

import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from photocal.base.errors import InputMalformedError
from photocal.exchange.ground_points import (
    angles_of_geo,
    read_gcp_list,
    read_gcp_rows,
    read_geo,
    write_gcp_list,
    write_geo,
)
from photocal.exchange.parts import Mark

NAME = st.text(st.characters(categories=("L", "N")), min_size=1, max_size=8)
FLOAT = st.floats(-1e7, 1e7, allow_nan=False)


@given(
    st.lists(
        st.tuples(st.tuples(FLOAT, FLOAT, FLOAT), FLOAT, FLOAT),
        max_size=8,
        unique_by=lambda row: tuple(v + 0.0 for v in row[0]),
    )
)
@settings(max_examples=30)
def test_gcp_list_round_trip(tmp_path_factory: pytest.TempPathFactory, rows: list) -> None:  # type: ignore[type-arg]
    path = tmp_path_factory.mktemp("gcp") / "gcp_list.txt"
    places = {f"p{k}": xyz for k, (xyz, _, _) in enumerate(rows)}
    marks = [Mark("a.jpg", f"p{k}", x, y, (1.0, 1.0), "") for k, (_, x, y) in enumerate(rows)]
    write_gcp_list(path, "EPSG:32632", places, marks)
    crs, found, again = read_gcp_list(path)
    assert crs == "EPSG:32632"
    assert found == places
    assert [replace(mark, place="") for mark in again] == marks


@pytest.mark.shared
def test_recorded_gcp_list(shared: Path) -> None:
    crs, places, marks = read_gcp_list(shared / "data" / "rtk-mrk-gcp-helenenschacht" / "gcp_list.txt")
    assert crs == "EPSG:4326"
    assert len(marks) == 35
    assert len(places) == len({mark.point for mark in marks}) == 5


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("1 2 3 4 5 a.jpg\n", "not with a coordinate system"),
        ("EPSG:31982\n1\t2\t\t4\t5\ta.jpg\n", "4 values where 5 were expected"),
        (
            "EPSG:39791798743.39 -68423.09 179.77 4033 1367 image1.tif\n1 2 3 4 5 a.jpg\n",
            "not with a coordinate",
        ),
        ("EPSG:4326\n1 2 3 4 a.jpg\n", "has 5 cells"),
        ("EPSG:4326\n1 2 nan 4 5 a.jpg\n", "not finite"),
        ("EPSG:4326\n1 2 3 4 5 a.jpg p\n1 2 3 4 5 b.jpg q\n", "same coordinates"),
        ("EPSG:4326\n1 2 3 4 5 a.jpg p\n1 2 4 4 5 b.jpg p\n", "listed twice"),
        ("EPSG:4326\n1 2 3 4 5 a.jpg p\n1 2 3 4 6 a.jpg p\n", "listed twice"),
    ],
)
def test_bad_gcp_list(tmp_path: Path, text: str, message: str) -> None:
    (tmp_path / "gcp_list.txt").write_text(text)
    with pytest.raises(InputMalformedError, match=message):
        read_gcp_list(tmp_path / "gcp_list.txt")


def test_geo_round_trip(tmp_path: Path) -> None:
    nan = math.nan
    given_ = {
        "a.jpg": [8.5, 47.25, 500.125, 10.0, -90.0, 0.5, 0.02, 0.04],
        "b.jpg": [8.5, 47.25, nan, nan, nan, nan, nan, nan],
        "c.jpg": [8.5, 47.25, 501.0, nan, nan, nan, 0.02, 0.04],
    }
    write_geo(tmp_path / "geo.txt", "EPSG:4326", given_)
    crs, again = read_geo(tmp_path / "geo.txt")
    assert crs == "EPSG:4326"
    assert repr(again) == repr(given_)


def test_angles_are_those_of_a_body_whose_camera_looks_down() -> None:
    """The sequence yaw, pitch, roll of a body (forward, right, down) in north, east, down."""
    given_ = np.array([[0.0, 0.0, 0.0], [90.0, 0.0, 0.0], [215.0, 12.0, -7.0], [300.0, -30.0, 20.0]])
    body = Rotation.from_euler("ZYX", given_, degrees=True).as_matrix()
    forward, right, down = np.moveaxis(body, 2, 0)
    camera = np.stack([right, forward, -down], axis=1)
    to_camera = camera[:, :, [1, 0, 2]] * [1.0, 1.0, -1.0]
    assert angles_of_geo(to_camera) == pytest.approx(given_, abs=1e-9)
    # Looks down, the upper edge of the image to the east.
    assert to_camera[1] @ [1.0, 0.0, 0.0] == pytest.approx([0.0, 1.0, 0.0])
    assert np.isnan(angles_of_geo(np.full((1, 3, 3), np.nan))).all()


@pytest.mark.parametrize(
    ("head", "crs"),
    [
        ("WGS84 UTM 22S", "EPSG:32722"),
        ("wgs84  utm 17 n", "EPSG:32617"),
        ("WGS84 longlat", "EPSG:4326"),
        ("EPSG:31982+5773", "EPSG:31982+5773"),
        ("+proj=utm +zone=37 +south +datum=WGS84", "+proj=utm +zone=37 +south +datum=WGS84"),
    ],
)
def test_heads_of_lists_of_real_flights(tmp_path: Path, head: str, crs: str) -> None:
    (tmp_path / "gcp_list.txt").write_text(f"{head} \r\n1 2 3 4 5 a.jpg \r\n")
    assert read_gcp_list(tmp_path / "gcp_list.txt")[0] == crs


@pytest.mark.parametrize(
    "row",
    [
        "1.5 2.5 3 10 20 a.jpg p",
        "1,5 2,5 3 10 20 a.jpg p",
        "1,5;2,5;3;10;20;a.jpg;p",
        "1.5,2.5,3,10,20,a.jpg,p",
        "1.5, 2.5, 3, 10, 20, a.jpg, p",
        '1.5 2.5 3 10 20 "a.jpg" "p"',
    ],
)
def test_separators_of_gcp_lists(tmp_path: Path, row: str) -> None:
    path = tmp_path / "gcp_list.txt"
    path.write_text(f"EPSG:32722\n{row}\n")
    _, places, (mark,) = read_gcp_list(path)
    assert places == {"p": (1.5, 2.5, 3)}
    assert (mark.x, mark.y, mark.image, mark.point) == (10, 20, "a.jpg", "p")


@pytest.mark.parametrize(
    "row",
    [
        "{x}.5\t2.5\t3\t10\t20\tIMG {n}.JPG\tGCP {x}",
        "{x},5;2,5;3;10;20;IMG {n}.JPG;GCP {x}",
        "{x}.5,2.5,3,10,20,IMG {n}.JPG,GCP {x}",
        "{x}.5 2.5 3 10 20 IMG {n}.JPG GCP {x}",
        "{x}.5\t2.5\t3\t10\t20\tGCP {x}\tIMG {n}.JPG",
        "{x}.5 2.5 3 10 20 GCP {x} IMG {n}.JPG",
    ],
)
def test_names_with_blanks_in_typed_lists(tmp_path: Path, row: str) -> None:
    """Of pictures and points, and in either order where the endings of the pictures tell."""
    path = tmp_path / "gcp_list.txt"
    rows = [row.format(x=x, n=n) for x in range(2) for n in range(2)]
    path.write_text("\n".join(["EPSG:32722", *rows]) + "\n")
    if "GCP {x} IMG" in row:
        # Between blanks alone nothing tells where the point ends.
        path.write_text(path.read_text().replace("GCP ", "GCP").replace("IMG ", "IMG"))
    _, read, _ = read_gcp_rows(path)
    assert [(r.name.replace(" ", ""), r.image.replace(" ", "")) for r in read] == [
        (f"GCP{x}", f"IMG{n}.JPG") for x in range(2) for n in range(2)
    ]


@pytest.mark.parametrize("head", ["EPSG 32722", "epsg:32722", "EPSG=32722", "EPSG:32722 ; metres"])
def test_codes_as_people_type_them(tmp_path: Path, head: str) -> None:
    (tmp_path / "gcp_list.txt").write_text(f"{head}\n1 2 3 4 5 a.jpg p\n")
    assert read_gcp_rows(tmp_path / "gcp_list.txt")[0] == "EPSG:32722"


@pytest.mark.parametrize("encoding", ["utf-16-le", "utf-16-be"])
def test_utf_16_with_changed_line_ends_is_no_list(tmp_path: Path, encoding: str) -> None:
    """A copy as text puts a byte before each end of line, and cuts what follows in two."""
    path = tmp_path / "gcp_list.txt"
    text = "\ufeffEPSG:2180\n1 2 3 4 5 a.jpg P\n1 2 3 4 5 b.jpg P\n1 2 3 4 5 c.jpg P\n"
    path.write_bytes(text.encode(encoding))
    assert len(read_gcp_rows(path)[1]) == 3
    path.write_bytes(text.encode(encoding).replace(b"\n", b"\r\n"))
    with pytest.raises(InputMalformedError, match="line ends were changed as if it were plain text"):
        read_gcp_rows(path)
