"""COLMAP models: half pixels, axes, both forms, and damaged files."""

from __future__ import annotations

import struct
from contextlib import suppress
from operator import attrgetter
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from photocal.base.errors import InputMalformedError, PhotocalError
from photocal.block.model import Block
from photocal.exchange.colmap import read_colmap, write_colmap
from photocal.exchange.exporting import Choices
from tests.photocal.exchange.conftest import residuals_of, to_adjust

CHOICES = Choices()


def by_hand(folder: Path) -> tuple[np.ndarray, np.ndarray]:
    """Projections and marks of a text model, straight from COLMAP's documentation."""
    rows = [line.split() for line in (folder / "cameras.txt").read_text().splitlines() if line[0] != "#"]
    cameras = {row[0]: np.array(row[4:], dtype=float) for row in rows}
    points = {
        row[0]: np.array(row[1:4], dtype=float)
        for row in (
            line.split() for line in (folder / "points3D.txt").read_text().splitlines() if line[0] != "#"
        )
    }
    lines = [line for line in (folder / "images.txt").read_text().splitlines() if not line.startswith("#")]
    found, marked = [], []
    for head, body in zip(lines[::2], lines[1::2], strict=True):
        cells = head.split()
        w, x, y, z = np.array(cells[1:5], dtype=float)
        turn = np.array(
            [
                [1 - 2 * y * y - 2 * z * z, 2 * x * y - 2 * w * z, 2 * z * x + 2 * w * y],
                [2 * x * y + 2 * w * z, 1 - 2 * x * x - 2 * z * z, 2 * y * z - 2 * w * x],
                [2 * z * x - 2 * w * y, 2 * y * z + 2 * w * x, 1 - 2 * x * x - 2 * y * y],
            ]
        )
        shift = np.array(cells[5:8], dtype=float)
        fx, fy, cx, cy, k1, k2, p1, p2, k3, k4, k5, k6 = cameras[cells[8]]
        for u, v, key in np.array(body.split()).reshape(-1, 3):
            q = turn @ points[key] + shift
            a, b = q[:2] / q[2]
            r2 = a * a + b * b
            radial = (1 + k1 * r2 + k2 * r2**2 + k3 * r2**3) / (1 + k4 * r2 + k5 * r2**2 + k6 * r2**3)
            found.append(
                [
                    fx * (a * radial + 2 * p1 * a * b + p2 * (r2 + 2 * a * a)) + cx,
                    fy * (b * radial + 2 * p2 * a * b + p1 * (r2 + 2 * b * b)) + cy,
                ]
            )
            marked.append([float(u), float(v)])
    return np.array(found), np.array(marked)


def test_residuals_are_ours(tmp_path: Path, vision: Block) -> None:
    conversions = write_colmap(tmp_path, vision, CHOICES)
    assert [conversion.largest_px for conversion in conversions] == [0, 0]
    found, marked = by_hand(tmp_path)
    assert np.abs(found - marked - residuals_of(vision)).max() < 1e-6
    # COLMAP's upper-left pixel has its centre at (0.5, 0.5).
    assert np.abs(marked - vision.observations.values - 0.5).max() < 1e-9


@pytest.mark.parametrize("binary", [False, True])
def test_round_trip(tmp_path: Path, vision: Block, binary: bool) -> None:
    write_colmap(tmp_path, vision, CHOICES, binary=binary)
    again = read_colmap(tmp_path)
    assert again.images.names == vision.images.names
    assert again.points.names == vision.points.names
    for name in ("images.values", "points.values", "observations.values"):
        value = attrgetter(name)
        np.testing.assert_allclose(value(again), value(vision), rtol=1e-9, atol=1e-9)
    for name in ("observations.image", "observations.point", "images.camera"):
        assert np.array_equal(attrgetter(name)(again), attrgetter(name)(vision))
    for own, other in zip(vision.cameras, again.cameras, strict=True):
        np.testing.assert_allclose(other.values, own.values, rtol=1e-9, atol=1e-15)


def test_binary_and_text_say_the_same(tmp_path: Path, vision: Block) -> None:
    for name in ("text", "binary"):
        (tmp_path / name).mkdir()
        write_colmap(tmp_path / name, vision, CHOICES, binary=name == "binary")
    text, binary = read_colmap(tmp_path / "text"), read_colmap(tmp_path / "binary")
    assert np.array_equal(text.images.values, binary.images.values)
    assert np.array_equal(text.observations.values, binary.observations.values)


def test_photogrammetric_camera_is_fitted(tmp_path: Path, photogrammetric: Block) -> None:
    (conversion,) = write_colmap(tmp_path, photogrammetric, CHOICES)
    assert 0 < conversion.rms_px < conversion.largest_px < 1
    found, marked = by_hand(tmp_path)
    assert np.abs(found - marked - residuals_of(photogrammetric)).max() <= conversion.largest_px


def test_block(tmp_path: Path, vision: Block) -> None:
    write_colmap(tmp_path, vision, CHOICES)
    block = to_adjust(read_colmap(tmp_path), "model", 0.5)
    assert block.datum == "free"
    assert np.all(block.observations.sigma == 0.5)
    assert block.cameras[0].estimated.sum() == 9


def test_marks_without_point_are_left_out(tmp_path: Path) -> None:
    (tmp_path / "cameras.txt").write_text("1 SIMPLE_RADIAL 100 80 90 50 40 0.01\n")
    (tmp_path / "images.txt").write_text(
        "1 1 0 0 0 0 0 5 1 a b.jpg\n10 20 7 30 40 -1\n2 1 0 0 0 0 0 6 1 c.jpg\n\n"
    )
    (tmp_path / "points3D.txt").write_text("7 0 0 0 1 2 3 0.5 1 0\n")
    found = read_colmap(tmp_path)
    assert found.images.names == ("a b.jpg", "c.jpg")
    assert found.observations.values.tolist() == [[9.5, 19.5]]
    # Five units in front of the camera, which looks along its z axis.
    assert found.images.values[0, 3:].tolist() == [0, 0, -5]


@pytest.mark.parametrize(
    ("name", "text", "message"),
    [
        ("cameras.txt", "1 FISHEYE 100 80 1 2 3\n", "no equivalent"),
        ("cameras.txt", "1 PINHOLE 100 80 90 90 50\n", "3 parameters where PINHOLE has 4"),
        ("cameras.txt", "1 PINHOLE 99999999 80 90 90 50 40\n", "impossible"),
        ("cameras.txt", "1 PINHOLE 100 80 90 nan 50 40\n", "not finite"),
        ("cameras.txt", "1 PINHOLE 100 80 90,5 90 50 40\n", "decimal comma"),
        ("images.txt", "1 1 0 0 0 0 0 5 1 a.jpg\n10 20 8\n", "unknown point 8"),
        ("images.txt", "1 1 0 0 0 0 0 5 3 a.jpg\n10 20 7\n", "unknown camera 3"),
        ("images.txt", "1 1 0 0 0 0 0 5 1 a.jpg", "ends before the marks"),
        ("images.txt", "1 1 0 0 0 0 0 5 1 a.jpg\n10 20\n", "not complete"),
        ("points3D.txt", "7 0 0 0 1 2\n", "not a row of a point"),
    ],
)
def test_bad_text(tmp_path: Path, name: str, text: str, message: str) -> None:
    (tmp_path / "cameras.txt").write_text("1 PINHOLE 100 80 90 90 50 40\n")
    (tmp_path / "images.txt").write_text("1 1 0 0 0 0 0 5 1 a.jpg\n10 20 7\n")
    (tmp_path / "points3D.txt").write_text("7 0 0 0 1 2 3 0.5 1 0\n")
    (tmp_path / name).write_text(text)
    with pytest.raises(InputMalformedError, match=message):
        read_colmap(tmp_path)


@pytest.mark.parametrize("name", ["cameras.bin", "images.bin", "points3D.bin"])
def test_huge_count_is_not_believed(tmp_path: Path, vision: Block, name: str) -> None:
    write_colmap(tmp_path, vision, CHOICES, binary=True)
    content = (tmp_path / name).read_bytes()
    (tmp_path / name).write_bytes(struct.pack("<Q", 10**13) + content[8:])
    with pytest.raises(InputMalformedError, match="more than the file can hold"):
        read_colmap(tmp_path)


@given(st.integers(0, 2), st.integers(0, 10**6), st.binary(max_size=12))
@settings(max_examples=80)
def test_damaged_binary_never_tracebacks(
    tmp_path_factory: pytest.TempPathFactory, vision: Block, which: int, at: int, noise: bytes
) -> None:
    folder = tmp_path_factory.mktemp("model")
    write_colmap(folder, vision, CHOICES, binary=True)
    path = folder / ("cameras.bin", "images.bin", "points3D.bin")[which]
    content = path.read_bytes()
    at %= len(content)
    path.write_bytes(content[:at] + noise + (content[at + len(noise) :] if len(noise) % 2 else b""))
    with suppress(PhotocalError):
        read_colmap(folder)


def test_blank_in_a_name(tmp_path: Path, vision: Block) -> None:
    from dataclasses import replace

    images = replace(vision.images, names=("a b.jpg", *vision.images.names[1:]))
    named = replace(vision, images=images)
    with pytest.raises(InputMalformedError, match="blanks"):
        write_colmap(tmp_path, named, CHOICES)
    write_colmap(tmp_path, named, CHOICES, binary=True)
    assert read_colmap(tmp_path).images.names[0] == "a b.jpg"


@pytest.mark.parametrize("binary", [False, True])
def test_pycolmap_reproduces_our_residuals(tmp_path: Path, vision: Block, binary: bool) -> None:
    """COLMAP's own reader and projection."""
    pycolmap = pytest.importorskip("pycolmap")
    write_colmap(tmp_path, vision, Choices(residuals_px=residuals_of(vision)), binary=binary)
    model = pycolmap.Reconstruction()
    (model.read_binary if binary else model.read_text)(str(tmp_path))
    assert model.is_valid()
    assert (model.num_images(), model.num_cameras()) == (6, 2)
    ours = {
        (vision.images.names[i], int(vision.points.names[j])): v
        for i, j, v in zip(
            vision.observations.image, vision.observations.point, residuals_of(vision), strict=True
        )
    }
    found = {}
    for image in model.images.values():
        for mark in image.points2D:
            projected = image.project_point(model.points3D[mark.point3D_id].xyz)
            found[image.name, mark.point3D_id] = projected - mark.xy
    assert found.keys() == ours.keys()
    assert max(np.abs(found[key] - ours[key]).max() for key in ours) < 1e-6
    mean = np.mean([np.hypot(*v) for v in ours.values()])
    assert model.compute_mean_reprojection_error() == pytest.approx(mean, rel=0.05)
