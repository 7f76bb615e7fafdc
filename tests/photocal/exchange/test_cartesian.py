"""A block in a map projection, exported: the geometry that was adjusted, and places on the Earth."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pyproj
import pytest
from typer.testing import CliRunner

from photocal.adjustment.adjust import adjust
from photocal.base.errors import ConfigurationError
from photocal.block.model import Block
from photocal.block.network import assemble
from photocal.block.results.adjusted import result_of
from photocal.block.results.adjusted_block import adjusted_block
from photocal.block.results.folder import read_result, write_result
from photocal.commands.cli import app
from photocal.exchange.ground_points import read_gcp_list, read_geo
from photocal.geometry.camera import camera
from photocal.geometry.frames import nearest_rotation, reference_frame
from photocal.geometry.rotation import angles_from_matrix, matrix_from_angles
from tests.photocal.exchange.conftest import reconstruction_of, to_adjust, with_roles

# Far from the central meridian: 1.2 degrees of convergence and a scale of 1.0006.
PLACE = np.array([790_000.0, 7_480_000.0, 600.0])


@pytest.fixture(scope="module")
def run(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A run in UTM 22S, adjusted from a block whose rays are straight in space."""
    values = {"c": 20.0, "K1": -1e-5, "P1": 1e-6}
    made = reconstruction_of((camera("1", "brown-ideal", "mm", (4608, 3456), (0.005, 0.005), values),))
    # Ten times as large: over a kilometre the curvature of the Earth is 8 cm.
    points, poses = made.points.values * 10, made.images.values * [1, 1, 1, 10, 10, 10]
    frame = reference_frame("EPSG:31982", "ellipsoidal", PLACE)
    places = frame.to_given(poses[:, 3:])
    turn = nearest_rotation(frame.derivative(places))
    angles = angles_from_matrix(matrix_from_angles(poses[:, :3]) @ turn)
    given = replace(
        made,
        frame="EPSG:31982",
        height="ellipsoidal",
        images=replace(made.images, values=np.hstack([angles, places])),
        points=replace(
            with_roles(made, "control").points,
            values=frame.to_given(points),
            sigma=np.full(points.shape, 0.01),
        ),
    )
    block = to_adjust(given, "map", 0.5)
    assembly = assemble(block)
    solution = adjust(assembly.network)
    folder = tmp_path_factory.mktemp("run") / "run"
    folder.mkdir()
    write_result(folder, result_of(block, assembly, solution))
    return folder


def exported(run: Path, folder: Path, *arguments: str) -> dict[str, object]:
    result = CliRunner().invoke(
        app, ["export", str(run), "-o", str(folder), "--json", *arguments], catch_exceptions=False
    )
    assert result.exit_code == 0
    answer: dict[str, object] = json.loads(result.stdout)
    return answer


def residuals(given: Block, residuals_px: np.ndarray) -> dict[tuple[str, str], np.ndarray]:
    return {
        (given.images.names[i], given.points.names[j]): v
        for i, j, v in zip(given.observations.image, given.observations.point, residuals_px, strict=True)
    }


def test_pycolmap_reproduces_the_residuals_of_the_adjustment(run: Path, tmp_path: Path) -> None:
    pycolmap = pytest.importorskip("pycolmap")
    answer = exported(run, tmp_path, "--format", "colmap-binary")
    origin = answer["origin"]
    assert isinstance(origin, dict)
    assert (origin["frame"], origin["height"]) == ("EPSG:31982", "ellipsoidal")
    assert np.abs(np.array([origin["x"], origin["y"]]) - PLACE[:2]).max() < 500
    ours = residuals(*adjusted_block(read_result(run)))
    model = pycolmap.Reconstruction(str(tmp_path))
    apart = []
    for image in model.images.values():
        for mark in image.points2D:
            found = image.project_point(model.points3D[mark.point3D_id].xyz) - mark.xy
            apart.append(found - ours[image.name, str(mark.point3D_id)])
    assert len(apart) == len(ours)
    assert np.abs(apart).max() < 1e-6


def test_places_on_the_earth_need_no_origin(run: Path, tmp_path: Path) -> None:
    exported(run, tmp_path, "--format", "geojson")
    given = adjusted_block(read_result(run))[0]
    turn = pyproj.Transformer.from_crs("EPSG:31982", "EPSG:4326", always_xy=True)
    features = json.loads((tmp_path / "block.geojson").read_text())["features"]
    exposures = [f["geometry"]["coordinates"] for f in features if f["properties"]["kind"] == "exposure"]
    longitude, latitude = turn.transform(given.images.values[:, 3], given.images.values[:, 4])
    np.testing.assert_allclose(np.array(exposures)[:, 0], longitude, atol=1e-9)
    np.testing.assert_allclose(np.array(exposures)[:, 1], latitude, atol=1e-9)
    np.testing.assert_allclose(np.array(exposures)[:, 2], given.images.values[:, 5], atol=1e-3)
    with pytest.raises(ConfigurationError, match="leave out --origin"):
        exported(run, tmp_path, "--format", "kml", "--origin", "0,0,0")


def test_lists_and_tables_keep_map_coordinates(run: Path, tmp_path: Path) -> None:
    given = adjusted_block(read_result(run))[0]
    assert exported(run, tmp_path, "--format", "odm")["origin"] is None
    crs, places, marks = read_gcp_list(tmp_path / "gcp_list.txt")
    assert crs == "EPSG:31982"
    assert len(marks) == len(given.observations.values)
    k = given.points.names.index(marks[0].point)
    assert places[marks[0].point] == tuple(given.points.values[k].tolist())
    _, images = read_geo(tmp_path / "geo.txt")
    told = np.array(list(images.values()))
    np.testing.assert_allclose(told[:, :3], given.images.values[:, 3:], rtol=1e-15)
    horizontal = np.hypot(*given.images.sigma[:, 3:5].T)
    np.testing.assert_allclose(told[:, 6], horizontal, rtol=1e-12)
    # The upper edge of the image points to the yaw, counted from true north: ten metres on by the geodesic.
    upper = matrix_from_angles(given.images.values[:, :3])[:, 1]
    turn = pyproj.Transformer.from_crs("EPSG:31982", "EPSG:4326", always_xy=True)
    level = 10 * upper[:, :2] / np.linalg.norm(upper[:, :2], axis=1)[:, None]
    here, there = (turn.transform(*(given.images.values[:, 3:5] + way).T) for way in (0.0, level))
    azimuth = pyproj.Geod(ellps="GRS80").inv(*here, *there)[0]
    yaw, pitch, _ = told[:, 3:6].T
    np.testing.assert_allclose((yaw - azimuth + 180) % 360 - 180, 0.0, atol=1e-3)
    np.testing.assert_allclose(pitch, np.degrees(np.arcsin(upper[:, 2])), atol=1e-9)


def test_a_system_without_geoid_is_refused(run: Path, tmp_path: Path) -> None:
    text = (run / "result.json").read_text().replace('"ellipsoidal"', '"orthometric"')
    for name in ("images.csv", "points.csv", "residuals.csv"):
        (tmp_path / name).write_bytes((run / name).read_bytes())
    (tmp_path / "result.json").write_text(text)
    with pytest.raises(ConfigurationError, match="does not name a geoid"):
        exported(tmp_path, tmp_path / "out", "--format", "colmap")
    assert not (tmp_path / "out").exists()
