"""The flown block against a simulated flight, whose ground is met by rays from the true camera."""

from __future__ import annotations

import csv
import json
import sqlite3
from collections.abc import Callable
from contextlib import closing
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from acquire.simulate.world.exposures import antenna_velocity
from acquire.simulate.world.observations import observe, seen
from acquire.simulate.world.world import World
from photocal.base.geopackage import LOCAL
from photocal.geometry.camera import camera
from photocal.geometry.oriented_images import OrientedImages
from photocal.geometry.strips import strips
from photocal.planning.flown import (
    FlownBlock,
    cells_seen,
    figures_of,
    flown_block,
    gaps,
    ground_through,
    level_ground,
)
from photocal.planning.flown_output import write_flown
from tests.photocal.analysis.georeferencing.flights import Plan, fly
from tests.photocal.conftest import Answer
from tests.simulated import true_poses, world_of

CHANGED = "2025-06-16T12:00:00.000Z"


@pytest.fixture(scope="module")
def world() -> World:
    return world_of()


@pytest.fixture(scope="module")
def images(world: World) -> OrientedImages:
    """The flight as an adjustment gives it: centimetres and hundredths of a degree wrong."""
    rng = np.random.default_rng(7)
    true = world.camera.certificate_terms("px")
    size = (world.camera.width, world.camera.height)
    own = camera("sim", "brown-ideal", "px", size, (1.0, 1.0), true, affinity="after")
    values = true_poses(world)
    values += rng.normal(0.0, 1.0, values.shape) * np.array([2e-4, 2e-4, 2e-4, 0.02, 0.02, 0.03])
    return OrientedImages(world.exposures.names, (own,), np.zeros(len(values), np.int64), values)


@pytest.fixture(scope="module")
def block(world: World, images: OrientedImages) -> FlownBlock:
    ties = observe(world).points_m
    velocity = antenna_velocity(world.motion, world.rig, world.exposures.event_s)
    strip, _ = strips(world.exposures.event_s, velocity)
    speed = np.linalg.norm(velocity, axis=1)
    exposure = np.full(len(images), world.configuration.camera.exposure_s)
    ground = ground_through(images, ties + np.random.default_rng(8).normal(0.0, 0.03, ties.shape))
    return flown_block(images, strip, ground, speed, exposure)


def shown(world: World, first: int, others: list[int]) -> float:
    """Share of a picture's ground that others show: rays of its pixels, met with the terrain."""
    own, pose = world.exposures.cameras[first], world.exposures.pose
    across, down = (np.arange(n) / n + 0.5 / n for n in (120, 80))
    column, row = np.meshgrid(across * own.width - 0.5, down * own.height - 0.5)
    # OpenCV's axes: x right, y down, z forward.
    rays = own.directions(np.column_stack([column.ravel(), row.ravel()])) * np.array([1.0, -1.0, -1.0])
    start = np.broadcast_to(pose.centre_m[first], rays.shape)
    places = world.terrain.intersect(start, rays @ pose.rotation[first])
    seen_by = np.zeros(len(places), bool)
    for other in others:
        single = type(pose)(pose.centre_m[other : other + 1], pose.rotation[other : other + 1])
        pixels = seen(places, single, world.exposures.cameras[other])
        seen_by |= world.exposures.cameras[other].sees(pixels, -0.5)
    return float(seen_by.mean())


def test_strips_are_those_flown(world: World, block: FlownBlock) -> None:
    assert (np.diff(block.strip) != 0).tolist() == (np.diff(world.exposures.strip) != 0).tolist()


def test_forward_overlap_is_the_true_one(world: World, block: FlownBlock) -> None:
    pairs = np.flatnonzero(np.isfinite(block.forward))[::2]
    true = np.array([shown(world, int(i), [int(i) + 1]) for i in pairs])
    # Single pairs lie partly over ground beyond the outermost tie points.
    assert np.abs(block.forward[pairs] - true).max() < 0.02
    assert abs(np.median(block.forward[pairs]) - np.median(true)) < 0.005


def test_side_overlap_is_the_true_one(world: World, block: FlownBlock) -> None:
    place = world.exposures.pose.centre_m[:, :2]
    assert len(block.side) == 10
    for (first, second), share in block.side.items():
        others = np.flatnonzero(block.strip == second).tolist()
        along = place[others[-1]] - place[others[0]]
        low, high = sorted((place[[others[0], others[-1]]] @ along).tolist())
        mine = [i for i in np.flatnonzero(block.strip == first) if low <= place[i] @ along <= high]
        assert share == pytest.approx(np.median([shown(world, int(i), others) for i in mine]), abs=0.012)


def test_height_ground_sampling_tilt_and_smear(world: World, block: FlownBlock) -> None:
    pose = world.exposures.pose
    height = pose.centre_m[:, 2] - world.terrain.height(*pose.centre_m[:, :2].T)
    assert np.abs(block.height_m / height - 1.0).max() < 0.015
    tilt = np.degrees(np.arccos(pose.rotation[:, 2, 2]))
    assert np.degrees(block.tilt_rad) == pytest.approx(tilt, abs=0.05)
    # How far the image of the ground below moves in the true camera between opening and closing.
    half = world.configuration.camera.exposure_s / 2.0
    velocity = antenna_velocity(world.motion, world.rig, world.exposures.event_s)
    for i in range(0, len(height), 7):
        own = world.exposures.cameras[i]
        moved = []
        for side in (-half, half):
            centre = pose.centre_m[i : i + 1] + side * velocity[i]
            below = pose.centre_m[i : i + 1] - [[0.0, 0.0, height[i]]]
            moved.append(seen(below, type(pose)(centre, pose.rotation[i : i + 1]), own)[0])
        assert block.smear_px[i] == pytest.approx(float(np.linalg.norm(moved[1] - moved[0])), rel=0.1)


def test_rays_and_gaps(world: World, images: OrientedImages, block: FlownBlock, tmp_path: Path) -> None:
    at = int(np.argmin(np.linalg.norm(block.ground.places[:, :2], axis=1)))
    place = block.ground.places[at : at + 1]
    true = sum(
        bool(own.sees(seen(place, type(world.exposures.pose)(c[None], m[None]), own))[0])
        for own, c, m in zip(
            world.exposures.cameras,
            world.exposures.pose.centre_m,
            world.exposures.pose.rotation,
            strict=True,
        )
    )
    assert abs(int(block.rays[at]) - true) <= 1
    assert gaps(block) == []
    # A hole: without the pictures that show the middle of the area.
    hole = np.array([5.0, 0.0])
    shows = [np.linalg.norm(block.ground.places[cells, :2] - hole, axis=1).min() < 8.0 for cells in
             cells_seen(images, block.ground)]  # fmt: skip
    kept = np.flatnonzero(~np.array(shows))
    torn = flown_block(images.only(kept), block.strip[kept], level_ground(images, 0.0))
    east, north, cells = gaps(torn)[0]
    assert np.hypot(east - hole[0], north - hole[1]) < 10.0
    assert cells * torn.ground.cell_m**2 > 150.0
    # The map has the areas of the figures.
    figures, still = figures_of(torn), np.zeros(len(kept))
    write_flown(tmp_path / "torn", torn, images.values[kept, 3:], still, figures, np.asarray, LOCAL, CHANGED)
    with closing(sqlite3.connect(tmp_path / "torn" / "flown.gpkg")) as database:
        areas = [area for (area,) in database.execute("SELECT area_m2 FROM gaps")]
    assert areas == pytest.approx([gap["area_m2"] for gap in figures["gaps"]])


def test_cells_are_sought_where_they_are(images: OrientedImages) -> None:
    """Every cell projected into every image, without a lens that folds ground beyond its corners into it."""
    size = images.cameras[0].size_px
    plain = camera("sim", "brown-ideal", "px", size, (1.0, 1.0), {"c": float(images.cameras[0].values[0])})
    straight = replace(images, cameras=(plain,))
    ground = level_ground(straight, 0.0)
    for i, cells in enumerate(cells_seen(straight, ground)):
        pixel = straight.project(np.full(len(ground.places), i), ground.places)
        inside = ((pixel >= -0.5) & (pixel <= np.array(size) - 0.5)).all(axis=1)
        assert np.array_equal(cells, np.flatnonzero(inside))


def test_figures_are_plain(block: FlownBlock) -> None:
    figures = figures_of(block)
    assert figures["images"] == len(block.names)
    assert 0.7 < figures["forward_overlap"]["median"] < 0.8
    nothing = replace(block, smear_px=np.full(len(block.names), np.nan))
    assert figures_of(nothing)["smear_px"] is None


def test_the_command_measures_a_block_folder(photocal: Callable[..., Answer], tmp_path: Path) -> None:
    """Strips 40 m apart, 26 m between images, at 90 m with 12 mm of 13.5 mm x 9 mm: overlaps by hand."""
    folder = fly(tmp_path / "flight", np.random.default_rng(3), plan=Plan(relief_m=0.0))
    plan = tmp_path / "plan.json"
    plan.write_text('{"levels": [{"height_m": 90.0, "gsd_m": 0.03375}]}', encoding="utf-8")
    said = photocal("flown", folder, "--exposure-ms", 1, "--plan", plan, "-o", tmp_path / "out", "--json")
    assert said.code == 0, said.err
    figures = json.loads(said.out)
    assert figures["planned"] == {"height_m": 90.0, "gsd_m": 0.03375}
    assert (figures["images"], figures["strips"]) == (40, 7)
    low = [row for row in read_rows(tmp_path / "out" / "flown.csv") if float(row["height_m"]) < 100.0]
    # Height along the flight: 9 mm / 12 mm x 90 m; the images are turned and shifted by chance.
    forward = np.median([float(row["forward_overlap"]) for row in low if row["forward_overlap"]])
    assert forward == pytest.approx(1.0 - 26.0 / 67.5, abs=0.03)
    assert float(low[0]["gsd_m"]) == pytest.approx(float(low[0]["height_m"]) * 0.0045 / 12.0, rel=1e-4)
    # 14 m/s and 8 m/s in turn, 1 ms, 3.4 and 4.9 cm.
    assert figures["smear_px"]["most"] == pytest.approx(14e-3 / 0.03375, rel=0.1)
    with closing(sqlite3.connect(tmp_path / "out" / "flown.gpkg")) as database:
        assert database.execute("SELECT COUNT(*) FROM images").fetchone() == (40,)
        assert database.execute("SELECT MIN(images) FROM rays").fetchone()[0] >= 0
    assert "<svg" in (tmp_path / "out" / "flown.svg").read_text(encoding="utf-8")


def read_rows(path: Path) -> list[dict[str, str]]:
    with path.open(encoding="utf-8", newline="") as stream:
        return list(csv.DictReader(stream))
