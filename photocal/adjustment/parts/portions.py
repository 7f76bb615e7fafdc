"""A block that no process holds: divided portion by portion, each with some points and all their rays."""

from collections.abc import Iterable, Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import csr_array

from photocal.adjustment.network import Network, Points, Rays
from photocal.adjustment.parts.dissection import Dissection, dissect
from photocal.adjustment.parts.part import (
    Shares,
    SubNetwork,
    divided,
    homes_among,
    images_together,
    part_of,
    part_of_points,
    require_divisible,
    shares,
)
from photocal.adjustment.parts.work import write, write_part
from photocal.base.arrays import Flags, Integers
from photocal.base.codec import unpacked


@dataclass(frozen=True)
class Portion:
    """Some points of a block, with all their rays, which are sorted by point.

    names, numbers (points,): their names, and their numbers in the whole.
    ray_numbers (rays,): numbers in the whole of the rays.
    """

    points: Points
    rays: Rays
    names: tuple[str, ...]
    numbers: Integers
    ray_numbers: Integers


def write_parts(network: Network, most: int, folder: Path) -> Dissection:
    """Divide a network into parts with at most so many inner images, and write them.

    raises ConfigurationError: for what cannot be divided.
    """
    rays = network.rays
    together = images_together(rays.image, rays.point, len(network.image_names))
    dissection = dissect(together, network.exposures.started[:, 3:], most)
    write_divided(network, dissection, folder)
    return dissection


def write_divided(network: Network, dissection: Dissection, folder: Path) -> None:
    """Write the parts of a dissected network.

    raises ConfigurationError: for what cannot be divided.
    """
    for number, part in enumerate(divided(network, dissection)):
        write_part(folder, number, part)


def together_in(portions: Iterable[Portion], count: int) -> csr_array:
    """Pairs of images that share a point, (count, count), from all portions."""
    together = csr_array((count, count), dtype=np.int64)
    for portion in portions:
        together = together + images_together(portion.rays.image, portion.rays.point, count)
    return together


def write_portions(frame: Network, portions: Iterable[Portion], dissection: Dissection, folder: Path) -> None:
    """Write the parts of a block that comes in portions: never all rays at a time.

    frame: cameras, images and what else is observed of them, without points; with `datum_points` where it is
        free: inner constraints are over all points.
    dissection: of its images, by those that are `together_in` the same portions.
    raises ConfigurationError: for what cannot be divided.
    """
    require_divisible(frame)
    count, centre = len(frame.image_names), np.nan_to_num(frame.exposures.started[:, 3:])
    home = np.full(count, len(dissection.parts))
    pieces = np.zeros(len(dissection.parts), dtype=np.int64)
    for portion in portions:
        rays = portion.rays
        part = part_of_points(dissection, centre, rays.image, rays.point, len(portion.numbers))
        home = np.minimum(home, homes_among(dissection, part, rays.image, rays.point))
        for number in np.unique(part):
            write(_piece(folder, int(number), int(pieces[number])), _of_part(portion, part == number))
            pieces[number] += 1
    shared = shares(dissection, home, frame)
    for number, of_part in enumerate(pieces):
        paths = [_piece(folder, number, piece) for piece in range(of_part)]
        write_part(folder, number, _whole(frame, paths, shared, number))
        for path in paths:
            path.unlink()


def _piece(folder: Path, part: int, number: int) -> Path:
    return folder / f"piece-{part:05}-{number:05}.npz"


def _of_part(portion: Portion, mask: Flags) -> Portion:
    """Keep some points of a portion."""
    place, kept = np.cumsum(mask) - 1, mask[portion.rays.point]
    rays = portion.rays.rows(kept)
    return Portion(
        portion.points.rows(mask),
        replace(rays, point=place[rays.point]),
        tuple(portion.names[j] for j in np.flatnonzero(mask)),
        portion.numbers[mask],
        portion.ray_numbers[kept],
    )


def _whole(frame: Network, paths: list[Path], shared: Shares, number: int) -> SubNetwork:
    """Put the pieces of a part together."""
    pieces = list(_read(paths))
    firsts = np.cumsum([0, *(len(piece.numbers) for piece in pieces)])
    points = Points(*(_joined([getattr(p.points, n) for p in pieces]) for n in ("values", "held", "weight")))
    rays = Rays(
        _joined([piece.rays.image for piece in pieces]),
        _joined([piece.rays.point + first for piece, first in zip(pieces, firsts[:-1], strict=True)]),
        _joined([piece.rays.plane for piece in pieces]),
        _joined([piece.rays.sigma for piece in pieces]),
    )
    own = replace(
        frame,
        points=points,
        rays=rays,
        point_names=tuple(name for piece in pieces for name in piece.names),
        datum_points=None if frame.datum_points is None else np.arange(firsts[-1]),
    )
    numbers = _joined([piece.numbers for piece in pieces])
    return part_of(own, numbers, _joined([piece.ray_numbers for piece in pieces]), shared, number)


def _read(paths: list[Path]) -> Iterator[Portion]:
    for path in paths:
        with np.load(path) as arrays:
            yield unpacked(Portion, arrays)


def _joined(arrays: list[NDArray[Any]]) -> NDArray[Any]:
    return np.concatenate(arrays)
