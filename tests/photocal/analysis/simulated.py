"""Simulated networks in which hidden errors are sought."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from photocal.adjustment.network import ExteriorOrientations, Network, Points, Rays, point_weights
from photocal.base.arrays import Floats
from photocal.geometry.camera import Camera, Model, camera
from photocal.geometry.distortion import projected
from photocal.geometry.rotation import angles_from_matrix, matrix_from_angles

SIGMA = 0.3
CONTROL_M = {"convergent": 0.002, "flight": 0.02}


@dataclass(frozen=True)
class Simulated:
    """A network with the image coordinates that its truth gives, without noise."""

    network: Network
    exact: Floats


def a_camera(estimate: tuple[str, ...], model: Model = "brown-observed", **changed: float) -> Camera:
    values = {"c": 3500.0, "x0": 12.0, "y0": -8.0, "K1": -7e-9, "K2": 4e-16, "P1": 3e-8, **changed}
    return camera("sim", model, "px", (4000, 3000), (1.0, 1.0), values, estimate=estimate)


def convergent(
    estimate: tuple[str, ...] = ("c", "x0", "y0", "K1", "K2", "P1", "P2"), model: Model = "brown-observed"
) -> Simulated:
    """Eight convergent photos, rolled by quarters, of 36 control points with relief."""
    own = a_camera(estimate, model)
    generator = np.random.default_rng(1)
    points = np.column_stack(
        [
            np.tile(np.linspace(-4, 4, 6), 6),
            np.repeat(np.linspace(-3, 3, 6), 6),
            generator.uniform(-0.8, 0.8, 36),
        ]
    )
    centres, rotations = [], []
    for k in range(8):
        azimuth = k * np.pi / 4
        centre = np.array([6.0 * np.cos(azimuth), 6.0 * np.sin(azimuth), 8.0])
        back = centre / np.linalg.norm(centre)
        right = np.cross([0.0, 0.0, 1.0], back)
        right /= np.linalg.norm(right)
        level = np.array([right, np.cross(back, right), back])
        roll = (k % 4) * np.pi / 2
        turn = np.array([[np.cos(roll), np.sin(roll), 0], [-np.sin(roll), np.cos(roll), 0], [0, 0, 1]])
        centres.append(centre)
        rotations.append(turn @ level)
    return _imaged(own, np.array(centres), np.array(rotations), points, 0.002)


def flight(turned: bool = True, flat: bool = False) -> Simulated:
    """Two lines of seven nearly vertical photos flown there and back over 84 control points."""
    estimate = ("K1", "K2") if flat else ("c", "x0", "y0", "K1", "K2")
    own = a_camera(estimate)
    generator = np.random.default_rng(2)
    grid = np.meshgrid(np.linspace(-60, 220, 12), np.linspace(-50, 100, 7))
    points = np.column_stack(
        [grid[0].ravel(), grid[1].ravel(), (0.0 if flat else 25.0) * generator.random(84)]
    )
    centres, angles = [], []
    for line, heading in ((0, 0.0), (1, np.pi if turned else 0.0)):
        for k in range(7):
            along = 25.0 * k if line == 0 else 25.0 * (6 - k)
            centres.append([along, 50.0 * line, 100.0 + (0.0 if flat else 20.0) * line])
            angles.append([*generator.uniform(-0.03, 0.03, 2), heading])
    return _imaged(own, np.array(centres), matrix_from_angles(np.array(angles)), points, 0.02)


def _imaged(own: Camera, centres: Floats, rotations: Floats, points: Floats, sigma_m: float) -> Simulated:
    rows = []
    for j, point in enumerate(points):
        for i, (centre, rotation) in enumerate(zip(centres, rotations, strict=True)):
            seen = projected(own, (rotation @ (point - centre))[None, :])[0]
            if np.all(np.abs(seen) < [1990.0, 1490.0]):
                rows.append((i, j, *seen))
    table = np.array(rows)
    image, point_of, exact = table[:, 0].astype(np.int64), table[:, 1].astype(np.int64), table[:, 2:]
    pose = np.hstack([angles_from_matrix(rotations), centres])
    held, weight = point_weights(np.full(points.shape, sigma_m))
    network = Network(
        (own,),
        ExteriorOrientations(np.zeros(len(centres), dtype=np.int64), pose, np.full(pose.shape, np.inf)),
        Points(points, held, weight),
        Rays(image, point_of, exact, np.full(exact.shape, SIGMA)),
        tuple(f"i{i}" for i in range(len(centres))),
        tuple(f"p{j}" for j in range(len(points))),
    )
    return Simulated(network, exact)


def noisy(simulated: Simulated, seed: int, plane: Floats | None = None, control_m: float = 0.002) -> Network:
    """Draw image coordinates and surveyed coordinates."""
    generator = np.random.default_rng(seed)
    network = simulated.network
    measured = (simulated.exact if plane is None else plane) + SIGMA * generator.standard_normal(
        simulated.exact.shape
    )
    surveyed = network.points.values + control_m * generator.standard_normal(network.points.values.shape)
    return replace(
        network,
        rays=replace(network.rays, plane=measured),
        points=replace(network.points, values=surveyed),
    )


def read_in_flight(made: Simulated) -> Floats:
    """Image coordinates when the rows are read during a twentieth of the exposure interval, in flight."""
    network = made.network
    own, image = network.cameras[0], network.rays.image
    centres = network.exposures.values[:, 3:]
    velocity = np.vstack([np.gradient(centres[:7], axis=0), np.gradient(centres[7:], axis=0)])
    late = 0.05 * -made.exact[:, 1] / own.size_px[1]
    rotation = matrix_from_angles(network.exposures.values[:, :3])[image]
    moved = centres[image] + late[:, None] * velocity[image]
    q = np.einsum("nij,nj->ni", rotation, network.points.values[network.rays.point] - moved)
    return projected(own, q)
