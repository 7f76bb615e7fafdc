"""A flight in strips of any size, made strip by strip: never whole in memory."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from photocal.adjustment.mounting import NO_MOUNTING, STRIPS, Mounting, Positions
from photocal.adjustment.network import ExteriorOrientations, Network, Points, Rays, point_weights
from photocal.geometry.camera import Camera
from photocal.geometry.distortion import projected
from photocal.geometry.rotation import NADIR, matrix_from_angles
from tests.photocal.networks import lens

Floats = NDArray[np.float64]
Integers = NDArray[np.int64]

HEIGHT, HALF_X, HALF_Y = 100.0, 13.5, 9.0
ARM = np.array([0.1, -0.05, -0.3])


@dataclass(frozen=True)
class Strips:
    """Strips flown to and fro over rolling ground, images of 27 mm x 18 mm at 20 mm.

    strips, each: strips, and images of each.
    forward, side: overlap along and across: a point is seen by 1 / (1 - forward) / (1 - side) images.
    rays: of an image, about.
    cameras: images take turns.
    control: one point in so many is a control point of 1 cm; 0: none.
    antenna: whether positions are those of an antenna, whose lever arm is an unknown; else of the images.
    """

    strips: int
    each: int
    forward: float = 0.75
    side: float = 0.4
    rays: int = 200
    cameras: int = 1
    control: int = 0
    antenna: bool = False
    positions: bool = True
    sigma_mm: float = 0.003
    position_sigma_m: float = 0.03
    seed: int = 1

    @property
    def count(self) -> int:
        """Number of images."""
        return self.strips * self.each

    @property
    def lenses(self) -> tuple[Camera, ...]:
        """The true cameras."""
        return tuple(lens(f"c{k}", c=20.0 + 0.1 * k) for k in range(self.cameras))

    @property
    def steps(self) -> Floats:
        """Distance of strips, and of images along them, m."""
        return np.array([2 * HALF_X * (1 - self.side), 2 * HALF_Y * (1 - self.forward)]) * HEIGHT / 20.0

    def poses(self) -> Floats:
        """True exterior orientations, (images, 6)."""
        rng = np.random.default_rng([self.seed, 0])
        strip, place = np.divmod(np.arange(self.count), self.each)
        ground = np.column_stack([strip, place]) * self.steps
        centre = np.column_stack([ground, HEIGHT + 6.0 * (strip % 3 - 1)])
        centre += rng.normal(0.0, 1.0, centre.shape)
        angles = rng.normal(0.0, 0.02, (self.count, 3))
        angles[:, 2] += np.pi * (strip % 2)
        return np.hstack([angles, centre])

    def seen(self, strip: int, poses: Floats) -> tuple[Floats, Integers, Integers, Floats]:
        """Ground points under a strip, image and point of their rays, and what was measured."""
        rng = np.random.default_rng([self.seed, 1, strip])
        rays_of_point = 1 / (1 - self.forward) / (1 - self.side)
        count = max(4, round(self.each * self.rays / rays_of_point))
        low, high = np.array([strip - 0.5, -0.5]), np.array([strip + 0.5, self.each - 0.5])
        ground = rng.uniform(low * self.steps, high * self.steps, (count, 2))
        xyz = np.column_stack([ground, rng.normal(0.0, 5.0, count)])
        near = np.rint(ground / self.steps).astype(np.int64)
        reach = np.ceil([1 / (1 - self.side) / 2 + 0.6, 1 / (1 - self.forward) / 2 + 0.6]).astype(np.int64)
        offsets = np.stack(np.meshgrid(*(np.arange(-r, r + 1) for r in reach), indexing="ij"), -1).reshape(
            -1, 2
        )
        at = near[:, None] + offsets
        inside = ((at >= 0) & (at < [self.strips, self.each])).all(axis=2)
        point, which = np.nonzero(inside)
        image = at[point, which] @ [self.each, 1]
        matrix = matrix_from_angles(poses[:, :3])
        q = np.einsum("nij,nj->ni", matrix[image], xyz[point] - poses[image, 3:])
        plane = 20.0 * q[:, :2] / -q[:, 2:]
        on = (np.abs(plane) < [HALF_X, HALF_Y]).all(axis=1)
        image, point, q = image[on], point[on], q[on]
        enough = np.bincount(point, minlength=count) >= 3
        kept = enough[point]
        image, point, q = image[kept], (np.cumsum(enough) - 1)[point[kept]], q[kept]
        measured = np.empty((len(image), 2))
        for k, own in enumerate(self.lenses):
            mine = image % self.cameras == k
            measured[mine] = projected(own, q[mine])
        return xyz[enough], image, point, measured + rng.normal(0.0, self.sigma_mm, measured.shape)

    def frame(self) -> Network:
        """Cameras, exposures and positions of the whole, with no points yet."""
        rng = np.random.default_rng([self.seed, 2])
        poses, count = self.poses(), self.count
        cameras = tuple(replace(one, values=np.where(one.estimated, 0.0, one.values)) for one in self.lenses)
        cameras = tuple(
            replace(one, values=np.where(np.arange(len(one.values)) == 0, 20.05, one.values))
            for one in cameras
        )
        start = poses + rng.normal(0.0, 1.0, poses.shape) * [0.002, 0.002, 0.002, 0.2, 0.2, 0.2]
        sigma = np.full((count, 6), np.inf)
        network = Network(
            cameras,
            ExteriorOrientations(np.arange(count) % self.cameras, start, sigma),
            Points(np.zeros((0, 3)), np.zeros((0, 3), dtype=np.bool_), np.zeros((0, 3, 3))),
            Rays(np.zeros(0, np.int64), np.zeros(0, np.int64), np.zeros((0, 2)), np.zeros((0, 2))),
            tuple(f"i{k}" for k in range(count)),
            (),
        )
        if not self.positions:
            return replace(network, datum_points=np.zeros(0, np.int64)) if not self.control else network
        error = rng.normal(0.0, self.position_sigma_m, (count, 3))
        if not self.antenna:
            start[:, 3:] = poses[:, 3:] + error
            sigma[:, 3:] = self.position_sigma_m
            return network
        body = NADIR
        place = poses[:, 3:] + np.einsum("nji,j->ni", matrix_from_angles(poses[:, :3]), body @ ARM) + error
        covariance = np.broadcast_to(self.position_sigma_m**2 * np.eye(3), (count, 3, 3)).copy()
        free = np.zeros(STRIPS + 6)
        free[:3] = 0.5
        nothing = np.zeros(count)
        positions = Positions(
            np.arange(count),
            place,
            covariance,
            np.zeros((count, 3)),
            nothing.astype(np.int64),
            nothing,
            nothing,
        )
        values = np.zeros(STRIPS + 6)
        return replace(network, positions=positions, mounting=Mounting(NO_MOUNTING.rotation, values, free))

    def points_and_rays(self, strip: int, poses: Floats) -> tuple[Points, Rays]:
        """Start values of the points under a strip, and their rays, sorted by point."""
        xyz, image, point, plane = self.seen(strip, poses)
        rng = np.random.default_rng([self.seed, 3, strip])
        sigma = np.full(xyz.shape, np.inf)
        if self.control:
            sigma[:: self.control] = 0.01
        held, weight = point_weights(sigma)
        start = xyz + rng.normal(0.0, 1.0, xyz.shape) * np.where(np.isfinite(sigma), sigma, 0.3)
        return Points(start, held, weight), Rays(image, point, plane, np.full(plane.shape, self.sigma_mm))

    def network(self) -> Network:
        """The whole."""
        poses, points, rays, first = self.poses(), [], [], 0
        for strip in range(self.strips):
            of_strip, seen = self.points_and_rays(strip, poses)
            points.append(of_strip)
            rays.append(replace(seen, point=seen.point + first))
            first += len(of_strip.values)
        return replace(
            self.frame(),
            points=Points(
                *(np.concatenate([getattr(p, n) for p in points]) for n in ("values", "held", "weight"))
            ),
            rays=Rays(
                *(np.concatenate([getattr(r, n) for r in rays]) for n in ("image", "point", "plane", "sigma"))
            ),
            point_names=tuple(f"p{j}" for j in range(first)),
        )
