"""Adjusting a block of tie points robustly: gross errors taken out, sigmas estimated from the residuals."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Self

import numpy as np

from photocal.adjustment.adjust import adjust
from photocal.adjustment.readout import READOUT, rolls_whatever_the_lens, with_readouts
from photocal.adjustment.shake import with_shake
from photocal.adjustment.solution import Solution
from photocal.adjustment.solver import CONVERGED
from photocal.adjustment.start.model import UNLIKE, robust_adjustment
from photocal.adjustment.state import State, start_state
from photocal.base.arrays import Flags, Floats, Integers
from photocal.base.errors import IllPosedError, NotConvergedError, PhotocalError
from photocal.base.operating_system import give_back_memory
from photocal.base.policy import policy
from photocal.block.model import Block, Images
from photocal.block.network import NetworkOfBlock, assemble
from photocal.block.results.adjusted import given_exposures, given_points
from photocal.geometry.camera import Camera, among
from photocal.geometry.oriented_images import given_poses, local_poses
from photocal.geometry.rotation import angles_from_matrix, matrix_from_angles
from photocal.measurement.features import made_once
from photocal.measurement.image_file import left_out_entry
from photocal.measurement.tie_block import (
    GROSS,
    fitting,
    place,
    ray_sigmas,
    with_ties,
    without_single_rays,
)
from photocal.measurement.tracks import Tracks, of_images

# A round takes out a third or less of what the one before has: after this share no later one would show.
_ROUNDS, FEW_LEFT = 8, 1e-4
# Without gross errors rays fit no less than with them: their sigma does not grow by more than this.
_STRAINED = 1.01
# Squared distance to the minimum, in standard deviations, that may be left of a round.
_ENOUGH = 1e-6
# Three rays give a pose that nothing checks.
FEWEST_RAYS = 6
Solved = tuple[Block, NetworkOfBlock, Solution]


@dataclass(frozen=True)
class AdjustedTies:
    """An adjusted block of tie points.

    block: with its tie points; start values are the adjusted ones, observed values stay as observed.
    start: the same without tie points: cameras as adjusted, the images that kept their hold.
    tracks: the tie points that are left, in the order of the block.
    values (images, 6): adjusted exterior orientations in the block's frame, of the observed ones too.
    """

    block: Block
    start: Block
    tracks: Tracks
    values: Floats
    assembly: NetworkOfBlock
    solution: Solution
    rejected: int
    left_out: tuple[dict[str, str], ...]

    @property
    def ray_sigma(self) -> Floats:
        """Standard deviation of each ray of the tie points, px."""
        return self.block.observations.sigma[-len(self.tracks.track) :, 0]

    @property
    def tie_sigma(self) -> float:
        """Standard deviation of the rays of tie points, root mean square, px."""
        return _usual(self.ray_sigma)

    def after(self, before: Self) -> Self:
        """Count what an adjustment before this one has rejected and left out, too."""
        left_out = (*before.left_out, *self.left_out)
        return replace(self, rejected=before.rejected + self.rejected, left_out=left_out)


@dataclass(frozen=True)
class _Ties:
    """What is being adjusted; images lose their hold, points and rays fall out.

    places (tracks, 3): of the points as they were adjusted last, in the block's coordinates; NaN for others.
    """

    start: Block
    poses: Floats
    tracks: Tracks
    sigma: Floats
    places: Floats
    left_out: tuple[dict[str, str], ...] = ()

    def some(self, rays: Flags) -> Self:
        """Keep some of the rays, and of those the points with two of them."""
        stay = np.bincount(self.tracks.track[rays], minlength=self.tracks.count) >= 2
        used = rays & stay[self.tracks.track]
        return replace(self, tracks=self.tracks.some(rays), sigma=self.sigma[used], places=self.places[stay])

    def adjusted(self, start: Block, assembly: NetworkOfBlock, solution: Solution) -> Self:
        """Images and points as an adjustment has placed them."""
        places = np.full((self.tracks.count, 3), np.nan)
        first = len(start.points.names)
        tie = assembly.points >= first
        places[assembly.points[tie] - first] = assembly.frame.to_given(solution.points[tie])
        return replace(self, start=start, poses=given_exposures(assembly, solution)[0], places=places)

    def held(self) -> tuple[Self, Block]:
        """Points that their rays determine, images that enough of them hold, and both as a block.

        Observed positions and angles stay as they were observed.
        """
        ties = self
        while True:
            images = replace(ties.start.images, values=ties.poses)
            # As they were adjusted last, the next adjustment begins near its end.
            values = place(replace(ties.start, images=images), ties.tracks, known=ties.places)
            known = np.asarray(np.isfinite(values).all(axis=1))
            if not known.all():
                ties, values = ties.some(known[ties.tracks.track]), values[known]
            held = replace(ties.start, images=_kept(ties.start, ties.poses))
            block = with_ties(held, ties.tracks, values, ties.sigma)
            count = np.bincount(block.observations.image, minlength=len(images.names))
            if (count >= FEWEST_RAYS).all():
                return ties, block
            ties = ties.without_few(count)

    def without_few(self, count: Integers) -> Self:
        """Take out the images that too few rays hold."""
        few, names = count < FEWEST_RAYS, self.start.images.names
        gone = [
            left_out_entry(names[k], f"only {count[k]} of its tie points fit the other images", "few-ties")
            for k in np.flatnonzero(few)
        ]
        if (~few).sum() < 2:
            raise IllPosedError(
                f"the tie points of no two images fit together ({gone[0]['image']}: {gone[0]['reason']})",
                "take images that overlap by 60 % and more, from different places",
            )
        ties = self.some(~few[self.tracks.image])
        return replace(
            ties,
            start=self.start.of_images(~few),
            poses=self.poses[~few],
            tracks=of_images(ties.tracks, ~few),
            left_out=(*self.left_out, *gone),
        )


def adjust_ties(start: Block, poses: Floats, tracks: Tracks, cache: Path | None = None) -> AdjustedTies:
    """Adjust a block with tie points; rays that do not fit and undetermined images are left out.

    cache: folder where the result is kept, for blocks that are adjusted again: those without marks.
    """
    # Patches are cut as the kept ones orient the images: what is left there would change which points match.
    near = _ENOUGH if cache is None else CONVERGED
    return made_once(
        cache, AdjustedTies, (start, poses, tracks), lambda: _adjusted(start, poses, tracks, None, near)
    )


def adjusted_again(before: AdjustedTies, start: Block, poses: Floats) -> AdjustedTies:
    """Adjust the rays that fitted an adjustment once more, with other control, cameras or sigmas.

    It begins with the sigmas that the rays were found to have, and leaves out what it now shows to be wrong.
    """
    return _adjusted(start, poses, before.tracks, before.ray_sigma, _ENOUGH)


def _adjusted(start: Block, poses: Floats, tracks: Tracks, sigma: Floats | None, near: float) -> AdjustedTies:
    total, given = len(tracks.track), start.cameras
    # What chose and placed the rays took more than they do.
    give_back_memory()
    ties = _fitting_ties(start, poses, tracks, sigma, near)
    # Readouts that the network did not bear while rays still fell out are tested once more.
    ties, block = replace(ties, start=_opened(ties.start, given)).held()
    ties, block, solved = _where_rays_meet(ties, block, held=False)
    start, assembly, solution = _with_room(*solved)
    start = _opened(start, given)
    if start.datum == "free":
        block = without_single_rays(block)
    values = given_exposures(assembly, solution)[0]
    points = block.points.values.copy()
    tie = assembly.points >= len(start.points.names)
    points[assembly.points[tie]] = given_points(assembly, solution)[0][tie]
    block = replace(
        block,
        cameras=start.cameras,
        datum=start.datum,
        images=_kept(start, values),
        points=replace(block.points, values=points),
    )
    rejected = total - len(ties.tracks.track)
    return AdjustedTies(block, start, ties.tracks, values, assembly, solution, rejected, ties.left_out)


def _fitting_ties(start: Block, poses: Floats, tracks: Tracks, sigma: Floats | None, near: float) -> _Ties:
    """The rays that fit, with their sigmas, and the block as they leave it.

    sigma: of the rays, where that is known: then the gross errors are out.
    near: squared distance to its minimum that a round may leave, see `adjust`; where it may leave some, the
        next one begins at the points of the last.
    """
    known = np.ones(len(tracks.track)) if sigma is None else sigma
    ties, block = _Ties(start, poses, tracks, known, _nowhere(tracks)).held()
    as_oriented = replace(block, images=replace(block.images, values=ties.poses))
    ties, block = ties.some(fitting(as_oriented)[len(ties.start.observations.image) :]).held()
    lost_before, usual_before = np.inf, np.inf if sigma is None else _usual(ties.sigma)
    for round_ in range(_ROUNDS):
        # Gross errors first: they must not go into the camera.
        held = round_ == 0 and sigma is None
        try:
            start, assembly, solution = _solved(ties.start, block, ties.poses, held=held, near=near)
        except (IllPosedError, NotConvergedError) as refusal:
            # Of a datum that positions hold loosely few gross errors make a valley without an end.
            if not _few_apart(refusal, block):
                ties, block = _robustly(ties, block).held()
            ties, block, (start, assembly, solution) = _where_rays_meet(ties, block, held=held)
        ties = ties.adjusted(start, assembly, solution)
        if near == CONVERGED:
            ties = replace(ties, places=_nowhere(ties.tracks))
        size, redundancy = by_ray(assembly, solution)
        tie_rays = slice(len(start.observations.image), None)
        own = ray_sigmas(ties.tracks.scale, ties.tracks.image, size[tie_rays], redundancy[tie_rays])
        # A residual shows the part of the error that the redundancy number says.
        standardised = size[tie_rays] / (
            own * np.sqrt(2 * np.maximum(redundancy[tie_rays], policy.least_checked))
        )
        good = standardised <= (2 * GROSS if held else GROSS)
        # Where those that are left fit less than before, no ray is to blame, but what is held of the cameras,
        # or what was brought in.
        strained = _usual(own) > _STRAINED * usual_before
        if strained:
            good = np.ones(len(own), dtype=np.bool_)
        if not held:
            # Whether they roll is shown once, and asked again when all rays are chosen.
            ties = replace(ties, start=replace(start, cameras=shutters_closed(start.cameras)))
        ties, block = replace(ties, sigma=own).some(good).held()
        lost = float(np.mean(~good))
        # Gross errors become fewer; what does not is what the camera, or what is held of it, lacks.
        if strained or (not held and (lost <= FEW_LEFT or lost >= lost_before)):
            break
        lost_before, usual_before = (np.inf, np.inf) if held else (lost, _usual(own))
    return ties


def _usual(sigma: Floats) -> float:
    """Root mean square of the standard deviations of rays."""
    return float(np.sqrt(np.mean(sigma**2)))


def with_vibration(adjusted: AdjustedTies) -> AdjustedTies:
    """Adjust once more where images are found to vibrate while their rows are read.

    Else that makes the rays seem less precise, and takes c along.
    """
    network, solution = with_shake(adjusted.assembly.network, adjusted.solution)
    if network is adjusted.assembly.network:
        return adjusted
    cameras = tuple(
        replace(camera.with_values(values), shake=shaking.shake)
        for camera, shaking, values in zip(
            adjusted.start.cameras, network.cameras, solution.cameras, strict=True
        )
    )
    start = replace(adjusted.start, cameras=cameras)
    return adjusted_again(adjusted, start, adjusted.values).after(adjusted)


def _kept(start: Block, poses: Floats) -> Images:
    images = start.images
    return replace(images, values=np.where(np.isfinite(images.sigma), images.values, poses))


def _solved(start: Block, block: Block, poses: Floats, *, held: bool, near: float = CONVERGED) -> Solved:
    """Adjust, and give the cameras their new values; where the block does not bear them they are held."""
    try:
        return _solved_with(start, block, poses, _held(start.cameras) if held else start.cameras, near)
    except (IllPosedError, NotConvergedError) as refusal:
        # These points go first.
        if _few_apart(refusal, block):
            raise
        # A readout, and how each image moves in it, is what few images bear least.
        if any(camera.rolling for camera in start.cameras):
            plain = replace(start, cameras=without_readouts(start.cameras))
            return _solved(plain, block, poses, held=held, near=near)
        if not any(camera.estimated.any() for camera in start.cameras):
            raise
        start = start if held else replace(start, cameras=_held(start.cameras))
        return _solved_with(start, block, poses, _held(start.cameras), near)


def _solved_with(
    start: Block, block: Block, poses: Floats, cameras: tuple[Camera, ...], near: float
) -> Solved:
    assembly, state = assembled(replace(block, cameras=cameras), poses)
    solution = adjust(assembly.network, state=state, near=near)
    # A rolling shutter looks like gross errors; who holds the lens cannot tell it.
    asked = any(camera.shutter == "unknown" and camera.estimated.any() for camera in cameras)
    if asked and rolls_whatever_the_lens(assembly.network, solution):
        network, solution, _ = with_readouts(assembly.network, solution)
        # What the network did not bear it will not bear in the next round.
        shut = [
            replace(camera, shutter="global") if camera.shutter == "unknown" else camera
            for camera in network.cameras
        ]
        assembly = replace(assembly, network=replace(network, cameras=tuple(shut)))
    return _taken(start, assembly, solution)


def _with_room(start: Block, assembly: NetworkOfBlock, solution: Solution) -> Solved:
    """Let images move as far as their readouts tell, which were those of the round before.

    Only once all rays are chosen: in each round again it would take most of the time.
    """
    if not any(camera.rolling and camera.estimated[READOUT] for camera in assembly.network.cameras):
        return start, assembly, solution
    try:
        network, solution, _ = with_readouts(assembly.network, solution)
    except (IllPosedError, NotConvergedError):
        return start, assembly, solution
    return _taken(start, replace(assembly, network=network), solution)


def _taken(start: Block, assembly: NetworkOfBlock, solution: Solution) -> Solved:
    """The block with what an adjustment found of its cameras."""
    better = tuple(map(_better, start.cameras, assembly.network.cameras, solution.cameras))
    return replace(start, cameras=better), assembly, solution


def _better(camera: Camera, adjusted: Camera, values: Floats) -> Camera:
    """The camera with adjusted values, and with the rolling shutter that it was found to have."""
    if adjusted.rolling and not camera.rolling:
        rolls, direction = camera.estimated | among("readout"), adjusted.readout_direction
        camera = replace(camera, estimated=rolls, shutter="rolling", readout_direction=direction)
    elif not camera.rolling:
        camera = replace(camera, shutter=adjusted.shutter)
    return replace(camera, values=values, given=camera.values if camera.given is None else camera.given)


def _opened(start: Block, given: tuple[Camera, ...]) -> Block:
    """The block with shutters that were unknown to be tested again, unless they were found to roll."""
    unknown = {camera.id for camera in given if camera.shutter == "unknown" and not camera.rolling}
    cameras = [
        replace(camera, shutter="unknown") if camera.id in unknown and not camera.rolling else camera
        for camera in start.cameras
    ]
    return replace(start, cameras=tuple(cameras))


def reopened(adjusted: AdjustedTies, given: Sequence[Camera]) -> AdjustedTies:
    """An adjustment with closed shutters, those given as unknown open again, with what moves in them."""
    block = _opened(adjusted.block, tuple(given))
    assembly, state = assembled(block, adjusted.values)
    return replace(adjusted, block=block, assembly=assembly, solution=replace(adjusted.solution, state=state))


def assembled(block: Block, poses: Floats) -> tuple[NetworkOfBlock, State]:
    """Make the network of a block with tie points, and the state to start from, where its rays meet.

    Priors observe what was known of the cameras beforehand, not what came of it in between; positions and
    angles that were observed may be far from the poses, too.
    """
    as_given = tuple(
        camera
        if camera.given is None
        else camera.with_values(
            np.where(camera.estimated & np.isfinite(camera.prior_sigma), camera.given, camera.values)
        )
        for camera in block.cameras
    )
    assembly = assemble(replace(block, cameras=as_given))
    local, start = local_poses(assembly.frame, poses), start_state(assembly.network)
    # Seen from what was observed, points may have lain behind the cameras, and were placed again.
    tie = block.points.of_role("tie")[assembly.points]
    given = assembly.frame.to_local(block.points.values[assembly.points])
    points = np.where(tie[:, None] & np.isfinite(given), given, start.points)
    cameras = np.array([camera.values for camera in block.cameras])
    rotation = matrix_from_angles(local[:, :3])
    return assembly, replace(start, cameras=cameras, rotation=rotation, centre=local[:, 3:], points=points)


def _where_rays_meet(ties: _Ties, block: Block, *, held: bool) -> tuple[_Ties, Block, Solved]:
    """Adjust at last, without the tie points whose rays turn out not to meet."""
    # Few of them are wrong themselves; when many do not meet, positions or control may keep them apart.
    solved: Callable[..., Solved] = _solved
    while True:
        try:
            return ties, block, solved(ties.start, block, ties.poses, held=held)
        except (IllPosedError, NotConvergedError) as refusal:
            names = block.points.names[len(ties.start.points.names) :]
            apart = set(getattr(refusal, "points", ())) & set(names)
            if solved is _solved and not _few_apart(refusal, block):
                solved = _solved_at_last
                continue
            if not apart:
                raise
        lost = np.array([name in apart for name in names])
        ties, block = ties.some(~lost[ties.tracks.track]).held()


def _few_apart(refusal: PhotocalError, block: Block) -> bool:
    """Whether all that is wrong are some tie points whose rays do not meet."""
    ties = set(np.array(block.points.names, dtype=object)[block.points.of_role("tie")])
    apart = set(getattr(refusal, "points", ()))
    # Share of the tie points that may not meet for reasons of their own.
    few_apart = 0.02
    return bool(apart) and apart <= ties and len(apart) <= few_apart * len(ties)


def _solved_at_last(start: Block, block: Block, poses: Floats, *, held: bool) -> Solved:
    """Adjust; where positions and control do not bear the datum, the block is adjusted free."""
    try:
        return _solved(start, block, poses, held=held)
    except (IllPosedError, NotConvergedError):
        return _solved(_free(start), _free(block), poses, held=held)


def _free(block: Block) -> Block:
    images = replace(block.images, sigma=np.full_like(block.images.sigma, np.inf))
    return replace(without_single_rays(block), datum="free", images=images)


def _robustly(ties: _Ties, block: Block) -> _Ties:
    """Ties without the rays that a robust adjustment leaves far off, at its poses."""
    assembly, start = assembled(replace(block, cameras=_held(block.cameras)), ties.poses)
    state, ray_fits = robust_adjustment(assembly.network, start)
    fit = np.empty(len(assembly.rays))
    fit[assembly.rays] = ray_fits
    poses = np.hstack([angles_from_matrix(state.rotation), state.centre])
    good = fit <= UNLIKE * np.median(fit)
    ties = ties.some(good[len(ties.start.observations.image) :])
    return replace(ties, poses=given_poses(assembly.frame, poses), places=_nowhere(ties.tracks))


def _nowhere(tracks: Tracks) -> Floats:
    """Places of points of which none is known."""
    return np.full((tracks.count, 3), np.nan)


def _held(cameras: tuple[Camera, ...]) -> tuple[Camera, ...]:
    return tuple(replace(camera, estimated=np.zeros_like(camera.estimated)) for camera in cameras)


def shutters_closed(cameras: Sequence[Camera]) -> tuple[Camera, ...]:
    """The cameras with shutters that are not tested, unless they are known to roll."""
    return tuple(camera if camera.rolling else replace(camera, shutter="global") for camera in cameras)


def without_readouts(cameras: tuple[Camera, ...]) -> tuple[Camera, ...]:
    """The cameras as if no shutter rolled: what is left of it goes into the residuals."""
    readout = among("readout")
    return tuple(
        replace(
            camera.changed(readout=0.0),
            estimated=camera.estimated & ~readout,
            prior_sigma=np.where(readout, np.inf, camera.prior_sigma),
            shutter="global",
            shake=(),
        )
        if camera.rolling
        else camera
        for camera in cameras
    )


def pixel_residuals(assembly: NetworkOfBlock, solution: Solution) -> Floats:
    """Residuals in the order of the block's observations, px, whatever the unit of the cameras; (n, 2)."""
    network = assembly.network
    pitch = np.array([camera.pitch for camera in network.cameras])[
        network.exposures.camera[network.rays.image]
    ]
    residuals = np.empty_like(solution.residuals)
    residuals[assembly.rays] = solution.residuals / pitch
    return residuals


def by_ray(assembly: NetworkOfBlock, solution: Solution) -> tuple[Floats, Floats]:
    """Length of the residual, px, and mean redundancy number of each observation of the block."""
    size = np.hypot(*pixel_residuals(assembly, solution).T)
    redundancy = np.empty(len(assembly.rays))
    redundancy[assembly.rays] = solution.redundancy.mean(axis=1)
    return size, redundancy


def ray_rms_px(adjusted: AdjustedTies) -> float:
    """What is left in the rays, each as its redundancy shows it, px."""
    return float(adjusted.tie_sigma * np.sqrt(adjusted.solution.variance_factor))
