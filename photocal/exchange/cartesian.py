"""From a reference system to a Cartesian frame: what programs need that know nothing of map projections.

A block in a coordinate reference system has map coordinates, and angles that refer to the map's axes at
each image; straight rays are bent there. Most formats of other programs hold Cartesian coordinates, so such
a block is taken to the topocentric frame (east, north, up) at its middle. That is the very geometry that
was adjusted: reprojection residuals stay what they are.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from drivers.arrays import Floats
from drivers.errors import ConfigurationError
from photocal.exchange.reconstruction import Reconstruction
from photocal.geometry.frames import ReferenceFrame, nearest_rotation, parsed, reference_frame
from photocal.geometry.rotation import angles_from_matrix, matrix_from_angles


def to_cartesian(given: Reconstruction) -> Reconstruction:
    """Take a block to the topocentric frame at its middle; a local frame stays as it is."""
    if given.frame == "local":
        return given
    frame = reference_frame(given.frame, given.height, middle(given))
    return replace(
        given, frame="local", height="", poses=_turned(given.poses, frame), xyz=frame.to_local(given.xyz)
    )


def middle(given: Reconstruction) -> Floats:
    """Where the topocentric frame of a block has its origin, in the block's coordinates, shape (3,)."""
    return np.asarray(np.nanmean(np.vstack([given.poses[:, 3:], given.xyz]), axis=0))


def to_wgs84(given: Reconstruction) -> Callable[[Floats], Floats]:
    """Make the way from the topocentric frame of `to_cartesian` to WGS 84."""
    from pyproj import Transformer
    from pyproj.exceptions import ProjError

    def turn(xyz: Floats) -> Floats:
        x, y, z = frame.to_given(xyz).T
        return np.column_stack(transformer.transform(x, y, z, errcheck=True)).reshape(-1, 3)

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
            f"no way leads from {given.frame} to WGS 84 ({failure})",
            remedy="install the grids of PROJ, or export a format that keeps the block's own coordinates",
        ) from failure
    return turn


def _turned(poses: Floats, frame: ReferenceFrame) -> Floats:
    if not len(poses):
        return poses
    turn = nearest_rotation(frame.derivative(poses[:, 3:]))
    matrix = matrix_from_angles(poses[:, :3]) @ np.swapaxes(turn, 1, 2)
    return np.hstack([angles_from_matrix(matrix), frame.to_local(poses[:, 3:])])
