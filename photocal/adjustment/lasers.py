"""Laser distances of images to the surface of the object points.

The laser of an image measures along the axis of its camera d = (1 + k) s + o, with s the distance to the
plane through three object points about its target, and offset o and scale k what the errors of all distances
have in common. With q_j = M (P_j - X0) the points in camera axes and u the direction of the axis, the plane
n q = 1 gives s = 1 / (n u). The target has shares l_j in the points, u s = l_1 q_1 + l_2 q_2 + l_3 q_3, so
that with g = s n steps of the points change s by the sum of l_j g dq_j (g u = 1).
"""

from dataclasses import dataclass, replace
from typing import Self

import numpy as np

from photocal.adjustment.equations import Equations
from photocal.adjustment.mounting import common_equations
from photocal.base.arrays import Columns, Flags, Floats, Integers

# What all distances have in common: an offset (m) and a scale (m/m).
OFFSET, SCALE = 0, 1
OF_LASER = ("laser_offset", "laser_scale")
# Camera axes: x right, y up, z backwards.
AHEAD = np.array([0.0, 0.0, -1.0])


@dataclass(frozen=True)
class LaserDistances(Columns):
    """Distances from images to the planes through three points each.

    image (n,), corners (n, 3): the image, and the points about its target.
    values, sigma (n,): m; the sigma is that of the laser and of the surface between the points.
    common_sigma: of offset and scale, as `OF_LASER`, observed as zero; a sigma of 0 holds it, infinity leaves
        it free; empty where a network has no laser.
    """

    image: Integers
    corners: Integers
    values: Floats
    sigma: Floats
    common_sigma: tuple[float, ...] = ()

    @property
    def points(self) -> Integers:
        """All points that are corners, sorted."""
        return np.unique(self.corners)

    @property
    def unknown(self) -> Flags:
        """Which of the common values are unknowns."""
        return np.asarray(np.array(self.common_sigma) != 0.0) & bool(len(self.image))

    def of_points(self, place: Integers, kept: Flags) -> Self:
        """Distances to some points, at the places that these have now."""
        return replace(self, corners=place[self.corners]).rows(kept[self.corners].all(axis=1))

    def of_images(self, place: Integers, kept: Flags) -> Self:
        """Distances of some images, at the places that these have now."""
        return replace(self, image=place[self.image]).rows(kept[self.image])


_NONE = np.zeros(0, dtype=np.int64)
NO_LASERS = LaserDistances(_NONE, np.zeros((0, 3), dtype=np.int64), np.zeros(0), np.zeros(0))


@dataclass(frozen=True)
class Planes:
    """Distances along the axes of cameras to planes.

    distance (n,): m; negative, or not finite, where the axis does not meet the plane ahead.
    normal (n, 3): g, in camera axes; share (n, 3): of each corner in the target, which sum to 1.
    """

    distance: Floats
    normal: Floats
    share: Floats


def planes_ahead(corners: Floats) -> Planes:
    """Meet the planes through three points in camera axes, (n, 3, 3): one row for each point."""
    turned = np.swapaxes(corners, 1, 2)
    share = np.linalg.solve(turned, np.broadcast_to(AHEAD[:, None], (len(corners), 3, 1)))[..., 0]
    normal = np.linalg.solve(corners, np.ones((len(corners), 3, 1)))[..., 0]
    distance = 1.0 / share.sum(axis=1)
    return Planes(distance, distance[:, None] * normal, distance[:, None] * share)


def laser_equations(
    lasers: LaserDistances,
    poses: tuple[Floats, Floats],
    points: Floats,
    common: Floats,
    columns: tuple[Integers, Integers, Integers],
    basis: Floats,
    free: tuple[Flags, Flags],
) -> dict[str, Equations]:
    """Linearise the distances, and give offset and scale as observations.

    poses: rotation (images, 3, 3) and projection centre (images, 3).
    common (2,): offset and scale.
    columns: of the images (images, 6), of all corners (n, 9), and of the common values (2,), -1 where held.
    basis (images, 3, 3): turns that the rotation unknowns make.
    free: what of images (images, 6) and points (points, 3) is unknown.
    """
    if not len(lasers.image):
        return {}
    image, corners = lasers.image, lasers.corners
    rotation, centre = poses[0][image], poses[1][image]
    meets = planes_ahead((points[corners] - centre[:, None]) @ np.swapaxes(rotation, 1, 2))
    longer = 1.0 + common[SCALE]
    across = np.einsum("na,nab->nb", meets.normal, rotation)
    turning = np.einsum("na,nab->nb", np.cross(meets.distance[:, None] * AHEAD, meets.normal), basis[image])
    of_image = np.hstack([turning, -across]) * free[0][image]
    of_corners = meets.share[:, :, None] * across[:, None, :] * free[1][corners]
    parts = [longer * of_image, longer * of_corners.reshape(-1, 9)]
    at = [columns[0][image], columns[1]]
    for k, by_value in ((OFFSET, np.ones(len(image))), (SCALE, meets.distance)):
        if columns[2][k] >= 0:
            parts.append(by_value[:, None])
            at.append(np.full((len(image), 1), columns[2][k]))
    coefficient = np.hstack(parts)
    residual = longer * meets.distance + common[OFFSET] - lasers.values
    start = coefficient.shape[1] * np.arange(len(image) + 1)
    rows = Equations(start, np.hstack(at).ravel(), coefficient.ravel(), residual, lasers.sigma**-2.0)
    sigma = np.array(lasers.common_sigma)
    return {"laser": rows, "laser-offset": common_equations(np.zeros(2), sigma, common, columns[2])}
