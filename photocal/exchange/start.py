"""Start values of exterior orientations by resection from points with coordinates."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from photocal.adjustment.intersection import intersect
from photocal.block.model import Block
from photocal.block.network import observed_plane
from photocal.geometry.distortion import undistorted
from photocal.geometry.rotation import angles_from_matrix, matrix_from_angles

Floats = NDArray[np.float64]

# A pose from fewer points is not unique.
FEWEST = 4


def with_resections(block: Block) -> Block:
    """Give images without exterior orientation one by resection, as far as control reaches.

    Images that see enough known points are resected (SQPnP: Terzakis and Lourakis 2020, then
    Levenberg-Marquardt); tie points that two oriented images see are intersected; and again, until
    nothing is added. What cannot be reached stays NaN.

    Parameters
    ----------
    block : Block

    Returns
    -------
    Block
        With start values in its images and tie points.
    """
    poses = block.images.values.copy()
    missing: NDArray[np.bool_] = np.asarray(np.isnan(poses).any(axis=1))
    if not missing.any():
        return block
    plane, _ = observed_plane(block)
    image, point = block.observations.image, block.observations.point
    camera = block.images.camera[image]
    rays = np.empty((len(image), 2))
    distance = np.array([own.value("c") for own in block.cameras])[camera]
    for k, own in enumerate(block.cameras):
        rays[camera == k] = undistorted(own, plane[camera == k])
    check = block.points.of_role("check")
    known = np.where(check[:, None], np.nan, block.points.values)
    while True:
        added = False
        for j in np.flatnonzero(missing):
            use = (image == j) & np.isfinite(known[point]).all(axis=1)
            pose = resection(known[point[use]], rays[use] / distance[use][:, None]) if use.any() else None
            if pose is not None:
                poses[j], missing[j], added = pose, False, True
        if not added or not missing.any():
            break
        oriented = ~missing[image]
        found = intersect(
            point[oriented],
            len(known),
            poses[image[oriented], 3:],
            matrix_from_angles(poses[image[oriented], :3]),
            rays[oriented],
            distance[oriented],
        )
        twice = np.bincount(point[oriented], minlength=len(known)) >= 2
        new = np.isnan(known).any(axis=1) & twice & np.isfinite(found).all(axis=1)
        known[new] = found[new]
    return replace(block, images=replace(block.images, values=poses))


def resection(xyz: Floats, rays: Floats) -> Floats | None:
    """Exterior orientation of one image from known points.

    Parameters
    ----------
    xyz : ndarray, shape (n, 3)
        Points, m.
    rays : ndarray, shape (n, 2)
        Undistorted image coordinates over the principal distance, x right, y up.

    Returns
    -------
    ndarray, shape (6,), or None
        omega, phi, kappa in radians, X, Y, Z in m; None when the points do not give a pose.
    """
    if len(xyz) < FEWEST:
        return None
    import cv2

    middle = xyz.mean(axis=0)
    size = float(np.abs(xyz - middle).max())
    if size == 0:
        return None
    world = (xyz - middle) / size
    # OpenCV looks along +z with y down.
    flipped = np.ascontiguousarray(rays * [1.0, -1.0])
    try:
        _, turns, shifts, errors = cv2.solvePnPGeneric(
            world, flipped, np.eye(3), None, flags=cv2.SOLVEPNP_SQPNP
        )
    except cv2.error:
        return None
    if not turns:
        return None
    best = int(np.argmin(np.ravel(errors)))
    turn, shift = cv2.solvePnPRefineLM(world, flipped, np.eye(3), None, turns[best], shifts[best])
    matrix = np.asarray(cv2.Rodrigues(turn)[0], dtype=float)
    if not (np.isfinite(matrix).all() and np.isfinite(shift).all()):
        return None
    place = -matrix.T @ np.ravel(shift) * size + middle
    return np.concatenate([angles_from_matrix(np.diag([1.0, -1.0, -1.0]) @ matrix), place])
