"""Where each unknown stands in the reduced normal equations.

Object points are eliminated. What remains is ordered so that images which see the same points stand
close together (a band), followed by the unknowns that touch every image (the border).
"""

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from scipy.sparse import csr_array
from scipy.sparse.csgraph import reverse_cuthill_mckee

from photocal.adjustment.envelope import PANEL, envelope
from photocal.adjustment.kernels.data import POSE, WIDTHS, Structure
from photocal.adjustment.network import Network, own_parameters
from photocal.base.arrays import Flags, Floats, Integers
from photocal.base.compiled import compiled

# Directions in which the images of a block may stand one after the other.
DIRECTIONS = 12


@dataclass(frozen=True)
class Layout:
    """Columns of the reduced system.

    image_columns (images, 6): columns of the three rotation unknowns and of X, Y, Z of each image.
    own_columns (images, n): columns of each image's own parameters, see `own_parameters`; -1 for those that
        it does not have.
    camera_columns: for each camera the positions of its estimated parameters and their columns.
    with_image (cameras,): whether they stand among those of its only image, see `lone_cameras`.
    common_columns (k,): column of each common value of the mounting, of the lasers, then of the heads of
        rigs; -1 for those that are no unknowns.
    kept_points (m,): points that are not eliminated because observations relate them to others.
    point_columns (m, 3): their columns.
    envelope, strips: structure of the matrix, and of the same with a panel for each image and A'Pv as first
        row of the border, as pieces of points fill it: its offsets count rows.
    size: number of columns.
    width: columns of each image, one of `WIDTHS`.
    """

    image_columns: Integers
    own_columns: Integers
    camera_columns: tuple[tuple[Integers, Integers], ...]
    with_image: Flags
    common_columns: Integers
    kept_points: Integers
    point_columns: Integers
    envelope: Structure
    strips: Structure
    size: int
    width: int

    @cached_property
    def camera_parameters(self) -> tuple[Integers, Integers, Integers]:
        """Camera, position and column of each estimated parameter of the cameras, (k,)."""
        counts = [len(active) for active, _ in self.camera_columns]
        none = np.zeros(0, dtype=np.int64)
        active, columns = (np.concatenate([none, *part]) for part in zip(*self.camera_columns, strict=True))
        return np.repeat(np.arange(len(counts)), counts), active, columns


def layout(network: Network, ray_start: Integers) -> Layout:
    """Order the unknowns of a network.

    ray_start (points + 1,): first ray of each point.
    """
    count = len(network.image_names)
    together = np.zeros((count, count), dtype=np.bool_)
    mark_together(ray_start, network.rays.image, together)
    rig = network.rig
    together[rig.first, rig.second] = together[rig.second, rig.first] = True
    position, last = order(csr_array(together), network.exposures.started[:, 3:])
    parameters = own_parameters(network)
    with_image, width = _placed(network, parameters, last)
    image_columns = width * position[:, None] + np.arange(POSE)
    own_columns = np.where(
        parameters >= 0, width * position[:, None] + POSE + np.arange(parameters.shape[1]), -1
    )
    camera_columns = []
    column = width * count
    first = np.zeros(len(network.cameras), dtype=np.int64)
    first[network.exposures.camera] = image_columns[:, 0] + POSE
    for k, camera in enumerate(network.cameras):
        active = np.flatnonzero(camera.estimated)
        if with_image[k]:
            camera_columns.append((active, first[k] + np.arange(len(active))))
            continue
        camera_columns.append((active, column + np.arange(len(active))))
        column += len(active)
    lens = column - width * count
    mounted = bool(len(network.positions.image) or len(network.attitudes.image))
    of_mounting = (network.mounting.sigma != 0) & mounted
    common = of_mounting, network.lasers.unknown, rig.unknown(network.exposures.camera).ravel()
    unknown = np.flatnonzero(np.concatenate(common))
    common_columns = np.full(sum(map(len, common)), -1)
    common_columns[unknown] = column + np.arange(len(unknown))
    column += len(unknown)
    kept_points = np.union1d(network.relations.points, network.lasers.points)
    point_columns = column + np.arange(3 * len(kept_points)).reshape(-1, 3)
    column += point_columns.size
    reach, border = width * (last + 1), column - width * count
    strips = envelope(reach, width, 1 + border, width, lens)
    return Layout(
        image_columns,
        own_columns,
        tuple(camera_columns),
        with_image,
        common_columns,
        kept_points,
        point_columns,
        envelope(reach, width, border, PANEL, lens),
        strips._replace(offset=strips.offset // width),
        column,
        width,
    )


def lone_cameras(network: Network) -> Flags:
    """Cameras that took one image, of which nothing else depends: none that varies or reads line by line."""
    images = np.bincount(network.exposures.camera, minlength=len(network.cameras))
    alike = [not camera.rolling and not camera.deviation_sigma.any() for camera in network.cameras]
    return np.asarray((images == 1) & np.array(alike, dtype=np.bool_))


def _placed(network: Network, parameters: Integers, last: Integers) -> tuple[Flags, int]:
    """Which cameras stand with their image, and the columns of an image: all lone ones, or none.

    Of both, what takes fewer multiplications: of the rays of a point among each other and with the border,
    and of the factor.

    parameters (images, n): each image's own ones.
    last (images,): last image that those up to each place share a point with.
    """
    unknowns = np.array([np.count_nonzero(camera.estimated) for camera in network.cameras], dtype=np.int64)
    rays, points = len(network.rays.image), max(len(network.points.values), 1)
    reach, own, choices = last - np.arange(len(last)) + 1.0, parameters.shape[1], []
    for alone in (np.zeros(len(unknowns), dtype=np.bool_), lone_cameras(network)):
        most = max(own, int(unknowns[alone].max(initial=0)))
        width = next(width for width in WIDTHS if width >= POSE + most)
        border = int(unknowns[~alone].sum())
        work = 2.0 * rays * width * (border + width * rays / points / 2)
        work += float(np.sum(width * (width * reach + border) ** 2)) + border**3 / 3
        choices.append((work, width, alone))
    _, width, alone = min(choices, key=lambda each: each[0])
    return alone, width


def order(together: csr_array, centre: Floats) -> tuple[Integers, Integers]:
    """Place of each image, and of the last image up to each place that shares a point with one so far.

    Of orders across the block in several directions, and that of Cuthill and McKee, the one whose factor
    takes least work.

    together (images, images): pairs that share a point.
    centre (images, 3): about where they were taken.
    """
    count = len(centre)
    if not count:
        return np.zeros(0, dtype=np.int64), np.zeros(0, dtype=np.int64)
    image, other = together.nonzero()
    middle = np.nan_to_num(centre)
    middle = middle - middle.mean(axis=0)
    plane = middle @ np.linalg.svd(middle.T @ middle)[0][:, :2]
    turns = np.pi / DIRECTIONS * np.arange(DIRECTIONS)
    tried = [reverse_cuthill_mckee(together, symmetric_mode=True).astype(np.int64)]
    tried += [np.argsort(plane @ [np.cos(turn), np.sin(turn)], kind="stable") for turn in turns]
    orders = []
    for images in tried:
        position = np.empty(count, dtype=np.int64)
        position[images] = np.arange(count)
        last = np.arange(count)
        np.maximum.at(last, position[image], position[other])
        last = np.maximum.accumulate(last)
        orders.append((float(np.sum((last - np.arange(count) + 1.0) ** 2)), position, last))
    _, position, last = min(orders, key=lambda each: each[0])
    return position, last


@compiled
def mark_together(ray_start: Integers, ray_image: Integers, together: Flags) -> None:
    """Mark the pairs of images that see a common point."""
    for point in range(len(ray_start) - 1):
        for a in range(ray_start[point], ray_start[point + 1]):
            for b in range(ray_start[point], ray_start[point + 1]):
                together[ray_image[a], ray_image[b]] = True
