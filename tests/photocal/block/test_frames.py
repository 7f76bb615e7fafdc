"""Blocks in a coordinate reference system give what the same block gives in Cartesian coordinates."""

from __future__ import annotations

import csv
import shutil
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from pyproj import Transformer
from scipy.spatial.transform import Rotation

from photocal.base.errors import ConfigurationError, InputMalformedError
from tests.photocal.blocks import adjusted_json

Floats = NDArray[np.float64]
DEMO = Path(__file__).resolve().parents[3] / "photocal" / "demo" / "dcs460"
# Near Curitiba, far enough from the central meridian for a convergence of half a degree.
ORIGIN = (-49.25, -25.44, 905.0)
PIPELINE = (
    "+proj=pipeline +step +inv +proj=topocentric +ellps=GRS80 +lon_0={} +lat_0={} +h_0={} "
    "+step +inv +proj=cart +ellps=GRS80 +step +proj=utm +zone=22 +south +ellps=GRS80"
).format(*ORIGIN)


def to_grid(local: Floats) -> Floats:
    """East, north, height in UTM 22 S of topocentric coordinates, by the library's own pipeline."""
    return np.column_stack(Transformer.from_pipeline(PIPELINE).transform(*local.T))


def grid_axes(local: Floats) -> Floats:
    """Rotation from topocentric axes to the grid's axes at a place."""
    steps = [
        to_grid((local + 10 * axis)[None])[0] - to_grid((local - 10 * axis)[None])[0] for axis in np.eye(3)
    ]
    matrix = np.array(steps).T
    unit = matrix / np.linalg.norm(matrix, axis=1, keepdims=True)
    left, _, right = np.linalg.svd(unit)
    return np.asarray(left @ right)


def object_to_camera(angles: Floats) -> Floats:
    """M = R3(kappa) R2(phi) R1(omega) by another library: the inverse of intrinsic x, y, z turns."""
    return np.asarray(Rotation.from_euler("XYZ", angles, degrees=True).as_matrix().T)


def rows_of(path: Path) -> list[dict[str, str]]:
    with path.open(encoding="utf-8") as text:
        return list(csv.DictReader(text))


def write(path: Path, rows: list[dict[str, Any]]) -> None:
    with path.open("w", encoding="utf-8", newline="") as text:
        writer = csv.DictWriter(text, list(rows[0]))
        writer.writeheader()
        writer.writerows(rows)


@pytest.fixture
def grid_block(tmp_path: Path) -> Path:
    """The demonstration block with its coordinates in UTM 22 S and ellipsoidal heights."""
    folder = tmp_path / "grid"
    shutil.copytree(DEMO, folder)
    text = (folder / "block.toml").read_text(encoding="utf-8")
    text = text.replace('frame = "local"', 'frame = "EPSG:31982"\nheight = "ellipsoidal"')
    (folder / "block.toml").write_text(text, encoding="utf-8")
    for name in ("images.csv", "points.csv"):
        rows: list[dict[str, Any]] = [dict(row) for row in rows_of(folder / name)]
        for row in rows:
            local = np.array([float(row[axis]) for axis in "XYZ"])
            if name == "images.csv":
                angles = np.array([float(row[a]) for a in ("omega", "phi", "kappa")])
                turned = object_to_camera(angles) @ grid_axes(local).T
                new = Rotation.from_matrix(turned.T).as_euler("XYZ", degrees=True)
                row.update(zip(("omega", "phi", "kappa"), map(repr, new.tolist()), strict=True))
            row.update(zip("XYZ", map(repr, to_grid(local[None])[0].tolist()), strict=True))
        write(folder / name, rows)
    return folder


def test_same_adjustment_in_a_projected_system(grid_block: Path, tmp_path: Path) -> None:
    local = adjusted_json(DEMO, tmp_path / "local-run")
    grid = adjusted_json(grid_block, tmp_path / "grid-run")
    # The 3 mm of the control are grid metres there, which the scale of the projection makes 0.01 % longer.
    assert grid["chi_squared"] == pytest.approx(local["chi_squared"], rel=5e-5)
    (one,), (other,) = (run["cameras"].values() for run in (local, grid))
    for name, figures in one["parameters"].items():
        assert other["parameters"][name]["value"] == pytest.approx(
            figures["value"], abs=1e-3 * figures["sigma"] + 1e-15
        )
    points = [rows_of(tmp_path / run / "points.csv") for run in ("local-run", "grid-run")]
    places = [np.array([[float(r[axis]) for axis in "XYZ"] for r in rows]) for rows in points]
    assert np.abs(to_grid(places[0]) - places[1]).max() < 1e-5
    images = [rows_of(tmp_path / run / "images.csv") for run in ("local-run", "grid-run")]
    for here, there in zip(*images, strict=True):
        place = np.array([float(here[axis]) for axis in "XYZ"])
        matrices = [
            object_to_camera(np.array([float(row[a]) for a in ("omega", "phi", "kappa")]))
            for row in (here, there)
        ]
        expected = matrices[0] @ grid_axes(place).T
        assert np.abs(expected - matrices[1]).max() < 1e-6


@pytest.mark.parametrize(
    ("frame", "error", "says"),
    [
        ('frame = "EPSG:31982"', ConfigurationError, "the height kind of frame"),
        ('frame = "EPSG:31982+5773"\nheight = "ellipsoidal"', ConfigurationError, "vertical"),
        (
            'frame = "EPSG:31982+5773"\nheight = "orthometric"',
            InputMalformedError,
            "photocal fetch-grids EPSG:31982.5773",
        ),
        ('frame = "EPSG:2263"\nheight = "ellipsoidal"', ConfigurationError, "foot"),
        ('frame = "Atlantis"', ConfigurationError, "not a coordinate system"),
    ],
)
def test_frames_that_cannot_be_trusted(
    grid_block: Path, tmp_path: Path, frame: str, error: type[Exception], says: str
) -> None:
    text = (grid_block / "block.toml").read_text(encoding="utf-8")
    text = text.replace('frame = "EPSG:31982"\nheight = "ellipsoidal"', frame)
    (grid_block / "block.toml").write_text(text, encoding="utf-8")
    with pytest.raises(error, match=says):
        adjusted_json(grid_block, tmp_path / "run")
    assert not (tmp_path / "run").exists()


def test_full_covariance_of_control(tmp_path: Path) -> None:
    """Control with correlated coordinates equals control in turned axes with independent ones."""
    turn = Rotation.from_euler("xyz", [20, -35, 50], degrees=True).as_matrix()
    sigma = np.array([0.002, 0.004, 0.006])
    runs = []
    for turned in (False, True):
        folder = tmp_path / f"block-{turned}"
        shutil.copytree(DEMO, folder)
        axes = turn if turned else np.eye(3)
        covariance = axes @ np.diag(sigma**2) @ axes.T
        points: list[dict[str, Any]] = [dict(row) for row in rows_of(folder / "points.csv")]
        for row in points:
            place = axes @ np.array([float(row[axis]) for axis in "XYZ"])
            row.update(zip("XYZ", map(repr, place.tolist()), strict=True))
            row.update(zip(("sX", "sY", "sZ"), map(repr, np.sqrt(np.diag(covariance)).tolist()), strict=True))
            row.update(sXY=repr(float(covariance[0, 1])), sXZ=repr(float(covariance[0, 2])))
            row.update(sYZ=repr(float(covariance[1, 2])))
        write(folder / "points.csv", points)
        images: list[dict[str, Any]] = [dict(row) for row in rows_of(folder / "images.csv")]
        for row in images:
            place = axes @ np.array([float(row[axis]) for axis in "XYZ"])
            matrix = object_to_camera(np.array([float(row[a]) for a in ("omega", "phi", "kappa")])) @ axes.T
            angles = Rotation.from_matrix(matrix.T).as_euler("XYZ", degrees=True)
            row.update(zip("XYZ", map(repr, place.tolist()), strict=True))
            row.update(zip(("omega", "phi", "kappa"), map(repr, angles.tolist()), strict=True))
        write(folder / "images.csv", images)
        runs.append(adjusted_json(folder, tmp_path / f"run-{turned}"))
    assert runs[1]["chi_squared"] == pytest.approx(runs[0]["chi_squared"], rel=1e-8)
    one, other = (run["cameras"]["dcs460"]["parameters"]["c"] for run in runs)
    assert other["value"] == pytest.approx(one["value"], abs=1e-4 * one["sigma"])
    assert other["sigma"] == pytest.approx(one["sigma"], rel=1e-6)
