"""Export to other programs: a block, and what a format needs besides."""

from collections.abc import Callable
from dataclasses import dataclass, field, replace
from typing import Literal

import numpy as np

from photocal.base.arrays import Floats
from photocal.base.errors import ConfigurationError
from photocal.base.geodesy import GeodeticPlace
from photocal.block.model import Block
from photocal.geometry.frames import parsed, reference_frame, require_geoid
from photocal.geometry.oriented_images import local_poses

Angle = Literal["deg", "gon"]


@dataclass(frozen=True)
class Choices:
    """What some formats need besides.

    origin: where a local frame touches the ellipsoid.
    changed_utc: time that a file may note as that of its making.
    residuals_px (rays, 2): of the block's observations, computed minus measured; empty where they are not
        known.
    """

    angle_unit: Angle | None = None
    origin: GeodeticPlace | None = None
    changed_utc: str = "1970-01-01T00:00:00.000Z"
    residuals_px: Floats = field(default_factory=lambda: np.empty((0, 2)))

    def residuals_of(self, given: Block) -> Floats:
        """Residuals of a block's observations, px; NaN where they are not known."""
        like = given.observations.values
        return self.residuals_px if len(self.residuals_px) == len(like) else np.full(like.shape, np.nan)


def to_cartesian(given: Block) -> Block:
    """Take a block to the topocentric frame at its middle; a local frame stays as it is."""
    if given.frame == "local":
        return given
    require_geoid(given.frame, given.height)
    frame = reference_frame(given.frame, given.height, middle(given))
    return replace(
        given,
        frame="local",
        height="",
        images=replace(given.images, values=local_poses(frame, given.images.values)),
        points=replace(given.points, values=frame.to_local(given.points.values)),
    )


def middle(given: Block) -> Floats:
    """Where the topocentric frame of a block has its origin, in the block's coordinates, shape (3,)."""
    return np.asarray(np.nanmean(np.vstack([given.images.values[:, 3:], given.points.values]), axis=0))


def to_wgs84(given: Block) -> Callable[[Floats], Floats]:
    """Make the way from the topocentric frame of `to_cartesian` to WGS 84."""
    from pyproj import Transformer
    from pyproj.exceptions import ProjError

    def turn(xyz: Floats) -> Floats:
        """Return coordinates (n, 3) of the other system."""
        x, y, z = frame.to_given(xyz).T
        return np.column_stack(transformer.transform(x, y, z, errcheck=True)).reshape(-1, 3)

    require_geoid(given.frame, given.height)
    frame = reference_frame(given.frame, given.height, middle(given))
    system = parsed(frame.crs)
    try:
        source = system if len(system.axis_info) == 3 else system.to_3d()
        transformer = Transformer.from_crs(
            source, "EPSG:4979", always_xy=True, allow_ballpark=False, only_best=True
        )
        turn(np.zeros((1, 3)))
    except ProjError as failure:
        raise ConfigurationError(
            f"no transformation is known from {given.frame} to WGS 84 ({failure})",
            "install the grids of PROJ, or export a format that keeps the block's own coordinates",
        ) from failure
    return turn


def file_name(name: str) -> str:
    """A name that stays inside the folder: letters, digits and a few signs."""
    kept = "".join(letter if letter.isalnum() or letter in "-_. " else "_" for letter in name)
    return kept.strip(". ") or "camera"
