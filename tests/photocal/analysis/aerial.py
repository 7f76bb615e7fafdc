"""Simulated flights of any size with a known truth: strips there and back, others across and higher."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from photocal.adjustment.mounting import NO_MOUNTING, STRIPS, Mounting, Positions
from photocal.adjustment.network import ExteriorOrientations, Network, Points, Rays, point_weights
from photocal.base.arrays import Floats, Integers
from photocal.geometry.camera import Camera, Model, camera
from photocal.geometry.distortion import projected
from photocal.geometry.rotation import matrix_from_angles

ESTIMATED = ("c", "x0", "y0", "K1", "K2", "K3", "P1", "P2", "B1")
LENS = {"c": 3650.0, "x0": 12.0, "y0": -8.0, "K1": -8e-9, "K2": 6e-16, "P1": 4e-8, "P2": -2e-8, "B1": 2e-4}
SIZE = (4000, 3000)
HEIGHT, GNSS_M, CONTROL_M = 100.0, np.array([0.02, 0.02, 0.04]), 0.01


@dataclass(frozen=True)
class Flight:
    """What is flown.

    Attributes
    ----------
    images, rays : int
        About so many.
    gnss, control : bool
        Whether positions of the exposures and nine control points are observed; without both the network
        is free.
    share : float
        Of the rays, drawn at random, that are measured.
    """

    images: int
    rays: int
    model: Model = "brown-ideal"
    sigma_px: float = 1.0
    gnss: bool = True
    control: bool = True
    estimate: tuple[str, ...] = ESTIMATED
    control_points: int = 9
    share: float = 1.0


@dataclass(frozen=True)
class Flown:
    """A network with its errors, and what is true."""

    network: Network
    lens: Camera
    points: Floats


def lens(flight: Flight) -> Camera:
    """The true camera."""
    return camera("sim", flight.model, "px", SIZE, (1.0, 1.0), LENS, estimate=flight.estimate)


def fly(flight: Flight, seed: int, **changed: float) -> Flown:
    """Fly and measure: every observed value has the error that is stated for it.

    Parameters
    ----------
    changed : float
        True values of the camera that differ from those of `LENS`; all that are not estimated stay unknown to
        the network.
    """
    rng = np.random.default_rng(seed)
    known = lens(flight)
    truth = camera("sim", flight.model, "px", SIZE, (1.0, 1.0), {**LENS, **changed})
    poses = _poses(flight.images, rng)
    low, high = poses[:, 3:5].min(axis=0) - 40.0, poses[:, 3:5].max(axis=0) + 40.0
    rotation = matrix_from_angles(poses[:, :3])
    sample = _ground(rng, 400, low, high)
    per_point = max(flight.share * len(_seen(truth, rotation, poses[:, 3:], sample)[0]) / 400, 1.0)
    xyz = _ground(rng, max(int(flight.rays / per_point), 30), low, high)
    if flight.control:
        xyz[: flight.control_points] = _spread(flight.control_points, low + 50.0, high - 50.0, xyz)
    image, point, exact = _seen(truth, rotation, poses[:, 3:], xyz)
    if flight.share < 1.0:
        measured = rng.random(len(image)) < flight.share
        image, point, exact = image[measured], point[measured], exact[measured]
    enough = np.bincount(point, minlength=len(xyz)) >= 2
    kept = enough[point]
    image, point, exact = image[kept], (np.cumsum(enough) - 1)[point[kept]], exact[kept]
    surveyed = int(enough[: flight.control_points].sum()) if flight.control else 0
    xyz = xyz[enough]
    sigma = np.full(xyz.shape, np.inf)
    sigma[:surveyed] = CONTROL_M
    held, weight = point_weights(sigma)
    given = xyz + rng.normal(0.0, 0.05, xyz.shape)
    given[:surveyed] = xyz[:surveyed] + rng.normal(0.0, CONTROL_M, (surveyed, 3))
    start = poses + rng.normal(0.0, 1.0, poses.shape) * ([1e-3] * 3 + [0.05] * 3)
    network = Network(
        (known,),
        ExteriorOrientations(np.zeros(len(poses), dtype=np.int64), start, np.full(poses.shape, np.inf)),
        Points(given, held, weight),
        Rays(
            image,
            point,
            exact + rng.normal(0.0, flight.sigma_px, exact.shape),
            np.full(exact.shape, flight.sigma_px),
        ),
        tuple(f"i{i}" for i in range(len(poses))),
        tuple(f"p{j}" for j in range(len(xyz))),
        datum_points=None if flight.gnss or flight.control else np.zeros(0, dtype=np.int64),
    )
    if flight.gnss:
        network = replace(network, positions=_positions(poses[:, 3:], rng), mounting=_mounting(len(poses)))
    return Flown(network, truth, xyz)


def _mounting(images: int) -> Mounting:
    strips = int(_strip(images).max()) + 1
    values = np.zeros(STRIPS + 6 * strips)
    return replace(NO_MOUNTING, values=values, sigma=values.copy())


def _strip(images: int) -> Integers:
    return np.asarray(np.arange(images) // max(int(np.sqrt(images)), 3), dtype=np.int64)


def _positions(centres: Floats, rng: np.random.Generator) -> Positions:
    n = len(centres)
    strip = _strip(n)
    first = np.searchsorted(strip, strip)
    return Positions(
        np.arange(n),
        centres + rng.normal(0.0, GNSS_M, (n, 3)),
        np.broadcast_to(np.diag(GNSS_M**2), (n, 3, 3)).copy(),
        np.zeros((n, 3)),
        strip,
        (np.arange(n) - first).astype(float),
        np.zeros(n),
    )


def _poses(images: int, rng: np.random.Generator) -> Floats:
    """Three of four images in strips there and back, the others across and a quarter higher."""
    across = images // 4
    poses = []
    for count, turn, height in ((images - across, 0.0, HEIGHT), (across, np.pi / 2, 1.25 * HEIGHT)):
        line = max(int(np.sqrt(count)), 3)
        apart = np.sqrt((images - across) / max(count, 1))
        for k in range(count):
            strip, along = divmod(k, line)
            along = along if strip % 2 == 0 else line - 1 - along
            place = np.array([25.0 * apart * along, 35.0 * apart * strip])
            if turn:
                place = place[::-1]
            heading = turn + (np.pi if strip % 2 else 0.0)
            poses.append([*rng.normal(0.0, 0.04, 2), heading + rng.normal(0.0, 0.04), *place, height])
    table = np.array(poses)
    table[:, 3:] += rng.normal(0.0, 1.5, (len(table), 3))
    return table


def _ground(rng: np.random.Generator, count: int, low: Floats, high: Floats) -> Floats:
    xy = rng.uniform(low, high, (count, 2))
    z = 8.0 * np.sin(xy[:, 0] / 40.0) + 6.0 * np.cos(xy[:, 1] / 55.0) + rng.uniform(-2.0, 2.0, count)
    return np.column_stack([xy, z])


def _spread(count: int, low: Floats, high: Floats, xyz: Floats) -> Floats:
    """So many of the points, near the corners and edges of the area."""
    rows = max(int(np.sqrt(count)), 2)
    grid = np.array([(a, b) for a in np.linspace(0, 1, rows) for b in np.linspace(0, 1, -(-count // rows))])
    wanted = low + grid[:count] * np.maximum(high - low, 0.0)
    nearest = [int(np.argmin(np.linalg.norm(xyz[:, :2] - place, axis=1))) for place in wanted]
    chosen = xyz[nearest].copy()
    chosen[:, :2] += 1e-3 * np.arange(count)[:, None]
    return chosen


def _seen(own: Camera, rotation: Floats, centres: Floats, xyz: Floats) -> tuple[Integers, Integers, Floats]:
    """Image, point and place in the image of all rays, sorted by point."""
    reach = 1.4 * np.hypot(*SIZE) / 2 / own.values[0] * 1.4 * HEIGHT
    rows = []
    # Points by squares as large as what an image sees: each image looks at three columns of them.
    low = xyz[:, :2].min(axis=0)
    column, row = ((xyz[:, :2] - low) // reach).astype(np.int64).T
    high = int(row.max()) + 1
    square = column * high + row
    by_square = np.argsort(square, kind="stable")
    square, sorted_xyz = square[by_square], xyz[by_square]
    for i, (turn, centre) in enumerate(zip(rotation, centres, strict=True)):
        at, up = ((centre[:2] - low) // reach).astype(np.int64)
        first, last = np.clip([up - 1, up + 2], 0, high)
        ends = np.searchsorted(square, np.arange(at - 1, at + 2)[:, None] * high + [first, last])
        near = np.concatenate([by_square[a:b] for a, b in ends])
        q = np.concatenate([sorted_xyz[a:b] for a, b in ends])
        close = np.linalg.norm(q[:, :2] - centre[:2], axis=1) < reach
        near, q = near[close], (q[close] - centre) @ turn.T
        ideal = np.abs(own.values[0] * q[:, :2] / q[:, 2:])
        inside = np.flatnonzero(np.all(ideal < 0.62 * np.array(SIZE), axis=1))
        inside = inside[np.argsort(near[inside])]
        near, q = near[inside], q[inside]
        plane = projected(own, q)
        ok = np.all(np.abs(plane) < np.array(SIZE) / 2 - 10, axis=1)
        rows.append((np.full(int(ok.sum()), i), near[ok], plane[ok]))
    image, point = (np.concatenate([row[k] for row in rows]).astype(np.int64) for k in (0, 1))
    plane = np.vstack([row[2] for row in rows])
    order = np.lexsort((image, point))
    return image[order], point[order], plane[order]


def correlated(network: Network, size_px: float, rng: np.random.Generator) -> Network:
    """Add to each image a smooth field of errors of its own: its rays are then not independent."""
    rays = network.rays
    x, y = (rays.plane / (np.array(SIZE) / 2)).T
    terms = np.stack([x**2, y**2, x * y, x, y, x * (x**2 + y**2)], axis=-1)
    amounts = rng.normal(0.0, size_px, (len(network.image_names), 2, 6))[rays.image]
    return replace(network, rays=replace(rays, plane=rays.plane + np.einsum("rak,rk->ra", amounts, terms)))


def scattered(network: Network, size_px: float, rng: np.random.Generator) -> Network:
    """Add noise that is larger in some images than in others."""
    rays = network.rays
    size = size_px * np.exp(rng.normal(0.0, 0.7, len(network.image_names)))[rays.image, None]
    return replace(network, rays=replace(rays, plane=rays.plane + size * rng.normal(size=rays.plane.shape)))
