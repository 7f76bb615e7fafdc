"""Direct georeferencing from GNSS and inertial unit alone, also line by line, and with a calibration.

Space intersection with uncertain exterior orientation: each point alone, by generalised least squares.
"""

from dataclasses import dataclass, replace

import numpy as np
from scipy.linalg import block_diag

from photocal.adjustment.adjust import adjust
from photocal.adjustment.factored import Factored, factored
from photocal.adjustment.ledger import because
from photocal.adjustment.mounting import (
    BORESIGHT,
    HEIGHT_SCALE,
    LEVER,
    OF_FLIGHT,
    SHIFT,
    STRIPS,
    TIME,
    Mounting,
    body_to_camera,
)
from photocal.adjustment.readout import READOUT
from photocal.base.arrays import Flags, Floats, Integers
from photocal.base.errors import ConfigurationError, IllPosedError
from photocal.block.model import Block
from photocal.block.network import assemble, observed_pixels, observed_plane
from photocal.geometry.camera import PARAMETERS
from photocal.geometry.distortion import undistorted
from photocal.geometry.oriented_images import oriented_images, turned
from photocal.geometry.resection import intersect
from photocal.geometry.rotation import left_jacobian, matrix_from_angles, skew, turn_per_angle


@dataclass(frozen=True)
class Calibration:
    """Camera and mounting as one adjustment has found them.

    They are correlated, often nearly fully (principal point and boresight, principal distance and vertical
    lever arm): what one takes from the other cancels on the ground. Diagonals alone would predict errors many
    times too large.

    cameras (n, parameters): in the order of the block's cameras.
    mounting (11,): lever arm (m), boresight (rad), time offset (s); shift (m) and height scale of its flight.
    covariance (11 + n parameters, 11 + n parameters): of the mounting, then of the cameras; zero for what was
        held.
    """

    cameras: Floats
    mounting: Floats
    covariance: Floats

    def on_flight(self, mounting: Mounting) -> "Calibration":
        """Give the calibration for another flight, whose positions have errors of their own."""
        values, covariance = self.mounting.copy(), self.covariance.copy()
        values[OF_FLIGHT] = mounting.values[OF_FLIGHT]
        covariance[OF_FLIGHT], covariance[:, OF_FLIGHT] = 0.0, 0.0
        stated = mounting.sigma[OF_FLIGHT]
        at = np.arange(len(covariance))[OF_FLIGHT]
        covariance[at, at] = np.where(np.isfinite(stated), stated, 0.0) ** 2
        return Calibration(self.cameras, values, covariance)


def calibrate(block: Block) -> Calibration:
    """Adjust a block and keep camera and mounting; raises PhotocalError as the adjustment does."""
    network = assemble(block).network
    with because("on-the-job calibration"):
        return calibration_of(factored(network, adjust(network).state))


def calibration_of(at: Factored) -> Calibration:
    """Keep camera and mounting of an adjusted network, with their joint covariance."""
    columns = [at.problem.layout.common_columns[:STRIPS]]
    for active, where in at.problem.layout.camera_columns:
        camera_columns = np.full(len(PARAMETERS), -1)
        camera_columns[active] = where
        columns.append(camera_columns)
    column = np.concatenate(columns)
    unknown = np.flatnonzero(column >= 0)
    covariance = np.zeros((len(column), len(column)))
    if len(unknown):
        covariance[np.ix_(unknown, unknown)] = at.joint(column[unknown])
    return Calibration(at.state.cameras, at.state.common[:STRIPS], covariance)


def leaves_open(block: Block) -> bool:
    """Whether a value of mounting or camera, or its standard deviation, is not stated: then it is unknown."""
    mounted = bool(len(block.positions.image) and len(block.attitudes.image))
    unknown = [camera.estimated & np.isinf(camera.prior_sigma) for camera in block.cameras]
    return bool(np.any(unknown)) or (mounted and bool(np.isinf(block.mounting.sigma[:STRIPS]).any()))


def with_calibration(block: Block, calibration: Calibration) -> Block:
    """Return a block with camera and mounting of a calibration of its own flight, or one made `on_flight`."""
    if len(calibration.cameras) != len(block.cameras):
        raise ConfigurationError(
            f"the calibration has {len(calibration.cameras)} cameras, the block {len(block.cameras)}",
            where=block.name,
            remedy="take the calibration of the same rig",
        )
    cameras = tuple(
        camera.with_values(values) for camera, values in zip(block.cameras, calibration.cameras, strict=True)
    )
    values = block.mounting.values.copy()
    values[:STRIPS] = calibration.mounting
    return replace(block, cameras=cameras, mounting=replace(block.mounting, values=values))


def joint_covariance(calibration: Calibration, common: int) -> Floats:
    """Give the covariance of all common values of a block and its cameras."""
    size = len(calibration.covariance)
    at = np.concatenate([np.arange(STRIPS), common + np.arange(size - STRIPS)])
    joint = np.zeros((common + size - STRIPS, common + size - STRIPS))
    joint[np.ix_(at, at)] = calibration.covariance
    return joint


@dataclass(frozen=True)
class DirectOrientation:
    """Exterior orientation that no image observation has touched.

    rotation (n, 3, 3): object to camera axes.
    covariance (n, 6, 6): of a small turn in camera axes (rad) and of the centre (m), from each exposure's own
        errors.
    by_common (n, 6, k): derivative with respect to the common values of the mounting.
    common_covariance (k, k): of those, from the sigmas that the block states.
    """

    known: Flags
    rotation: Floats
    centre: Floats
    covariance: Floats
    by_common: Floats
    common_covariance: Floats


def direct_orientation(block: Block) -> DirectOrientation:
    """Exterior orientation of the images of a block from its position and attitude observations.

    returns: X0 = A - M' B l + v dt - s - d t and M = B R, see `photocal.adjustment.mounting`.
    """
    count, common = len(block.images.names), len(block.mounting.values)
    rotation = matrix_from_angles(block.images.values[:, :3])
    centre = block.images.values[:, 3:].copy()
    complete = np.asarray(np.isfinite(block.images.sigma).all(axis=1))
    covariance = np.zeros((count, 6, 6))
    sigma = np.where(complete[:, None], block.images.sigma, 0.0)
    turn = turn_per_angle(block.images.values[:, :3])
    covariance[:, :3, :3] = turn @ (sigma[:, :3, None] ** 2 * np.swapaxes(turn, 1, 2))
    covariance[:, range(3, 6), range(3, 6)] = sigma[:, 3:] ** 2
    by_common = np.zeros((count, 6, common))
    known = complete
    positions, attitudes, mounting = block.positions, block.attitudes, block.mounting
    row_p = {int(i): k for k, i in enumerate(positions.image)}
    row_a = {int(i): k for k, i in enumerate(attitudes.image)}
    matrix = body_to_camera(mounting, mounting.values)
    arm = matrix @ mounting.values[LEVER]
    for i in sorted(row_p.keys() & row_a.keys()):
        p, a = row_p[i], row_a[i]
        m = matrix @ attitudes.rotation[a]
        at = STRIPS + 6 * int(positions.strip[p])
        velocity, elapsed = positions.velocity[p], positions.time[p]
        raised = np.array([0.0, 0.0, positions.above[p]])
        shift = mounting.values[at : at + 3] + elapsed * mounting.values[at + 3 : at + 6]
        shift = shift + mounting.values[SHIFT] + raised * mounting.values[HEIGHT_SCALE]
        rotation[i] = m
        centre[i] = positions.values[p] - m.T @ arm + velocity * mounting.values[TIME] - shift
        # Rows: the turn of the camera, the projection centre; columns: turn of the body, antenna.
        jacobian = np.zeros((6, 6))
        jacobian[:3, :3] = matrix
        jacobian[3:, :3] = -m.T @ skew(arm) @ matrix
        jacobian[3:, 3:] = np.eye(3)
        measured = np.zeros((6, 6))
        measured[:3, :3], measured[3:, 3:] = attitudes.covariance[a], positions.covariance[p]
        covariance[i] = jacobian @ measured @ jacobian.T
        by_common[i, :3, BORESIGHT] = left_jacobian(mounting.values[BORESIGHT])
        by_common[i, 3:, LEVER] = -m.T @ matrix
        by_common[i, 3:, TIME] = velocity
        by_common[i, 3:, SHIFT] = -np.eye(3)
        by_common[i, 3:, HEIGHT_SCALE] = -raised
        by_common[i, 3:, at : at + 3] = -np.eye(3)
        by_common[i, 3:, at + 3 : at + 6] = -elapsed * np.eye(3)
        known[i] = True
    stated = np.where(np.isfinite(mounting.sigma), mounting.sigma, 0.0)
    return DirectOrientation(known, rotation, centre, covariance, by_common, np.diag(stated**2))


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
    """Observations: corrected image coordinates p = -c (u, v)/w, and the poses of the lines that have them.

    ideal (n, 2), covariance (n, 2, 2), by_camera (n, 2, parameters): p, and how it depends on measurement and
        camera.
    camera, distance (n,): of each, with its principal distance.
    rotation (n, 3, 3), centre (n, 3): of the line in which each was recorded.
    late (n,): when it was read, in readouts from the middle.
    by_readout (n, 6): derivative of turn (camera axes) and centre with respect to the readout.
    spread (images, 6): sigmas of turn and centre during the whole readout.
    """

    ideal: Floats
    covariance: Floats
    by_camera: Floats
    camera: Integers
    distance: Floats
    rotation: Floats
    centre: Floats
    late: Floats
    by_readout: Floats
    spread: Floats


def intersect_points(
    block: Block, orientation: DirectOrientation, wanted: Integers, joint: Floats | None = None
) -> Intersected:
    """Intersect points from all images that have an orientation.

    raises IllPosedError: when no point has two rays that meet.
    """
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
    every = _rays(block, orientation, np.diag(joint)[len(orientation.common_covariance) :])
    poses = every.centre, every.rotation
    start = intersect(observations.point, len(block.points.names), *poses, every.ideal, every.distance)
    found = []
    for point in wanted:
        rays = np.flatnonzero(observations.point == point)
        if len(rays) < 2 or not np.isfinite(start[point]).all():
            continue
        solved = _one_point(block, orientation, every, rays, start[point], joint)
        if solved is not None:
            found.append((int(point), rays, *solved))
    if not found:
        raise IllPosedError(
            "no ground point has two rays from exposures with position and attitude that meet",
            "measure the ground points in more images; do positions and images belong together?",
            where=block.name,
        )
    points, of_points, xyz, covariance, residuals, standardised, squares = zip(*found, strict=True)
    rays = np.concatenate(of_points)
    pitch = np.array([camera.pitch for camera in block.cameras])
    return Intersected(
        np.array(points),
        np.array(xyz),
        np.array(covariance),
        chosen[rays],
        np.concatenate(residuals) / pitch[block.images.camera[observations.image[rays]]],
        np.concatenate(standardised),
        float(sum(squares)),
        2 * len(rays) - 3 * len(points),
    )


def _one_point(
    block: Block,
    orientation: DirectOrientation,
    every: _Rays,
    rays: Integers,
    start: Floats,
    joint: Floats,
) -> tuple[Floats, Floats, Floats, Floats, float] | None:
    """Coordinates, covariance, residuals, also standardised, and their sum; None where there is no place."""
    rotation, centre = every.rotation[rays], every.centre[rays]
    c, ideal = every.distance[rays], every.ideal[rays]
    xyz = start
    iterations = 20
    enough_m = 1e-7
    for _ in range(iterations):
        q = np.einsum("nij,nj->ni", rotation, xyz - centre)
        by_q = _by_camera_axes(q, c)
        by_point = (by_q @ rotation).reshape(-1, 3)
        miss = (-c[:, None] * q[:, :2] / q[:, 2:] - ideal).ravel()
        try:
            weight = np.linalg.inv(_misclosure(block, orientation, every, rays, q, by_q, joint))
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
    every: _Rays,
    rays: Integers,
    q: Floats,
    by_q: Floats,
    joint: Floats,
) -> Floats:
    """Covariance of computed minus corrected coordinates of one point's rays, shape (2n, 2n)."""
    n, image = len(rays), block.observations.image[rays]
    # exp([t]x) q = q - [q]x t
    turn = -skew(q)
    by_pose = np.concatenate([by_q @ turn, -by_q @ every.rotation[rays]], axis=2)
    by_readout = np.einsum("nab,nb->na", by_pose, every.by_readout[rays])
    result = np.zeros((2 * n, 2 * n))
    of_pairs = result.reshape(n, 2, n, 2)
    # Rays of one image share its errors.
    k, other = np.nonzero(image[:, None] == image)
    late = every.late[rays[k]] * every.late[rays[other]]
    gusts = np.eye(6) * (late[:, None] * every.spread[image[k]] ** 2)[:, None]
    part = by_pose[k] @ (orientation.covariance[image[k]] + gusts) @ np.swapaxes(by_pose[other], 1, 2)
    of_pairs[k, :, other] += part
    of_pairs[range(n), :, range(n)] += every.covariance[rays]
    shared = [(by_pose @ orientation.by_common[image]).reshape(2 * n, -1)]
    for index in range(len(block.cameras)):
        of_camera = every.camera[rays] == index
        by_camera = -every.by_camera[rays] * of_camera[:, None, None]
        by_camera[:, :, 0] += np.where(of_camera[:, None], -q[:, :2] / q[:, 2:], 0.0)
        by_camera[:, :, READOUT] += np.where(of_camera[:, None], by_readout, 0.0)
        shared.append(by_camera.reshape(2 * n, -1))
    by_shared = np.hstack(shared)
    return np.asarray(result + by_shared @ joint @ by_shared.T)


def _rays(block: Block, orientation: DirectOrientation, variance: Floats) -> _Rays:
    """Correct the observations; `variance` of all camera parameters tells which derivatives are needed.

    Their poses are moved as the images move.
    """
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
    return _Rays(ideal, covariance, by_camera, camera, distance, *_moved(block, orientation))


def _moved(block: Block, orientation: DirectOrientation) -> tuple[Floats, Floats, Floats, Floats, Floats]:
    """Rotation, centre, lateness of the observations, derivative by the readout, and spread: see `_Rays`."""
    image, camera = block.observations.image, block.images.camera
    readout = np.array([interior.values[READOUT] for interior in block.cameras])[camera][:, None]
    motion, sigma = (np.nan_to_num(part) for part in (block.images.motion, block.images.motion_sigma))
    views = oriented_images(block.cameras, camera, orientation.rotation, orientation.centre)
    views = replace(views, movement=motion * readout)
    pixels = observed_pixels(block)
    late = views.late(image, pixels)
    by_readout = np.hstack([turned(motion[image], late[:, None]), late[:, None] * motion[image][:, :3]])
    return *views.at_lines(image, pixels), late, by_readout, (sigma * np.abs(readout))[:, np.r_[3:6, :3]]
