"""Metashape camera XML: round trips, the published camera of a Phantom 4 Pro, and PhotoScan's older form."""

from __future__ import annotations

import zipfile
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from drivers.errors import InputMalformedError
from photocal.exchange.metashape import read_metashape, to_metashape, write_metashape
from photocal.exchange.reconstruction import Reconstruction
from photocal.geometry.camera import camera, plane_to_pixel
from photocal.geometry.distortion import projected

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
    own = read_metashape(written(tmp_path / "c.xml", P4P | affine)).reconstruction.cameras[0]
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
    found = read_metashape(written(tmp_path / "c.xml", P4P)).reconstruction
    assert found.image_names == ("DJI_0001.JPG",)
    # Looks straight down with the top of the image to the north: all angles zero.
    np.testing.assert_allclose(found.poses, [[0, 0, 0, 10, 20, 30]], atol=1e-12)


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
    assert chunk.crs.startswith("PROJCS")
    given = chunk.reconstruction
    # (10, 20, 30) turned by 90 degrees about Z, doubled, moved.
    np.testing.assert_allclose(given.poses[0, 3:], [100 - 40, 200 + 20, 360])
    np.testing.assert_allclose(np.degrees(given.poses[0, :3]), [0, 0, 90], atol=1e-9)
    assert chunk.markers[0].sigma == (0.01, 0.01, 0.02)
    assert np.isnan(chunk.markers[1].xyz).all()
    assert given.pixels.tolist() == [[10, 20]]


def test_round_trip(tmp_path: Path, vision: Reconstruction) -> None:
    # K4, P3, P4 and a skew: what no other format holds.
    extra = {"K4": 1e-32, "P3": 1e-9, "P4": 1e-16, "B2": 1e-4}
    skewed = replace(vision, cameras=tuple(own.changed(**extra) for own in vision.cameras))
    assert all(made.largest_px == 0 for made in write_metashape(tmp_path / "c.xml", skewed))
    again = read_metashape(tmp_path / "c.xml").reconstruction
    np.testing.assert_allclose(again.poses, skewed.poses, rtol=1e-9, atol=1e-9)
    for own, other in zip(skewed.cameras, again.cameras, strict=True):
        np.testing.assert_allclose(other.values, own.values, rtol=1e-9, atol=0)
    # Control and check points travel as markers with their projections.
    surveyed = [k for k, role in enumerate(skewed.roles) if role != "tie"]
    np.testing.assert_allclose(again.xyz, skewed.xyz[surveyed], rtol=1e-12)
    assert len(again.pixels) == np.isin(skewed.point, surveyed).sum()


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
    given = read_metashape(tmp_path / "doc.xml").reconstruction
    own = given.cameras[0]
    assert own.value("c") == 20656.5
    # Principal point 4430, 6468 from the corner of 8858 x 12996 px.
    assert (own.value("x0"), own.value("y0")) == (4430 - 4429, 6498 - 6468)
    export = read_export(folder / "pmexports" / "w-op0-with-orient-pmexport.txt")
    marks = np.array([(mark.x, mark.y) for mark in export.marks])
    nearest = np.abs(given.pixels[:, None] - marks[None]).max(axis=2).min(axis=1)
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
