"""Terrain models: interpolation, triangulation against matplotlib's, files and the kind of heights."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import rasterio  # type: ignore[import-untyped]
from hypothesis import given, settings
from hypothesis import strategies as st
from matplotlib.tri import LinearTriInterpolator, Triangulation
from numpy.typing import NDArray

from photocal.base.errors import ConfigurationError, IllPosedError, InputMalformedError
from photocal.products.raster import describe, same_system, system_wkt, terrain_source, write_terrain
from photocal.products.terrain import Terrain, grid_of_points, read_terrain_points
from tests.photocal.products.test_orthophoto import write_job

Floats = NDArray[np.float64]


def loose(xyz: Floats) -> tuple[Floats, NDArray[np.int64]]:
    return xyz, np.full(len(xyz), -1)


def centers(terrain: Terrain) -> tuple[Floats, Floats]:
    rows, columns = terrain.heights.shape
    a, _, c, _, e, f = terrain.transform
    x, y = np.meshgrid(c + a * (np.arange(columns) + 0.5), f + e * (np.arange(rows) + 0.5))
    return x, y


@settings(max_examples=25)
@given(
    slope=st.tuples(st.floats(-1, 1), st.floats(-1, 1), st.floats(-100, 100)),
    shift=st.tuples(st.floats(-1e6, 1e6), st.floats(-1e7, 1e7)),
    seed=st.integers(0, 1000),
)
def test_a_plane_stays_a_plane(
    slope: tuple[float, float, float], shift: tuple[float, float], seed: int
) -> None:
    random = np.random.default_rng(seed)
    xy = random.uniform(0, 100, (40, 2))
    z = slope[0] * xy[:, 0] + slope[1] * xy[:, 1] + slope[2]
    terrain = grid_of_points(*loose(np.column_stack([xy + shift, z])), 5.0, "", "local")[0]
    x, y = centers(terrain)
    found = np.isfinite(terrain.heights)
    assert found.mean() > 0.5
    exact = slope[0] * (x - shift[0]) + slope[1] * (y - shift[1]) + slope[2]
    assert terrain.heights[found] == pytest.approx(exact[found], abs=1e-6)
    # And between the centres of the cells.
    inner = np.array([x[10, 8] + 1.3]), np.array([y[10, 8] - 2.1])
    expected = slope[0] * (inner[0] - shift[0]) + slope[1] * (inner[1] - shift[1]) + slope[2]
    assert terrain.at(*inner) == pytest.approx(expected, abs=1e-6)


def test_triangles_equal_those_of_matplotlib() -> None:
    random = np.random.default_rng(13)
    xyz = np.column_stack([random.uniform(0, 80, (200, 2)), random.normal(0, 5, 200)])
    terrain, _, flat = grid_of_points(*loose(xyz), 1.0, "", "local")
    x, y = centers(terrain)
    peer = LinearTriInterpolator(Triangulation(xyz[:, 0], xyz[:, 1]), xyz[:, 2])(x, y)
    ours = np.isfinite(terrain.heights)
    assert (ours != ~np.ma.getmaskarray(peer)).sum() <= 2
    both = ours & ~np.ma.getmaskarray(peer)
    assert terrain.heights[both] == pytest.approx(np.asarray(peer)[both], abs=1e-9)
    assert flat == 0


def test_contours_are_followed() -> None:
    # A cone of contours with few vertices: denser ones keep triangles from crossing the next contour.
    vertices, lines = [], []
    for number, radius in enumerate((40.0, 30.0, 20.0, 10.0)):
        angle = np.linspace(0, 2 * np.pi, 24)
        vertices.append(
            np.column_stack([radius * np.cos(angle), radius * np.sin(angle), 0 * angle + 40 - radius])
        )
        lines += [number] * 24
    contours = np.vstack(vertices), np.array(lines)
    terrain, _, flat = grid_of_points(*contours, 0.5, "", "orthometric")
    x, y = centers(terrain)
    distance = np.hypot(x, y)
    ring = (distance > 11) & (distance < 39)
    assert np.abs(terrain.heights - (40 - distance))[ring].max() < 0.4
    # The summit is cut off at its contour, and that is said.
    assert flat > 0
    assert terrain.at(np.zeros(1), np.zeros(1))[0] == pytest.approx(30)


def test_points_at_one_place_give_their_mean() -> None:
    xyz = np.array([[0.0, 0, 1], [10, 0, 1], [10, 10, 1], [0, 10, 1], [5, 5, 1], [5, 5, 3]])
    terrain = grid_of_points(*loose(xyz), 1.0, "", "local")[0]
    assert np.nanmax(terrain.heights) <= 2
    assert terrain.at(np.array([5.0]), np.array([5.0]))[0] == pytest.approx(2, abs=0.25)


def test_complaints() -> None:
    line = np.column_stack([np.arange(5.0), np.arange(5.0), np.zeros(5)])
    for points in (line, line[:2]):
        with pytest.raises(IllPosedError):
            grid_of_points(*loose(points), 1.0, "", "local")
    square = np.array([[0.0, 0, 0], [1e6, 0, 0], [1e6, 1e6, 0]])
    with pytest.raises(ConfigurationError, match="larger cells"):
        grid_of_points(*loose(square), 1.0, "", "local")
    with pytest.raises(ConfigurationError, match="positive"):
        grid_of_points(*loose(square), 0.0, "", "local")


def test_adjusted_points_make_a_terrain_without_the_check_points(tmp_path: Path) -> None:
    path = tmp_path / "points.csv"
    path.write_text(
        "point,role,X,Y,Z,sX,sY,sZ,rays\na,tie,0,0,5,1,1,1,3\nb,control,1,0,6,1,1,1,3\nc,check,9,9,9,1,1,1,3\n"
        "d,tie,0,1,,,,,2\n",
        encoding="utf-8",
    )
    assert read_terrain_points(path)[0].tolist() == [[0, 0, 5], [1, 0, 6]]


def test_a_written_model_reads_the_same_in_pieces(tmp_path: Path) -> None:
    random = np.random.default_rng(14)
    heights = random.normal(100, 10, (300, 400)).astype(np.float32).astype(float)
    heights[5:9, 7:9] = np.nan
    crs = system_wkt("EPSG:31982")
    terrain = Terrain(heights, (2.0, 0, 500000.0, 0, -2.0, 7000000.0), crs, "orthometric")
    write_terrain(terrain, tmp_path / "dtm.tif")
    raster = describe(tmp_path / "dtm.tif")
    assert raster.height_kind == "orthometric"
    assert same_system(raster.crs, crs)
    piece = terrain_source(raster, "orthometric")
    x, y = random.uniform(499990, 500810, 300), random.uniform(6999390, 7000010, 300)
    expected = terrain.at(x, y)
    found = [piece((a, b, a, b)).at(np.array([a]), np.array([b]))[0] for a, b in zip(x, y, strict=True)]
    assert np.array(found) == pytest.approx(expected, abs=1e-9, nan_ok=True)
    assert 0.8 < np.isfinite(expected).mean() < 1


@pytest.mark.parametrize(
    ("system", "kind"), [("EPSG:31982", ""), ("EPSG:31982+5773", "orthometric"), ("EPSG:4979", "ellipsoidal")]
)
def test_the_system_tells_the_kind_of_the_heights(tmp_path: Path, system: str, kind: str) -> None:
    terrain = Terrain(np.ones((3, 3)), (1.0, 0, 0, 0, -1.0, 3), system_wkt(system), "")
    write_terrain(terrain, tmp_path / "dtm.tif")
    assert describe(tmp_path / "dtm.tif").height_kind == kind


def test_any_raster_of_gdal_with_scale_and_turned_axes(tmp_path: Path) -> None:
    path = tmp_path / "dtm.tif"
    turned = rasterio.Affine(0.0, 3.0, 10.0, 3.0, 0.0, 20.0)
    with rasterio.open(
        path, "w", driver="GTiff", width=4, height=5, count=1, dtype="int16", transform=turned
    ) as target:
        target.write(np.arange(20, dtype=np.int16).reshape(1, 5, 4))
        target.scales, target.offsets = (0.5,), (100.0,)
    piece = terrain_source(describe(path), "local")
    # Row 2, column 1 has its centre at X = 10 + 3 * 2.5, Y = 20 + 3 * 1.5.
    x, y = np.array([17.5]), np.array([24.5])
    assert piece((17.5, 24.5, 17.5, 24.5)).at(x, y) == pytest.approx([100 + 0.5 * 9])
    grid = tmp_path / "dtm.asc"
    grid.write_text("ncols 2\nnrows 2\nxllcorner 0\nyllcorner 0\ncellsize 1\nNODATA_value -9\n1 2\n3 -9\n")
    heights = terrain_source(describe(grid), "local")((0, 0, 2, 2)).heights
    assert heights[0].tolist() == [1, 2]
    assert np.isnan(heights[1, 1])


@pytest.mark.parametrize(("bands", "said"), [(3, "3 bands"), (1, "a picture, not a terrain model")])
def test_what_is_no_terrain_model_is_refused(tmp_path: Path, bands: int, said: str) -> None:
    path = tmp_path / "photo.tif"
    options = {"driver": "GTiff", "width": 3, "height": 3, "dtype": "uint8", "count": bands}
    with rasterio.open(path, "w", transform=rasterio.Affine(1, 0, 0, 0, -1, 3), **options) as target:
        target.write(np.zeros((bands, 3, 3), np.uint8))
    with pytest.raises(InputMalformedError, match=said):
        terrain_source(describe(path), "local")


@pytest.mark.filterwarnings("ignore::rasterio.errors.NotGeoreferencedWarning")
def test_orthophoto_on_tie_points(photocal: Callable[..., Any], tmp_path: Path) -> None:
    arguments = write_job(tmp_path)
    corners = [(x, y) for x in (380, 500, 620) for y in (580, 700, 820)]
    rows = [f"{x},{y},{0.05 * (x - 500) - 0.03 * (y - 700) + 10}" for x, y in corners]
    (tmp_path / "ties.csv").write_text("X,Y,Z\n" + "\n".join(rows) + "\n", encoding="utf-8")
    more = ["--cell", "0.5", "--bounds", "475,680,525,720"]
    assert photocal(*arguments, *more).code == 0
    with rasterio.open(tmp_path / "ortho.tif") as made:
        expected = made.read()
    csv = ["--dtm", tmp_path / "ties.csv", "--dtm-cell", "5"]
    assert "give --dtm-cell, --dtm-output" in photocal(*arguments, *more, *csv).err
    told = photocal(*arguments, *more, *csv, "--dtm-output", tmp_path / "made.tif")
    assert told.code == 0, told.err
    assert "9 points, 8 triangles" in told.out
    with rasterio.open(tmp_path / "ortho.tif") as made:
        pixels = made.read()
    inside = (expected > 0).all(axis=0)
    # Heights are kept with 7 digits: micrometres, and so now and then one grey level.
    assert np.abs(pixels.astype(int) - expected)[:, inside].max() <= 1
