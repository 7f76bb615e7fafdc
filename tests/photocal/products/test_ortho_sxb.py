"""Orthophoto of a real aerial block on the terrain of its own tie points, at its surveyed points."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest
from scipy.ndimage import map_coordinates

from photocal.block.results.adjusted import adjust_block
from photocal.exchange.formats import read_any_block
from photocal.geometry.camera import plane_to_pixel
from photocal.geometry.frames import LocalFrame
from photocal.geometry.oriented_images import OrientedImages
from photocal.products.kernels import BILINEAR
from photocal.products.oriented import oriented
from photocal.products.ortho_job import terrain_points
from photocal.products.orthophoto import ImageStore, Recipe, Tile, orthophoto
from photocal.products.raster import read_image
from photocal.products.terrain import Grid, Terrain, grid_of_points, read_terrain_points

CELL = 0.1
SIDE = 100


@pytest.mark.shared
@pytest.mark.slow
def test_the_orthophoto_has_the_check_points_in_their_places(shared: Path, tmp_path: Path) -> None:
    source = shared / "data" / "dbat-sxb"
    adjust_block(source / "script" / "sxb.xml", tmp_path / "run", read=read_any_block)
    block, frame, shots = oriented(source / "script" / "sxb.xml", tmp_path / "run")
    terrain = grid_of_points(*read_terrain_points(tmp_path / "run" / "points.csv"), 2.0, "", "local")[0]
    observations = block.observations
    for point in np.flatnonzero(block.points.of_role("check")):
        surveyed = block.points.values[point]
        rows = np.flatnonzero(observations.point == point)
        measured = np.array([_pixel(block, int(row)) for row in rows])
        # On ground of the surveyed height the rays meet the surveyed place within the block's own check
        # errors; on the sparse terrain of the tie points its error in height comes on top.
        level = replace(terrain, heights=np.full_like(terrain.heights, surveyed[2]))
        off = float(terrain.at(surveyed[:1], surveyed[1:2])[0] - surveyed[2])
        for row, pixel in zip(rows, measured, strict=True):
            number = int(observations.image[row])
            exact, found = (terrain_points(shots, number, pixel[None], t, frame)[0] for t in (level, terrain))
            assert np.hypot(*(exact - surveyed)[:2]) < 0.6
            slope = np.abs((frame.to_given(shots.station[number][None])[0] - exact)[:2]).sum() / 1700
            assert np.hypot(*(found - exact)[:2]) < abs(off) * slope + 0.05
        # In the picture: the surroundings of the surveyed place against those of the measured image point.
        number = int(observations.image[rows[0]])
        image = read_image(source / "images" / shots.names[number])
        west, north = surveyed[0] - CELL * SIDE / 2, surveyed[1] + CELL * SIDE / 2
        grid = Grid(west, north, CELL, SIDE, SIDE)
        one = shots.only([number])
        recipe = Recipe(one, frame, lambda _: terrain, grid, BILINEAR, 3, "uint8", 0.0)
        (tile,) = orthophoto(recipe, ImageStore([image].__getitem__), 1)
        _same_as_peers(tile, image, one, frame, terrain, grid)
        corners = terrain_points(one, 0, measured[0] + 40 * np.eye(3, 2, -1), terrain, frame)
        across = np.linalg.inv((corners[1:, :2] - corners[0, :2]).T / 40)
        steps = (np.arange(SIDE) + 0.5) * CELL - CELL * SIDE / 2
        east, up = np.meshgrid(steps, -steps)
        place = (measured[0] + np.stack([east, up], axis=-1) @ across.T).astype(np.float32)
        around = cv2.remap(image, place[..., 0], place[..., 1], cv2.INTER_LINEAR)
        made = np.moveaxis(tile[2], 0, 2)
        shift, response = cv2.phaseCorrelate(
            around.mean(axis=2).astype(np.float64), made.mean(axis=2).astype(np.float64)
        )
        assert response > 0.3
        gap = terrain_points(one, 0, measured[:1], terrain, frame)[0] - surveyed
        assert np.array(shift) * CELL * [1, -1] == pytest.approx(gap[:2], abs=0.05)


def _same_as_peers(
    tile: Tile, image: np.ndarray[tuple[int, ...], np.dtype[np.uint8]], one: OrientedImages,
    frame: LocalFrame, terrain: Terrain, grid: Grid,
) -> None:  # fmt: skip
    """SciPy and OpenCV resample the image by the same map: equal to one grey level.

    OpenCV rounds places to 1/32 px, which at hard edges is more: there only most cells agree.
    """
    _, _, pixels, chosen = tile
    x, y = grid.centers(0, 0, grid.columns, grid.rows)
    xs, ys = np.meshgrid(x, y)
    given = np.column_stack([xs.ravel(), ys.ravel(), terrain.at(xs, ys).ravel()])
    place = one.project(np.full(len(given), 0), frame.to_local(given)).reshape(*xs.shape, 2)
    seen = np.isfinite(place).all(axis=2) & (chosen >= 0)
    assert seen.mean() > 0.9
    low, high = (np.floor(edge(place[seen], axis=0)).astype(int) for edge in (np.min, np.max))
    first = np.maximum(low - 2, 0)
    around_it = image[first[1] : high[1] + 4, first[0] : high[0] + 4]
    place -= first
    for band in range(3):
        values = around_it[..., band].astype(np.float32)
        exact = map_coordinates(values, place[seen].T[::-1], order=1, mode="nearest")
        assert np.abs(exact - pixels[band][seen]).max() <= 1
    columns, rows = (np.ascontiguousarray(place[..., k], dtype=np.float32) for k in (0, 1))
    around = cv2.remap(around_it, columns, rows, cv2.INTER_LINEAR)
    apart = np.abs(np.moveaxis(around, 2, 0).astype(int) - pixels.astype(int)).max(axis=0)[seen]
    assert (apart <= 1).mean() > 0.95
    assert apart.max() <= 255 / 32


def _pixel(block: object, row: int) -> np.ndarray[tuple[int, ...], np.dtype[np.float64]]:
    observations, images = block.observations, block.images  # type: ignore[attr-defined]
    camera = block.cameras[images.camera[observations.image[row]]]  # type: ignore[attr-defined]
    value = observations.values[row]
    if observations.axes == "pixel":
        scale = 1.0 if observations.unit == "px" else 1 / np.array(camera.pitch)
        return np.asarray(value * scale)
    plane = value if observations.unit == "mm" or camera.unit == "px" else value * np.array(camera.pitch)

    return plane_to_pixel(camera.size_px, camera.pitch, plane)
