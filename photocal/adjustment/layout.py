"""Where each unknown stands in the reduced normal equations.

Object points are eliminated. What remains is ordered so that images which see the same points stand
close together (a band), followed by the unknowns that touch every image (the border).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.sparse import csr_array
from scipy.sparse.csgraph import reverse_cuthill_mckee

from drivers.arrays import Flags, Integers
from photocal.adjustment.envelope import Envelope, envelope
from photocal.adjustment.kernels.data import POSE, WIDTHS
from photocal.adjustment.network import Network, own_parameters
from photocal.compiled import compiled


@dataclass(frozen=True)
class Layout:
    """Columns of the reduced system.

    image_columns (images, 6): columns of the three rotation unknowns and of X, Y, Z of each image.
    own_columns (images, n): columns of each image's own parameters, see `own_parameters`; -1 for those that
        it does not have.
    camera_columns: for each camera the positions of its estimated parameters and their columns.
    common_columns (k,): column of each common value of the mounting, then of the heads of rigs; -1 for
        those that are no unknowns.
    kept_points (m,): points that are not eliminated because observations relate them to others.
    point_columns (m, 3): their columns.
    envelope, strips: structure of the matrix, and of the same with a panel for each image.
    size: number of columns.
    width: columns of each image, one of `WIDTHS`.
    """

    image_columns: Integers
    own_columns: Integers
    camera_columns: tuple[tuple[Integers, Integers], ...]
    common_columns: Integers
    kept_points: Integers
    point_columns: Integers
    envelope: Envelope
    strips: Envelope
    size: int
    width: int


def layout(network: Network, ray_start: Integers) -> Layout:
    """Order the unknowns of a network.

    ray_start (points + 1,): first ray of each point.
    """
    count = len(network.image_names)
    together = np.zeros((count, count), dtype=np.bool_)
    mark_together(ray_start, network.rays.image, together)
    rig = network.rig
    together[rig.first, rig.second] = together[rig.second, rig.first] = True
    order = reverse_cuthill_mckee(csr_array(together), symmetric_mode=True)
    position = np.empty(count, dtype=np.int64)
    position[order] = np.arange(count)
    own = own_parameters(network)
    most = own.shape[1]
    width = next(width for width in WIDTHS if width >= POSE + most)
    image_columns = width * position[:, None] + np.arange(POSE)
    own_columns = np.where(own >= 0, width * position[:, None] + POSE + np.arange(most), -1)
    camera_columns = []
    column = width * count
    for camera in network.cameras:
        active = np.flatnonzero(camera.estimated)
        camera_columns.append((active, column + np.arange(len(active))))
        column += len(active)
    mounted = bool(len(network.positions.image) or len(network.attitudes.image))
    common = (network.mounting.sigma != 0) & mounted, rig.unknown(network.exposures.camera).ravel()
    unknown = np.flatnonzero(np.concatenate(common))
    common_columns = np.full(len(common[0]) + len(common[1]), -1)
    common_columns[unknown] = column + np.arange(len(unknown))
    column += len(unknown)
    relations = network.relations
    kept_points = np.unique(np.concatenate([relations.first, relations.second]))
    point_columns = column + np.arange(3 * len(kept_points)).reshape(-1, 3)
    column += point_columns.size
    # The last image, in the new order, that each one shares a point with.
    sorted_together = together[order][:, order]
    last = count - 1 - np.argmax(sorted_together[:, ::-1], axis=1) if count else np.zeros(0, dtype=np.int64)
    last = np.maximum(last, np.arange(count))
    reach, border = width * (last + 1), column - width * count
    return Layout(
        image_columns,
        own_columns,
        tuple(camera_columns),
        common_columns,
        kept_points,
        point_columns,
        envelope(reach, width, border),
        envelope(reach, width, border, width),
        column,
        width,
    )


@compiled
def mark_together(ray_start: Integers, ray_image: Integers, together: Flags) -> None:
    """Mark the pairs of images that see a common point."""
    for point in range(len(ray_start) - 1):
        for a in range(ray_start[point], ray_start[point + 1]):
            for b in range(ray_start[point], ray_start[point + 1]):
                together[ray_image[a], ray_image[b]] = True
