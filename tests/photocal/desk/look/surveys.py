"""Projects of a ready block with pictures, simulated with known truth: a small one, and one of any size."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from photocal.adjustment.mounting import Positions
from photocal.block.model import ROLES, Block, Images, ObjectPoints, Observations
from photocal.geometry.camera import Camera, camera
from photocal.geometry.oriented_images import OrientedImages
from tests.photocal.measurement.marking.conftest import plate
from tests.photocal.measurement.site import SIDE, flight, plate_place, texture, with_plate

Floats = NDArray[np.float64]
SIGMA_PX, POSITION_M, CONTROL_M = 0.3, 0.02, 0.01
PLACES = ((-8.0, -5.0), (8.0, -5.0), (-8.0, 5.0), (8.0, 5.0), (0.5, 0.0), (-4.0, 2.0))
PLATES = {f"P{k + 1}": place for k, place in enumerate(PLACES)}
ESTIMATED = ("c", "x0", "y0", "K1")
CHECKS = ("P4", "P6")
# The mark that lies a plate's half too far right: 12 px are 0.5 m there.
GROSS_IMAGE, GROSS_POINT, GROSS_PX = "p2.png", "P5", 12.0
PROJECT = """# A small survey with painted targets.
[project]
name = "site"
crs = "local"
height = "local"
output = "work"

[measurements]
block = "block"   # simulated
"""
# The same pictures with a table of control, none of it marked.
MARKING = """
[project]
name = "site"
crs = "local"
height = "local"
output = "work"
[images]
folder = "images"
[[camera]]
id = "cam"
model = "brown-ideal"
unit = "px"
size_px = [480, 360]
parameters = { c = 450.0, K1 = -8e-8 }
[control]
points = "control.csv"
marks = "marks.csv"
"""


def with_control(folder: Path) -> dict[str, tuple[float, float]]:
    """Give a finished project a table of control; returns where its points lie."""
    places = {name: plate_place(plate(1), place) for name, place in PLATES.items()}
    rows = [f"{name},{x:.4f},{y:.4f},0.0,0.01,0.01,0.01,control" for name, (x, y) in places.items()]
    (folder / "control.csv").write_text("\n".join(["point,X,Y,Z,sX,sY,sZ,role", *rows]) + "\n")
    (folder / "project.toml").write_text(MARKING, encoding="utf-8")
    return places


def small(folder: Path) -> Path:
    """Write a project of eight rendered pictures, six painted targets and a mark that is 12 px off."""
    (folder / "images").mkdir(parents=True)
    ground, lain = texture(5, SIDE), dict[str, tuple[float, float, float]]()
    for name, place in PLATES.items():
        with_plate(ground, plate(1), place)
        lain[name] = (*plate_place(plate(1), place), 0.0)
    site = flight()
    site.render(ground, folder / "images")
    rng = np.random.default_rng(3)
    ties = np.column_stack([rng.uniform(-13, 13, 160), rng.uniform(-9, 9, 160), np.zeros(160)])
    block = simulated(site.views, lain, ties, seed=3)
    seen = block.observations
    gross = (seen.image == site.names.index(GROSS_IMAGE)) & (
        seen.point == block.points.names.index(GROSS_POINT)
    )
    assert gross.sum() == 1
    seen.values[gross, 0] += GROSS_PX
    block.write(folder / "block")
    (folder / "project.toml").write_text(PROJECT + '\n[images]\nfolder = "images"\n', encoding="utf-8")
    return folder


def large(folder: Path, images: int = 581, rays: int = 108_000) -> Path:
    """Write a project without pictures: strips over a field, 20 megapixels, ties all over."""
    rng = np.random.default_rng(8)
    size, given = (5472, 3648), {"c": 3650.0, "K1": -6e-10}
    own = camera("p1", "brown-ideal", "px", size, (1.0, 1.0), given, estimate=ESTIMATED)
    strips = max(2, round(np.sqrt(images / 1.6)))
    strip, step = np.divmod(np.arange(images), -(-images // strips))
    poses = np.zeros((images, 6))
    poses[:, 3] = np.where(strip % 2 == 0, step, step.max() - step) * 18.0
    poses[:, 4], poses[:, 5] = strip * 28.0, 80.0 + rng.normal(0, 0.5, images)
    poses[:, :3] = np.radians(rng.normal(0, 2, (images, 3))) + np.pi * np.outer(strip % 2, [0, 0, 1])
    views = OrientedImages(
        tuple(f"DJI_{k:04d}.JPG" for k in range(images)), (own,), np.zeros(images, np.int64), poses
    )
    reach = poses[:, 3:5].max(axis=0)
    # An image shows 9600 m2.
    count = int(rays / 9600.0 / images * (reach[0] + 120.0) * (reach[1] + 80.0))
    ties = np.column_stack([rng.uniform(-60, reach[0] + 60, count), rng.uniform(-40, reach[1] + 40, count)])
    ties = np.column_stack([ties, 4.0 * np.sin(ties[:, 0] / 90.0) * np.cos(ties[:, 1] / 70.0)])
    marked = {f"G{k}": (*(reach * (0.1 + 0.8 * np.array(divmod(k, 4)) / 3.0)), 1.0) for k in range(16)}
    simulated(views, marked, ties, seed=8, checks=("G5", "G6", "G9", "G10")).write(folder / "block")
    (folder / "project.toml").write_text(PROJECT, encoding="utf-8")
    return folder


def simulated(
    views: OrientedImages,
    marked: Mapping[str, tuple[float, ...]],
    ties: Floats,
    *,
    seed: int,
    checks: tuple[str, ...] = CHECKS,
) -> Block:
    """Observe points in images with the errors that their sigmas state."""
    rng = np.random.default_rng(seed)
    truth = np.vstack([np.array(list(marked.values())), ties])
    image, point, pixel = _seen(views, truth)
    seen = np.bincount(point, minlength=len(truth)) >= 2
    kept = seen | (np.arange(len(truth)) < len(marked))
    place, ray = np.cumsum(kept) - 1, kept[point]
    names = (*marked, *(f"t{k}" for k in range(len(ties))))
    given = np.full((len(truth), 3), np.inf)
    given[: len(marked)] = CONTROL_M
    role = np.full(len(truth), ROLES.index("tie"))
    role[: len(marked)] = [ROLES.index("check" if name in checks else "control") for name in marked]
    noisy = truth + np.where(np.isfinite(given), rng.normal(0, CONTROL_M, truth.shape), 0.3)
    points = ObjectPoints(names, noisy, given, role).only(kept)
    count = int(ray.sum())
    values = pixel[ray] + rng.normal(0, SIGMA_PX, (count, 2))
    sigma = np.full((count, 2), SIGMA_PX)
    observations = Observations("px", "pixel", image[ray], place[point[ray]], values, sigma)
    start = views.values.copy()
    start[:, :3] += rng.normal(0, 2e-3, (len(start), 3))
    own = (_estimating(views.cameras[0]),)
    return Block(
        name="site",
        frame="local",
        height="local",
        datum="control",
        cameras=own,
        images=Images(views.names, views.camera, start),
        points=points,
        observations=observations,
        positions=_antennas(views.station, rng),
    )


def _estimating(lens: Camera) -> Camera:
    if lens.estimated.any():
        return lens
    given = {name: lens.value(name) for name in ("c", "K1")}
    own = lens.id, lens.model, lens.unit, lens.size_px, lens.pitch
    return camera(*own, given, estimate=ESTIMATED)


def _antennas(centre: Floats, rng: np.random.Generator) -> Positions:
    n = len(centre)
    covariance = np.tile(np.eye(3) * POSITION_M**2, (n, 1, 1))
    observed = centre + rng.normal(0, POSITION_M, centre.shape)
    # A strip ends where the next image lies beside it.
    strip = np.cumsum(np.r_[0, np.abs(np.diff(centre[:, 1])) > 3.0])
    return Positions(
        np.arange(n), observed, covariance, np.zeros((n, 3)), strip.astype(np.int64), np.zeros(n), np.zeros(n)
    )


def _seen(views: OrientedImages, truth: Floats) -> tuple[NDArray[np.int64], NDArray[np.int64], Floats]:
    """Images and points of all rays, and where they are, 5 px from the edges at least."""
    images, points, pixels = [], [], []
    size = np.array(views.cameras[0].size_px)
    for k in range(len(views)):
        reach = 1.2 * views.station[k, 2]
        near = np.flatnonzero((np.abs(truth[:, :2] - views.station[k, :2]) < reach).all(axis=1))
        pixel = views.project(np.full(len(near), k), truth[near])
        inside = ((pixel > 5) & (pixel < size - 5)).all(axis=1)
        images.append(np.full(int(inside.sum()), k))
        points.append(near[inside])
        pixels.append(pixel[inside])
    return np.concatenate(images), np.concatenate(points), np.vstack(pixels)


def with_pictures(folder: Path, jpeg: bytes) -> Path:
    """Give a project pictures that look alike, in files that a remark makes different."""
    (folder / "images").mkdir()
    for name in Block.read(folder / "block").images.names:
        remark = name.encode()
        segment = b"\xff\xfe" + (len(remark) + 2).to_bytes(2, "big") + remark
        (folder / "images" / name).write_bytes(jpeg[:2] + segment + jpeg[2:])
    with (folder / "project.toml").open("a", encoding="utf-8") as text:
        text.write('\n[images]\nfolder = "images"\n')
    return folder
