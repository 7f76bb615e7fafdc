"""Exterior orientation as the positioning system gave it, against the adjusted one: table 3 of the form."""

from __future__ import annotations

import numpy as np

from photocal.block.model import Block
from photocal.block.network import block_frame
from photocal.geometry.oriented_images import local_poses
from photocal.geometry.rotation import angles_from_matrix
from photocal.georeferencing.direct import direct_orientation
from photocal.georeferencing.local import in_local_frame
from photocal.report.stored_analysis import ExteriorDifference
from photocal.results.result import Result


def exterior_difference(block: Block, result: Result) -> ExteriorDifference | None:
    """Compare the orientations that the positioning system gave with the adjusted ones."""
    original = direct_orientation(in_local_frame(block))
    if not original.known.any():
        return None
    adjusted = result.images.values
    if block.frame != "local":
        adjusted = local_poses(block_frame(block), adjusted)
    given = np.hstack([angles_from_matrix(original.rotation), original.centre])
    d = (given - adjusted)[original.known]
    d[:, :3] = np.degrees((d[:, :3] + np.pi) % (2 * np.pi) - np.pi) * 3600.0
    mean, rmse = d.mean(axis=0), np.sqrt(np.mean(d**2, axis=0))
    x, y, z, *turn = mean[[3, 4, 5, 0, 1, 2]].tolist()
    rx, ry, rz, *turns = rmse[[3, 4, 5, 0, 1, 2]].tolist()
    return ExteriorDifference(len(d), (x, y, z), (rx, ry, rz), _triple(turn), _triple(turns))


def _triple(values: list[float]) -> tuple[float, float, float]:
    first, second, third = values
    return first, second, third
