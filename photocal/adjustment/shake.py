"""Vibration within the readout of a rolling shutter: whether images shake, and by how much."""

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from scipy import special

from photocal.adjustment.adjust import adjust
from photocal.adjustment.kernels.data import POSE, Design, Values, columns
from photocal.adjustment.kernels.ray import ray_rows
from photocal.adjustment.network import Network, own_parameters
from photocal.adjustment.normal import prepare, values_of
from photocal.adjustment.solution import Solution
from photocal.adjustment.solver import Iteration
from photocal.adjustment.state import State
from photocal.base.arrays import Flags, Floats
from photocal.base.compiled import compiled
from photocal.base.errors import IllPosedError, NotConvergedError
from photocal.base.policy import policy
from photocal.geometry.camera import MOTION, OWN, PARAMETERS, SHAKE_DEGREES
from photocal.geometry.lens import Scratch, scratch

# Sigmas are estimated until they change by less than this share.
SETTLED, ROUNDS = 0.1, 6
# A displacement from a steady movement by less than this share of a ray's sigma changes no figure, however
# significant: it is a four-hundredth of its variance.
SHOWS = 0.05
# Fewer images than these tell nothing of how they differ; an image with fewer rays for each of its unknowns
# tells nothing of itself.
FEWEST, RAYS_EACH = 5, 2.0
_FIRST = len(PARAMETERS + MOTION)


@dataclass(frozen=True)
class _Local:
    """Normal equations of each image of a camera alone, for how it shakes; pose and movement eliminated.

    matrix (n, 15, 15), pull (n, 15): in units of the image's own noise.
    spare (n,): redundancy of each image's rays.
    """

    matrix: Floats
    pull: Floats
    spare: Floats


def with_shake(
    network: Network, solution: Solution, report: Callable[[Iteration], None] | None = None
) -> tuple[Network, Solution]:
    """Let images turn to and fro within their readout where the residuals say that they do.

    The pose and the movement of an image leave what vibrates within its readout, and neighbouring rays of a
    line share it: as independent noise it would make all sigmas too small. Every image gets Legendre
    polynomials of its line as unknowns, observed as zero with sigmas of each degree that are estimated as
    variance components (Foerstner 1979), beginning with those that cameras already have. A network that
    does not bear them stays as it is.
    """
    sigmas = {k: np.array(camera.shake[1:]) for k, camera in enumerate(network.cameras) if camera.shake}
    sigmas |= {
        k: _start(local)
        for k, local in _by_camera(network, solution).items()
        if k not in sigmas and _shakes(local) < policy.significance
    }
    if not sigmas:
        return network, solution
    given = network, solution
    for _ in range(ROUNDS):
        before, network = network, _with(network, sigmas)
        try:
            solution = adjust(network, report, carried(before, network, solution.state))
        except (IllPosedError, NotConvergedError):
            # Few images do not bear the lens and so many unknowns: what they share stays.
            return given
        latest = {k: _estimated(network, solution, k) for k in sigmas}
        change = [abs(a - b) > SETTLED * b for k in latest for a, b in zip(latest[k], sigmas[k], strict=True)]
        if not any(change):
            break
        sigmas = latest
    least = SHOWS * float(np.median(network.rays.sigma))
    still = all(not any(latest[k]) or network.cameras[k].shaken < least for k in latest)
    return given if still else (network, solution)


def carried(before: Network, after: Network, state: State) -> State:
    """A state with the deviations that images of another network of the same images have."""
    whole = np.zeros((len(before.exposures.camera), len(OWN)))
    parameters = own_parameters(before)
    image, place = np.nonzero(parameters >= 0)
    whole[image, parameters[image, place]] = state.deviations[image, place]
    parameters = own_parameters(after)
    taken = np.take_along_axis(whole, np.maximum(parameters, 0), axis=1)
    return replace(state, deviations=np.where(parameters >= 0, taken, 0.0))


def _with(network: Network, sigmas: dict[int, Floats]) -> Network:
    """Cameras whose images shake; they turn as a whole by about twice as much as in any degree."""
    cameras = tuple(
        replace(camera, shake=(2.0 * max(sigmas[k]), *sigmas[k])) if k in sigmas else camera
        for k, camera in enumerate(network.cameras)
    )
    return replace(network, cameras=cameras)


def _by_camera(network: Network, solution: Solution) -> dict[int, _Local]:
    """Normal equations of the images of every camera whose shutter rolls."""
    exposures = network.exposures
    rolling = [k for k, camera in enumerate(network.cameras) if camera.rolling and camera.value("readout")]
    if exposures.motion is None or exposures.motion_sigma is None or not rolling:
        return {}
    free = _with(network, {k: np.ones(len(SHAKE_DEGREES)) for k in rolling})
    problem = prepare(free)
    width = problem.layout.width
    count = len(exposures.camera)
    matrix, pull, squares = np.zeros((count, width, width)), np.zeros((count, width)), np.zeros(count)
    values = values_of(problem, carried(network, free, solution.state))
    of_images(problem.design, values, scratch(width), matrix, pull, squares)
    rays = np.bincount(network.rays.image, minlength=count)
    spare = np.bincount(network.rays.image, solution.redundancy.sum(axis=1), count).astype(float)
    parameters = own_parameters(free)
    enough = rays > RAYS_EACH * width
    locals_ = {}
    for k in rolling:
        images = np.flatnonzero((exposures.camera == k) & enough)
        if len(images) >= FEWEST:
            shaking = np.pad(parameters[images[0]] >= _FIRST, (POSE, width - POSE - parameters.shape[1]))
            used = np.diagonal(matrix[images], axis1=1, axis2=2).min(axis=0) > 0
            locals_[k] = _local(matrix[images], pull[images], squares[images], spare[images], shaking, used)
    return locals_


def _local(
    matrix: Floats, pull: Floats, squares: Floats, spare: Floats, shaking: Flags, used: Flags
) -> _Local:
    rest = used & ~shaking
    mixed = matrix[:, shaking][:, :, rest]
    taken = np.linalg.solve(matrix[:, rest][:, :, rest], np.swapaxes(mixed, 1, 2))
    normal = matrix[:, shaking][:, :, shaking] - mixed @ taken
    left = pull[:, shaking] - np.einsum("nab,na->nb", taken, pull[:, rest])
    explained = np.einsum("na,na->n", left, np.linalg.solve(normal, left[:, :, None])[:, :, 0])
    remaining = np.maximum(spare - left.shape[1], 1.0)
    noise = np.maximum(squares - explained, 1e-12) / remaining
    return _Local(normal / noise[:, None, None], left / noise[:, None], remaining)


def _shakes(local: _Local) -> float:
    """Probability of a camera at rest: F of what the images have each for itself."""
    # What all have alike is the lens. Object points as known make the test a cautious one.
    alone = np.linalg.solve(local.matrix, local.pull[:, :, None])[:, :, 0]
    together = np.linalg.solve(local.matrix.sum(axis=0), local.pull.sum(axis=0))
    fall = np.sum(local.pull * alone) - local.pull.sum(axis=0) @ together
    free = (len(alone) - 1) * alone.shape[1]
    return float(special.fdtrc(free, local.spare.sum(), fall / free))


def _start(local: _Local) -> Floats:
    """Sigmas of the degrees from each image alone, rad."""
    inverse = np.linalg.inv(local.matrix)
    alone = np.einsum("nab,nb->na", inverse, local.pull)
    noise = np.diagonal(inverse, axis1=1, axis2=2)
    by_degree = (-1, len(SHAKE_DEGREES), 3)
    square = np.mean((alone**2 - noise).reshape(by_degree), axis=(0, 2))
    return np.asarray(np.sqrt(np.maximum(square, 0.01 * np.mean(noise.reshape(by_degree), axis=(0, 2)))))


def _estimated(network: Network, solution: Solution, camera: int) -> Floats:
    """Sigmas of the degrees from the adjustment with those that it was given; zero where nothing shows."""
    given, photo_variant = np.array(network.cameras[camera].shake[1:]), solution.photo_variant
    shaking = (network.exposures.camera[photo_variant.image] == camera) & (photo_variant.parameter >= _FIRST)
    degree = (photo_variant.parameter[shaking] - _FIRST) // 3
    squares = np.bincount(degree, photo_variant.deviations[shaking] ** 2, len(given))
    share = (photo_variant.deviation_sigma[shaking] / given[degree]) ** 2
    redundancy = np.bincount(degree, 1.0 - share, len(given))
    return np.asarray(np.sqrt(np.where(redundancy > 1.0, squares / np.maximum(redundancy, 1.0), 0.0)))


@compiled
def of_images(
    design: Design, values: Values, room: Scratch, matrix: Floats, pull: Floats, squares: Floats
) -> None:
    """Add what the rays of each image give to its own normal equations."""
    by_image = room.by_image
    for j in range(len(design.ray_start) - 1):
        for r in range(design.ray_start[j], design.ray_start[j + 1]):
            i = design.ray_image[r]
            vx, vy = ray_rows(design, values, r, i, j, room)
            px, py = design.weight[r, 0], design.weight[r, 1]
            squares[i] += px * vx * vx + py * vy * vy
            for a in range(columns(design)):
                ax, ay = px * by_image[0, a], py * by_image[1, a]
                pull[i, a] -= ax * vx + ay * vy
                for b in range(columns(design)):
                    matrix[i, a, b] += ax * by_image[0, b] + ay * by_image[1, b]
