"""Small networks with a known truth: the one place where tests make them."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from photocal.adjustment.lasers import LaserDistances
from photocal.adjustment.mounting import Attitudes, Mounting, Positions
from photocal.adjustment.network import ExteriorOrientations, Network, Points, Rays, Relations, point_weights
from photocal.geometry.camera import PARAMETERS, Affinity, AffinityForm, Camera, Model, camera
from photocal.geometry.distortion import projected
from photocal.geometry.rotation import NADIR, angles_from_matrix, matrix_from_angles

Floats = NDArray[np.float64]
Integers = NDArray[np.int64]

# A lens like that of a 20 mm wide angle, in mm.
LENS = {
    "c": 20.0,
    "x0": -0.2,
    "y0": 0.15,
    "K1": -2.5e-4,
    "K2": 3e-7,
    "K3": 8e-10,
    "P1": 1.5e-5,
    "P2": -1e-5,
    "B1": 2e-4,
    "B2": -1e-4,
}
COMMON = ("c", "x0", "y0", "K1", "K2", "P1", "P2")


def lens(
    name: str = "main",
    model: Model = "brown-observed",
    *,
    estimate: tuple[str, ...] = COMMON,
    prior_sigma: dict[str, float] | None = None,
    affinity: Affinity = "additive",
    affinity_form: AffinityForm = "fraser",
    photo_variant: dict[str, float] | None = None,
    focus_m: float = 0.0,
    **changes: float,
) -> Camera:
    """A camera with the values of `LENS`, changed by name."""
    return camera(
        name,
        model,
        "mm",
        (3000, 2000),
        (0.009, 0.009),
        LENS | changes,
        estimate=estimate,
        prior_sigma=prior_sigma,
        affinity=affinity,
        affinity_form=affinity_form,
        photo_variant=photo_variant,
        focus_m=focus_m,
    )


@dataclass(frozen=True)
class Scene:
    """The truth: cameras, exposures (omega, phi, kappa, X, Y, Z) and object points."""

    cameras: tuple[Camera, ...]
    camera_of: Integers
    exposures: Floats
    points: Floats

    def turned(self, rotation: Floats, shift: Floats) -> Scene:
        """The same scene in a frame X' = R X + t."""
        matrix = matrix_from_angles(self.exposures[:, :3]) @ rotation.T
        centre = self.exposures[:, 3:] @ rotation.T + shift
        exposures = np.hstack([angles_from_matrix(matrix), centre])
        return replace(self, exposures=exposures, points=self.points @ rotation.T + shift)


def convergent(
    cameras: tuple[Camera, ...] | None = None, *, images: int = 6, points: int = 20, seed: int = 1
) -> Scene:
    """Images of a field of points from all around, rolled by 90 degrees each, cameras in turn."""
    rng = np.random.default_rng(seed)
    cameras = cameras or (lens(),)
    xyz = rng.uniform([-4, -3, -1], [4, 3, 1], (points, 3))
    poses = []
    for i in range(images):
        bearing = 2 * np.pi * i / images + 0.3
        centre = np.array([5 * np.cos(bearing), 4 * np.sin(bearing), 9.0]) + rng.uniform(-0.5, 0.5, 3)
        poses.append(np.concatenate([looking(centre, rng.uniform(-0.3, 0.3, 3), i * np.pi / 2), centre]))
    return Scene(cameras, np.arange(images) % len(cameras), np.array(poses), xyz)


def looking(centre: Floats, target: Floats, roll: float) -> Floats:
    """Angles of a camera that looks from one place to another."""
    backwards = (centre - target) / np.linalg.norm(centre - target)
    right = np.cross([0.0, 1.0, 0.0], backwards)
    right /= np.linalg.norm(right)
    level = np.array([right, np.cross(backwards, right), backwards])
    spin = matrix_from_angles(np.array([0.0, 0.0, roll]))
    return angles_from_matrix(spin @ level)


def observe(
    scene: Scene,
    rng: np.random.Generator | None,
    *,
    sigma: float = 0.003,
    point_sigma: Floats | float = 0.003,
    exposure_sigma: Floats | float = np.inf,
    missing: float = 0.0,
    disturb: float = 0.02,
) -> Network:
    """Measure a scene: every value that has a sigma gets its error, every other one a rough start.

    Parameters
    ----------
    scene : Scene
    rng : Generator or None
        None: observations without errors (start values are disturbed all the same).
    sigma : float
        Of image coordinates, mm.
    point_sigma, exposure_sigma : float or ndarray
        0 holds, infinity leaves free; broadcast to (points, 3) and (images, 6).
    missing : float
        Share of the rays that are not measured; two stay at every point.
    disturb : float
        Error of start values, m and radians.
    """
    start = np.random.default_rng(99)
    images, points = len(scene.exposures), len(scene.points)
    image, point = np.tile(np.arange(images), points), np.repeat(np.arange(points), images)
    seen = (start.random(len(image)) >= missing) | ((image - point) % images < 2)
    image, point = image[seen], point[seen]
    q = np.einsum(
        "nij,nj->ni",
        matrix_from_angles(scene.exposures[:, :3])[image],
        scene.points[point] - scene.exposures[image, 3:],
    )
    plane = np.empty((len(image), 2))
    for k, own in enumerate(scene.cameras):
        mine = scene.camera_of[image] == k
        plane[mine] = projected(own, q[mine])
    of_point = np.broadcast_to(np.asarray(point_sigma, dtype=float), (points, 3)).copy()
    of_exposure = np.broadcast_to(np.asarray(exposure_sigma, dtype=float), (images, 6)).copy()
    if rng is not None:
        plane = plane + rng.normal(0.0, sigma, plane.shape)
    held, weight = point_weights(of_point)
    return Network(
        tuple(_started(own, rng) for own in scene.cameras),
        ExteriorOrientations(
            scene.camera_of, _observed(scene.exposures, of_exposure, rng, start, disturb / 4), of_exposure
        ),
        Points(_observed(scene.points, of_point, rng, start, disturb), held, weight),
        Rays(image, point, plane, np.full(plane.shape, sigma)),
        tuple(f"i{k}" for k in range(images)),
        tuple(f"p{j}" for j in range(points)),
    )


def _observed(
    true: Floats, sigma: Floats, rng: np.random.Generator | None, start: np.random.Generator, disturb: float
) -> Floats:
    weighted = np.isfinite(sigma)
    error = np.zeros(true.shape) if rng is None else rng.normal(0.0, 1.0, true.shape)
    rough = start.uniform(-disturb, disturb, true.shape)
    return true + np.where(weighted, error * np.where(weighted, sigma, 0.0), rough)


def _started(own: Camera, rng: np.random.Generator | None) -> Camera:
    """The camera as it is known before: c a little off, no distortion; weighted values with their error."""
    values = own.values.copy()
    free = own.estimated & ~np.isfinite(own.prior_sigma)
    values[free] = 0.0
    values[0] = own.values[0] * (1.01 if free[0] else 1.0)
    weighted = own.estimated & np.isfinite(own.prior_sigma)
    if rng is not None:
        values[weighted] += (rng.normal(0.0, 1.0, len(PARAMETERS)) * own.prior_sigma)[weighted]
    return own.with_values(values)


def related(
    network: Network, scene: Scene, rng: np.random.Generator | None, kinds: list[int], sigma: Floats
) -> Network:
    """Add relations of the given kinds (numbers of `RELATIONS`) between points 0-1(-2), 1-2(-3), ..."""
    first = np.arange(len(kinds)) % (len(scene.points) - 2)
    d = scene.points[first + 1] - scene.points[first]
    other = scene.points[first + 2] - scene.points[first]
    azimuth, level = np.arctan2(d[:, 0], d[:, 1]), np.hypot(d[:, 0], d[:, 1])
    by_kind = np.array(
        [
            np.linalg.norm(d, axis=1),
            d[:, 2],
            azimuth,
            np.arctan2(d[:, 2], level),
            np.arctan2(other[:, 0], other[:, 1]) - azimuth,
            np.zeros(len(d)),
        ]
    )
    values, kind = by_kind[kinds, np.arange(len(kinds))], np.array(kinds, dtype=np.int64)
    if rng is not None:
        # A point is somewhere about its line, but never observed to be elsewhere.
        values = values + rng.normal(0.0, sigma) * (kind != 5)
    third = np.where(kind > 3, first + 2, -1)
    return replace(network, relations=Relations(kind, first, first + 1, values, sigma, third))


def ranged(
    network: Network,
    scene: Scene,
    rng: np.random.Generator | None,
    common_sigma: tuple[float, float] = (0.02, 0.001),
    sigma: float = 0.01,
    common: tuple[float, float] = (0.0, 0.0),
) -> Network:
    """Add a laser distance of each image to the plane through the three points nearest to its axis.

    common: offset and scale of all distances, beyond the errors that they get with a generator.
    """
    matrix, centre = matrix_from_angles(scene.exposures[:, :3]), scene.exposures[:, 3:]
    q = np.einsum("iab,ijb->ija", matrix, scene.points - centre[:, None])
    corners = np.argsort(np.hypot(q[..., 0], q[..., 1]) / -q[..., 2], axis=1)[:, :3]
    a, b, c = np.moveaxis(scene.points[corners], 1, 0)
    upright, axis = np.cross(b - a, c - a), -matrix[:, 2]
    far = np.sum(upright * (a - centre), axis=1) / np.sum(upright * axis, axis=1)
    count, (offset, scale) = len(centre), common
    if rng is not None:
        offset, scale = np.array(common) + rng.normal(0.0, 1.0, 2) * common_sigma
        far = far + rng.normal(0.0, sigma, count) / (1 + scale)
    measured = (1 + scale) * far + offset
    lasers = LaserDistances(np.arange(count), corners, measured, np.full(count, sigma), common_sigma)
    return replace(network, lasers=lasers)


def navigated(
    network: Network,
    scene: Scene,
    rng: np.random.Generator,
    mounting: Floats,
    mounting_sigma: Floats,
    *,
    strips: int = 1,
    attitudes: bool = True,
) -> Network:
    """Add antenna positions with correlated errors, velocities and attitudes.

    Parameters
    ----------
    network, scene : Network, Scene
    rng : Generator
    mounting : ndarray, shape (11 + 6 strips,)
        True lever arm, boresight, time offset, shift and height scale of the flight, shift and drift of
        each strip.
    mounting_sigma : ndarray of the same shape
        0 holds the true value, infinity leaves it free and starts at 0.
    strips : int
        Images take turns.
    attitudes : bool
        Whether there are attitudes too.
    """
    count = len(scene.exposures)
    image = np.arange(count)
    strip, time = image % strips, np.linspace(-3.0, 3.0, count)
    velocity = rng.uniform(-15, 15, (count, 3))
    camera_of_body = Rotation.from_rotvec(mounting[3:6]).as_matrix() @ NADIR
    matrix = matrix_from_angles(scene.exposures[:, :3])
    at = 11 + 6 * strip[:, None] + np.arange(3)
    place = scene.exposures[:, 3:] + np.swapaxes(matrix, 1, 2) @ camera_of_body @ mounting[:3]
    place = place - velocity * mounting[6] + mounting[at] + mounting[at + 3] * time[:, None]
    above = place[:, 2] - 0.5
    place = place + mounting[7:10] + above[:, None] * [0.0, 0.0, mounting[10]]
    root = np.array([[0.02, 0, 0], [0.005, 0.015, 0], [-0.01, 0.005, 0.03]])
    place = place + rng.normal(size=(count, 3)) @ root.T
    covariance = np.broadcast_to(root @ root.T, (count, 3, 3)).copy()
    turn_sigma = np.array([0.0008, 0.0005, 0.0015])
    turn = rng.normal(size=(count, 3)) * turn_sigma
    body = Rotation.from_rotvec(-turn).as_matrix() @ camera_of_body.T @ matrix
    seen = image if attitudes else image[:0]
    start = np.where(np.isfinite(mounting_sigma), mounting, 0.0)
    weighted = np.isfinite(mounting_sigma) & (mounting_sigma > 0)
    start[weighted] += (rng.normal(size=len(mounting)) * mounting_sigma)[weighted]
    return replace(
        network,
        positions=Positions(image, place, covariance, velocity, strip, time, above),
        attitudes=Attitudes(
            seen, body[seen], np.broadcast_to(np.diag(turn_sigma**2), (len(seen), 3, 3)).copy()
        ),
        mounting=Mounting(NADIR, start, mounting_sigma),
    )
