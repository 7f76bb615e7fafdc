"""Flights with five cameras on one frame, simulated with their truth: one looks down, four obliquely."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from photocal.adjustment.network import ExteriorOrientations, Network, Points, Rays, point_weights
from photocal.adjustment.rig import OF_HEAD, RigHeads, pairs_of
from photocal.adjustment.solution import Solution
from photocal.block.model import ROLES, Block, Images, ObjectPoints, Observations
from photocal.block.rig import Head
from photocal.geometry.camera import Camera, camera
from photocal.geometry.distortion import projected
from photocal.geometry.rotation import angles_from_matrix

Floats = NDArray[np.float64]
Integers = NDArray[np.int64]

SIZE = (1280, 960)
HEIGHT_M, SPEED_M_S = 80.0, 11.0
HEADS = ("down", "left", "right", "fore", "aft")
# How the oblique heads look, as rotation vectors about the axes of the one that looks down, degrees.
NOMINAL = np.radians([[0, 0, 0], [0, -45, 0], [0, 45, 0], [45, 0, 0], [-45, 0, 0]])
# How far a real frame is from its drawing, and what the drawing states: rad, m, s.
PRIOR = np.array([np.radians(0.5)] * 3 + [0.01] * 3 + [0.002])
STIFFNESS = (0.0001, np.radians(1 / 3600))
ESTIMATE = ("c", "x0", "y0", "K1")


@dataclass(frozen=True)
class Flown:
    """The truth: what the heads are (turn from the nominal rotation, place, time), and points."""

    cameras: tuple[Camera, ...]
    heads: Floats
    rotation: Floats
    centre: Floats
    points: Floats


def lens(name: str, rng: np.random.Generator) -> Camera:
    """A camera of 60 degrees, each another specimen."""
    c = 1050 + rng.normal(0, 5)
    values = {"c": c, "x0": rng.normal(0, 5), "y0": rng.normal(0, 5), "K1": 2e-8 + rng.normal(0, 2e-9)}
    return camera(name, "brown-ideal", "px", SIZE, (1.0, 1.0), values, estimate=ESTIMATE)


def flight(
    rng: np.random.Generator, *, exposures: int = 60, points: int = 1500, sigma_px: float = 0.5,
    missing: float = 0.0, times: bool = True, aft_later_s: float = 0.0,
) -> tuple[Flown, Network]:  # fmt: skip
    """Crossed strips with a camera of five heads: the truth and what is measured of it.

    missing: share of the pictures that are lost. times: whether the heads do not expose together.
    aft_later_s: by how much later one of them exposes.
    """
    lines = 5
    along, across = np.divmod(np.arange(exposures), lines)
    place = np.column_stack([(across - 2.0) * 28, (along - along.mean()) * 22, np.full(exposures, HEIGHT_M)])
    crossed = np.arange(exposures) % 2 == 1
    place[crossed] = place[crossed][:, [1, 0, 2]] * [1, 1, 1.15]
    place += rng.normal(0, [2, 2, 1.5], place.shape)
    heading = np.where(crossed, np.pi / 2, 0.0) + np.pi * (across % 2)
    angles = np.column_stack([*rng.normal(0, np.radians(4), (2, exposures)), heading])
    first = Rotation.from_euler("zyx", -angles[:, ::-1]).as_matrix()
    velocity = SPEED_M_S * np.column_stack([-np.sin(heading), np.cos(heading), np.zeros(exposures)])
    velocity += rng.normal(0, [1.5, 1.5, 0.5], velocity.shape)
    rate = rng.normal(0, np.radians(6), velocity.shape)
    truth = rng.normal(0, 1, (len(HEADS), len(OF_HEAD))) * PRIOR
    truth[0] = 0.0
    truth[:, 3:6] += [[0, 0, 0], [-0.1, 0, 0.02], [0.1, 0, 0.02], [0, 0.1, 0.02], [0, -0.1, 0.02]]
    if not times:
        truth[:, 6] = 0.0
    truth[-1, 6] += aft_later_s
    turn = Rotation.from_rotvec(truth[:, :3]) * Rotation.from_rotvec(NOMINAL)
    count = len(HEADS) * exposures
    rotation, centre, motion = np.zeros((count, 3, 3)), np.zeros((count, 3)), np.zeros((count, 6))
    head, exposure = np.tile(np.arange(len(HEADS)), exposures), np.repeat(np.arange(exposures), len(HEADS))
    for k, own in enumerate(turn):
        onward = Rotation.from_rotvec(rate * truth[k, 6]).as_matrix()
        rotation[head == k] = own.as_matrix() @ onward @ first
        arm = np.einsum("nji,j->ni", first, truth[k, 3:6])
        centre[head == k] = place + arm + velocity * truth[k, 6]
        motion[head == k] = np.hstack([velocity, rate @ own.as_matrix().T])
    there = rng.random(count) >= missing
    rotation, centre, motion = rotation[there], centre[there], motion[there]
    head, exposure = head[there], exposure[there]
    cameras = tuple(lens(name, rng) for name in HEADS)
    reach = np.abs(place[:, :2]).max(axis=0) + 110
    ground = rng.uniform(-reach, reach, (points, 2))
    relief = 6 * np.sin(ground[:, 0] / 17) + 5 * np.cos(ground[:, 1] / 11)
    flown = Flown(cameras, truth, rotation, centre, np.column_stack([ground, relief]))
    sigma = np.where(np.arange(len(HEADS))[:, None] == 0, 0.0, PRIOR * ([1] * 6 + [int(times)]))
    given = np.zeros_like(truth)
    given[1:] = truth[1:] + rng.normal(0, 1, truth[1:].shape) * sigma[1:]
    pairs = pairs_of(exposure, head, np.zeros(len(HEADS), dtype=np.int64))
    rig = RigHeads(
        Rotation.from_rotvec(NOMINAL).as_matrix(), given, sigma, np.arange(len(HEADS)),
        np.zeros(len(HEADS), dtype=np.int64), *pairs, np.tile(STIFFNESS, (len(pairs[0]), 1)),
        np.zeros((len(pairs[0]), 2)), np.zeros((len(HEADS), 2)),
    )  # fmt: skip
    return flown, _measured(flown, head, exposure, motion, rig, rng, sigma_px)


def _measured(
    flown: Flown,
    head: Integers,
    exposure: Integers,
    motion: Floats,
    rig: RigHeads,
    rng: np.random.Generator,
    sigma_px: float,
) -> Network:
    """Rays with their errors, positions of 3 cm, and start values that are somewhat off."""
    seeing, seen_of, measured = list[Integers](), list[Integers](), list[Floats]()
    for i, k in enumerate(head):
        q = (flown.points - flown.centre[i]) @ flown.rotation[i].T
        seen = np.flatnonzero(q[:, 2] < -1.0)
        xy = projected(flown.cameras[k], q[seen])
        inside = (np.abs(xy) < np.array(SIZE) / 2).all(axis=1) & (-q[seen, 2] < 4 * HEIGHT_M)
        chosen = np.flatnonzero(inside)
        chosen = np.sort(rng.permutation(chosen)[:45])
        seeing.append(np.full(len(chosen), i))
        seen_of.append(seen[chosen])
        measured.append(xy[chosen])
    image, point, plane = np.concatenate(seeing), np.concatenate(seen_of), np.vstack(measured)
    # Heads of one exposure see a point from one place.
    places = np.unique(np.column_stack([point, exposure[image]]), axis=0)[:, 0]
    kept = (np.bincount(places, minlength=len(flown.points)) >= 3)[point]
    order = np.flatnonzero(kept)[np.argsort(point[kept], kind="stable")]
    used, points = np.unique(point[order], return_inverse=True)
    held, weight = point_weights(np.full((len(used), 3), np.inf))
    start = np.hstack([angles_from_matrix(flown.rotation), flown.centre])
    start += rng.normal(0, [*np.radians([0.3] * 3), 0.03, 0.03, 0.03], start.shape)
    deviation = np.full(start.shape, np.inf)
    deviation[:, 3:] = 0.03
    cameras = tuple(
        own.with_values(np.where(own.estimated, own.values * 0.999, own.values)) for own in flown.cameras
    )
    noise = rng.normal(0, sigma_px, (len(order), 2))
    return Network(
        cameras,
        ExteriorOrientations(head.copy(), start, deviation, motion),
        Points(flown.points[used] + rng.normal(0, 0.2, (len(used), 3)), held, weight),
        Rays(image[order], points, plane[order] + noise, np.full((len(order), 2), sigma_px)),
        tuple(f"i{k}" for k in range(len(head))),
        tuple(f"p{j}" for j in used),
        rig=rig,
    )


def standardised(flown: Flown, network: Network, solution: Solution) -> Floats:
    """Errors of the heads' values in standard deviations, shape (heads, 7); NaN for held ones."""
    size = network.rig.values.size
    found = solution.state.common[-size:].reshape(network.rig.values.shape)
    sigma = np.sqrt(np.diag(solution.common_covariance)[-size:]).reshape(found.shape)
    with np.errstate(divide="ignore", invalid="ignore"):
        return np.where(sigma > 0, (found - flown.heads) / sigma, np.nan)


def without_rig(network: Network) -> Network:
    """The same images as if nothing held the heads together."""
    images = np.arange(len(network.image_names))
    return replace(network, rig=network.rig.of_images(images, images < 0))


def in_gusts(network: Network, rng: np.random.Generator, time_sigma_s: float | None = None) -> Block:
    """A block of the same through gusts of 0.5 m/s and 0.03 rad/s that nobody has recorded.

    time_sigma_s: how well the times of the heads are stated, and by how much they are off, where the flight
        has them right.
    """
    if time_sigma_s is not None:
        sigma, values = network.rig.sigma.copy(), network.rig.values.copy()
        sigma[1:, 6] = time_sigma_s
        values[1:, 6] += rng.normal(0, time_sigma_s, len(values) - 1)
        network = replace(network, rig=replace(network.rig, sigma=sigma, values=values))
    block, motion = block_of(network), network.exposures.motion
    assert motion is not None
    # All heads of an exposure fly through the same gust.
    gust = rng.normal(0, [0.5] * 3 + [0.03] * 3, motion.shape)
    gust[network.rig.second, :3] = gust[network.rig.first, :3]
    sigma = np.broadcast_to([0.5] * 3 + [0.03] * 3, motion.shape)
    images = replace(block.images, motion=motion + gust, motion_sigma=sigma)
    return replace(block, images=images)


def block_of(network: Network) -> Block:
    """The same as a block: its observations in pixels, the exposures named."""
    rays, exposures = network.rays, network.exposures
    size = np.array(SIZE)
    pixels = np.column_stack([rays.plane[:, 0] + (size[0] - 1) / 2, (size[1] - 1) / 2 - rays.plane[:, 1]])
    first = np.arange(len(network.image_names))
    first[network.rig.second] = network.rig.first
    heads = [
        Head(own.id, HEADS[0], Rotation.from_matrix(turn).as_rotvec(), values, sigma, STIFFNESS)
        for own, turn, values, sigma in zip(
            network.cameras, network.rig.rotation, network.rig.values, network.rig.sigma, strict=True
        )
    ]
    points = len(network.point_names)
    return Block(
        "five heads",
        "local",
        "local",
        "control",
        network.cameras,
        Images(
            network.image_names,
            exposures.camera,
            exposures.values,
            exposures.sigma,
            exposure=tuple(f"e{k}" for k in first),
        ),
        ObjectPoints(network.point_names, network.points.values, np.full((points, 3), np.inf),
                     np.full(points, ROLES.index("tie"))),
        Observations("px", "pixel", rays.image, rays.point, pixels, rays.sigma),
        heads=tuple(heads),
    )  # fmt: skip
