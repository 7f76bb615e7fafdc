"""Tie points added to a block, and placed by its oriented images."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from drivers.arrays import Flags, Floats
from photocal.block.model import ROLES, Block, ObjectPoints
from photocal.block.network import block_frame, observed_plane
from photocal.geometry.distortion import undistorted
from photocal.geometry.oriented_images import given_places
from photocal.geometry.resection import ray_residuals
from photocal.measurement.tracks import Tracks
from photocal.measurement.views import intersected, spread, views_of

TIE = ROLES.index("tie")
# At the start, when the camera is not calibrated, a ray is wrong when its residual exceeds so many medians.
START_GROSS = 8.0
# Points whose rays deviate less from their mean lie too far away to be determined, rad.
LEAST_SPREAD = 0.005


def with_ties(block: Block, tracks: Tracks, values: Floats, sigma: Floats) -> Block:
    """Add tie points behind the points that a block has."""
    known, seen = block.points, block.observations
    count = tracks.count
    return replace(
        block,
        points=ObjectPoints(
            (*known.names, *(f"t{j + 1}" for j in range(count))),
            np.vstack([known.values, values]),
            np.vstack([known.sigma, np.full((count, 3), np.inf)]),
            np.concatenate([known.role, np.full(count, TIE)]),
            None if known.cross is None else np.vstack([known.cross, np.zeros((count, 3))]),
        ),
        observations=replace(
            seen,
            image=np.concatenate([seen.image, tracks.image]),
            point=np.concatenate([seen.point, tracks.track + len(known.names)]),
            values=np.vstack([seen.values, tracks.pixels]),
            sigma=np.vstack([seen.sigma, np.column_stack([sigma, sigma])]),
        ),
    )


def place(block: Block, tracks: Tracks, least_spread: float = LEAST_SPREAD) -> Floats:
    """Intersect the rays of tracks in the oriented images of a block.

    least_spread: of a point's rays from their mean, rad.

    Returns
    -------
    ndarray, shape (tracks.count, 3)
        In the block's frame; NaN where the rays do not meet, or are almost parallel.
    """
    frame = block_frame(block)
    views = views_of(block, frame)
    points = intersected(views, tracks)
    with np.errstate(invalid="ignore"):
        points[~(spread(views, tracks, points) >= least_spread)] = np.nan
    return given_places(frame, points)


def fitting(block: Block) -> Flags:
    """Rays that fit the start values: a gross error would keep least squares from converging."""
    seen = block.observations
    plane, _ = observed_plane(block)
    frame = block_frame(block)
    camera = block.images.camera[seen.image]
    c = np.array([own.value("c") for own in block.cameras])[camera]
    for k, own in enumerate(block.cameras):
        plane[camera == k] = undistorted(own, plane[camera == k])
    views = views_of(block, frame)
    rotation, station = views.rotation[seen.image], views.station[seen.image]
    points = frame.to_local(block.points.values)[seen.point]
    miss = ray_residuals(rotation, station, points, plane / c[:, None]) * c
    tie = block.points.role[seen.point] == TIE
    typical = np.nanmedian(np.where(np.isfinite(miss) & tie, miss, np.nan))
    with np.errstate(invalid="ignore"):
        return np.asarray(miss <= START_GROSS * typical)
