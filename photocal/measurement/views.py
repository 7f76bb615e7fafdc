"""Tracks in oriented images: where their rays meet, and by how much they miss."""

from __future__ import annotations

import numpy as np

from drivers.arrays import Floats
from photocal.adjustment.intersection import intersect
from photocal.block.model import Block
from photocal.geometry.frames import Frame
from photocal.geometry.oriented_images import OrientedImages, local_poses
from photocal.measurement.tracks import Tracks


def intersected(views: OrientedImages, tracks: Tracks) -> Floats:
    """Points where the rays of tracks come closest, local, shape (tracks.count, 3); NaN where they do not."""
    ideal, c = views.ideal(tracks.image, tracks.pixels)
    return intersect(
        tracks.track, tracks.count, views.station[tracks.image], views.rotation[tracks.image], ideal, c
    )


def misses(views: OrientedImages, tracks: Tracks, points: Floats) -> Floats:
    """Distance of each ray from where its image should show its point, px; NaN where it cannot."""
    return np.asarray(
        np.hypot(*(views.project(tracks.image, points[tracks.track]) - tracks.pixels).T), dtype=np.float64
    )


def spread(views: OrientedImages, tracks: Tracks, points: Floats) -> Floats:
    """Largest angle of a point's rays from their mean, rad, shape (tracks.count,).

    points (tracks.count, 3).

    Returns
    -------
    ndarray
        NaN for points without coordinates.
    """
    towards = views.station[tracks.image] - points[tracks.track]
    towards = towards / np.linalg.norm(towards, axis=1)[:, None]
    mean = np.column_stack([np.bincount(tracks.track, towards[:, k], tracks.count) for k in range(3)])
    mean = mean / np.linalg.norm(mean, axis=1)[:, None]
    # The chord keeps small angles exact.
    chord = np.linalg.norm(towards - mean[tracks.track], axis=1)
    angle = np.zeros(tracks.count)
    np.maximum.at(angle, tracks.track, 2 * np.arcsin(np.minimum(chord / 2, 1)))
    return angle


def views_of(block: Block, frame: Frame) -> OrientedImages:
    """Give a block's images at their present values in a local frame; NaN where they are not oriented."""
    images = block.images
    return OrientedImages(images.names, block.cameras, images.camera, local_poses(frame, images.values))
