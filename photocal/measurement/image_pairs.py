"""Which images to match: those whose footprints overlap, as far as these are known beforehand."""

from collections.abc import Sequence
from typing import Literal

import numpy as np

from photocal.base.arrays import Flags, Floats, Integers
from photocal.block.model import ObjectPoints
from photocal.measurement.image_facts import ImageFacts
from photocal.measurement.maker_camera import stated_camera
from photocal.measurement.orientation import Orientation
from photocal.measurement.position_files import local_places

Rule = Literal["footprints", "neighbours", "sequence", "all"]

# All pairs that may overlap up to so many images; beyond, without any exposure, those that follow each other.
ALL_UP_TO, SEQUENCE = 60, 12
# Each image is paired with so many others at most: pairs grow with the images, not with their square. Of more
# images than those the nearest are matched first, which by their tracks join it to those farther away.
MOST_PARTNERS, NEAREST = 24, 12


# Where images look, as far as it is known before they are oriented: middles of the footprints (n, 2), m, NaN
# when unknown; radii (n,) of circles of their areas, m, NaN when the height above ground is unknown.
Footprints = tuple[Floats, Floats]


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
    yaw = np.nan_to_num(yaw_pitch[:, 0])
    pitch = np.where(np.isnan(yaw_pitch[:, 1]), -np.pi / 2, yaw_pitch[:, 1])
    # Views to the horizon see everything; what is useful of them ends at 60 degrees from the vertical.
    tilt = np.clip(np.pi / 2 + pitch, 0.0, np.radians(60))
    ahead = height_m * np.tan(tilt)
    centre = places + ahead[:, None] * np.column_stack([np.sin(yaw), np.cos(yaw)])
    radius = height_m / np.cos(tilt) * np.sqrt(size_px.prod(axis=1) / np.pi) / c_px
    return np.where(np.isfinite(centre), centre, places), radius


def stated_footprints(facts: Sequence[ImageFacts]) -> Footprints:
    """Footprints of images as they say where they are, how high and which way they look."""
    places, _ = local_places(facts)
    return footprints(
        places[:, :2],
        np.array([f.relative_altitude_m for f in facts]),
        np.radians([[f.gimbal_deg[2], f.gimbal_deg[1]] for f in facts]),
        np.array([f.size_px for f in facts], dtype=float),
        np.array([stated_camera("", f).camera.value("c") for f in facts]),
    )


def exposed_footprints(
    exposures: Orientation, control: ObjectPoints, facts: Sequence[ImageFacts]
) -> Footprints:
    """Footprints by the exposures, on the level of the control points."""
    frame = exposures.to_local(control.values)
    ground = float(np.mean(frame.to_local(control.values)[:, 2]))
    views = exposures.images.in_local(frame).named([f.name for f in facts])
    looks = -views.rotation[:, 2]
    c = np.array([camera.value("c") / camera.pitch[0] for camera in views.cameras])
    return footprints(
        views.station[:, :2],
        views.station[:, 2] - ground,
        np.column_stack([np.arctan2(looks[:, 0], looks[:, 1]), np.arcsin(looks[:, 2])]),
        np.array([f.size_px for f in facts], dtype=float),
        # Where an image is not oriented its camera does not matter.
        c[np.maximum(views.camera, 0)],
    )


def select_pairs(seen: Footprints, count: int) -> tuple[Integers, Rule]:
    """Choose the pairs of images to match.

    Few images of which nobody knows where they were taken go with all; many, with those before and after.
    """
    placed = np.isfinite(seen[0]).all(axis=1)
    lost = np.flatnonzero(~placed)
    if len(lost) and count <= ALL_UP_TO:
        return np.column_stack(np.triu_indices(count, 1)).astype(np.int64), "all"
    span = count if len(lost) <= ALL_UP_TO else SEQUENCE
    near = np.arange(-span, span + 1)
    first = np.repeat(lost, len(near))
    second = first + np.tile(near, len(lost))
    good = (second >= 0) & (second < count) & (second != first)
    pairs = [np.column_stack([first, second])[good]]
    rule: Rule = "sequence"
    if placed.sum() >= 2:
        some, rule = _near(seen, np.flatnonzero(placed))
        pairs.append(some)
    return np.unique(np.sort(np.concatenate(pairs), axis=1), axis=0).astype(np.int64), rule


def _near(seen: Footprints, rows: Integers) -> tuple[Integers, Rule]:
    """Pairs of neighbours, of those whose footprints overlap where these are known."""
    from scipy.spatial import KDTree

    partners = min(len(rows), MOST_PARTNERS + 1)
    centre, radius = (part[rows] for part in seen)
    nearest = KDTree(centre).query(centre, k=partners)
    distance, other = (np.reshape(part, (len(rows), -1)) for part in nearest)
    first = np.broadcast_to(np.arange(len(rows))[:, None], other.shape)
    near = first != other
    # Where a height is not known the nearest go together, however far.
    known = np.isfinite(radius[first] + radius[other])
    with np.errstate(invalid="ignore"):
        # Footprints that overlap by less than about a fifth are of no use.
        useful = 0.8
        near &= ~known | (distance < useful * (radius[first] + radius[other]))
    pairs = np.column_stack([rows[first[near]], rows[other[near]]])
    return pairs, "footprints" if known.all() else "neighbours"


def among_nearest(places: Floats, pairs: Integers, count: int) -> Flags:
    """Tell which pairs have an image among the nearest of the other; all where places are not known.

    Images of one place, as the heads of a rig take them, go together and are not counted.

    places (images, 2 or 3).
    pairs (n, 2).
    count: how many of those that an image is paired with are its nearest.
    returns (n,).
    """
    apart = np.linalg.norm(places[pairs[:, 0]] - places[pairs[:, 1]], axis=1)
    counted = apart > 0.0
    distance, image = np.tile(apart[counted], 2), pairs[counted].T.ravel()
    order = np.lexsort((distance, image))
    begin = np.searchsorted(image[order], image[order])
    near = np.zeros(len(image), dtype=np.bool_)
    near[order] = np.arange(len(image)) - begin < count
    among: Flags = ~counted
    among[counted] = near.reshape(2, -1).any(axis=0)
    return among
