"""A small adjusted block with everything in it, made by projecting points."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from photocal.block.model import ROLES, Block, Images, ObjectPoints, Role
from photocal.exchange.parts import block
from photocal.exchange.parts import pixels as in_px
from photocal.geometry.camera import Camera, camera, plane_to_pixel
from photocal.geometry.distortion import projected
from photocal.geometry.oriented_images import OrientedImages
from photocal.geometry.rotation import matrix_from_angles


def vision_camera(**extra: float) -> Camera:
    values = {"c": 3650.25, "x0": -12.5, "y0": 7.75, "K1": -3e-9, "K2": 2e-16, "K3": -1e-24}
    values |= {"P1": 1.5e-8, "P2": -2.5e-8}
    return camera("x5", "brown-ideal", "px", (4608, 3456), (1.0, 1.0), values | extra, affinity="after")


def observed_camera() -> Camera:
    values = {"c": 20.5, "x0": -0.22, "y0": 0.18, "K1": -2.75e-4, "K2": 2.7e-7, "K3": 9e-10}
    values |= {"P1": 1e-5, "P2": 5e-6}
    return camera("dcs460", "brown-observed", "mm", (3060, 2036), (0.009, 0.009), values)


def reconstruction_of(cameras: tuple[Camera, ...], count: int = 6, points: int = 40) -> Block:
    random = np.random.default_rng(8)
    poses = np.column_stack(
        [
            random.normal(0, 0.2, (count, 2)),
            random.uniform(-3, 3, count),
            random.uniform(-30, 30, (count, 2)),
            random.uniform(90, 110, count),
        ]
    )
    xyz = random.uniform([-40, -40, 0], [40, 40, 15], (points, 3))
    which = np.arange(count) % len(cameras)
    image, point, pixels = [], [], []
    for k in range(count):
        own = cameras[which[k]]
        q = (xyz - poses[k, 3:]) @ matrix_from_angles(poses[k, :3]).T
        found = plane_to_pixel(own.size_px, own.pitch, projected(own, q))
        inside = np.isfinite(found).all(axis=1) & (found > 0).all(axis=1) & (found < own.size_px).all(axis=1)
        image += [k] * int(inside.sum())
        point += np.flatnonzero(inside).tolist()
        pixels.append(found[inside])
    exact = np.vstack(pixels)
    roles = np.minimum(np.arange(len(xyz)), 2)
    role = np.array([ROLES.index(("control", "check", "tie")[k]) for k in roles])
    return Block(
        "block",
        "local",
        "",
        "control",
        cameras,
        Images(tuple(f"img_{k}.jpg" for k in range(count)), which, poses, np.full((count, 6), 1e-3)),
        ObjectPoints(tuple(str(100 + k) for k in range(len(xyz))), xyz, np.full(xyz.shape, 2e-3), role),
        in_px(np.array(image), np.array(point), exact - random.normal(0, 0.4, exact.shape)),
    )


def residuals_of(given: Block) -> np.ndarray[Any, np.dtype[np.float64]]:
    """Computed minus measured, px, of cameras that all lines share."""
    views = OrientedImages(given.images.names, given.cameras, given.images.camera, given.images.values)
    seen = given.observations
    return np.asarray(views.project(seen.image, given.points.values[seen.point]) - seen.values)


def roles_of(given: Block) -> tuple[str, ...]:
    return tuple(ROLES[k] for k in given.points.role)


def of_role(given: Block, role: Role) -> list[int]:
    rows: list[int] = np.flatnonzero(given.points.of_role(role)).tolist()
    return rows


def shown(given: Block, fewest: int = 1) -> Block:
    """Without the points that fewer images show, and their rays."""
    seen = given.observations
    points = np.flatnonzero(np.bincount(seen.point, minlength=len(given.points.names)) >= fewest)
    rays = seen.rows(np.isin(seen.point, points))
    rays = replace(rays, point=np.searchsorted(points, rays.point))
    return replace(given, points=given.points.only(points), observations=rays)


def with_roles(given: Block, *roles: Role) -> Block:
    """With roles for the points, again and again in this order."""
    role = np.array([ROLES.index(roles[k % len(roles)]) for k in range(len(given.points.names))])
    return replace(given, points=replace(given.points, role=role))


def to_adjust(given: Block, name: str = "block", sigma_px: float = 1.0) -> Block:
    """The block as it is measured: orientations and tie points are start values."""
    seen, images = given.observations, given.images
    started = Images(images.names, images.camera, images.values, exposure=images.exposure)
    rays = in_px(seen.image, seen.point, seen.values, sigma_px)
    made = block(name, given.cameras, started, given.points, rays, ())
    return replace(made, frame=given.frame, height=given.height, heads=given.heads)


@pytest.fixture(scope="session")
def vision() -> Block:
    """Two cameras of the vision model: without and with an affinity."""
    return reconstruction_of((vision_camera(), vision_camera(B1=2e-4)))


@pytest.fixture(scope="session")
def photogrammetric() -> Block:
    """One camera of the photogrammetric model, in mm."""
    return reconstruction_of((observed_camera(),))
