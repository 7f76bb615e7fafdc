"""What start values are made from: the rays as directions, and who saw what."""

from dataclasses import dataclass, replace
from typing import Self

import numpy as np
from scipy.sparse import csr_array

from photocal.adjustment.network import Rays
from photocal.base.arrays import Flags, Floats, Integers
from photocal.geometry.camera import Camera
from photocal.geometry.distortion import slopes_of


@dataclass(frozen=True)
class Bearings:
    """Rays of a block.

    given, cameras: as they were given, what is known of them beforehand; and with values as good as they are
        known.
    camera_of (images,).
    points: number of object points.
    rays: sorted by point.
    slopes (rays, 2): undistorted image coordinates over the principal distance.
    """

    given: tuple[Camera, ...]
    cameras: tuple[Camera, ...]
    camera_of: Integers
    points: int
    rays: Rays
    slopes: Floats

    @property
    def images(self) -> int:
        """Number of images."""
        return len(self.camera_of)

    def of_image(self, image: int) -> Integers:
        """Rays of an image."""
        return np.flatnonzero(self.rays.image == image)

    def common(self, first: int, second: int) -> tuple[Integers, Integers]:
        """Rays of two images to their common points, in the same order."""
        a, b = self.of_image(first), self.of_image(second)
        _, ia, ib = np.intersect1d(self.rays.point[a], self.rays.point[b], return_indices=True)
        return a[ia], b[ib]

    def together(self) -> csr_array:
        """How many points each pair of images has in common, shape (images, images)."""
        ones = np.ones(len(self.rays.image), dtype=np.int64)
        seen = csr_array((ones, (self.rays.image, self.rays.point)), shape=(self.images, self.points))
        return csr_array(seen @ seen.T)

    def some(self, rays: Flags) -> Self:
        """Keep some of the rays."""
        return replace(self, rays=self.rays.rows(rays), slopes=self.slopes[rays])

    def by(self, cameras: tuple[Camera, ...]) -> Self:
        """Undistort the rays anew by better cameras."""
        slopes = slopes_of(cameras, self.camera_of[self.rays.image], self.rays.plane)
        return replace(self, cameras=cameras, slopes=slopes)


def bearings(cameras: tuple[Camera, ...], camera_of: Integers, points: int, rays: Rays) -> Bearings:
    """Undistort the rays of a block.

    camera_of (images,).
    """
    slopes = slopes_of(cameras, camera_of[rays.image], rays.plane)
    return Bearings(cameras, cameras, camera_of, points, rays, slopes)
