"""The result of an adjustment, made of the block, its network and the solution."""

import os
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from weakref import finalize, ref

import numpy as np
from scipy.spatial.transform import Rotation

from photocal.adjustment.adjusted import AdjustedNetwork, at_minimum
from photocal.adjustment.factored import factored
from photocal.adjustment.joint import joint_covariance
from photocal.adjustment.lasers import OFFSET, SCALE
from photocal.adjustment.ledger import because
from photocal.adjustment.mounting import BORESIGHT, COMMON, STRIPS
from photocal.adjustment.network import Network
from photocal.adjustment.readout import adjust_moving_images, with_moving_images
from photocal.adjustment.reliability import UNCHECKED
from photocal.adjustment.rig import OF_HEAD, TURN, head_rotation
from photocal.adjustment.snooping import Test, snoop, subset
from photocal.adjustment.solution import ComponentFactor, Solution
from photocal.adjustment.solver import Iteration
from photocal.adjustment.state import State, head_values, laser_values, lenses, start_state
from photocal.adjustment.unknowns import XYZ
from photocal.adjustment.variance_components import estimate_components, rays_by_camera, with_factors
from photocal.base.arrays import Flags, Floats, Integers
from photocal.base.chi_square import global_test
from photocal.base.errors import IllPosedError, NotConvergedError
from photocal.base.files import output_folder
from photocal.base.version import __version__
from photocal.block.folder import read_block
from photocal.block.model import ROLES, Block
from photocal.block.motion import require_motion
from photocal.block.network import NetworkOfBlock, assemble, behind_cameras, plane_per_unit
from photocal.block.options import Wanted
from photocal.block.results.folder import write_result
from photocal.block.results.more_tables import more_figures, write_more
from photocal.block.results.result import (
    AdjustedHead,
    AdjustedLasers,
    AdjustedPoints,
    BlockFacts,
    CheckLength,
    CheckPoint,
    CheckSummary,
    LaserShot,
    MountingValue,
    RejectedRay,
    Residuals,
    Result,
    Software,
    common_values,
)
from photocal.geometry.camera import PARAMETERS, Camera, among
from photocal.geometry.frames import nearest_rotation
from photocal.geometry.oriented_images import OrientedImages, local_poses
from photocal.geometry.rotation import angles_from_matrix, matrix_from_angles, turn_per_angle

NOTHING_MORE = Wanted()
Report = Callable[[Iteration], None]
# What adjustments of this process ended with, by the identity of their results, as long as these are in use.
_ENDED = dict[int, tuple[ref[Block], NetworkOfBlock, Solution]]()


@dataclass(frozen=True)
class AdjustedBlock:
    """A block, the network that its adjustment ended with, and the result, for the next step."""

    block: Block
    assembly: NetworkOfBlock
    solution: Solution
    result: Result

    @cached_property
    def minimum(self) -> AdjustedNetwork:
        """The network at its minimum, with its factored equations."""
        return at_minimum(self.assembly.network, self.solution)


def known_adjustment(block: Block, result: Result) -> AdjustedBlock | None:
    """Give what a block was adjusted to in this process; None for a result that was read, or is another's."""
    ended = _ENDED.get(id(result))
    if ended is None or ended[0]() is not block:
        return None
    _, assembly, solution = ended
    return AdjustedBlock(block, assembly, solution, result)


def result_of(
    block: Block,
    assembly: NetworkOfBlock,
    solution: Solution,
    *,
    snooping: Test | None = None,
    components: Sequence[ComponentFactor] = (),
) -> Result:
    """Make the result of an adjustment; covariances are scaled by the a priori unit variance."""
    factor = solution.variance_factor
    sigma = np.sqrt(np.diagonal(solution.camera_covariance, axis1=1, axis2=2))
    scale = np.where(sigma > 0, sigma, 1.0)
    correlation = solution.camera_covariance / (scale[:, :, None] * scale[:, None, :])
    given = zip(assembly.network.cameras, solution.cameras, sigma, correlation, strict=True)
    cameras = tuple(camera.adjusted(*figures) for camera, *figures in given)
    values, covariance = given_exposures(assembly, solution)
    points = AdjustedPoints(
        tuple(block.points.names[j] for j in assembly.points),
        tuple(ROLES[r] for r in block.points.role[assembly.points]),
        *given_points(assembly, solution),
        np.bincount(assembly.network.rays.point, minlength=len(assembly.points)),
    )
    seen = block.observations
    observed = np.bincount(seen.point, minlength=len(block.points.names)) > 0
    left_out = np.ones(len(seen.image), dtype=np.bool_)
    left_out[assembly.rays] = False
    return Result(
        software=Software("photocal", __version__),
        block=BlockFacts(
            block.name,
            block.frame,
            block.datum,
            seen.unit,
            seen.axes,
            block.height,
            refraction=block.refraction,
            curvature=block.curvature,
        ),
        inputs=block.inputs,
        converged=True,
        iterations=len(solution.iterations),
        observations=solution.observations,
        unknowns=solution.unknowns,
        degrees_of_freedom=solution.degrees_of_freedom,
        chi_squared=solution.chi_squared,
        sigma0_squared=factor if np.isfinite(factor) else None,
        # Standard deviations from the residuals are not tested with them.
        global_test=None
        if components
        else global_test(solution.chi_squared, solution.degrees_of_freedom, *block.global_test),
        groups=solution.groups,
        checks=_checks(block, assembly, points, solution),
        snooping=snooping,
        mounting=_mounting(block, solution),
        heads=_heads(assembly.network, solution),
        lasers=_lasers(assembly.network, solution),
        variance_components=tuple(components),
        readouts=assembly.readouts,
        rejected=tuple(
            RejectedRay(block.images.names[seen.image[row]], block.points.names[seen.point[row]])
            for row in np.flatnonzero(left_out)
        ),
        unobserved=tuple(block.points.names[j] for j in np.flatnonzero(~observed)),
        repetition=block.repetition,
        # How the marks of each image fit, in the unit of its camera.
        fiducials=tuple(
            {
                "image": fit.image,
                "sigma0": fit.sigma0 if fit.redundancy else None,
                "residuals": [
                    {"fiducial": name, "vx": vx, "vy": vy}
                    for name, (vx, vy) in zip(fit.fiducials, fit.residuals.tolist(), strict=True)
                ],
            }
            for fit in block.fiducial_fits
        ),
        cameras={camera.id: camera for camera in cameras},
        images=OrientedImages(
            block.images.names,
            cameras,
            block.images.camera,
            values,
            covariance,
            movements(assembly, solution, values),
        ),
        points=points,
        residuals=residuals_of(block, assembly, solution),
    )


def movements(assembly: NetworkOfBlock, solution: Solution, values: Floats) -> Floats | None:
    """How images moved while they were read, along the given axes; None where no shutter rolls."""
    if not any(camera.rolling for camera in assembly.network.cameras):
        return None
    movement = lenses(assembly.network, solution.state)[:, len(PARAMETERS) :].copy()
    back = np.linalg.inv(assembly.frame.derivative(values[:, 3:]))
    movement[:, :3] = np.einsum("nab,nb->na", back, movement[:, :3])
    return movement


def network_of(block: Block, result: Result) -> NetworkOfBlock:
    """Make the network that a result ended with: without what was rejected, with the estimated sigmas."""
    lag = {head.camera: head.lag for head in result.heads}
    heads = tuple(replace(head, lag=lag.get(head.camera)) for head in block.heads)
    assembly = assemble(_started(replace(block, heads=heads), result))
    if result.rejected:
        refused = {(ray.image, ray.point) for ray in result.rejected}
        image, point = block.images.names, block.points.names
        seen = block.observations
        accepted = np.array(
            [(image[seen.image[k]], point[seen.point[k]]) not in refused for k in assembly.rays],
            dtype=np.bool_,
        )
        assembly = _part(assembly, *subset(assembly.network, accepted))
    if any(camera.shutter != "global" for camera in assembly.network.cameras):
        adjusted_cameras = [result.cameras[camera.id] for camera in assembly.network.cameras]
        cameras = tuple(map(_with_shutter, assembly.network.cameras, adjusted_cameras))
        assembly = replace(assembly, network=replace(assembly.network, cameras=cameras))
    if not result.variance_components:
        return assembly
    factors = {part.name: part.factor for part in result.variance_components}
    network = with_factors(assembly.network, rays_by_camera(assembly.network), factors)
    return replace(assembly, network=network)


def _started(block: Block, result: Result) -> Block:
    """The block, its result in place of start values that it lacks; those of a free one make its datum."""
    if block.datum == "free":
        return block
    place = {name: k for k, name in enumerate(block.points.names)}
    found = np.full(block.points.values.shape, np.nan)
    found[[place[name] for name in result.points.names]] = result.points.values
    poses, points = block.images.values, block.points.values
    return replace(
        block,
        images=replace(block.images, values=np.where(np.isnan(poses), result.images.values, poses)),
        points=replace(block.points, values=np.where(np.isnan(points), found, points)),
    )


def _part(
    assembly: NetworkOfBlock, network: Network, rays: Integers | Flags, points: Integers | Flags
) -> NetworkOfBlock:
    """The assembly of a network of some of its rays and points."""
    return replace(assembly, network=network, points=assembly.points[points], rays=assembly.rays[rays])


def state_of(assembly: NetworkOfBlock, result: Result) -> State | None:
    """State to adjust a network anew from: that of its result; None where start values make the datum."""
    network = assembly.network
    if network.datum_points is not None:
        return None
    image = {name: k for k, name in enumerate(result.images.names)}
    point = {name: k for k, name in enumerate(result.points.names)}
    poses = local_poses(assembly.frame, result.images.values[[image[name] for name in network.image_names]])
    start = start_state(network)
    common = common_values(result.mounting, start.common).copy()
    of_heads = head_values(network, common)
    for head in result.heads:
        values = np.array([head.values[key].value for key in OF_HEAD])
        values[TURN] = np.radians(values[TURN])
        of_heads[[network.cameras[k].id for k in network.rig.camera].index(head.camera)] = values
    common[len(common) - of_heads.size :] = of_heads.ravel()
    if result.lasers is not None:
        laser_values(network, common)[:] = result.lasers.offset_m.value, result.lasers.scale.value
    points = result.points.values[[point[name] for name in network.point_names]]
    return replace(
        start,
        common=common,
        cameras=np.array([result.cameras[camera.id].values for camera in network.cameras]),
        rotation=matrix_from_angles(poses[:, :3]),
        centre=np.ascontiguousarray(poses[:, 3:]),
        points=np.ascontiguousarray(assembly.frame.to_local(points)),
    )


def _with_shutter(camera: Camera, result: Camera) -> Camera:
    """Camera with the readout and the shakes that a result estimated, from what its sigmas belong to."""
    readout = among("readout")
    given = result.values if result.given is None else result.given
    return replace(
        camera,
        values=np.where(readout, given, camera.values),
        estimated=np.where(readout, result.estimated, camera.estimated),
        readout_direction=result.readout_direction,
        shake=result.shake,
    )


def _mounting(block: Block, solution: Solution) -> dict[str, MountingValue] | None:
    """Lever arm (m, body axes), boresight (deg), time offset (s) and the strips' shifts and drifts."""
    if not len(block.positions.image) and not len(block.attitudes.image):
        return None
    strips = (len(block.mounting.values) - STRIPS) // 6
    names = list(COMMON) + [
        f"{what}_{axis}[{strip}]" for strip in range(strips) for what in ("shift", "drift") for axis in "xyz"
    ]
    scale = np.ones(len(names))
    scale[BORESIGHT] = np.degrees(1.0)
    values = solution.state.common[: len(names)] * scale
    sigma = np.sqrt(np.diag(solution.common_covariance))[: len(names)] * scale
    return {
        name: MountingValue(float(values[k]), float(sigma[k]), bool(block.mounting.sigma[k] != 0))
        for k, name in enumerate(names)
    }


def _lasers(network: Network, solution: Solution) -> AdjustedLasers | None:
    """Laser distances with what the block says of them; None without any."""
    lasers = network.lasers
    if not len(lasers.image):
        return None
    first = len(network.mounting.values)
    values = laser_values(network, solution.state.common).tolist()
    sigma = np.sqrt(np.diag(solution.common_covariance))[first:].tolist()
    offset, scale = (
        MountingValue(values[k], sigma[k], bool(lasers.common_sigma[k] != 0)) for k in (OFFSET, SCALE)
    )
    v, r = solution.laser_residuals, solution.laser_redundancy
    checked = r > UNCHECKED
    w = np.where(checked, v / (lasers.sigma * np.sqrt(np.where(checked, r, 1.0))), np.nan)
    figures = (lasers.values, lasers.sigma, v, r, w)
    rows = zip(lasers.image.tolist(), *(column.tolist() for column in figures), strict=True)
    shots = tuple(
        LaserShot(network.image_names[i], measured, stated, miss, share, t if np.isfinite(t) else None)
        for i, measured, stated, miss, share, t in rows
    )
    return AdjustedLasers(offset, scale, shots)


def _heads(network: Network, solution: Solution) -> tuple[AdjustedHead, ...]:
    """Cameras on frames with their relative orientations (deg, m, s), but for the first heads."""
    rig, size = network.rig, network.rig.values.size
    if not len(rig.first):
        return ()
    scale = np.where(np.arange(len(OF_HEAD)) < TURN.stop, np.degrees(1.0), 1.0)
    values, covariance = head_values(network, solution.state.common), solution.common_covariance
    free = rig.unknown(network.exposures.camera)
    head = rig.head_of(network.exposures.camera)
    names = [network.cameras[k].id for k in rig.camera]
    turned = Rotation.from_matrix(head_rotation(rig, values)).as_rotvec()
    given = Rotation.from_matrix(rig.rotation).as_rotvec()
    heads = []
    for k, name in enumerate(names):
        lead = int(np.argmax(rig.base == rig.base[k]))
        with_others = int((head[rig.second] == k).sum() + len(np.unique(rig.first[head[rig.first] == k])))
        if k == lead or not with_others:
            continue
        begin = len(covariance) - size + k * len(OF_HEAD)
        columns = slice(begin, begin + len(OF_HEAD))
        of_head = covariance[columns, columns] * np.outer(scale, scale)
        sigma = np.sqrt(np.diag(of_head))
        at = np.flatnonzero(free[k])
        heads.append(
            AdjustedHead(
                name,
                names[lead],
                with_others,
                tuple(np.degrees(turned[k]).tolist()),
                tuple(np.degrees(given[k]).tolist()),
                {
                    key: MountingValue(float(scale[n] * values[k, n]), float(sigma[n]), bool(free[k, n]))
                    for n, key in enumerate(OF_HEAD)
                },
                {
                    key: (float(scale[n] * rig.values[k, n]), float(known) if np.isfinite(known) else None)
                    for n, key in enumerate(OF_HEAD)
                    for known in [scale[n] * rig.sigma[k, n]]
                },
                tuple(map(tuple, (of_head[np.ix_(at, at)] / np.outer(sigma[at], sigma[at])).tolist())),
                (float(rig.lag[k, 0]), float(rig.lag[k, 1])),
                *_registration(network, solution, lead, k, head_rotation(rig, values)),
            )
        )
    return tuple(heads)


def _registration(
    network: Network, solution: Solution, base: int, head: int, rotation: Floats
) -> tuple[int, float | None]:
    """Rays that two heads have in common, and by how much their pictures of them miss each other, px."""
    rig, rays = network.rig, network.rays
    of = rig.head_of(network.exposures.camera)
    pairs = (of[rig.first] == base) & (of[rig.second] == head)
    partner = np.full(len(network.image_names), -1)
    partner[rig.second[pairs]] = rig.first[pairs]
    key = rays.image * len(network.point_names) + rays.point
    of_head = np.flatnonzero(partner[rays.image] >= 0)
    wanted = partner[rays.image[of_head]] * len(network.point_names) + rays.point[of_head]
    order = np.argsort(key)
    place = order[np.minimum(np.searchsorted(key[order], wanted), len(order) - 1)]
    both = key[place] == wanted
    if not both.any():
        return 0, None
    cameras = [rig.camera[k] for k in (base, head)]
    scale = solution.cameras[cameras[1], 0] / solution.cameras[cameras[0], 0]
    carried = scale * solution.residuals[place[both]] @ rotation[head][:2, :2].T
    miss = (solution.residuals[of_head[both]] - carried) / network.cameras[cameras[1]].pitch
    return int(both.sum()), float(np.sqrt(np.mean(np.sum(miss**2, axis=1))))


def _checks(
    block: Block, assembly: NetworkOfBlock, points: AdjustedPoints, solution: Solution
) -> CheckSummary:
    check = block.points.of_role("check")[assembly.points]
    d = points.values[check] - block.points.values[assembly.points[check]]
    rmse = np.sqrt(np.mean(d**2, axis=0)).tolist() if len(d) else [None] * 3
    surveyed = block.points.sigma[assembly.points[check]]
    stated = [[u if np.isfinite(u) and u > 0.0 else None for u in row] for row in surveyed.tolist()]
    rows = zip(np.flatnonzero(check), d.tolist(), points.sigma[check].tolist(), stated, strict=True)
    checked = tuple(CheckPoint(points.names[j], *dj, *sj, *uj) for j, dj, sj, uj in rows)
    lengths = _lengths(block, assembly, solution)
    return CheckSummary(len(d), dict(zip("xyz", rmse, strict=True)), checked, lengths)


def _lengths(block: Block, assembly: NetworkOfBlock, solution: Solution) -> tuple[CheckLength, ...]:
    """Held-out distances between points that were measured, with the joint covariance of their ends."""
    network, asked = assembly.network, block.check_distances
    place = {name: j for j, name in enumerate(network.point_names)}
    names = [
        (block.points.names[i], block.points.names[j]) for i, j in zip(asked.first, asked.second, strict=True)
    ]
    known = [k for k, ends in enumerate(names) if all(end in place for end in ends)]
    if not known:
        return ()
    ends = dict.fromkeys(end for k in known for end in names[k])
    unknowns, joint = joint_covariance(factored(network, solution.state), [("point", end) for end in ends])
    lengths = []
    for k in known:
        first, second = names[k]
        apart = solution.points[place[second]] - solution.points[place[first]]
        length = float(np.linalg.norm(apart))
        along = dict(zip(XYZ, apart / length, strict=True))
        sign = {first: -1.0, second: 1.0}
        row = np.array([sign.get(unknown.of, 0.0) * along[unknown.parameter] for unknown in unknowns])
        sigma = float(np.sqrt(max(row @ joint @ row, 0.0)))
        given, given_sigma = float(asked.values[k]), float(asked.sigma[k])
        lengths.append(CheckLength(first, second, given, length - given, sigma, given_sigma))
    return tuple(lengths)


def observed_residuals(block: Block, assembly: NetworkOfBlock, solution: Solution) -> Floats:
    """Residuals (computed minus measured) in the unit and axes of the observations, shape (rays, 2)."""
    camera = block.images.camera[assembly.network.rays.image]
    sign = np.array([1.0, -1.0 if block.observations.axes == "pixel" else 1.0])
    return np.asarray(solution.residuals / plane_per_unit(block)[camera] * sign)


def given_points(assembly: NetworkOfBlock, solution: Solution) -> tuple[Floats, Floats]:
    """Adjusted points in the block's coordinates, shape (n, 3), and their covariance, (n, 3, 3)."""
    values = assembly.frame.to_given(solution.points)
    back = np.linalg.inv(assembly.frame.derivative(values))
    return values, np.asarray(back @ solution.point_covariance @ np.swapaxes(back, 1, 2))


def given_exposures(assembly: NetworkOfBlock, solution: Solution) -> tuple[Floats, Floats]:
    """Adjusted exterior orientation in the block's coordinates, shape (n, 6), and covariance, (n, 6, 6).

    The angles refer to the axes of the given coordinates at each image.
    """
    values = solution.exposures.copy()
    values[:, 3:] = assembly.frame.to_given(values[:, 3:])
    derivative = assembly.frame.derivative(values[:, 3:])
    turn = nearest_rotation(derivative)
    jacobian = np.broadcast_to(np.eye(6), solution.exposure_covariance.shape).copy()
    if not np.array_equal(turn, np.broadcast_to(np.eye(3), turn.shape)):
        matrix = solution.state.rotation @ turn
        values[:, :3] = angles_from_matrix(matrix)
        local = turn_per_angle(solution.exposures[:, :3])
        jacobian[:, :3, :3] = np.linalg.solve(turn_per_angle(values[:, :3]), local)
        jacobian[:, 3:, 3:] = np.linalg.inv(derivative)
    covariance = jacobian @ solution.exposure_covariance @ np.swapaxes(jacobian, 1, 2)
    return values, np.asarray(covariance)


def residuals_of(block: Block, assembly: NetworkOfBlock, solution: Solution) -> Residuals:
    """Residuals of all observations of a block; NaN for those that were not used."""
    seen = block.observations
    sign = np.array([1.0, -1.0 if seen.axes == "pixel" else 1.0])
    v, r, w = np.full((3, len(seen.image), 2), np.nan)
    v[assembly.rays] = observed_residuals(block, assembly, solution)
    r[assembly.rays] = solution.redundancy
    w[assembly.rays] = solution.standardised(assembly.network.rays.sigma) * sign
    return Residuals(block.images.names, block.points.names, seen.image, seen.point, seen.values, v, r, w)


def adjust_block(
    source: Path,
    output: Path,
    snooping: Test | None = None,
    report: Report | None = None,
    wanted: Wanted = NOTHING_MORE,
    read: Callable[[Path], Block] = read_block,
) -> Result:
    """Read a block, adjust it, write the results.

    raises PhotocalError: for bad input, an ill-posed network, or an output that cannot be written.
    """
    return write_adjusted(adjustment_of(read(source), snooping, report, wanted), source, output, wanted)


def write_adjusted(
    adjusted: AdjustedBlock, source: Path, output: Path, wanted: Wanted = NOTHING_MORE
) -> Result:
    """Write the results of an adjustment of the block that was read from `source`.

    raises PhotocalError: when the output cannot be written.
    """
    block, result = adjusted.block, adjusted.result
    root, setup = source, ""
    if source.is_file():
        setup = next(file.path for file in block.inputs if Path(file.path).name == source.name)
        root = source.parents[len(Path(setup).parts) - 1]
    # Inputs and run may move to another place together; the run folder alone need not.
    seen = Path(os.path.relpath(root.resolve(), output.resolve())).as_posix()
    facts = replace(result.block, source=seen, setup=setup)
    result = replace(result, block=facts)
    with output_folder(output) as aside:
        write_result(aside, result)
        more = adjusted.assembly, adjusted.solution, result.points.covariance, wanted
        write_more(aside, block, *more)
    return result


def adjust_network(block: Block, snooping: Test | None = None, wanted: Wanted = NOTHING_MORE) -> Result:
    """Adjust a block that is at hand; parameters and errors as of `adjust_block`."""
    return adjustment_of(block, snooping, None, wanted).result


def adjustment_of(
    block: Block,
    snooping: Test | None = None,
    report: Report | None = None,
    wanted: Wanted = NOTHING_MORE,
) -> AdjustedBlock:
    """Adjust a block and keep what the next step needs; parameters and errors as of `adjust_block`."""
    assembly = assemble(block)
    require_motion(block, assembly.network)
    with _control_in_doubt(assembly.network):
        assembly, solution = adjusted(assembly, snooping, report)
    components: tuple[ComponentFactor, ...] = ()
    if wanted.components:
        weighed = estimate_components(assembly.network, rays_by_camera(assembly.network), report=report)
        assembly, solution = replace(assembly, network=weighed.network), weighed.solution
        components = weighed.components
    result = result_of(block, assembly, solution, snooping=snooping, components=components)
    result = replace(result, **more_figures(block, assembly, result.points, wanted))
    _ENDED[id(result)] = ref(block), assembly, solution
    finalize(result, _ENDED.pop, id(result), None)
    return AdjustedBlock(block, assembly, solution, result)


@contextmanager
def _control_in_doubt(network: Network) -> Iterator[None]:
    """Say of an adjustment that fails which control has bent the block: exchanged, or far off."""
    try:
        yield
    except (IllPosedError, NotConvergedError) as refusal:
        # What is needed of a failure only takes no time of others.
        from photocal.hypotheses.causes import points_of
        from photocal.hypotheses.search import without_wrong_control

        without = without_wrong_control(network)
        cause = None if without is None else without[1].cause
        if cause is not None:
            names = ", ".join(points_of(network, cause))
            says = (
                f"first exchange the coordinates of {names}: each fits where the other is"
                if cause.fault.code == "control-exchanged"
                else f"first correct or leave out {names}: the other control contradicts that, and fits"
            )
            refusal.remedy = "; ".join(filter(None, (says, refusal.remedy)))
        raise


def seen_from_before(assembly: NetworkOfBlock) -> NetworkOfBlock:
    """Leave out points that no start value brings before their cameras."""
    network = assembly.network
    known = network.points.held.any(axis=1) | network.points.weight.any(axis=(1, 2))
    lost = behind_cameras(network.exposures, network.rays, network.points.values) & ~known
    return _part(assembly, *subset(network, ~lost[network.rays.point])) if lost.any() else assembly


def adjusted(
    assembly: NetworkOfBlock, snooping: Test | None = None, report: Report | None = None
) -> tuple[NetworkOfBlock, Solution]:
    """Adjust the network of an assembly; points that no start value brings before their cameras are not used.

    raises PhotocalError: for an ill-posed network.
    """
    assembly = seen_from_before(assembly)
    with because("calibration of the block"):
        if snooping is None:
            network, solution, readouts = adjust_moving_images(assembly.network, report)
        else:
            clean = snoop(assembly.network, snooping, report)
            assembly = _part(assembly, clean.network, clean.accepted, clean.points)
            network, solution, readouts = with_moving_images(assembly.network, clean.solution, report)
    return replace(assembly, network=network, readouts=readouts), solution
