"""Space intersection with uncertain exterior orientation: each point alone, by generalised least squares."""

from dataclasses import dataclass, replace

import numpy as np
from scipy.linalg import block_diag

from photocal.adjustment.readout import READOUT
from photocal.base.arrays import Floats, Integers
from photocal.block.model import Block
from photocal.block.network import observed_plane
from photocal.geometry.camera import PARAMETERS
from photocal.geometry.distortion import undistorted
from photocal.geometry.resection import intersect
from photocal.geometry.rotation import skew
from photocal.georeferencing.direct import DirectOrientation, MovedRays, moved_rays


@dataclass(frozen=True)
class Intersected:
    """Points intersected from given exterior orientations.

    covariance (n, 3, 3): from the image observations, the orientations, the mounting and the interior
        orientation.
    rays (r,): rows of the block's observations that took part.
    residuals, standardised (r, 2): computed minus measured, in the image plane without distortion, px; over
        its standard deviation.
    """

    points: Integers
    xyz: Floats
    covariance: Floats
    rays: Integers
    residuals: Floats
    standardised: Floats
    chi_squared: float
    degrees_of_freedom: int


@dataclass(frozen=True)
class _Rays:
    """Corrected image coordinates p = -c (u, v)/w and how they depend on measurement and camera."""

    ideal: Floats
    covariance: Floats
    by_camera: Floats
    camera: Integers
    distance: Floats


def intersect_points(
    block: Block, orientation: DirectOrientation, wanted: Integers, joint: Floats | None = None
) -> Intersected:
    """Intersect points from all images that have an orientation."""
    if joint is None:
        # What the block states of the interior orientation; 0 where it states nothing.
        stated = (
            np.where(np.isfinite(camera.prior_sigma) & camera.estimated, camera.prior_sigma, 0.0)
            for camera in block.cameras
        )
        joint = block_diag(orientation.common_covariance, *(np.diag(sigma**2) for sigma in stated))
    usable = orientation.known[block.observations.image]
    chosen = np.flatnonzero(usable & np.isin(block.observations.point, wanted))
    observations = block.observations.rows(chosen)
    block = replace(block, observations=observations)
    corrected = _corrected(block, np.diag(joint)[len(orientation.common_covariance) :])
    moved = moved_rays(block, orientation)
    start = intersect(
        observations.point,
        len(block.points.names),
        moved.centre,
        moved.rotation,
        corrected.ideal,
        corrected.distance,
    )
    intersected = []
    for point in wanted:
        rays = np.flatnonzero(observations.point == point)
        if len(rays) < 2 or not np.isfinite(start[point]).all():
            continue
        solved = _one_point(block, orientation, corrected, moved, rays, start[point], joint)
        if solved is not None:
            intersected.append((int(point), rays, *solved))
    rays = np.concatenate([f[1] for f in intersected]) if intersected else np.zeros(0, dtype=np.int64)
    pitch = np.array([camera.pitch for camera in block.cameras])
    scale = pitch[block.images.camera[observations.image[rays]]]
    stack = np.concatenate
    return Intersected(
        np.array([f[0] for f in intersected], dtype=np.int64),
        np.array([f[2] for f in intersected]).reshape(-1, 3),
        np.array([f[3] for f in intersected]).reshape(-1, 3, 3),
        chosen[rays],
        stack([f[4] for f in intersected]) / scale if intersected else np.zeros((0, 2)),
        stack([f[5] for f in intersected]) if intersected else np.zeros((0, 2)),
        float(sum(f[6] for f in intersected)),
        2 * len(rays) - 3 * len(intersected),
    )


def _one_point(
    block: Block,
    orientation: DirectOrientation,
    corrected: _Rays,
    moved: MovedRays,
    rays: Integers,
    start: Floats,
    joint: Floats,
) -> tuple[Floats, Floats, Floats, Floats, float] | None:
    """Coordinates, covariance, residuals, also standardised, and their sum; None where there is no place."""
    rotation, centre = moved.rotation[rays], moved.centre[rays]
    c, ideal = corrected.distance[rays], corrected.ideal[rays]
    xyz = start
    iterations = 20
    enough_m = 1e-7
    for _ in range(iterations):
        q = np.einsum("nij,nj->ni", rotation, xyz - centre)
        by_q = _by_camera_axes(q, c)
        by_point = (by_q @ rotation).reshape(-1, 3)
        miss = (-c[:, None] * q[:, :2] / q[:, 2:] - ideal).ravel()
        try:
            weight = np.linalg.inv(_misclosure(block, orientation, corrected, moved, rays, q, by_q, joint))
            covariance = np.linalg.inv(by_point.T @ weight @ by_point)
        except np.linalg.LinAlgError:
            return None
        step = -covariance @ (by_point.T @ (weight @ miss))
        xyz = xyz + step
        if np.abs(step).max() < enough_m:
            break
    else:
        return None
    q = np.einsum("nij,nj->ni", rotation, xyz - centre)
    miss = (-c[:, None] * q[:, :2] / q[:, 2:] - ideal).ravel()
    variance = np.diag(np.linalg.inv(weight) - by_point @ covariance @ by_point.T)
    deviation = np.where(variance > 0, np.sqrt(np.maximum(variance, 1e-300)), np.nan)
    standardised = (miss / deviation).reshape(-1, 2)
    return xyz, np.asarray(covariance), miss.reshape(-1, 2), standardised, float(miss @ weight @ miss)


def _by_camera_axes(q: Floats, c: Floats) -> Floats:
    """Derivative of p = -c (u, v)/w with respect to (u, v, w), shape (n, 2, 3)."""
    u, v, w = q.T
    zero = np.zeros_like(u)
    rows = [[-c / w, zero, c * u / w**2], [zero, -c / w, c * v / w**2]]
    return np.moveaxis(np.array(rows), (0, 1), (-2, -1))


def _misclosure(
    block: Block,
    orientation: DirectOrientation,
    corrected: _Rays,
    moved: MovedRays,
    rays: Integers,
    q: Floats,
    by_q: Floats,
    joint: Floats,
) -> Floats:
    """Covariance of computed minus corrected coordinates of one point's rays, shape (2n, 2n)."""
    n, image = len(rays), block.observations.image[rays]
    # exp([t]x) q = q - [q]x t
    turn = -skew(q)
    by_pose = np.concatenate([by_q @ turn, -by_q @ moved.rotation[rays]], axis=2)
    by_readout = np.einsum("nab,nb->na", by_pose, moved.by_readout[rays])
    result = np.zeros((2 * n, 2 * n))
    of_pairs = result.reshape(n, 2, n, 2)
    # Rays of one image share its errors.
    k, other = np.nonzero(image[:, None] == image)
    late = moved.late[rays[k]] * moved.late[rays[other]]
    gusts = np.eye(6) * (late[:, None] * moved.spread[image[k]] ** 2)[:, None]
    part = by_pose[k] @ (orientation.covariance[image[k]] + gusts) @ np.swapaxes(by_pose[other], 1, 2)
    of_pairs[k, :, other] += part
    of_pairs[range(n), :, range(n)] += corrected.covariance[rays]
    shared = [(by_pose @ orientation.by_common[image]).reshape(2 * n, -1)]
    for index in range(len(block.cameras)):
        of_camera = corrected.camera[rays] == index
        by_camera = -corrected.by_camera[rays] * of_camera[:, None, None]
        by_camera[:, :, 0] += np.where(of_camera[:, None], -q[:, :2] / q[:, 2:], 0.0)
        by_camera[:, :, READOUT] += np.where(of_camera[:, None], by_readout, 0.0)
        shared.append(by_camera.reshape(2 * n, -1))
    by_shared = np.hstack(shared)
    return np.asarray(result + by_shared @ joint @ by_shared.T)


def _corrected(block: Block, variance: Floats) -> _Rays:
    """Correct the observations; `variance` of all camera parameters tells which derivatives are needed."""
    plane, sigma = observed_plane(block)
    camera = block.images.camera[block.observations.image]
    ideal, by_plane = np.empty(plane.shape), np.empty((len(plane), 2, 2))
    by_camera = np.zeros((len(plane), 2, len(PARAMETERS)))
    distance = np.empty(len(plane))
    for index, interior in enumerate(block.cameras):
        of_camera = camera == index
        at = plane[of_camera]
        ideal[of_camera], distance[of_camera] = undistorted(interior, at), interior.value("c")
        small = 0.1 * interior.pitch[0]
        for k in range(2):
            step = small * np.eye(2)[k]
            change = undistorted(interior, at + step) - undistorted(interior, at - step)
            by_plane[of_camera, :, k] = change / (2 * small)
        sigma_own = np.sqrt(variance.reshape(-1, len(PARAMETERS))[index])
        for k in np.flatnonzero(sigma_own > 0).tolist():
            move = np.eye(len(PARAMETERS))[k] * sigma_own[k] * 0.1
            higher = undistorted(replace(interior, values=interior.values + move), at)
            lower = undistorted(replace(interior, values=interior.values - move), at)
            by_camera[of_camera, :, k] = (higher - lower) / (2 * move[k])
    covariance = by_plane @ (sigma[:, :, None] ** 2 * np.swapaxes(by_plane, 1, 2))
    return _Rays(ideal, covariance, by_camera, camera, distance)
