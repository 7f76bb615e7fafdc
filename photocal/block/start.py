"""Start values that a block does not give: exterior orientations and coordinates of tie points."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from drivers.arrays import Flags, Floats
from drivers.errors import IllPosedError
from photocal.adjustment.intersection import intersect
from photocal.adjustment.network import Exposures, Rays, Relations
from photocal.block.model import Block
from photocal.geometry.camera import Camera
from photocal.geometry.distortion import undistorted
from photocal.geometry.resection import ray_residuals
from photocal.geometry.rotation import matrix_from_angles

# Start coordinates are impossible where a ray misses them by this many principal distances, and by this many
# times what rays usually miss: attitudes of a flight may be degrees off, those of all images alike.
_ASTRAY, _UNLIKE = 0.25, 8.0


def with_start_values(
    block: Block,
    exposures: Exposures,
    rays: Rays,
    points: Floats,
    known: Floats,
    relations: Relations,
    surveyed: Flags,
) -> tuple[Exposures, Floats]:
    """Fill what is missing among the start values."""
    values = exposures.values
    if np.isnan(values).any():
        # The search needs computer vision: blocks that are complete do not wait for it.
        from photocal.adjustment.start.values import start_values

        # Coordinates of check and tie points may be wrong without anybody having noticed, and so may those
        # of control points that have no sigma: these serve only where nothing else does.
        directions = np.trace(known, axis1=1, axis2=2)
        for surveyed in (directions > 2.5, directions > 0.5):
            trusted = points if block.datum == "free" else np.where(surveyed[:, None], points, np.nan)
            found = start_values(
                block.cameras, exposures.camera, values, trusted, rays, relations, free=block.datum == "free"
            )
            if not len(found.lost):
                break
        if len(found.lost):
            some = ", ".join(block.images.names[i] for i in found.lost[:5])
            raise IllPosedError(
                f"no start values for {len(found.lost)} image(s) ({some}): too few points connect them",
                where="images.csv",
                remedy="give X, Y, Z, omega, phi, kappa roughly, or measure more common points",
            )
        exposures = replace(exposures, values=found.exposures)
        points = np.where(np.isnan(points), found.points, points)
        # The directions in which a control point is free start where its rays meet.
        partly = (directions > 0.5) & (directions < 2.5) & np.isfinite(found.points).all(axis=1)
        open_ones = np.eye(3) - known[partly]
        away = (found.points - points)[partly]
        points[partly] += np.einsum("nab,nb->na", open_ones, away)
    return exposures, _intersected(block.cameras, exposures, rays, points, known, surveyed)


def _intersected(
    cameras: tuple[Camera, ...],
    exposures: Exposures,
    rays: Rays,
    points: Floats,
    known: Floats,
    surveyed: Flags,
) -> Floats:
    """Fill the coordinates of points that have none, or impossible ones, by intersecting their rays.

    Tie points that a camera sees behind itself are such: other programs leave them there.
    """
    missing = np.asarray(np.isnan(points).any(axis=1))
    behind = behind_cameras(exposures, rays, points) & ~surveyed & ~missing
    some = (missing | surveyed | behind)[rays.point]
    if not some.any():
        return points
    rays = Rays(*(column[some] for column in vars(rays).values()))
    camera = exposures.camera[rays.image]
    slopes = np.empty((len(camera), 2))
    for k, own in enumerate(cameras):
        mine = camera == k
        slopes[mine] = undistorted(own, rays.plane[mine]) / own.value("c")
    rotation = matrix_from_angles(exposures.values[:, :3])[rays.image]
    centre = exposures.values[rays.image, 3:]
    start = intersect(rays.point, len(points), centre, rotation, slopes, np.ones(len(slopes)))
    miss = ray_residuals(rotation, centre, points[rays.point], slopes)
    # Nobody has used the coordinates of a check point before: a slip of the pen stands there unnoticed.
    of_surveyed = miss[(surveyed & ~missing)[rays.point]]
    usual = float(np.median(of_surveyed)) if len(of_surveyed) else 0.0
    least = np.full(len(points), np.inf)
    np.fmin.at(least, rays.point, miss)
    unused = surveyed & ~missing & ~known.any(axis=(1, 2))
    impossible = behind | (unused & (least > max(_ASTRAY, _UNLIKE * usual)))
    points = np.where((impossible & np.isfinite(start).all(axis=1))[:, None], start, points)
    lost = np.flatnonzero(missing & np.isnan(start).any(axis=1))
    if len(lost):
        raise IllPosedError(
            f"the rays of {len(lost)} point(s) without coordinates are parallel",
            where="points.csv",
            remedy="give these points start coordinates, or rays from different places",
        )
    return np.where(missing[:, None], start, points)


def behind_cameras(exposures: Exposures, rays: Rays, points: Floats) -> Flags:
    """Points that lie behind a camera that sees them, (points,)."""
    axis = matrix_from_angles(exposures.values[:, :3])[rays.image, 2]
    away = points[rays.point] - exposures.values[rays.image, 3:]
    behind = np.einsum("ni,ni->n", axis, away) >= 0.0
    return np.bincount(rays.point[behind], minlength=len(points)) > 0
