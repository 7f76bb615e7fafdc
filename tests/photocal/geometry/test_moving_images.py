"""Images that move while they are read: projected, exported, intersected and mosaicked line by line."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from photocal.analysis.georeferencing.direct import direct_orientation, intersect_points
from photocal.base.arrays import Integers
from photocal.block.folder import read_block
from photocal.block.model import Block, Images, ObjectPoints, Observations
from photocal.block.results.adjusted import adjust_network
from photocal.block.results.adjusted_block import adjusted_block
from photocal.block.results.folder import read_result, write_result
from photocal.block.writer import write_block
from photocal.geometry.camera import PARAMETERS, plane_to_pixel
from photocal.geometry.oriented_images import OrientedImages, oriented_images
from photocal.products.kernels import Poses, look_up
from photocal.products.oriented import lens_tables
from tests.photocal import flights

Floats = flights.Floats
READOUT_S = 0.06


@pytest.fixture(scope="module")
def truth() -> flights.Flight:
    rng = np.random.default_rng(7)
    own = replace(flights.wide(), shutter="rolling").changed(readout=READOUT_S)
    return flights.flight(own, rng, images=12, points=150, readout_s=READOUT_S)


@pytest.fixture(scope="module")
def views(truth: flights.Flight) -> OrientedImages:
    count = len(truth.centre)
    movement = READOUT_S * np.hstack([truth.velocity, truth.rate])
    still = oriented_images((truth.camera,), np.zeros(count), truth.rotation, truth.centre)
    return replace(still, movement=movement)


def seen(truth: flights.Flight) -> tuple[Integers, Integers, Floats]:
    """Image, point and pixels of all rays within the images, without errors."""
    count = len(truth.points)
    image, point = (
        np.repeat(np.arange(len(truth.centre)), count),
        np.tile(np.arange(count), len(truth.centre)),
    )
    plane = flights.recorded(truth, image, point)
    with np.errstate(invalid="ignore"):
        inside = (np.abs(plane) < np.array(flights.SIZE) / 2 - 10).all(axis=1)
    pixels = plane_to_pixel(np.array(flights.SIZE), np.ones(2), plane)
    return image[inside], point[inside], pixels[inside]


def test_projection_is_that_of_the_line(truth: flights.Flight, views: OrientedImages) -> None:
    image, point, pixels = seen(truth)
    assert views.project(image, truth.points[point]) == pytest.approx(pixels, abs=1e-6)
    still = replace(views, movement=None).project(image, truth.points[point])
    assert np.abs(still - pixels).max() > 5.0


@pytest.mark.parametrize("shaken", [False, True])
def test_orthophoto_looks_the_line_up(truth: flights.Flight, views: OrientedImages, shaken: bool) -> None:
    if shaken:
        views = replace(views, movement=np.hstack([views.movements, np.full((len(views), 15), 5e-4)]))
    lenses, count = lens_tables(views.cameras), len(truth.points)
    place, chosen = np.full((2, count), np.nan), np.full(count, -1, dtype=np.int64)
    poses = Poses(views.camera, views.rotation, views.station, views.movements)
    look_up(truth.points, lenses, poses, np.arange(len(views)), place, chosen)
    found = np.flatnonzero(chosen >= 0)
    expected = views.project(chosen[found], truth.points[found])
    assert len(found) > 50
    assert pytest.approx(expected, abs=1e-3 if shaken else 1e-4) == place[:, found].T


def block_of(truth: flights.Flight) -> Block:
    """The rays without errors, poses known and moving as they do."""
    image, point, pixels = seen(truth)
    enough = np.bincount(point, minlength=len(truth.points)) >= 3
    kept = enough[point]
    image, point, pixels = image[kept], point[kept], pixels[kept]
    poses = oriented_images((truth.camera,), np.zeros(len(truth.centre)), truth.rotation, truth.centre)
    images = Images(poses.names, poses.camera, poses.values)
    motion = np.hstack([truth.velocity, truth.rate])
    given = replace(
        images, sigma=np.full(images.sigma.shape, 1e-6), motion=motion, motion_sigma=1e-9 + 0 * motion
    )

    points = ObjectPoints(
        tuple(str(j) for j in range(len(enough))),
        truth.points,
        np.full(truth.points.shape, np.inf),
        np.full(len(enough), 2),
    )
    own = replace(truth.camera, estimated=np.zeros(len(PARAMETERS), dtype=np.bool_))
    observed = Observations("px", "pixel", image, point, pixels, np.full(pixels.shape, 0.5))
    return Block("b", "local", "", "control", (own,), given, points, observed)


def test_intersection_goes_along_the_lines(truth: flights.Flight) -> None:
    block = block_of(truth)
    found = intersect_points(block, direct_orientation(block), np.unique(block.observations.point))
    assert len(found.points) > 30
    assert found.xyz == pytest.approx(truth.points[found.points], abs=1e-6)


def test_exported_observations_are_those_of_one_pose(truth: flights.Flight, views: OrientedImages) -> None:
    """Programs with one pose for all lines find the same points: corrected pixels are those of the middle."""
    result = adjust_network(block_of(truth))
    assert result.images.movement is not None
    assert result.images.movement == pytest.approx(views.movements, abs=1e-6)
    given = adjusted_block(result)[0]
    assert not given.cameras[0].rolling
    still = replace(views, movement=None)
    names = [int(given.points.names[j]) for j in given.observations.point]
    assert given.observations.values == pytest.approx(
        still.project(given.observations.image, truth.points[names]), abs=1e-3
    )


def test_lines_are_moved_to_the_middle(truth: flights.Flight, views: OrientedImages) -> None:
    """Turns alone, with the polynomials: where each image would show its points without them."""
    turning = replace(views, movement=np.hstack([views.movements, np.full((len(views), 15), 5e-4)]))
    turning.movements[:, :3] = 0.0
    image, point, _ = seen(truth)
    shown = turning.project(image, truth.points[point])
    still = replace(views, movement=None).project(image, truth.points[point])
    assert np.abs(shown - still).max() > 5.0
    # The line of a projection is found to some 1e-4 px.
    assert turning.at_the_middle(image, shown) == pytest.approx(still, abs=1e-3)


def test_recorded_turns_come_through_files(
    truth: flights.Flight, views: OrientedImages, tmp_path: Path
) -> None:
    """Of a block as it is written and read, and of the result of its adjustment."""
    block = block_of(truth)
    shakes = np.random.default_rng(5).normal(0.0, 0.001, (len(truth.centre), 15))
    motion = np.hstack([block.images.motion, shakes])
    rays = block.observations
    shaken = replace(views, movement=READOUT_S * motion)
    pixels = shaken.project(rays.image, truth.points[rays.point])
    written = replace(
        block,
        images=replace(block.images, motion=motion),
        observations=replace(rays, values=pixels),
    )
    for name in ("block", "run"):
        (tmp_path / name).mkdir()
    write_block(tmp_path / "block", written)
    # Six digits of m/s, and of deg/s.
    assert read_block(tmp_path / "block").images.motion == pytest.approx(motion, abs=0.51e-6)
    result = adjust_network(written)
    write_result(tmp_path / "run", result)
    read = read_result(tmp_path / "run").images.movement
    moved = result.images.movement
    assert moved is not None
    assert moved == pytest.approx(READOUT_S * motion, abs=1e-6)
    assert read == pytest.approx(moved, abs=1e-12)
