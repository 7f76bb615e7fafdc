"""Blocks without any exterior orientation reach the minimum that is known for them."""

from __future__ import annotations

import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from photocal.adjustment.adjust import adjust
from photocal.adjustment.network import Network, Rays, Relations
from photocal.adjustment.solution import Solution
from photocal.adjustment.start.values import start_values
from photocal.block.folder import read_block
from photocal.block.network import assemble
from photocal.exchange.dbat import read_dbat
from photocal.exchange.jaicov import read_jaicov
from photocal.geometry.camera import camera
from photocal.geometry.oriented_images import local_poses
from photocal.geometry.rotation import matrix_from_angles
from tests.photocal import blocks, networks
from tests.simulated import PLANS, block_of, true_poses, world_of

SIZE, C = (3000, 2000), 2222.0
LENS = {"nominal_mm": 20.0, "pitch_mm": 0.009, "fx": C, "fy": C, "cx": 1499.5, "cy": 999.5}
STRIPS = {"height_m": 100, "course_deg": 90, "speed_m_s": 8, "forward_overlap": 0.72, "side_overlap": 0.77}
FLIGHT = {
    "camera": {"size_px": SIZE, **LENS},
    "plan": {
        "area_m": [[-62, -42], [62, -42], [62, 42], [-62, 42]],
        "take_off_m": [-80, -40],
        "on_ground_s": 8,
        "pass": [STRIPS],
    },
    "terrain": {"relief_m": 4.0, "longest_m": 100.0},
    "targets": {"control": 0, "check": 0},
    "observing": {"ties": 500, "sigma_px": 0.33},
}
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


def flight(seed: int, gross: float = 0.0) -> tuple[Network, np.ndarray]:
    """Three strips of 18 images over hilly ground, with a lens of 20 mm; also the true exposures."""
    world = world_of(PLANS / "small.toml", seed=seed, **FLIGHT)
    rng = np.random.default_rng(seed)
    own = camera("main", "brown-ideal", "px", SIZE, (1.0, 1.0), {"c": 1.01 * C}, estimate=networks.COMMON)
    block = block_of(world, own, np.full(3, 0.05), rng)
    wrong = rng.random(len(block.observations.image)) < gross
    block.observations.values[wrong] += rng.uniform(-300, 300, (int(wrong.sum()), 2))
    made = assemble(block)
    return made.network, local_poses(made.frame, true_poses(world))


def turn(a: np.ndarray, b: np.ndarray) -> float:
    """Largest angle between two sets of orientations, radians."""
    product = matrix_from_angles(a) @ np.swapaxes(matrix_from_angles(b), 1, 2)
    return float(np.arccos(np.clip((np.trace(product, axis1=1, axis2=2) - 1) / 2, -1, 1)).max())


@pytest.mark.parametrize("gross", [0.0, 0.05])
def test_flight_with_three_control_points(gross: float) -> None:
    """No image sees four of them: relative orientation, then a similarity. 5 % gross errors do not harm."""
    network, truth = flight(21, gross)
    xyz = network.points.values
    known = np.zeros(len(xyz), bool)
    for corner in ((-62, -30), (62, -30), (0, 30)):
        known[np.argmin(np.sum((xyz[:, :2] - corner) ** 2, axis=1))] = True
    start = from_nothing(network, known)
    assert start[2].tolist() == []
    assert turn(start[0][:, :3], truth[:, :3]) < 0.02
    # The principal distance is known to 1 % only: 1 m of the flying height.
    assert np.abs(start[0][:, 3:] - truth[:, 3:]).max() < 1.5


def test_flight_with_positions_only() -> None:
    """Positions of the projection centres are control enough; they stay as they were observed."""
    network, truth = flight(22)
    start = from_nothing(network, np.zeros(len(network.point_names), bool), centres=True)
    assert start[2].tolist() == []
    assert turn(start[0][:, :3], truth[:, :3]) < 0.01
    assert np.abs(start[0][:, 3:] - truth[:, 3:]).max() < 0.5


def test_known_poses_are_kept() -> None:
    network, truth = flight(23)
    exposures = np.full(truth.shape, np.nan)
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
    network, _ = flight(21, 0.05)
    known = np.arange(len(network.point_names)) % 20 == 0
    first, second = (from_nothing(network, known) for _ in range(2))
    assert (first[0] == second[0]).all()
