"""Blocks without any exterior orientation reach the minimum that is known for them."""

from __future__ import annotations

import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from photocal.adjustment.adjust import adjust
from photocal.adjustment.network import ExteriorOrientations, Network, Rays, Relations
from photocal.adjustment.solution import Solution
from photocal.adjustment.start.values import start_values
from photocal.block.folder import read_block
from photocal.block.network import assemble
from photocal.exchange.dbat import read_dbat
from photocal.exchange.jaicov import read_jaicov
from photocal.geometry.rotation import matrix_from_angles
from tests.photocal import blocks, networks

Flags = np.ndarray
Start = tuple[Flags, Flags, Flags]


def from_nothing(network: Network, known: Flags, *, centres: bool = False, free: bool = False) -> Start:
    """Start values from the coordinates of some points, perhaps of the projection centres, and no more."""
    exposures = np.full(network.exposures.values.shape, np.nan)
    if centres:
        exposures[:, 3:] = network.exposures.values[:, 3:]
    return start_values(
        network.cameras,
        network.exposures.camera,
        exposures,
        np.where(known[:, None], network.points.values, np.nan),
        network.rays,
        network.relations,
        free=free,
    )


def solved(network: Network, start: Start) -> Solution:
    """Adjust from start values; observed coordinates stay what they are."""
    assert start[2].tolist() == []
    weight = np.diagonal(network.points.weight, axis1=1, axis2=2)
    control = np.asarray(((weight > 0) | network.points.held).any(axis=1))
    values = np.where(control[:, None], network.points.values, start[1])
    assert np.isfinite(values).all()
    observed = np.isfinite(network.exposures.sigma)
    exposures = np.where(observed, network.exposures.values, start[0])
    return adjust(
        replace(
            network,
            points=replace(network.points, values=values),
            exposures=replace(network.exposures, values=exposures),
        )
    )


CONTROL: dict[str, tuple[str, ...] | None] = {
    "all": None,
    "three": ("1", "9", "37"),
    "four": ("1", "9", "22", "37"),
}


@pytest.mark.parametrize("control", CONTROL)
def test_dcs460(tmp_path: Path, control: str) -> None:
    """888.36 (an independent adjustment of the study's data), from 40, 4 or 3 known targets on a wall."""
    network = assemble(read_block(blocks.dcs460(tmp_path / "block", photo2=True))).network
    chosen = CONTROL[control]
    known = np.array([chosen is None or name in chosen for name in network.point_names])
    assert known.sum() == (40 if chosen is None else len(chosen))
    found = solved(network, from_nothing(network, known))
    assert found.chi_squared == pytest.approx(888.36, abs=0.005)


@pytest.mark.shared
@pytest.mark.parametrize("few", [False, True])
def test_sxb(shared: Path, few: bool) -> None:
    """DBAT's sigma0 of five aerial images, from its 14 control points or from three of them."""
    folder = shared / "data" / "dbat-sxb" / "script"
    block = read_dbat(folder / "sxb.xml")
    assembly = assemble(block)
    known = block.points.of_role("control")[assembly.points]
    if few:
        known[np.flatnonzero(known)[[k for k in range(14) if k not in (0, 5, 10)]]] = False
    found = solved(assembly.network, from_nothing(assembly.network, known))
    printed = re.search(r"Sigma0:\s+(\S+)", (folder / "report.txt").read_text(encoding="utf-8"))
    assert printed
    digits = len(printed.group(1).partition(".")[2])
    assert np.sqrt(found.variance_factor) == pytest.approx(float(printed.group(1)), abs=2 * 10.0**-digits)


@pytest.mark.shared
def test_jaicov(shared: Path) -> None:
    """115 images of an industrial object, no control at all: the residual sum of the full iteration."""
    network = assemble(read_jaicov(shared / "data" / "jaicov-aicon-block" / "example.ior")).network
    start = from_nothing(network, np.zeros(len(network.point_names), bool), free=True)
    assert solved(network, start).chi_squared == pytest.approx(12374.16, abs=0.02)


def flight(rng: np.random.Generator, gross: float = 0.0) -> tuple[Network, np.ndarray]:
    """Three strips over hilly ground, 18 nadir images; also the true exposures."""
    own = networks.lens(K1=0.0, K2=0.0, K3=0.0, P1=0.0, P2=0.0, B1=0.0, B2=0.0, x0=0.0, y0=0.0)
    x, y = np.meshgrid(np.arange(6) * 25.0, np.arange(3) * 30.0)
    n = x.size
    centre = np.column_stack([x.ravel(), y.ravel(), np.full(n, 100.0)]) + rng.normal(0, 1.0, (n, 3))
    kappa = np.where(np.arange(n) // 6 == 1, np.pi, 0.0) + np.pi / 2
    angles = np.column_stack([rng.normal(0, 0.05, (n, 2)), kappa + rng.normal(0, 0.05, n)])
    ground = rng.uniform([-40, -40], [165, 100], (500, 2))
    height = 6 * np.sin(ground[:, 0] / 30) + 4 * np.cos(ground[:, 1] / 20)
    xyz = np.column_stack([ground, height])
    q = np.einsum("nij,npj->npi", matrix_from_angles(angles), xyz - centre[:, None])
    plane = -20.0 * q[..., :2] / q[..., 2:]
    inside = (np.abs(plane) < [13.5, 9.0]).all(axis=2)
    inside &= inside.sum(axis=0) >= 3
    point, image = np.nonzero(inside.T)
    used, place = np.unique(point, return_inverse=True)
    measured = plane[image, point] + rng.normal(0, 0.003, (len(point), 2))
    wrong = rng.random(len(point)) < gross
    measured[wrong] += rng.uniform(-3, 3, (int(wrong.sum()), 2))
    exposures = np.hstack([angles, centre])
    scene = networks.Scene((own,), np.zeros(n, np.int64), exposures, xyz[used])
    base = networks.observe(scene, None, point_sigma=np.inf)
    rays = Rays(image, place.astype(np.int64), measured, np.full(measured.shape, 0.003))
    return replace(base, rays=rays), exposures


def turn(a: np.ndarray, b: np.ndarray) -> float:
    """Largest angle between two sets of orientations, radians."""
    product = matrix_from_angles(a) @ np.swapaxes(matrix_from_angles(b), 1, 2)
    return float(np.arccos(np.clip((np.trace(product, axis1=1, axis2=2) - 1) / 2, -1, 1)).max())


@pytest.mark.parametrize("gross", [0.0, 0.05])
def test_flight_with_three_control_points(gross: float) -> None:
    """No image sees four of them: relative orientation, then a similarity. 5 % gross errors do not harm."""
    network, truth = flight(np.random.default_rng(21), gross)
    xyz = network.points.values
    known = np.zeros(len(xyz), bool)
    for corner in ((0, 0), (125, 0), (60, 60)):
        known[np.argmin(np.sum((xyz[:, :2] - corner) ** 2, axis=1))] = True
    start = from_nothing(network, known)
    assert start[2].tolist() == []
    assert turn(start[0][:, :3], truth[:, :3]) < 0.02
    # The principal distance is known to 1 % only: 1 m of the flying height.
    assert np.abs(start[0][:, 3:] - truth[:, 3:]).max() < 1.5


def test_flight_with_positions_only() -> None:
    """Positions of the projection centres are control enough; they stay as they were observed."""
    network, truth = flight(np.random.default_rng(22))
    observed = truth[:, 3:] + np.random.default_rng(1).normal(0, 0.05, (18, 3))
    network = replace(
        network,
        exposures=ExteriorOrientations(
            network.exposures.camera, np.hstack([np.zeros((18, 3)), observed]), network.exposures.sigma
        ),
    )
    start = from_nothing(network, np.zeros(len(network.point_names), bool), centres=True)
    assert start[2].tolist() == []
    assert turn(start[0][:, :3], truth[:, :3]) < 0.01
    assert np.abs(start[0][:, 3:] - truth[:, 3:]).max() < 0.5


def test_known_poses_are_kept() -> None:
    network, truth = flight(np.random.default_rng(23))
    exposures = np.full((18, 6), np.nan)
    exposures[:2] = truth[:2]
    start = start_values(
        network.cameras,
        network.exposures.camera,
        exposures,
        np.full_like(network.points.values, np.nan),
        network.rays,
    )
    assert start[2].tolist() == []
    assert start[0][:2] == pytest.approx(truth[:2], abs=0)
    assert np.abs(start[0][:, 3:] - truth[:, 3:]).max() < 1.0


def test_scale_from_a_distance() -> None:
    """A free network has its scale from distances, and an arbitrary place."""
    scene = networks.convergent(points=25)
    network = networks.observe(scene, None, point_sigma=np.inf)
    length = float(np.linalg.norm(scene.points[3] - scene.points[17]))
    relations = Relations(
        np.zeros(1, np.int64), np.array([3]), np.array([17]), np.array([length]), np.array([0.001])
    )
    network = replace(network, relations=relations, cameras=scene.cameras)
    start = from_nothing(network, np.zeros(25, bool), free=True)
    found, true = (
        np.linalg.norm(p[:, None] - p[None], axis=2)[np.triu_indices(25, 1)] for p in (start[1], scene.points)
    )
    assert found == pytest.approx(true, rel=1e-3)


def test_what_cannot_be_reached_is_named() -> None:
    """An image that sees nothing of the others, and a block with nothing that ties it to the object."""
    scene = networks.convergent(points=25)
    network = networks.observe(scene, None, point_sigma=np.inf)
    seen, keep = network.rays, network.rays.image != 2
    rays = Rays(seen.image[keep], seen.point[keep], seen.plane[keep], seen.sigma[keep])
    start = from_nothing(replace(network, rays=rays), np.ones(25, bool))
    assert start[2].tolist() == [2]
    assert np.isnan(start[0][2]).all()
    nothing = from_nothing(network, np.zeros(25, bool))
    assert nothing[2].tolist() == [0, 1, 2, 3, 4, 5]


def test_the_same_every_time() -> None:
    network, _ = flight(np.random.default_rng(21), 0.05)
    known = np.arange(len(network.point_names)) % 20 == 0
    first, second = (from_nothing(network, known) for _ in range(2))
    assert (first[0] == second[0]).all()
