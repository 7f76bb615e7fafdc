"""Simulated survey flights with a known truth: many rays, gusts, a shutter that may roll."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Literal

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from acquire.simulate.world.motion import Waves, make_waves
from photocal.adjustment.mounting import COMMON, Attitudes, Mounting, Positions
from photocal.adjustment.network import ExteriorOrientations, Network, Points, Rays, point_weights
from photocal.adjustment.solution import Solution
from photocal.block.motion import expected_rates, velocity_of_neighbours
from photocal.geometry.camera import PARAMETERS, Camera, Model, camera
from photocal.geometry.distortion import projected
from photocal.geometry.rotation import NADIR, angles_from_matrix, matrix_from_angles

Floats = NDArray[np.float64]

SIZE = (5472, 3648)
C = 3650.0
HEIGHT_M = 80.0
ESTIMATE = ("c", "x0", "y0", "K1", "K2", "K3", "P1", "P2")


@dataclass(frozen=True)
class Flight:
    """The truth of a flight.

    Attributes
    ----------
    velocity, rate : ndarray, shape (images, 3)
        m/s in the object frame; rad/s about the camera's axes, as a turn of them: d(M)/dt = [rate]x M.
    time : ndarray, shape (images,)
        Of the exposures, s.
    vibration : Waves or None
        Turns of the camera about its axes over time, rad.
    """

    camera: Camera
    rotation: Floats
    centre: Floats
    velocity: Floats
    rate: Floats
    points: Floats
    readout_s: float
    time: Floats
    vibration: Waves | None = None


def wide(
    model: Model = "brown-ideal", *, distortion: float = 0.03, estimate: tuple[str, ...] = ESTIMATE
) -> Camera:
    """A 20 megapixel camera whose distortion in the corner is this share of the radius."""
    corner = np.hypot(*SIZE) / 2
    k = -distortion * np.array([1.6, -0.9, 0.3]) / corner ** np.array([2, 4, 6])
    values = {"c": C, "x0": 12.0, "y0": -9.0, "K1": k[0], "K2": k[1], "K3": k[2], "P1": 2e-7, "P2": -1.5e-7}
    return camera("wide", model, "px", SIZE, (1.0, 1.0), values, estimate=estimate)


def flight(
    own: Camera, rng: np.random.Generator, *, images: int = 60, points: int = 1500, readout_s: float = 0.0,
    gust_m_s: float = 0.4, gust_rad_s: float = np.radians(3.0),
) -> Flight:  # fmt: skip
    """Crossed strips at 8 m/s in two heights, the upper edge of every image forward."""
    base, line = 0.2 * SIZE[1] / C * HEIGHT_M, 0.35 * SIZE[0] / C * HEIGHT_M
    main = 2 * images // 3
    rows = max(2, round(np.sqrt(main * base / line)))
    places, headings, times = [], [], list[Floats]()
    for count, lines, turn, height in (
        (main, rows, 0.0, HEIGHT_M),
        (images - main, 2, np.pi / 2, 1.25 * HEIGHT_M),
    ):
        along = np.arange(count) // lines
        across = np.arange(count) % lines
        forward = np.where(across % 2 == 0, 1.0, -1.0)
        x = (along - along.mean()) * base * (1 if lines > 2 or turn == 0 else 1.3)
        y = (across - (lines - 1) / 2) * line
        spin = np.array([[np.cos(turn), -np.sin(turn)], [np.sin(turn), np.cos(turn)]])
        places.append(np.column_stack([np.column_stack([x, y]) @ spin.T, np.full(count, height)]))
        times.append(1000 * (1 + len(times)) + 100 * across + forward * x / 8.0)
        headings.append(turn + np.where(forward > 0, 0.0, np.pi))
    centre, heading = np.vstack(places), np.concatenate(headings)
    centre = centre + rng.normal(0, [1.0, 1.0, 0.7], centre.shape)
    forward = np.column_stack([np.cos(heading), np.sin(heading), np.zeros(images)])
    # y of the image looks forward: kappa turns the axes by heading - 90 degrees.
    angles = np.column_stack([*rng.normal(0, np.radians(3.0), (2, images)), heading - np.pi / 2])
    angles[:, 2] += rng.normal(0, np.radians(3.0), images)
    reach = np.abs(centre[:, :2]).max(axis=0) + 0.4 * HEIGHT_M
    ground = rng.uniform(-reach, reach, (points, 2))
    relief = 4 * np.sin(ground[:, 0] / 17) + 3 * np.cos(ground[:, 1] / 11)
    return Flight(
        own, matrix_from_angles(angles), centre,
        8.0 * forward + rng.normal(0, gust_m_s, (images, 3)), rng.normal(0, gust_rad_s, (images, 3)),
        np.column_stack([ground, relief]), readout_s, np.concatenate(times),
    )  # fmt: skip


def recorded(truth: Flight, image: NDArray[np.int64], point: NDArray[np.int64]) -> Floats:
    """Where each ray is recorded when every line has its own pose, shape (n, 2); line by line, plainly."""
    line = np.zeros(len(image))
    plane = np.zeros((len(image), 2))
    for _ in range(8 if truth.readout_s else 1):
        time = truth.readout_s * line
        centre = truth.centre[image] + truth.velocity[image] * time[:, None]
        turn = Rotation.from_rotvec(truth.rate[image] * time[:, None])
        if truth.vibration is not None:
            turn = Rotation.from_rotvec(truth.vibration.at(truth.time[image] + time)) * turn
        q = turn.apply(np.einsum("nij,nj->ni", truth.rotation[image], truth.points[point] - centre))
        plane = projected(truth.camera, q)
        plane[q[:, 2] >= 0] = np.nan
        line = np.clip(np.nan_to_num(-plane[:, 1] / SIZE[1]), -1, 1)
    return plane


def measured(
    truth: Flight, rng: np.random.Generator, *, sigma: float = 1.0, most: int = 8, control: int = 0,
    control_sigma: float = 0.01,
) -> Network:  # fmt: skip
    """Image observations with their errors; the first points nearest to a frame's corners are control."""
    images, points = len(truth.centre), len(truth.points)
    image, point = (grid.ravel() for grid in np.meshgrid(np.arange(images), np.arange(points), indexing="ij"))
    near = np.abs(truth.points[point, :2] - truth.centre[image, :2]).max(axis=1) < 1.2 * HEIGHT_M
    image, point = image[near], point[near]
    plane = recorded(truth, image, point)
    with np.errstate(invalid="ignore"):
        inside = (np.abs(plane) < np.array(SIZE) / 2 - 10).all(axis=1)
    image, point, plane = image[inside], point[inside], plane[inside]
    # At most so many rays of a point, by lot; points with fewer than three drop out.
    order = np.lexsort((rng.random(len(point)), point))
    image, point, plane = image[order], point[order], plane[order]
    first = np.searchsorted(point, np.arange(points))
    kept = np.arange(len(point)) - first[point] < most
    kept &= (np.bincount(point, minlength=points) >= 3)[point]
    image, point, plane = image[kept], point[kept], plane[kept]
    used, point = np.unique(point, return_inverse=True)
    xyz = truth.points[used]
    deviation = np.full(xyz.shape, np.inf)
    corners = np.quantile(xyz[:, :2], [0.12, 0.88], axis=0)
    spots = [(corners[a, 0], corners[b, 1]) for a in (0, 1) for b in (0, 1)]
    spots += [tuple(spot) for spot in rng.uniform(corners[0], corners[1], (max(control - 4, 0), 2))]
    for spot in spots[:control]:
        deviation[np.argmin(np.linalg.norm(xyz[:, :2] - spot, axis=1))] = control_sigma
    held, weight = point_weights(deviation)
    errors = np.where(
        np.isfinite(deviation), rng.normal(0, control_sigma, xyz.shape), rng.normal(0, 0.3, xyz.shape)
    )
    start = np.hstack([angles_from_matrix(truth.rotation), truth.centre])
    start += rng.normal(0, [*np.radians([0.5] * 3), 0.3, 0.3, 0.3], start.shape)
    values = np.where(truth.camera.estimated, 0.0, truth.camera.values)
    values[0] = 1.005 * truth.camera.values[0]
    return Network(
        (truth.camera.with_values(values),),
        ExteriorOrientations(np.zeros(images, dtype=np.int64), start, np.full((images, 6), np.inf)),
        Points(xyz + errors, held, weight),
        Rays(image, point, plane + rng.normal(0, sigma, plane.shape), np.full(plane.shape, sigma)),
        tuple(f"i{k}" for k in range(images)),
        tuple(f"p{j}" for j in used),
    )


LEVER, BORESIGHT, DELAY = np.array([0.12, -0.05, -0.25]), np.radians([0.8, -0.5, 1.1]), 0.03
LEVER_SIGMA, ATTITUDE_SIGMA = 0.02, np.radians(0.2)
# By how much velocity and rate depart: from what a trajectory and gyros say, and from a steady flight.
OF_FLIGHT, GUST = np.array([0.05] * 3 + [np.radians(0.3)] * 3), np.array([0.4] * 3 + [np.radians(3.0)] * 3)


def navigated(network: Network, truth: Flight, rng: np.random.Generator, *, attitudes: bool) -> Network:
    """Antenna positions and, with attitudes, a mounting with lever arm, boresight and delay to be found."""
    images = np.arange(len(truth.centre))
    mounting = np.array([*(LEVER if attitudes else [0.0] * 3), *BORESIGHT, DELAY * attitudes, *[0.0] * 10])
    camera_of_body = Rotation.from_rotvec(mounting[3:6]).as_matrix() @ NADIR
    place = truth.centre + np.swapaxes(truth.rotation, 1, 2) @ camera_of_body @ mounting[:3]
    spread = np.array([0.02, 0.02, 0.03])
    place = place - truth.velocity * mounting[6] + rng.normal(0, spread, truth.centre.shape)
    covariance = np.broadcast_to(np.diag(spread**2), (len(images), 3, 3)).copy()
    none = np.zeros(len(images))
    positions = Positions(images, place, covariance, truth.velocity, none.astype(int), none, none)
    turn = Rotation.from_rotvec(rng.normal(0, ATTITUDE_SIGMA, truth.centre.shape)).as_matrix()
    seen = images if attitudes else images[:0]
    body = (turn @ camera_of_body.T @ truth.rotation)[seen]
    spread_of_body = np.broadcast_to(ATTITUDE_SIGMA**2 * np.eye(3), (len(seen), 3, 3)).copy()
    sigma = np.zeros(17)
    if attitudes:
        sigma[:3], sigma[3:7] = LEVER_SIGMA, np.inf
    values = np.where(sigma == 0, mounting, 0.0)
    values[:3] = mounting[:3] + rng.normal(0, 1, 3) * sigma[:3]
    return replace(
        network, positions=positions, attitudes=Attitudes(seen, body, spread_of_body),
        mounting=Mounting(NADIR, values, sigma),
    )  # fmt: skip


Case = Literal["attitudes", "positions", "pictures"]


def case(
    name: Case, seed: int, *, readout_s: float, images: int = 60,
    points: int = 1500, sigma_px: float = 1.0, vibration_deg: float = 0.0,
) -> tuple[Flight, Network]:  # fmt: skip
    """A flight of which the shutter is not known, with what says how its images moved."""
    rng = np.random.default_rng(seed)
    truth = flight(replace(wide(), shutter="unknown"), rng, images=images, points=points, readout_s=readout_s)
    if vibration_deg:
        of_time = np.random.default_rng(1000 + seed)
        waves = make_waves(np.full(3, np.radians(vibration_deg)), 20.0, 60.0, of_time)
        truth = replace(truth, vibration=waves)
    network = measured(truth, rng, control=4 if name == "pictures" else 0, sigma=sigma_px)
    if name != "pictures":
        network = navigated(network, truth, rng, attitudes=name == "attitudes")
    if name == "attitudes":
        motion = np.hstack([truth.velocity, truth.rate]) + rng.normal(0, OF_FLIGHT, (images, 6))
        sigma = np.tile(OF_FLIGHT, (images, 1))
        # As a block takes them: along rates that were observed a readout comes out too short.
        motion[:, 3:], sigma[:, 3:] = expected_rates(motion[:, 3:], sigma[:, 3:], np.full(images, GUST[3]))
    else:
        known = network.exposures.values[:, 3:] if name == "pictures" else network.positions.values
        velocity, unsteady = velocity_of_neighbours(network.exposures.camera, truth.time, known)
        motion, sigma = np.hstack([velocity, np.zeros((images, 3))]), np.tile(GUST, (images, 1))
        sigma[:, :3] = np.hypot(GUST[:3], unsteady[:, None])
    return truth, replace(network, exposures=replace(network.exposures, motion=motion, motion_sigma=sigma))


def standardised(truth: Flight, network: Network, solution: Solution) -> dict[str, float]:
    """Errors of what is common to all images in units of their standard deviations."""
    own, errors = truth.camera, {}
    values = own.values.copy()
    values[PARAMETERS.index("readout")] = truth.readout_s
    for k in np.flatnonzero(network.cameras[0].estimated):
        sigma = np.sqrt(solution.camera_covariance[0, k, k])
        errors[PARAMETERS[k]] = float((solution.cameras[0, k] - values[k]) / sigma)
    mounting = np.array([*LEVER, *BORESIGHT, DELAY])
    for k in np.flatnonzero(network.mounting.sigma[:7]):
        sigma = np.sqrt(solution.common_covariance[k, k])
        errors[COMMON[k]] = float((solution.state.common[k] - mounting[k]) / sigma)
    return errors


def with_positions(network: Network, truth: Flight, rng: np.random.Generator, sigma: float = 0.03) -> Network:
    """Projection centres as observations."""
    exposures = network.exposures
    values, deviation = exposures.values.copy(), exposures.sigma.copy()
    values[:, 3:] = truth.centre + rng.normal(0, sigma, truth.centre.shape)
    deviation[:, 3:] = sigma
    return replace(network, exposures=replace(exposures, values=values, sigma=deviation))
