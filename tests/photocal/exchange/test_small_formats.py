"""OpenSfM, ODM's lists, Pix4D, PATB, Inpho, GeoJSON and KML."""

from __future__ import annotations

import json
import math
import sqlite3
import struct
from contextlib import closing
from pathlib import Path
from typing import Literal
from xml.etree.ElementTree import parse

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from drivers.errors import ConfigurationError, InputMalformedError, PhotocalError
from photocal.exchange.geographic import Origin, footprints, topocentric, write_geojson, write_kml
from photocal.exchange.geopackage import write_geopackage
from photocal.exchange.ground_points import (
    GroundMark,
    ImagePosition,
    read_gcp_list,
    read_geo,
    write_gcp_list,
    write_geo,
)
from photocal.exchange.jaicov import read_jaicov, write_jaicov
from photocal.exchange.opensfm import read_cameras, read_reconstruction, write_opensfm
from photocal.exchange.orientation_tables import (
    read_angles,
    read_inpho,
    read_matrices,
    write_angles,
    write_inpho,
    write_matrices,
)
from photocal.exchange.pinhole import to_vision
from photocal.exchange.pix4d import read_pix4d, write_pix4d
from photocal.exchange.reconstruction import Reconstruction
from photocal.exchange.reference_table import Reference, read_references, write_references
from photocal.geometry.camera import camera, pixel_to_plane, plane_to_pixel
from photocal.geometry.distortion import projected

# OpenSfM


def test_opensfm_round_trip(tmp_path: Path, vision: Reconstruction) -> None:
    from dataclasses import replace

    named = replace(vision, cameras=tuple(replace(own, id=f"v{k}") for k, own in enumerate(vision.cameras)))
    assert all(made.largest_px == 0 for made in write_opensfm(tmp_path, named))
    again = read_reconstruction(tmp_path / "reconstruction.json")
    np.testing.assert_allclose(again.poses, vision.poses, rtol=1e-9, atol=1e-9)
    np.testing.assert_allclose(again.xyz, vision.xyz, rtol=1e-12)
    for own, other in zip(vision.cameras, read_cameras(tmp_path / "cameras.json"), strict=True):
        np.testing.assert_allclose(other.values, own.values, rtol=1e-9, atol=1e-15)


def test_opensfm_normalised_coordinates(tmp_path: Path, vision: Reconstruction) -> None:
    """OpenSfM's own definition: (column + 0.5 - width / 2) / larger side."""
    write_opensfm(tmp_path, vision)
    rows = [line.split("\t") for line in (tmp_path / "tracks.csv").read_text().splitlines()[1:]]
    x = np.array([float(row[3]) for row in rows])
    np.testing.assert_allclose(x * 4608 - 0.5 + 4608 / 2, vision.pixels[:, 0], atol=1e-9)


@pytest.mark.shared
def test_opensfm_example(shared: Path) -> None:
    """Berlin: the published reconstruction reprojects into its published tracks."""
    folder = shared / "data" / "opensfm-berlin-gcp"
    found = read_reconstruction(folder / "reconstruction_example.json")
    point = {name: k for k, name in enumerate(found.point_names)}
    image = {name: k for k, name in enumerate(found.image_names)}
    own = found.cameras[0]
    miss = []
    for line in (folder / "tracks_example.csv").read_text().splitlines()[1:]:
        name, track, _, x, y = line.split("\t")[:5]
        if track in point and name in image:
            rotation, translation = to_vision(found.poses[image[name]])
            q = rotation @ found.xyz[point[track]] + translation
            pixel = plane_to_pixel(own.size_px, own.pitch, projected(own, (q * [1, -1, -1])[None]))[0]
            miss.append(pixel - [float(x) * 3264 + 3264 / 2 - 0.5, float(y) * 3264 + 2448 / 2 - 0.5])
    assert len(miss) > 1000
    # A few tenths of a per mille of the image; wrong axes or signs would give hundreds of pixels.
    assert np.sqrt(np.median(np.square(miss))) < 2


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("[]", "no reconstruction"),
        ("[{}]", "not the structure"),
        (
            '[{"cameras": {"a": {"projection_type": "fisheye", "width": 10, "height": 10}}, "shots": {}}]',
            "fisheye",
        ),
        (
            '[{"cameras": {"a": {"projection_type": "brown", "width": 1e12, "height": 10}}, "shots": {}}]',
            "impossible",
        ),
        ('[{"cameras": {"a": 5}, "shots": {}}]', "not the structure"),
        ('[{"cameras": {}, "shots": {"i": {"rotation": [0, 0, Infinity]}}}]', "not finite"),
        ('[{"cameras": {}, ', "no valid JSON"),
    ],
)
def test_bad_reconstruction(tmp_path: Path, text: str, message: str) -> None:
    (tmp_path / "r.json").write_text(text)
    with pytest.raises(InputMalformedError, match=message):
        read_reconstruction(tmp_path / "r.json")


# ODM's lists

NAME = st.text(st.characters(categories=("L", "N")), min_size=1, max_size=8)
FLOAT = st.floats(-1e7, 1e7, allow_nan=False)


@given(
    st.lists(
        st.tuples(st.tuples(FLOAT, FLOAT, FLOAT), FLOAT, FLOAT),
        max_size=8,
        unique_by=lambda row: tuple(v + 0.0 for v in row[0]),
    )
)
@settings(max_examples=30, deadline=None)
def test_gcp_list_round_trip(tmp_path_factory: pytest.TempPathFactory, rows: list) -> None:  # type: ignore[type-arg]
    path = tmp_path_factory.mktemp("gcp") / "gcp_list.txt"
    marks = [GroundMark(f"p{k}", xyz, x, y, "a.jpg", "") for k, (xyz, x, y) in enumerate(rows)]
    write_gcp_list(path, "EPSG:32632", marks)
    crs, again = read_gcp_list(path)
    assert crs == "EPSG:32632"
    assert [(m.point, m.xyz, m.column, m.row, m.image) for m in again] == [
        (m.point, m.xyz, m.column, m.row, m.image) for m in marks
    ]


@pytest.mark.shared
def test_recorded_gcp_list(shared: Path) -> None:
    crs, marks = read_gcp_list(shared / "data" / "rtk-mrk-gcp-helenenschacht" / "gcp_list.txt")
    assert crs == "EPSG:4326"
    assert len(marks) == 35
    assert len({mark.point for mark in marks}) == 5


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("1 2 3 4 5 a.jpg\n", "not with a coordinate system"),
        ("EPSG:4326\n1 2 3 4 a.jpg\n", "has 5 cells"),
        ("EPSG:4326\n1,5 2 3 4 5 a.jpg\n", "decimal comma"),
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
    given_ = [
        ImagePosition("a.jpg", (8.5, 47.25, 500.125), (10.0, -90.0, 0.5), (0.02, 0.04)),
        ImagePosition("b.jpg", (8.5, 47.25, nan), (nan,) * 3, (nan, nan)),
        ImagePosition("c.jpg", (8.5, 47.25, 501.0), (nan,) * 3, (0.02, 0.04)),
    ]
    write_geo(tmp_path / "geo.txt", "EPSG:4326", given_)
    crs, again = read_geo(tmp_path / "geo.txt")
    assert crs == "EPSG:4326"
    assert repr(again) == repr(tuple(given_))


# Pix4D


def test_pix4d_example() -> None:
    """The file printed in EasyIDP's documentation: its numbers by OpenCV's equations."""
    text = (
        "Pix4D camera calibration file 0\n"
        "#Focal Length mm assuming a sensor width of 17.49998592000000030566x13.12498944000000200560mm\n"
        "F 15.01175404934517487732\n#Principal Point mm\n"
        "Px 8.48210511970419922534\nPy 6.33434629978042273990\n"
        "#Symmetrical Lens Distortion Coeffs\nK1 0.03833474118270804865\nK2 -0.01750917966495743258\n"
        "K3 0.02049798716391852335\n#Tangential Lens Distortion Coeffs\nT1 0.00240851666319534747\n"
        "T2 0.00292562392135245920\n"
    )
    import tempfile

    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "maize.cam"
        path.write_text(text.replace("\n", "\r\n"))
        own = read_pix4d(path, (4608, 3456))
        write_pix4d(Path(folder) / "again.cam", own)
        again = read_pix4d(Path(folder) / "again.cam", (4608, 3456))
    np.testing.assert_allclose(again.values, own.values, rtol=1e-9, atol=1e-20)
    x, y = 0.3, -0.2
    r2 = x * x + y * y
    radial = 1 + 0.03833474118270805 * r2 - 0.017509179664957433 * r2**2 + 0.020497987163918523 * r2**3
    t1, t2 = 0.0024085166631953475, 0.002925623921352459
    u = 8.4821051197042 + 15.011754049345175 * (x * radial + 2 * t1 * x * y + t2 * (r2 + 2 * x * x))
    v = 6.334346299780423 + 15.011754049345175 * (y * radial + 2 * t2 * x * y + t1 * (r2 + 2 * y * y))
    pixel = plane_to_pixel(own.size_px, own.pitch, projected(own, np.array([[x, -y, -1.0]])))[0]
    np.testing.assert_allclose((pixel + 0.5) * 17.49998592 / 4608, [u, v], atol=1e-9)


def test_pix4d_wants_the_right_image_size(tmp_path: Path, photogrammetric: Reconstruction) -> None:
    write_pix4d(tmp_path / "a.cam", photogrammetric.cameras[0])
    with pytest.raises(InputMalformedError, match="does not fit images"):
        read_pix4d(tmp_path / "a.cam", (4000, 4000))


# JAICOV


def test_jaicov_round_trip(tmp_path: Path, vision: Reconstruction) -> None:
    from dataclasses import replace

    values = {"c": 28.7, "x0": 0.017, "y0": 0.057, "K1": -1.1e-4, "K2": 1.5e-7, "P1": 5.8e-6, "P2": -8.6e-6}
    own = camera(
        "1",
        "brown-ideal",
        "mm",
        (4608, 3456),
        (0.004, 0.004),
        values | {"B1": -7e-5, "B2": -3e-5},
        affinity="additive",
    )
    single = replace(vision, cameras=(own,), image_camera=np.zeros(6, dtype=np.int64))
    assert write_jaicov(tmp_path / "block", single).largest_px == 0
    block = read_jaicov(tmp_path / "block.ior", sigma_mm=0.0005)
    np.testing.assert_allclose(block.cameras[0].values, own.values, rtol=1e-9, atol=1e-18)
    np.testing.assert_allclose(block.images.values, vision.poses, rtol=1e-9, atol=1e-9)
    np.testing.assert_allclose(block.points.values, vision.xyz, rtol=1e-9, atol=1e-9)
    plane = pixel_to_plane(own.size_px, own.pitch, vision.pixels)
    np.testing.assert_allclose(block.observations.values, plane, rtol=1e-9, atol=1e-12)
    with pytest.raises(ConfigurationError, match="a priori"):
        read_jaicov(tmp_path / "block.ior")


@pytest.mark.parametrize(
    ("suffix", "old", "new", "message"),
    [
        (".ior", "-28.7", "28.7", "not negative"),
        (".ior", "4608", "46080000", "impossible"),
        (".eor", " 1 ", " 2 ", "not in the .ior"),
        (".eor", "\n2 ", "\n1 ", "listed twice"),
        (".obc", "100 ", "100 x", "not a number|values where"),
        (".phc", " 1 1 1\n", " 1 1\n", "10 values where"),
    ],
)
def test_bad_jaicov(
    tmp_path: Path, vision: Reconstruction, suffix: str, old: str, new: str, message: str
) -> None:
    from dataclasses import replace

    own = camera("1", "brown-ideal", "mm", (4608, 3456), (0.004, 0.004), {"c": 28.7})
    single = replace(vision, cameras=(own,), image_camera=np.zeros(6, dtype=np.int64))
    write_jaicov(tmp_path / "block", single)
    path = tmp_path / f"block{suffix}"
    text = path.read_text()
    assert old in text
    path.write_text(text.replace(old, new, 1))
    with pytest.raises(InputMalformedError, match=message):
        read_jaicov(tmp_path / "block.phc", sigma_mm=0.001)


# Metashape's reference tables


def test_reference_round_trip(tmp_path: Path) -> None:
    nan = math.nan
    rows = (
        Reference('a, "quoted".jpg', (999660.44, 112368.17, 1916.55), (0.05, 0.05, 0.1)),
        Reference("b", (1.0, 2.0, 3.0), (nan, nan, nan)),
    )
    write_references(tmp_path / "r.csv", 'LOCAL_CS["m"]', rows)
    crs, again = read_references(tmp_path / "r.csv")
    assert crs == 'LOCAL_CS["m"]'
    assert repr(again) == repr(rows)


@pytest.mark.shared
def test_recorded_references(shared: Path) -> None:
    _, rows = read_references(shared / "data" / "dbat-sxb" / "ref" / "fake-camera-positions.txt")
    assert [row.label for row in rows] == ["8811.jpg", "8936.jpg", "8937.jpg", "8938.jpg"]
    assert rows[0].xyz == (999660.44, 112368.17, 1916.55)
    assert rows[0].accuracy == (0.05, 0.05, 0.05)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("a,1,2,3\n", "no header"),
        ("#Label,X,Y\na,1,2\n", "no column Z"),
        ("#Label,X,Y,Z\na,1,2\n", "3 cells where the header has 4"),
        ("#Label,X,Y,Z\na,1,2,inf\n", "not finite"),
        ("#Label,X,Y,Z\na,1,2,3\na,1,2,3\n", "listed twice"),
        ('#Label,X,Y,Z\n"a,1,2,3\n', "no row of a table|cells where"),
    ],
)
def test_bad_references(tmp_path: Path, text: str, message: str) -> None:
    (tmp_path / "r.csv").write_text(text)
    with pytest.raises(InputMalformedError, match=message):
        read_references(tmp_path / "r.csv")


# Tables of orientations


@pytest.mark.parametrize("unit", ["deg", "gon"])
def test_angles_round_trip(tmp_path: Path, vision: Reconstruction, unit: Literal["deg", "gon"]) -> None:
    path = tmp_path / "ori.txt"
    write_angles(path, vision.image_names, vision.poses, unit)
    names, poses = read_angles(path, unit)
    assert names == vision.image_names
    np.testing.assert_allclose(poses, vision.poses, rtol=1e-12)
    first = [float(cell) for cell in path.read_text().splitlines()[1].split()[4:]]
    circle = 360 if unit == "deg" else 400
    np.testing.assert_allclose(np.array(first) / circle, vision.poses[0, :3] / (2 * np.pi), rtol=1e-12)


def test_matrices_round_trip(tmp_path: Path, vision: Reconstruction) -> None:
    write_matrices(tmp_path / "ori.txt", vision.image_names, vision.poses)
    np.testing.assert_allclose(read_matrices(tmp_path / "ori.txt")[1], vision.poses, rtol=1e-9)
    # Camera to object is the inverse of object to vision axes, with y and z turned back.
    cells = (tmp_path / "ori.txt").read_text().splitlines()[1].split()[4:]
    rotation, _ = to_vision(vision.poses[0])
    np.testing.assert_allclose(
        np.array(cells, float).reshape(3, 3), rotation.T @ np.diag([1, -1, -1]), atol=1e-12
    )


def test_inpho_round_trip(tmp_path: Path, vision: Reconstruction) -> None:
    write_inpho(tmp_path / "a.prj", vision.image_names, vision.poses, [100.5] * len(vision.poses))
    names, poses = read_inpho(tmp_path / "a.prj")
    assert names == vision.image_names
    np.testing.assert_allclose(poses, vision.poses, rtol=1e-9)


def test_bad_tables(tmp_path: Path) -> None:
    path = tmp_path / "ori.txt"
    for text, message in (
        ("a 1 2 3 390 0 0\n", "name their unit"),
        ("a 1 2 3 0 0\n", "5 values where 6"),
        ("a 1 2 3 0 0 0\na 1 2 3 0 0 0\n", "listed twice"),
        ("a 1 2 3 0 0,5 0\n", "decimal comma"),
        ("# nothing\n", "no exterior orientation"),
    ):
        path.write_text(text)
        with pytest.raises(InputMalformedError, match=message):
            read_angles(path, "deg")
    path.write_text("a 0 0 0 1 0 0 0 1 0 0 0 2\n")
    with pytest.raises(InputMalformedError, match="no rotation"):
        read_matrices(path)
    path.write_text("$PHOTO\n $PHOTO_NUM : 1\n $EXT_ORI :\n 100 1 2 3\n 1 0 0\n")
    with pytest.raises(InputMalformedError, match="ends inside"):
        read_inpho(path)


# GeoJSON, KML


def test_topocentric_against_the_textbook() -> None:
    """Closed form: geodetic to geocentric, turned and moved (Kaplan and Hegarty 2017, ch. 2)."""
    a, f = 6378137.0, 1 / 298.257223563
    lat, lon, h = math.radians(47.3), math.radians(8.6), 450.0
    e2 = f * (2 - f)

    def geocentric(phi: float, lam: float, height: float) -> np.ndarray:
        n = a / math.sqrt(1 - e2 * math.sin(phi) ** 2)
        return np.array(
            [
                (n + height) * math.cos(phi) * math.cos(lam),
                (n + height) * math.cos(phi) * math.sin(lam),
                (n * (1 - e2) + height) * math.sin(phi),
            ]
        )

    east = np.array([-math.sin(lon), math.cos(lon), 0])
    up = np.array([math.cos(lat) * math.cos(lon), math.cos(lat) * math.sin(lon), math.sin(lat)])
    local = np.array([120.0, -340.0, 25.0])
    there = geocentric(lat, lon, h) + local @ np.array([east, np.cross(up, east), up])
    found = topocentric(Origin(47.3, 8.6, 450.0))(local[None])[0]
    back = geocentric(math.radians(found[1]), math.radians(found[0]), found[2])
    assert np.abs(back - there).max() < 1e-6


def test_footprint_of_a_vertical_image(vision: Reconstruction) -> None:
    from dataclasses import replace

    pose = np.array([[0.0, 0.0, 0.0, 10.0, 20.0, 100.0]])
    own = vision.cameras[0].with_values([1000.0] + [0.0] * 12)
    single = replace(vision, cameras=(own,), image_names=("a",), image_camera=np.array([0]), poses=pose)
    # 4608 x 3456 px, c = 1000 px, 100 m above the plane.
    expected = [
        [10 - 230.4, 20 + 172.8, 0],
        [10 + 230.4, 20 + 172.8, 0],
        [10 + 230.4, 20 - 172.8, 0],
        [10 - 230.4, 20 - 172.8, 0],
    ]
    np.testing.assert_allclose(footprints(single, 0.0)[0], expected, atol=1e-9)
    assert np.isnan(footprints(single, 200.0)).all()


def test_geojson_and_kml(tmp_path: Path, vision: Reconstruction) -> None:
    turn = topocentric(Origin(47.3, 8.6, 450.0))
    write_geojson(tmp_path / "b.geojson", vision, turn)
    write_kml(tmp_path / "b.kml", vision, turn)
    content = json.loads((tmp_path / "b.geojson").read_text())
    kinds = [feature["properties"]["kind"] for feature in content["features"]]
    assert kinds.count("exposure") == kinds.count("footprint") == 6
    assert (kinds.count("control"), kinds.count("check"), kinds.count("tie")) == (1, 1, 38)
    for feature in content["features"]:
        if feature["geometry"]["type"] == "Point":
            longitude, latitude, height = feature["geometry"]["coordinates"]
            assert abs(longitude - 8.6) < 0.01
            assert abs(latitude - 47.3) < 0.01
            assert 440 < height < 600
    root = parse(tmp_path / "b.kml").getroot()  # noqa: S314
    assert len(root.findall(".//{http://www.opengis.net/kml/2.2}Placemark")) == len(content["features"])


@pytest.mark.parametrize("origin", [None, Origin(47.3, 8.6, 450.0)])
def test_geopackage(tmp_path: Path, vision: Reconstruction, origin: Origin | None) -> None:
    """Read with plain SQLite by the standard's layout (OGC 12-128r15, clause 2.1.3)."""
    path = tmp_path / "b.gpkg"
    write_geopackage(
        path, vision, None if origin is None else topocentric(origin), "2026-01-31T12:00:00.000Z"
    )
    with closing(sqlite3.connect(path)) as database:
        assert database.execute("PRAGMA application_id").fetchone()[0] == 0x47504B47
        assert database.execute("PRAGMA foreign_key_check").fetchall() == []
        system = -1 if origin is None else 4326
        tables = dict(database.execute("SELECT table_name, srs_id FROM gpkg_geometry_columns"))
        assert tables == dict.fromkeys(("exposures", "footprints", "points"), system)
        rows = database.execute("SELECT geom, name, kappa_deg FROM exposures ORDER BY fid").fetchall()
        assert [name for _, name, _ in rows] == list(vision.image_names)
        for k, (geometry, _, kappa) in enumerate(rows):
            magic, version, flags, number, order, kind, x, y, z = struct.unpack("<2sBBiBI3d", geometry)
            assert (magic, version, flags, number, order, kind) == (b"GP", 0, 1, system, 1, 1001)
            assert kappa == pytest.approx(np.degrees(vision.poses[k, 2]))
            if origin is None:
                np.testing.assert_allclose([x, y, z], vision.poses[k, 3:], rtol=1e-12)
            else:
                assert (round(x, 1), round(y, 1)) == (8.6, 47.3)
        residuals = database.execute(
            "SELECT column_px, row_px, vx_px, vy_px FROM image_residuals ORDER BY fid"
        )
        expected = np.hstack([vision.pixels, vision.residuals_px])
        np.testing.assert_allclose(residuals.fetchall(), expected, rtol=1e-12)
        assert database.execute("SELECT count(*) FROM points WHERE kind = 'control'").fetchone() == (1,)


@given(st.binary(max_size=300))
@settings(max_examples=150, deadline=None)
def test_noise_never_tracebacks(tmp_path_factory: pytest.TempPathFactory, noise: bytes) -> None:
    path = tmp_path_factory.mktemp("noise") / "file.txt"
    path.write_bytes(noise)
    for read in (
        read_gcp_list,
        read_geo,
        read_cameras,
        read_reconstruction,
        read_inpho,
        read_matrices,
        read_references,
        lambda file: read_angles(file, "deg"),
        lambda file: read_pix4d(file, (100, 100)),
    ):
        with pytest.raises(PhotocalError):
            read(path)
