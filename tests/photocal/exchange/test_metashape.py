"""Metashape camera XML: round trips, the published camera of a Phantom 4 Pro, and PhotoScan's older form."""

from __future__ import annotations

import struct
import zipfile
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from photocal.base.errors import InputMalformedError, InputNotFoundError
from photocal.block.model import ROLES, Block
from photocal.exchange.metashape import read_metashape, to_metashape
from photocal.exchange.metashape import write as write_metashape
from photocal.exchange.photoscan import read as read_project
from photocal.geometry.camera import camera, plane_to_pixel
from photocal.geometry.distortion import projected
from photocal.geometry.rotation import matrix_from_angles
from tests.photocal.exchange.conftest import roles_of

# Phantom 4 Pro as published (table 3, figure 20), f, cx, cy in px; image of 5472 x 3648 px.
P4P = {"f": 3673.03, "cx": -2.3621, "cy": -14.7955, "k1": 0.0115868, "k2": -0.0574271, "k3": 0.102937}
P4P |= {"p1": 7.76097e-07, "p2": -0.00191316}

DOCUMENT = """<?xml version="1.0" encoding="UTF-8"?>
<document version="1.4.0"><chunk label="Chunk 1" enabled="true">
<sensors next_id="1"><sensor id="0" label="FC6310" type="frame"><resolution width="5472" height="3648"/>
<calibration type="frame" class="adjusted"><resolution width="5472" height="3648"/>{calibration}</calibration>
</sensor></sensors>
<cameras next_id="1"><camera id="0" sensor_id="0" label="DJI_0001.JPG">
<transform>1 0 0 10 0 -1 0 20 0 0 -1 30 0 0 0 1</transform></camera>
<camera id="1" sensor_id="0" label="not aligned"/></cameras>{more}</chunk></document>
"""


def written(path: Path, values: dict[str, float], more: str = "") -> Path:
    calibration = "".join(f"<{key}>{value!r}</{key}>" for key, value in values.items())
    path.write_text(DOCUMENT.format(calibration=calibration, more=more), encoding="utf-8")
    return path


@pytest.mark.parametrize("affine", [{}, {"b1": 3.5, "b2": -1.25, "k4": 0.01, "p3": 0.2, "p4": -0.1}])
def test_published_camera_gives_the_same_distortion(tmp_path: Path, affine: dict[str, float]) -> None:
    value = dict.fromkeys(("b1", "b2", "k4", "p3", "p4"), 0.0) | P4P | affine
    own = read_metashape(written(tmp_path / "c.xml", P4P | affine)).block.cameras[0]
    x, y = np.random.default_rng(3).uniform([-0.74, -0.49], [0.74, 0.49], (300, 2)).T
    # The maker's equations (user manual, appendix), y down; u, v from the corner of the image.
    r2 = x * x + y * y
    radial = 1 + value["k1"] * r2 + value["k2"] * r2**2 + value["k3"] * r2**3 + value["k4"] * r2**4
    swell = 1 + value["p3"] * r2 + value["p4"] * r2**2
    xd = x * radial + (value["p1"] * (r2 + 2 * x * x) + 2 * value["p2"] * x * y) * swell
    yd = y * radial + (value["p2"] * (r2 + 2 * y * y) + 2 * value["p1"] * x * y) * swell
    u = 5472 / 2 + value["cx"] + xd * value["f"] + xd * value["b1"] + yd * value["b2"]
    v = 3648 / 2 + value["cy"] + yd * value["f"]
    q = np.column_stack([x, -y, -np.ones_like(x)])
    ours = plane_to_pixel(own.size_px, own.pitch, projected(own, q))
    # Column and row count from the centre of the first pixel, u and v from its corner.
    assert np.abs(ours + 0.5 - np.column_stack([u, v])).max() < 1e-9


def test_camera_to_chunk_matrix(tmp_path: Path) -> None:
    found = read_metashape(written(tmp_path / "c.xml", P4P)).block
    assert found.images.names == ("DJI_0001.JPG",)
    # Looks straight down with the top of the image to the north: all angles zero.
    np.testing.assert_allclose(found.images.values, [[0, 0, 0, 10, 20, 30]], atol=1e-12)


def test_chunk_transform_and_markers(tmp_path: Path) -> None:
    more = (
        "<transform><rotation>0 -1 0 1 0 0 0 0 1</rotation><translation>100 200 300</translation>"
        "<scale>2</scale></transform>"
        '<markers><marker id="4" label="GCP1"><reference x="1" y="2" z="3" sx="0.01" sy="0.01" sz="0.02"'
        ' enabled="true"/></marker><marker id="5" label="free"/></markers>'
        '<frames><frame id="0"><markers><marker marker_id="4">'
        '<location camera_id="0" pinned="true" x="10.5" y="20.5"/></marker></markers></frame></frames>'
        '<reference>PROJCS["ETRS89 / UTM zone 32N"]</reference>'
    )
    chunk = read_metashape(written(tmp_path / "c.xml", P4P, more))
    assert chunk.block.frame.startswith("PROJCS")
    given, points = chunk.block, chunk.block.points
    # (10, 20, 30) turned by 90 degrees about Z, doubled, moved.
    np.testing.assert_allclose(given.images.values[0, 3:], [100 - 40, 200 + 20, 360])
    np.testing.assert_allclose(np.degrees(given.images.values[0, :3]), [0, 0, 90], atol=1e-9)
    assert points.sigma[0].tolist() == [0.01, 0.01, 0.02]
    assert np.isnan(points.values[1]).all()
    assert given.observations.values.tolist() == [[10, 20]]


def test_round_trip(tmp_path: Path, vision: Block) -> None:
    # K4, P3, P4 and a skew: what no other format holds.
    extra = {"K4": 1e-32, "P3": 1e-9, "P4": 1e-16, "B2": 1e-4}
    skewed = replace(vision, cameras=tuple(own.changed(**extra) for own in vision.cameras))
    assert all(made.largest_px == 0 for made in write_metashape(tmp_path / "c.xml", skewed))
    again = read_metashape(tmp_path / "c.xml").block
    np.testing.assert_allclose(again.images.values, skewed.images.values, rtol=1e-9, atol=1e-9)
    for own, other in zip(skewed.cameras, again.cameras, strict=True):
        np.testing.assert_allclose(other.values, own.values, rtol=1e-9, atol=0)
    # Control and check points travel as markers with their projections.
    surveyed = [k for k, role in enumerate(roles_of(skewed)) if role != "tie"]
    np.testing.assert_allclose(again.points.values, skewed.points.values[surveyed], rtol=1e-12)
    assert len(again.observations.values) == np.isin(skewed.observations.point, surveyed).sum()


def test_photogrammetric_camera_is_fitted() -> None:
    own = camera(
        "a", "brown-observed", "mm", (3060, 2036), (0.009, 0.009), {"c": 20.5, "K1": -2.75e-4, "P1": 1e-5}
    )
    assert 0 < to_metashape(own).rms_px < 0.1


@pytest.mark.shared
def test_photoscan_project(shared: Path, tmp_path: Path) -> None:
    """SXB's own project: the older form, with the marks that PhotoModeler's export has too."""
    from photocal.exchange.photomodeler import read_export

    folder = shared / "data" / "dbat-sxb"
    with zipfile.ZipFile(folder / "psprojects" / "sxb.psz") as project:
        (tmp_path / "doc.xml").write_bytes(project.read("doc.xml"))
    given = read_metashape(tmp_path / "doc.xml").block
    own = given.cameras[0]
    assert own.value("c") == 20656.5
    # Principal point 4430, 6468 from the corner of 8858 x 12996 px.
    assert (own.value("x0"), own.value("y0")) == (4430 - 4429, 6498 - 6468)
    export = read_export(folder / "pmexports" / "w-op0-with-orient-pmexport.txt")
    marks = np.array([(mark.x, mark.y) for mark in export.marks])
    nearest = np.abs(given.observations.values[:, None] - marks[None]).max(axis=2).min(axis=1)
    assert (nearest < 1e-3).mean() > 0.9


@pytest.mark.parametrize(
    ("values", "message"),
    [
        ({"f": 0.0}, "focal length 0 px is impossible"),
        ({"f": 1e300}, "impossible"),
        ({"f": 1000.0, "k1": 1e200}, "impossible"),
    ],
)
def test_impossible_numbers(tmp_path: Path, values: dict[str, float], message: str) -> None:
    with pytest.raises(InputMalformedError, match=message):
        read_metashape(written(tmp_path / "c.xml", values))


LISTED = '<document><chunks><chunk id="0" path="0/chunk.zip"/></chunks></document>'
FRAME = '<frame><markers>{}</markers><point_cloud path="point_cloud/point_cloud.zip"/></frame>'


def as_project(folder: Path) -> Path:
    """A project in parts, in WGS 84: two images of one name, four markers (one for checks), a tie point."""
    import pyproj

    rng, f, size = np.random.default_rng(4), 900.0, (1000, 800)
    to_ecef = pyproj.Transformer.from_crs("EPSG:4979", "EPSG:4978", always_xy=True)
    places = [(-49.2001, -25.4, 430.0), (-49.1999, -25.4, 431.0)]
    ground = np.array([-49.2, -25.4, 330.0]) + rng.uniform(-1, 1, (5, 3)) * [2e-4, 2e-4, 5.0]
    centre, target = (np.array([to_ecef.transform(*p) for p in rows]) for rows in (places, ground))
    up = centre[0] / np.linalg.norm(centre[0])
    north = np.array([0, 0, 1.0]) - up[2] * up
    north /= np.linalg.norm(north)
    down = np.array([np.cross(north, up), -north, -up])
    scale, turn = 0.3, np.array([[0.0, -1, 0], [1, 0, 0], [0, 0, 1]])
    shots, seen = "", dict.fromkeys(range(4), "")
    pc = '<point_cloud><points path="points0.ply"/>'
    files = {}
    head = "ply\nformat binary_little_endian 1.0\nelement vertex {}\n{}end_header\n"
    columns = "".join(f"property float {axis}\n" for axis in "xyz") + "property uint id\n"
    files["points0.ply"] = head.format(1, columns).encode() + struct.pack("<3fI", 0, 0, 0, 7)
    for k, place in enumerate(centre):
        matrix = np.eye(4)
        matrix[:3, :3], matrix[:3, 3] = turn.T @ down.T, turn.T @ (place - centre[0]) / scale
        x, y, h = places[k]
        shots += (
            f'<camera id="{k}" sensor_id="0" label="A.JPG"><transform>'
            f"{' '.join(map(repr, matrix.ravel().tolist()))}</transform>"
            f'<reference x="{x}" y="{y}" z="{h}" sxy="0.02" sz="0.03" enabled="true"/></camera>'
        )
        xyz = (target - place) @ down.T
        pixels = f * xyz[:, :2] / xyz[:, 2:] + np.array(size) / 2
        for j in range(4):
            u, v = pixels[j].tolist()
            seen[j] += f'<location camera_id="{k}" x="{u!r}" y="{v!r}"/>'
        columns = "property float x\nproperty float y\nproperty uint id\n"
        files[f"p{k}.ply"] = head.format(1, columns).encode() + struct.pack("<2fI", *pixels[4], 7)
        pc += f'<projections camera_id="{k}" path="p{k}.ply"/>'
    listed = "".join(
        f'<marker id="{k}" label="G{k}"><reference x="{x!r}" y="{y!r}" z="{h!r}" '
        f'enabled="{"false" if k == 3 else "true"}"/></marker>'
        for k, (x, y, h) in enumerate(ground[:4].tolist())
    )
    wkt = pyproj.CRS("EPSG:4326").to_wkt("WKT1_GDAL").replace('"', "&quot;")
    chunk = (
        '<chunk label="c"><sensors><sensor id="0" label="s" type="frame"><calibration type="frame">'
        f'<resolution width="{size[0]}" height="{size[1]}"/><f>{f}</f></calibration></sensor></sensors>'
        f"<cameras>{shots}</cameras><markers>{listed}</markers>"
        f'<frames><frame id="0" path="0/frame.zip"/></frames><reference>{wkt}</reference>'
        f"<transform><rotation>{' '.join(map(str, turn.ravel()))}</rotation><scale>{scale}</scale>"
        f"<translation>{' '.join(map(repr, centre[0].tolist()))}</translation></transform>"
        '<settings><property name="accuracy_projections" value="0.1"/>'
        '<property name="accuracy_tiepoints" value="1"/><property name="accuracy_markers" value="0.005"/>'
        '<property name="accuracy_cameras_ypr" value="1 1 2"/></settings></chunk>'
    )
    marked = "".join(f'<marker marker_id="{k}">{rays}</marker>' for k, rays in seen.items())
    below = folder / "a.files" / "0" / "0" / "point_cloud"
    below.mkdir(parents=True)
    (folder / "a.psx").write_text('<document version="1.2.0" path="{projectname}.files/project.zip"/>')
    for place, members in (
        (below.parents[2] / "project.zip", {"doc.xml": LISTED}),
        (below.parents[1] / "chunk.zip", {"doc.xml": chunk}),
        (below.parent / "frame.zip", {"doc.xml": FRAME.format(marked)}),
        (below / "point_cloud.zip", files | {"doc.xml": pc + "</point_cloud>"}),
    ):
        with zipfile.ZipFile(place, "w") as archive:
            for name, content in members.items():
                archive.writestr(name, content)
    return folder / "a.psx"


def test_a_project_in_parts_and_in_a_reference_system(tmp_path: Path) -> None:
    """Its points are where its images show them, in east, north and up; positions of images come along."""
    chunk = read_project(as_project(tmp_path))
    block = chunk.block
    assert block.images.names == ("A.JPG", "A.JPG (2)")
    assert [ROLES[k] for k in block.points.role] == ["control"] * 3 + ["check", "tie"]
    np.testing.assert_allclose(chunk.position, block.images.values[:, 3:], atol=1e-6)
    assert chunk.position_sigma.tolist() == [[0.02, 0.02, 0.03]] * 2
    assert np.ptp(block.images.values[:, 5]) == pytest.approx(1.0, abs=1e-3)
    seen = block.observations
    known = np.isfinite(block.points.values[seen.point]).all(axis=1)
    assert known.sum() == 8
    rotation = matrix_from_angles(block.images.values[seen.image[known], :3])
    away = block.points.values[seen.point[known]] - block.images.values[seen.image[known], 3:]
    q = np.einsum("nab,nb->na", rotation, away)
    shown = np.column_stack([500 - 900 * q[:, 0] / q[:, 2], 400 + 900 * q[:, 1] / q[:, 2]])
    np.testing.assert_allclose(seen.values[known] + 0.5, shown, atol=1e-3)


@pytest.mark.parametrize("path", ["", "../../frame.zip", "0/none.zip"])
def test_parts_that_are_not_there_are_refused(tmp_path: Path, path: str) -> None:
    project = as_project(tmp_path)
    with zipfile.ZipFile(tmp_path / "a.files" / "project.zip", "w") as archive:
        archive.writestr("doc.xml", f'<document><chunks><chunk id="0" path="{path}"/></chunks></document>')
    with pytest.raises((InputMalformedError, InputNotFoundError)):
        read_project(project)
