"""A block made ready for the methods: in a local Cartesian frame, with exteriors as positions and attitudes.

Without what gives an adjustment nothing: single rays, images that hardly any ray holds.
"""

from dataclasses import replace

import numpy as np

from photocal.adjustment.lasers import NO_LASERS
from photocal.adjustment.ledger import because
from photocal.adjustment.mounting import (
    NO_ATTITUDES,
    NO_MOUNTING,
    NO_POSITIONS,
    STRIPS,
    Attitudes,
    Mounting,
    Positions,
    body_to_camera,
)
from photocal.adjustment.network import covariance_matrices
from photocal.adjustment.readout import READOUT, adjust_moving_images
from photocal.adjustment.rig import LATER
from photocal.base.arrays import Flags, Floats, Integers
from photocal.base.errors import PhotocalError
from photocal.base.policy import policy
from photocal.block.model import ROLES, Block, ObjectPoints
from photocal.block.motion import observed_motion
from photocal.block.network import NetworkOfBlock, assemble, block_frame, local_positions
from photocal.geometry.frames import LocalFrame
from photocal.geometry.oriented_images import local_poses
from photocal.geometry.rotation import angles_from_matrix, matrix_from_angles, turn_per_angle


def in_local_frame(block: Block) -> Block:
    """Return the block in topocentric coordinates (east, north, up) at its middle.

    Everything that is compared here is in metres along axes at right angles: differences of map
    coordinates would carry the scale of the projection.

    returns: the same block when its frame is local already.
    raises ConfigurationError: for an unknown system, or heights of a kind that does not fit it.
    """
    if block.frame == "local":
        return block
    frame = block_frame(block)
    given = block.images.values
    # Velocities along other axes; rates are about those of the camera.
    motion = block.images.motion.copy()
    motion[:, :3] = np.einsum("nab,nb->na", frame.derivative(given[:, 3:]), motion[:, :3])
    return replace(
        block,
        frame="local",
        height="local",
        images=replace(block.images, values=local_poses(frame, given), motion=motion),
        points=_points(block.points, frame),
        positions=local_positions(block.positions, frame),
    )


def _points(points: ObjectPoints, frame: LocalFrame) -> ObjectPoints:
    """Points with their covariance, where all three coordinates have a sigma."""
    whole = np.isfinite(points.sigma).all(axis=1) & np.isfinite(points.values).all(axis=1)
    given = np.zeros_like(points.values) if points.cross is None else points.cross
    by_given = frame.derivative(points.values[whole])
    matrix = by_given @ covariance_matrices(points.sigma[whole], given[whole]) @ np.swapaxes(by_given, 1, 2)
    sigma, cross = points.sigma.copy(), given.copy()
    sigma[whole] = np.sqrt(np.diagonal(matrix, axis1=1, axis2=2))
    cross[whole] = np.stack([matrix[:, 0, 1], matrix[:, 0, 2], matrix[:, 1, 2]], axis=1)
    held = (sigma == 0).any(axis=1)
    cross[held] = 0.0
    return replace(points, values=frame.to_local(points.values), sigma=sigma, cross=cross)


def as_mounted(block: Block) -> Block:
    """Return the block with observed elements of images.csv as positions and attitudes."""
    if len(block.positions.image) or len(block.attitudes.image):
        return block
    sigma, values = block.images.sigma, block.images.values
    weighted = np.isfinite(sigma) & (sigma > 0)
    placed, turned = (np.flatnonzero(weighted[:, part].all(axis=1)) for part in (slice(3, 6), slice(0, 3)))
    if not len(placed):
        return block
    count = len(placed)
    covariance = np.zeros((count, 3, 3))
    covariance[:, range(3), range(3)] = sigma[placed, 3:] ** 2
    zero = np.zeros(count, dtype=np.int64)
    none = np.zeros(count)
    positions = Positions(placed, values[placed, 3:], covariance, np.zeros((count, 3)), zero, none, none)
    to_body = NO_MOUNTING.rotation.T
    by_angle = to_body @ turn_per_angle(values[turned, :3])
    attitudes = Attitudes(
        turned,
        to_body @ matrix_from_angles(values[turned, :3]),
        by_angle @ (sigma[turned, :3, None] ** 2 * np.swapaxes(by_angle, 1, 2)),
    )
    left = sigma.copy()
    left[placed, 3:] = np.inf
    left[turned, :3] = np.inf
    held = np.zeros(STRIPS + 6)
    return replace(
        block,
        images=replace(block.images, sigma=left),
        positions=positions,
        attitudes=attitudes,
        mounting=Mounting(NO_MOUNTING.rotation, held, held),
    )


def with_attitude_angles(block: Block) -> Block:
    """Return the block with start angles of the images from their attitudes, where there are any."""
    if not len(block.attitudes.image):
        return block
    matrix = body_to_camera(block.mounting, block.mounting.values)
    values = block.images.values.copy()
    values[block.attitudes.image, :3] = angles_from_matrix(matrix @ block.attitudes.rotation)
    return replace(block, images=replace(block.images, values=values))


def with_shutters(block: Block) -> Block:
    """Give unknown shutters and lags of heads what an adjustment of all observations says of them.

    Images get their motion. A block that cannot be adjusted stays as it is: the methods say why.
    """
    undecided = any(camera.shutter == "unknown" or camera.estimated[READOUT] for camera in block.cameras)
    undecided &= not np.isfinite(block.images.motion_sigma).all()
    if not undecided and not any(head.sigma[LATER] and head.lag is None for head in block.heads):
        return block
    try:
        assembly = assemble(without_weak_images(checkable(block))[0])
        with because("shutters and lags of heads"):
            network = adjust_moving_images(assembly.network)[0]
    except PhotocalError:
        return block
    lag = {
        network.cameras[k].id: (t, s) for k, (t, s) in zip(network.rig.camera, network.rig.lag, strict=True)
    }
    heads = tuple(replace(head, lag=lag.get(head.camera)) for head in block.heads)
    if not undecided:
        return replace(block, heads=heads)
    images, spread = block.images, network.exposures.motion_sigma
    if spread is not None:
        # Rates as they were observed: what is expected of them is asked anew of each network.
        centre = network.exposures.started[:, 3:]
        turn = assembly.frame.derivative(assembly.frame.to_given(centre))
        motion, sigma, _ = observed_motion(block, centre, network.positions, turn)
        motion[:, :3] = np.einsum("nab,nb->na", np.linalg.inv(turn), motion[:, :3])
        sigma = np.where(np.isnan(sigma), spread, sigma)
        images = replace(images, motion=motion, motion_sigma=sigma)
    cameras = (camera if camera.rolling else replace(camera, shutter="global") for camera in network.cameras)
    return replace(block, cameras=tuple(cameras), images=images, heads=heads)


def without_georeference(block: Block) -> Block:
    """Return the block with control and image observations only."""
    images = replace(block.images, sigma=np.full_like(block.images.sigma, np.inf))
    return replace(
        block,
        images=images,
        positions=NO_POSITIONS,
        attitudes=NO_ATTITUDES,
        mounting=NO_MOUNTING,
        lasers=NO_LASERS,
    )


def checkable(block: Block) -> Block:
    """Return the block without observations of check and tie points that have a single ray."""
    rays = np.bincount(block.observations.point, minlength=len(block.points.names))
    alone = (rays == 1) & ~block.points.of_role("control")
    return _keep(block, ~alone[block.observations.point])


def without_weak_images(block: Block) -> tuple[Block, Flags]:
    """Set images with fewer than four rays aside: they give the adjustment nothing.

    returns weak (images,).
    """
    weak = np.zeros(len(block.images.names), dtype=np.bool_)
    while True:
        rays = np.bincount(block.observations.image, minlength=len(weak))
        more = (rays < policy.fewest_rays_of_image) & ~weak
        if not more.any():
            break
        weak |= more
        block = checkable(_keep(block, ~weak[block.observations.image]))
    if not weak.any():
        return block, weak
    sigma = block.images.sigma.copy()
    sigma[weak] = 0.0
    return replace(
        block,
        images=replace(block.images, sigma=sigma),
        positions=block.positions.rows(~weak[block.positions.image]),
        attitudes=block.attitudes.rows(~weak[block.attitudes.image]),
        lasers=block.lasers.rows(~weak[block.lasers.image]),
    ), weak


def _keep(block: Block, keep: Flags) -> Block:
    """Return the block with some of its observations."""
    if keep.all():
        return block
    seen = block.observations.rows(keep)
    left = np.bincount(seen.point, minlength=len(block.points.names)) > 0
    lasers = block.lasers.of_points(np.arange(len(left)), left)
    return replace(block, observations=seen, lasers=lasers)


def with_roles(block: Block, control: Integers) -> Block:
    """Return the block with these control points; its other control points become check points."""
    role = block.points.role.copy()
    role[block.points.of_role("control")] = ROLES.index("check")
    role[control] = ROLES.index("control")
    return replace(block, points=replace(block.points, role=role))


def ground_points(block: Block) -> Integers:
    """Control and check points that have rays, as indices."""
    rays = np.bincount(block.observations.point, minlength=len(block.points.names))
    return np.flatnonzero((block.points.role != ROLES.index("tie")) & (rays > 0))


def local_origin(assembly: NetworkOfBlock) -> Floats:
    """Give what was subtracted from all coordinates of a block in a local frame, m."""
    return np.asarray(assembly.frame.to_given(np.zeros((1, 3)))[0])
