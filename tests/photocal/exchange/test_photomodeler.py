"""PhotoModeler's export written and read, with several cameras; its tables of points."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from drivers.errors import InputMalformedError
from photocal.exchange.photomodeler import read_photomodeler
from photocal.exchange.photomodeler_export import read_export
from photocal.exchange.photomodeler_tables import read_marks, read_points
from photocal.exchange.photomodeler_writer import write_photomodeler
from photocal.exchange.reconstruction import Reconstruction
from photocal.geometry.camera import plane_to_pixel
from photocal.geometry.distortion import projected
from photocal.geometry.rotation import matrix_from_angles
from tests.photocal.exchange.conftest import observed_camera, reconstruction_of


def two_cameras() -> Reconstruction:
    first = observed_camera()
    other = replace(first.with_values(first.values * 1.01), id="other")
    return reconstruction_of((first, other))


def test_round_trip_with_two_cameras(tmp_path: Path) -> None:
    given = two_cameras()
    path = tmp_path / "export.txt"
    assert [made.largest_px for made in write_photomodeler(path, given)] == [0, 0]
    block = read_photomodeler(path, tmp_path / "export-control.txt")
    assert block.images.names == given.image_names
    np.testing.assert_allclose(block.images.values, given.poses, rtol=1e-12, atol=1e-12)
    assert np.array_equal(block.images.camera, given.image_camera)
    for own, again in zip(given.cameras, block.cameras, strict=True):
        np.testing.assert_allclose(again.values, own.values, rtol=1e-9, atol=1e-14)
    order = [block.points.names.index(name) for name in given.point_names]
    np.testing.assert_allclose(block.points.values[order], given.xyz, rtol=1e-12)
    assert block.points.sigma[order[0]].tolist() == [0.002] * 3
    rays = np.argsort(given.image, kind="stable")
    np.testing.assert_allclose(block.observations.values, given.pixels[rays], atol=1e-9)


def test_affinity_goes_into_the_width_of_a_pixel(tmp_path: Path) -> None:
    own = replace(observed_camera(), affinity="before").with_values([*observed_camera().values[:11], 2e-4, 0])
    given = reconstruction_of((own,))
    write_photomodeler(tmp_path / "e.txt", given)
    block = read_photomodeler(tmp_path / "e.txt", tmp_path / "e-control.txt")
    again = block.cameras[0]
    assert again.pitch[0] / again.pitch[1] == pytest.approx(1.0002, rel=1e-12)
    assert again.value("B1") == 0
    q = (given.xyz[given.point] - given.poses[given.image, 3:])[:, None]
    q = (q @ np.swapaxes(matrix_from_angles(given.poses[given.image, :3]), 1, 2))[:, 0]
    found = plane_to_pixel(again.size_px, again.pitch, projected(again, q))
    np.testing.assert_allclose(found - given.residuals_px, given.pixels, atol=1e-9)


def test_what_has_no_place(tmp_path: Path, vision: Reconstruction) -> None:
    skewed = observed_camera().with_values([*observed_camera().values[:12], 1e-4])
    for given, message in (
        (vision, "in mm"),
        (reconstruction_of((skewed,)), "skew"),
        (replace(two_cameras(), image_names=("../a", "b", "c", "d", "e", "f")), "cannot be that of a file"),
    ):
        with pytest.raises(InputMalformedError, match=message):
            write_photomodeler(tmp_path / "e.txt", given)
        assert not list(tmp_path.iterdir())


@pytest.mark.shared
@pytest.mark.parametrize(
    ("folder", "stem", "photos"),
    [
        ("dbat-sxb/pmexports", "w-op0-with-orient", 5),
        ("dbat-camcal/prague2016", "weighted-with-orient", 21),
    ],
)
def test_tables_agree_with_the_export(shared: Path, folder: str, stem: str, photos: int) -> None:
    """The same solution in both files; the export has four decimals of a pixel."""
    marks = read_marks(shared / "data" / folder / f"{stem}-2dpts.txt")
    export = read_export(shared / "data" / folder / f"{stem}-pmexport.txt")
    index = {photo.name: photo.number for photo in export.photos}
    exported = {(mark.point, index[mark.image]): (mark.x, mark.y) for mark in export.marks}
    found = {
        (name, photo): tuple(pixel)
        for name, photo, pixel in zip(marks.point, marks.photo.tolist(), marks.pixels, strict=True)
    }
    assert len(index) == photos
    assert found.keys() == exported.keys()
    apart = [np.abs(np.subtract(found[key], exported[key])).max() for key in found]
    assert max(apart) < 0.51e-4 + 1e-9
    points = read_points(shared / "data" / folder / f"{stem}-3dpts.txt")
    assert set(points.names) == set(marks.point)
    here = np.array([export.points[name] for name in points.names])
    # Up to a shift of the origin, which only one of the files has.
    shift = points.xyz - here
    assert np.ptp(shift, axis=0).max() < 2e-5


@pytest.mark.shared
def test_tables_of_smart_points(shared: Path) -> None:
    folder = shared / "data" / "dbat-sxb" / "pmexports"
    marks = read_marks(folder / "wsmart-with-orient-2dsmartpts.txt")
    points = read_points(folder / "wsmart-with-orient-3dsmartpts.txt")
    assert (len(marks.point), len(points.names)) == (1149, 365)
    assert set(marks.point) == set(points.names)


HEAD = "Project Units: meters\nUnits & Scale - Active\n\n"
MARKS = "Object Point ID,Photo #,X (pixels),Y (pixels),Residual X,Residual Y\n"


@pytest.mark.parametrize(
    ("text", "message"),
    [
        (MARKS + "1,1,2,3,0,0\n", "no header"),
        (HEAD + "Id,Name\n1,a\n", "no header"),
        (HEAD.replace("meters", "feet") + MARKS + "1,1,2,3,0,0\n", "is in 'feet'"),
        (HEAD + MARKS + "1,1,2,3,0\n", "5 cells where the header has 6"),
        (HEAD + MARKS + "1,1,2,nan,0,0\n", "not finite"),
        (HEAD + MARKS + "1,0,2,3,0,0\n", "impossible photo 0"),
        (HEAD + MARKS + "1,1,2,3,0,0\n1,1,2,3,0,0\n", "marked twice"),
        (HEAD + MARKS + "1.5,1,2,3,0,0\n", "not a whole number"),
    ],
)
def test_bad_table(tmp_path: Path, text: str, message: str) -> None:
    (tmp_path / "t.txt").write_text(text)
    with pytest.raises(InputMalformedError, match=message):
        read_marks(tmp_path / "t.txt")
