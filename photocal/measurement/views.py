"""Oriented images: where object points appear in them."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from photocal.adjustment.intersection import intersect
from photocal.block.model import Block
from photocal.geometry.camera import Camera, pixel_to_plane, plane_to_pixel
from photocal.geometry.distortion import projected, undistorted
from photocal.geometry.frames import Frame, nearest_rotation
from photocal.geometry.rotation import angles_from_matrix, matrix_from_angles
from photocal.measurement.tracks import Tracks

Floats = NDArray[np.float64]
Integers = NDArray[np.int64]


@dataclass(frozen=True)
class Views:
    """Cameras and exterior orientations in a local Cartesian frame.

    Attributes
    ----------
    camera : ndarray of int, shape (m,)
        Index into the cameras.
    rotation : ndarray, shape (m, 3, 3)
        From object to camera axes.
    station : ndarray, shape (m, 3)
        Projection centres, m.
    """

    cameras: tuple[Camera, ...]
    camera: Integers
    rotation: Floats
    station: Floats

    def project(self, image: Integers, xyz: Floats) -> Floats:
        """Columns and rows (px, shape (n, 2)) where images show points; NaN for those behind a camera.

        Parameters
        ----------
        image : ndarray of int, shape (n,)
        xyz : ndarray, shape (n, 3)
        """
        q = np.einsum("nij,nj->ni", self.rotation[image], xyz - self.station[image])
        pixels = np.full((len(image), 2), np.nan)
        for k, own in enumerate(self.cameras):
            mine = np.flatnonzero(self.camera[image] == k)
            if len(mine):
                plane = projected(own, q[mine])
                pixels[mine] = plane_to_pixel(own.size_px, own.pitch, plane)
        return pixels

    def ideal(self, image: Integers, pixels: Floats) -> tuple[Floats, Floats]:
        """Undistorted image coordinates from the principal point, shape (n, 2), and their c, shape (n,).

        Parameters
        ----------
        image : ndarray of int, shape (n,)
        pixels : ndarray, shape (n, 2)
        """
        plane, c = np.empty((len(image), 2)), np.empty(len(image))
        for k, own in enumerate(self.cameras):
            mine = np.flatnonzero(self.camera[image] == k)
            if len(mine):
                plane[mine] = undistorted(own, pixel_to_plane(own.size_px, own.pitch, pixels[mine]))
                c[mine] = own.value("c")
        return plane, c

    def sizes(self) -> Floats:
        """Width and height of each image, px, shape (m, 2)."""
        return np.array([own.size_px for own in self.cameras], dtype=float)[self.camera]


def intersected(views: Views, tracks: Tracks) -> Floats:
    """Points where the rays of tracks come closest, local, shape (tracks.count, 3); NaN where they do not."""
    ideal, c = views.ideal(tracks.image, tracks.pixels)
    return intersect(
        tracks.track, tracks.count, views.station[tracks.image], views.rotation[tracks.image], ideal, c
    )


def misses(views: Views, tracks: Tracks, points: Floats) -> Floats:
    """Distance of each ray from where its image should show its point, px; NaN where it cannot."""
    return np.asarray(
        np.hypot(*(views.project(tracks.image, points[tracks.track]) - tracks.pixels).T), dtype=np.float64
    )


def spread(views: Views, tracks: Tracks, points: Floats) -> Floats:
    """Largest angle of a point's rays from their mean, rad, shape (tracks.count,).

    Parameters
    ----------
    points : ndarray, shape (tracks.count, 3)

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


def views_of(block: Block, frame: Frame) -> Views:
    """Make the views of a block's images at their present values; NaN where they are not oriented."""
    poses = local_poses(frame, block.images.values)
    return Views(block.cameras, block.images.camera, matrix_from_angles(poses[:, :3]), poses[:, 3:])


def local_poses(frame: Frame, given: Floats) -> Floats:
    """Exterior orientations in local coordinates; given angles refer to the given axes at each image."""
    place = frame.to_local(given[:, 3:])
    return np.hstack([_turned(frame, given[:, :3], given[:, 3:], back=False), place])


def given_poses(frame: Frame, local: Floats) -> Floats:
    """Exterior orientations in the given coordinates: the way back from `local_poses`."""
    place = given_places(frame, local[:, 3:])
    return np.hstack([_turned(frame, local[:, :3], place, back=True), place])


def given_places(frame: Frame, local: Floats) -> Floats:
    """Points in the given coordinates, shape (n, 3); NaN where unknown."""
    known = np.isfinite(local).all(axis=1)
    given = np.full(local.shape, np.nan)
    if known.any():
        given[known] = frame.to_given(local[known])
    return given


def _turned(frame: Frame, angles: Floats, places: Floats, *, back: bool) -> Floats:
    known = np.isfinite(angles).all(axis=1) & np.isfinite(places).all(axis=1)
    result = np.full(angles.shape, np.nan)
    if not known.any():
        return result
    turn = nearest_rotation(frame.derivative(places[known]))
    turn = turn if back else np.swapaxes(turn, 1, 2)
    result[known] = angles_from_matrix(matrix_from_angles(angles[known]) @ turn)
    return result
