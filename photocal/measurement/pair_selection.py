"""Which pairs of images to match: those whose footprints overlap, else neighbours, else all."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np

from drivers.arrays import Floats, Integers

Rule = Literal["footprints", "neighbours", "sequence", "all"]

# Each image is matched with so many others at most: the number of pairs grows with the images, not
# with their square.
MOST_PARTNERS = 24
# Without any exposure: all pairs up to so many images, then those that follow each other.
ALL_UP_TO, SEQUENCE = 60, 12
# Footprints that overlap by less than about a fifth are of no use.
USEFUL = 0.8


@dataclass(frozen=True)
class Footprints:
    """Where images look, as far as it is known before they are oriented.

    centre (n, 2): middle of the footprint, m; NaN when unknown.
    radius (n,): of a circle with the area of the footprint, m; NaN when the height above ground is unknown.
    """

    centre: Floats
    radius: Floats


def footprints(
    places: Floats, height_m: Floats, yaw_pitch: Floats, size_px: Floats, c_px: Floats
) -> Footprints:
    """Footprints on level ground.

    places (n, 2): east and north of the projection centres, m.
    height_m (n,): above ground.
    yaw_pitch (n, 2): of the camera, radians; pitch -90 degrees looks down, which is assumed where it is
        unknown.
    size_px (n, 2).
    c_px (n,).
    """
    yaw, pitch = (
        np.nan_to_num(yaw_pitch[:, 0]),
        np.where(np.isnan(yaw_pitch[:, 1]), -np.pi / 2, yaw_pitch[:, 1]),
    )
    # Views to the horizon see everything; what is useful of them ends at 60 degrees from the vertical.
    tilt = np.clip(np.pi / 2 + pitch, 0.0, np.radians(60))
    ahead = height_m * np.tan(tilt)
    centre = places + ahead[:, None] * np.column_stack([np.sin(yaw), np.cos(yaw)])
    radius = height_m / np.cos(tilt) * np.sqrt(size_px.prod(axis=1) / np.pi) / c_px
    return Footprints(np.where(np.isfinite(centre), centre, places), radius)


def select_pairs(seen: Footprints, count: int) -> tuple[Integers, Rule]:
    """Choose the pairs of images to match."""
    if not np.isfinite(seen.centre).all():
        if count <= ALL_UP_TO:
            return np.column_stack(np.triu_indices(count, 1)).astype(np.int64), "all"
        first = np.repeat(np.arange(count), SEQUENCE)
        second = first + np.tile(np.arange(1, SEQUENCE + 1), count)
        return np.column_stack([first, second])[second < count], "sequence"
    from scipy.spatial import KDTree

    partners = min(count, MOST_PARTNERS + 1)
    found = KDTree(seen.centre).query(seen.centre, k=partners)
    distance, other = (np.reshape(part, (count, -1)) for part in found)
    first = np.broadcast_to(np.arange(count)[:, None], other.shape)
    near = first != other
    known = bool(np.isfinite(seen.radius).all())
    if known:
        near &= distance < USEFUL * (seen.radius[first] + seen.radius[other])
    pairs = np.sort(np.column_stack([first[near], other[near]]), axis=1)
    return np.unique(pairs, axis=0).astype(np.int64), "footprints" if known else "neighbours"
