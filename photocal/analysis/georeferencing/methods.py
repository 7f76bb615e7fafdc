"""One block georeferenced three ways: direct, as observed or as simulated, integrated, indirect.

A block in its own local Cartesian frame, its exteriors as antenna positions and body attitudes.
"""

from dataclasses import dataclass, field, replace
from typing import Literal

import numpy as np

from photocal.adjustment.adjust import adjust, adjusted_network
from photocal.adjustment.adjusted import AdjustedNetwork
from photocal.adjustment.joint import joint_covariance as covariance_of
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
from photocal.adjustment.solution import Solution
from photocal.adjustment.state import State, start_state
from photocal.analysis.georeferencing.direct import (
    Calibration,
    calibration_of,
    direct_orientation,
    intersect_points,
    joint_covariance,
    leaves_open,
    with_calibration,
)
from photocal.base.arrays import Flags, Floats, Integers
from photocal.base.chi_square import GlobalTest, global_test
from photocal.base.errors import ConfigurationError, PhotocalError
from photocal.base.policy import policy
from photocal.block.model import ROLES, Block, ObjectPoints
from photocal.block.motion import observed_motion
from photocal.block.network import NetworkOfBlock, assemble, block_frame, local_positions
from photocal.block.results.adjusted import AdjustedBlock
from photocal.geometry.frames import LocalFrame, ShiftedFrame
from photocal.geometry.oriented_images import local_poses
from photocal.geometry.rotation import angles_from_matrix, matrix_from_angles, turn_per_angle

Method = Literal["direct", "integrated", "indirect"]
# A column of the covariance for each coordinate.
_MOST_JOINT = 200
METHODS: tuple[Method, ...] = ("direct", "integrated", "indirect")


@dataclass(frozen=True)
class ImageResiduals:
    """Residuals summed up by image, px.

    largest (n,): largest absolute standardised residual.
    """

    rays: Integers
    rms: Floats
    largest: Floats


@dataclass(frozen=True)
class Georeferenced:
    """Ground points as one method gives them.

    label: what it is, with everything that a reader must know.
    fitted (n,): whether the point's surveyed coordinates took part.
    exposures (images, 6): omega, phi, kappa (rad), X, Y, Z (m); NaN where the method has none.
    origin: what was subtracted from all coordinates in the network of `adjusted`, m.
    joint: covariance of the check points among them, shape (3 n, 3 n), in the order of `points`; None for
        direct georeferencing, and for more of them than `_MOST_JOINT`.
    calibration: camera and mounting of the integrated method, where there are positions and attitudes.
    predicted: whether the covariance is complete; not where values of unknown uncertainty are used.
    """

    method: Method
    label: str
    points: Integers
    xyz: Floats
    covariance: Floats
    fitted: Flags
    exposures: Floats
    images: ImageResiduals
    chi_squared: float
    degrees_of_freedom: int
    test: GlobalTest | None
    adjusted: AdjustedNetwork | None
    origin: Floats = field(default_factory=lambda: np.zeros(3))
    joint: Floats | None = None
    calibration: Calibration | None = None
    predicted: bool = True

    @property
    def solution(self) -> Solution | None:
        """Solution of the adjustment; None for direct georeferencing."""
        return None if self.adjusted is None else self.adjusted.solution


def of_method(
    block: Block,
    method: Method,
    note: str = "",
    calibration: Calibration | None = None,
    near: Georeferenced | None = None,
) -> Georeferenced:
    """Georeference a block by one method.

    near: the same images and points by another method: where to start.
    raises ConfigurationError: when the block lacks what the method needs.
    raises PhotocalError: as the adjustment does.
    """
    if method == "direct":
        return _direct(block, note, calibration)
    return _adjusted(without_georeference(block) if method == "indirect" else block, method, note, near)


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


def ground_points(block: Block) -> Integers:
    """Control and check points that have rays, as indices."""
    rays = np.bincount(block.observations.point, minlength=len(block.points.names))
    return np.flatnonzero((block.points.role != ROLES.index("tie")) & (rays > 0))


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


def checkable(block: Block) -> Block:
    """Return the block without observations of check and tie points that have a single ray."""
    rays = np.bincount(block.observations.point, minlength=len(block.points.names))
    alone = (rays == 1) & ~block.points.of_role("control")
    return _keep(block, ~alone[block.observations.point])


def with_roles(block: Block, control: Integers) -> Block:
    """Return the block with these control points; its other control points become check points."""
    role = block.points.role.copy()
    role[block.points.of_role("control")] = ROLES.index("check")
    role[control] = ROLES.index("control")
    return replace(block, points=replace(block.points, role=role))


def local_origin(assembly: NetworkOfBlock) -> Floats:
    """Give what was subtracted from all coordinates of a block in a local frame, m."""
    return np.asarray(assembly.frame.to_given(np.zeros((1, 3)))[0])


def _direct(block: Block, note: str, calibration: Calibration | None) -> Georeferenced:
    joint = None
    if calibration is not None:
        block = with_calibration(block, calibration)
        joint = joint_covariance(calibration, len(block.mounting.values))
    orientation = direct_orientation(block)
    if not orientation.known.any():
        raise ConfigurationError(
            "direct georeferencing needs position and attitude of the exposures",
            "give positions.csv and attitudes.csv, or all six sigmas in images.csv",
            where=block.name,
        )
    intersected = intersect_points(block, orientation, ground_points(block), joint)
    label = "direct: space intersection from GNSS and attitude alone"
    if not orientation.known.all():
        label += f"; images without position or attitude, left out: {int((~orientation.known).sum())}"
    if joint is not None:
        label += ", with camera and mounting of a calibration"
    open_values = joint is None and leaves_open(block)
    if open_values:
        label += "; block.toml leaves camera or mounting open: their start values are used and are not tested"
    poses = np.hstack([angles_from_matrix(orientation.rotation), orientation.centre])
    poses[~orientation.known] = np.nan
    return Georeferenced(
        "direct",
        label + note,
        intersected.points,
        intersected.xyz,
        intersected.covariance,
        np.zeros(len(intersected.points), dtype=np.bool_),
        poses,
        _by_image(
            len(block.images.names),
            block.observations.image[intersected.rays],
            intersected.residuals,
            intersected.standardised,
        ),
        intersected.chi_squared,
        intersected.degrees_of_freedom,
        # The points of an image share its errors: their sum of squares is not chi-squared.
        None,
        None,
        predicted=not open_values,
    )


def _adjusted(block: Block, method: Method, note: str, near: Georeferenced | None) -> Georeferenced:
    if block.datum == "free":
        raise ConfigurationError(
            "check points cannot test a free network: it has no datum",
            'set datum = "control"',
            where="block.toml",
        )
    if method == "integrated" and not _has_georeference(block):
        raise ConfigurationError(
            "the integrated method needs observed positions or attitudes",
            "give positions.csv, or sigmas in images.csv",
            where=block.name,
        )
    block, weak = without_weak_images(block)
    assembly = assemble(block)
    with because(f"{method} georeferencing"):
        adjusted = adjusted_network(assembly.network, state=start_near(assembly, near))
    return _of_network(block, method, note, assembly, adjusted, weak)


def is_adjustment_of(adjusted: AdjustedBlock, given: Block, block: Block) -> bool:
    """Whether a method would adjust a block as it was adjusted: with all of its observations, and no more.

    given: the block as it was read; block: the same, ready for the methods.
    """
    assembly, cameras = adjusted.assembly, adjusted.assembly.network.cameras
    whole = len(assembly.rays) == len(given.observations.image) == len(block.observations.image)
    # The same readouts were found of both, or none.
    same_unknowns = all(
        one.rolling == other.rolling and np.array_equal(one.estimated, other.estimated)
        for one, other in zip(cameras, block.cameras, strict=True)
    )
    changed = bool(adjusted.result.variance_components) or bool(without_weak_images(block)[1].any())
    return adjusted.block is given and given.datum == "control" and whole and same_unknowns and not changed


def stands_for(block: Block) -> Method:
    """Which method the adjustment of all observations of a block is."""
    return "integrated" if _has_georeference(block) else "indirect"


def as_adjusted(block: Block, method: Method, adjusted: AdjustedBlock) -> Georeferenced:
    """Give a block in its local frame as it was adjusted."""
    assembly = adjusted.assembly
    if adjusted.block.frame != "local":
        assembly = replace(assembly, frame=ShiftedFrame(np.zeros(3)))
    weak = np.zeros(len(block.images.names), dtype=np.bool_)
    return _of_network(block, method, "", assembly, adjusted.minimum, weak)


def _has_georeference(block: Block) -> bool:
    return bool(len(block.positions.image) or np.isfinite(block.images.sigma).any())


def _of_network(
    block: Block, method: Method, note: str, assembly: NetworkOfBlock, adjusted: AdjustedNetwork, weak: Flags
) -> Georeferenced:
    """What a method gives of an adjusted network.

    weak (images,): which ones are no part of it.
    """
    solution = adjusted.solution
    origin = local_origin(assembly)
    exposures = solution.exposures + np.concatenate([np.zeros(3), origin])
    exposures[weak] = np.nan
    if weak.any():
        note = f"; images with fewer than four rays, left out: {int(weak.sum())}" + note
    control = block.points.of_role("control")
    wanted = np.isin(assembly.points, ground_points(block))
    points = assembly.points[wanted]
    checks = [
        name
        for j, name in enumerate(assembly.network.point_names)
        if wanted[j] and not control[assembly.points[j]]
    ]
    joint = calibration = None
    mounted = method == "integrated" and len(block.positions.image) and len(block.attitudes.image)
    few = 0 < len(checks) <= _MOST_JOINT
    if few or mounted:
        at = adjusted.factored
        joint = covariance_of(at, [("point", name) for name in checks])[1] if few else None
        calibration = calibration_of(at) if mounted else None
    labels = {
        "integrated": "integrated: positions, attitudes, control and image observations adjusted together",
        "indirect": "indirect: control and image observations only",
    }
    return Georeferenced(
        method,
        labels[method] + note,
        points,
        solution.points[wanted] + origin,
        solution.point_covariance[wanted],
        control[points],
        exposures,
        _residuals(block, assembly, solution),
        solution.chi_squared,
        solution.degrees_of_freedom,
        global_test(solution.chi_squared, solution.degrees_of_freedom, *block.global_test),
        adjusted,
        origin,
        joint,
        calibration,
    )


def start_near(assembly: NetworkOfBlock, near: Georeferenced | None) -> State | None:
    """Start at what another method gave of the same images and points; None where they are not the same."""
    network = assembly.network
    if near is None or near.adjusted is None:
        return None
    known = near.adjusted.network
    if (known.image_names, known.point_names) != (network.image_names, network.point_names):
        return None
    there, shift = near.adjusted.state, near.origin - local_origin(assembly)
    return replace(
        start_state(network),
        rotation=there.rotation,
        centre=there.centre + shift,
        points=there.points + shift,
        cameras=there.cameras,
    )


def _residuals(block: Block, assembly: NetworkOfBlock, solution: Solution) -> ImageResiduals:
    rays = assembly.network.rays
    pitch = np.array([camera.pitch for camera in block.cameras])[block.images.camera[rays.image]]
    standardised = solution.standardised(rays.sigma)
    return _by_image(len(block.images.names), rays.image, solution.residuals / pitch, standardised)


def _by_image(count: int, image: Integers, residuals: Floats, standardised: Floats) -> ImageResiduals:
    rays = np.bincount(image, minlength=count)
    squares = np.column_stack([np.bincount(image, residuals[:, a] ** 2, count) for a in range(2)])
    largest = np.zeros(count)
    np.maximum.at(largest, image, np.nan_to_num(np.abs(standardised)).max(axis=1, initial=0.0))
    return ImageResiduals(rays, np.sqrt(squares / np.maximum(rays, 1)[:, None]), largest)


@dataclass(frozen=True)
class Degradation:
    """Noise that is added to an adjusted exterior orientation.

    position_m, attitude_rad: standard deviations of X, Y, Z and of omega, phi, kappa.
    """

    position_m: float
    attitude_rad: float

    def __post_init__(self) -> None:
        if not (self.position_m > 0.0 and self.attitude_rad > 0.0):
            raise ConfigurationError(
                "the noise of simulated orientations must be positive",
                "give standard deviations such as 0.08 m and 0.02 deg",
            )

    @property
    def note(self) -> str:
        """What a reader must know about results with it."""
        return (
            f" [SIMULATED: adjusted orientation with added noise of {self.position_m:g} m and "
            f"{np.degrees(self.attitude_rad):g} deg; no GNSS/IMU measured it]"
        )


def degraded(block: Block, noise: Degradation, rng: np.random.Generator) -> Block:
    """Adjust a block and give its images the result with noise, as observations."""
    adjusted, weak = without_weak_images(block)
    assembly = assemble(adjusted)
    with because("simulated direct orientation"):
        solution = adjust(assembly.network)
    # Orientations belong with the camera that they were adjusted with.
    cameras = tuple(
        replace(camera.with_values(values), estimated=np.zeros_like(camera.estimated))
        for camera, values in zip(block.cameras, solution.cameras, strict=True)
    )
    sigma = np.broadcast_to(
        np.repeat([noise.attitude_rad, noise.position_m], 3), block.images.sigma.shape
    ).copy()
    values = solution.exposures + np.concatenate([np.zeros(3), local_origin(assembly)])
    sigma[weak] = np.inf
    values = values + rng.normal(0.0, 1.0, values.shape) * np.where(np.isfinite(sigma), sigma, 0.0)
    images = replace(block.images, values=values, sigma=sigma)
    return replace(without_georeference(block), images=images, cameras=cameras)


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
