"""Marks: points that were measured in images by hand or found as targets."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import replace
from pathlib import Path

import numpy as np

from photocal.block.model import Block
from photocal.block.table import read_table, refuse
from photocal.exchange.parts import Mark

# A point that somebody clicked, when the table does not say how well.
BY_HAND_PX = 1.0


def read_marks(path: Path) -> tuple[Mark, ...]:
    """Read marks.csv: image, point, x, y, optional sx, sy, px of the stored pixel grid."""
    table = read_table(path, ("image", "point", "x", "y"), ("sx", "sy"))
    xy, sigma = table.matrix("xy"), table.matrix(("sx", "sy"), empty=BY_HAND_PX)
    refuse(table, (sigma <= 0).any(axis=1), "the sigma is not positive", "give a positive number")
    names = (table.names(column) for column in ("image", "point"))
    images, points = ([found[k] for k in index] for index, found in names)
    seen: set[tuple[str, str]] = set()
    again = np.zeros(len(xy), dtype=np.bool_)
    for row, pair in enumerate(zip(images, points, strict=True)):
        again[row] = pair in seen
        seen.add(pair)
    refuse(table, again, "the point was already marked in this image", "keep one of the marks")
    return tuple(
        Mark(image, point, float(x), float(y), (float(sx), float(sy)), table.place(row))
        for row, (image, point, (x, y), (sx, sy)) in enumerate(zip(images, points, xy, sigma, strict=True))
    )


def with_marks(block: Block, marks: Iterable[Mark]) -> tuple[Block, tuple[Mark, ...]]:
    """Add marks of known points in known images to a block."""
    image = {name: k for k, name in enumerate(block.images.names)}
    point = {name: k for k, name in enumerate(block.points.names)}
    rows: dict[tuple[int, int], Mark] = {}
    unknown = []
    for mark in marks:
        if mark.image in image and mark.point in point:
            rows.setdefault((image[mark.image], point[mark.point]), mark)
        else:
            unknown.append(mark)
    keys = np.array(list(rows), dtype=np.int64).reshape(-1, 2)
    xy = np.array([(m.x, m.y) for m in rows.values()]).reshape(-1, 2)
    sigma = np.array([m.sigma for m in rows.values()]).reshape(-1, 2)
    seen = block.observations.plus(keys[:, 0], keys[:, 1], xy, sigma)
    return replace(block, observations=seen), tuple(unknown)
