"""One block georeferenced three ways: direct, as observed or as simulated, integrated, indirect.

Each of a block that is ready for it, see `prepared`.
"""

from dataclasses import dataclass, field, replace
from typing import Literal

import numpy as np

from photocal.adjustment.adjust import adjust, adjusted_network
from photocal.adjustment.adjusted import AdjustedNetwork
from photocal.adjustment.joint import joint_covariance as covariance_of
from photocal.adjustment.ledger import because
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
from photocal.analysis.georeferencing.prepared import (
    ground_points,
    local_origin,
    without_georeference,
    without_weak_images,
)
from photocal.base.arrays import Flags, Floats, Integers
from photocal.base.chi_square import GlobalTest, global_test
from photocal.base.errors import ConfigurationError
from photocal.block.model import Block
from photocal.block.network import NetworkOfBlock, assemble
from photocal.block.results.adjusted import AdjustedBlock
from photocal.geometry.frames import ShiftedFrame
from photocal.geometry.rotation import angles_from_matrix

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
