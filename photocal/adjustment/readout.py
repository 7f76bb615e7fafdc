"""What gusts move while a shutter rolls, or between the exposures of heads: for times that are found."""

import hashlib
import pickle
from collections.abc import Callable, Iterable
from contextlib import suppress
from dataclasses import asdict, dataclass, field, replace
from functools import lru_cache
from typing import cast

import numpy as np
from scipy import special

from photocal.adjustment.adjust import adjust, minimum_of
from photocal.adjustment.envelope import solve
from photocal.adjustment.factored import factored
from photocal.adjustment.network import Network
from photocal.adjustment.normal import Problem, prepare, values_of
from photocal.adjustment.rig import LATER
from photocal.adjustment.sensitivity import along
from photocal.adjustment.shake import with_shake
from photocal.adjustment.solution import Solution
from photocal.adjustment.solver import Iteration
from photocal.adjustment.state import head_values
from photocal.base.errors import IllPosedError, NotConvergedError
from photocal.base.policy import policy
from photocal.geometry.camera import PARAMETERS, Camera, ReadoutDirection, among

Report = Callable[[Iteration], None]

READOUT = PARAMETERS.index("readout")
# The sigmas of gusts belong to the readout when it changes by less than this share; those of frames, too.
SETTLED = 0.02
ROUNDS = 5
# Squared distance to the minimum, in units of the standard deviations, that may be left meanwhile.
_ROUGHLY = 1e-3
# A readout on trial that the network does not bear is approached without an end: in so many iterations v'Pv
# falls by less than this, a part of what makes a readout significant, and steps by less than so many times.
# That says nothing where much is explained already: a trial that left 0.60 of v'Pv went on so for twenty
# iterations, to where the valley falls, and found 48 ms. Trials of another flight left 0.95 and ended in a
# nearly singular network. None of 31 simulated flights with readouts of 3 to 40 ms and an unknown shutter
# stagnates.
_STAGNANT, _LITTLE, _SHORTER, _MUCH_LEFT = 10, 4.0, 10.0, 0.8
_LENS = tuple(PARAMETERS.index(name) for name in ("c", "x0", "y0"))


@dataclass(frozen=True)
class Readout:
    """What the rays say of a camera's readout.

    value, sigma: seconds.
    p_value: of a global shutter, two-sided, with sigma larger where the residuals are larger than stated.
    estimated: whether it is an unknown of the adjustment: given as one, or found significant.
    effect: root mean square of what it moves the rays by, in the unit of the camera.
    way: how far the camera usually flies during it, m.
    """

    camera: str
    value: float
    sigma: float
    p_value: float
    estimated: bool
    effect: float
    way: float


def with_readouts(
    network: Network, solution: Solution, report: Report | None = None
) -> tuple[Network, Solution, tuple[Readout, ...]]:
    """Test the readout where the shutter is unknown, and let the sigmas of gusts follow estimated readouts.

    One that is significant must be so beside a scale of y against x, too: what that explains is no readout.

    A movement that departs from the given motion has that motion's sigma times the readout. With a readout
    of zero nothing departs, and the test of a global shutter is exact.
    """
    # Standard deviations that its estimate must be away from zero, on the side that the test found.
    borne_sigmas = 2.0
    doubtful = [
        k for k, camera in enumerate(network.cameras) if camera.shutter == "unknown" and not camera.rolling
    ]
    tests, known = dict[int, Readout](), dict[int, Camera]()
    given = network, solution, ()
    try:
        if doubtful and network.exposures.motion is not None:
            freed = {k: _freed(network.cameras[k]) for k in doubtful}
            tests = _tested(_with(network, freed), solution, doubtful)
            rolling = [k for k, test in tests.items() if test.p_value < policy.significance]
            beside = {k: with_loose_sides(freed[k]) for k in rolling}
            tests |= _tested(_with(network, beside), solution, rolling) if rolling else {}
            # The test tells the readout well enough for the sigmas of gusts to begin with.
            known = {
                k: _forward(freed[k].changed(readout=test.value))
                for k, test in tests.items()
                if test.p_value < policy.significance
            }
        network, solution = _settled(_with(network, known), solution, report, changed=bool(known))
        # Free to move as much as such a readout lets them, the images must still bear it.
        borne = [readout_of(network, solution, k) for k in known]
        if any(readout.value < borne_sigmas * readout.sigma for readout in borne):
            return given[0], given[1], tuple(tests[k] for k in sorted(tests))
    except (IllPosedError, NotConvergedError):
        # A readout that nobody has stated and the network does not bear leaves it as it was.
        if doubtful:
            return given
        raise
    estimated = [k for k, camera in enumerate(network.cameras) if camera.estimated[READOUT]]
    tests |= {k: readout_of(network, solution, k) for k in estimated}
    return network, solution, tuple(tests[k] for k in sorted(tests))


def _settled(
    network: Network, solution: Solution, report: Report | None, *, changed: bool
) -> tuple[Network, Solution]:
    """Adjust until the sigmas of gusts belong to the readouts; `solution` is of a network before a change."""
    if not changed and _belong(network, _room(solution, _free(network))):
        return network, solution
    state, moved = solution.state, changed
    roughly = _unless_stagnant(report, solution.chi_squared) if changed else report
    if changed:
        state = minimum_of(network, roughly, state, _ROUGHLY)[1].state
    free = _free(network)
    before = dict[int, tuple[float, float]]()
    for _ in range(ROUNDS):
        values = {k: float(state.cameras[k, READOUT]) for k in free}
        if _belong(network, values):
            break
        pairs = {k: (float(network.cameras[k].values[READOUT]), v) for k, v in values.items()}
        settling = {k: _where_they_meet(before.get(k), pair) for k, pair in pairs.items()}
        network, moved = _with_values(network, settling), True
        before, state = pairs, minimum_of(network, roughly, state, _ROUGHLY)[1].state
    solution = adjust(network, report, state) if moved else solution
    room = _room(solution, free)
    if _belong(network, room):
        return network, solution
    network = _with_values(network, room)
    return network, adjust(network, report, solution.state)


def _unless_stagnant(report: Report | None, closed: float) -> Report:
    """Report that ends a trial which stagnates.

    closed: v'Pv with closed shutters.
    """
    steps = list[Iteration]()

    def line(iteration: Iteration) -> None:
        """Pass an iteration on, or end the trial."""
        if iteration.number == 1:
            steps.clear()
        steps.append(iteration)
        if len(steps) >= 2 * _STAGNANT and iteration.chi_squared > _MUCH_LEFT * closed:
            before = steps[-1 - _STAGNANT]
            gain = before.chi_squared - iteration.chi_squared
            if gain < _LITTLE and iteration.decrement * _SHORTER > before.decrement:
                raise NotConvergedError(
                    f"a readout is not found in {len(steps)} iterations", "state the shutter of the camera"
                )
        if report:
            report(iteration)

    return line


def _free(network: Network) -> list[int]:
    """Cameras whose readout nobody observed: a prior observes the value that is given, and that one stays."""
    return [
        k
        for k, camera in enumerate(network.cameras)
        if camera.estimated[READOUT] and np.isinf(camera.prior_sigma[READOUT])
    ]


def with_room(network: Network, solution: Solution, cameras: Iterable[int]) -> Network:
    """Let gusts move the images of some cameras as far as their readouts tell."""
    return _with_values(network, _room(solution, cameras))


def _room(solution: Solution, cameras: Iterable[int]) -> dict[int, float]:
    """Readouts that gusts get their room by."""
    # Gusts get room for so many sigmas of the readout beside itself. Where both come out short, its error e
    # and sigma s together, e / s has a variance of 1 + 9 (s / readout)^2, to second order.
    room_sigmas = 3.0
    variance = {k: float(solution.camera_covariance[k, READOUT, READOUT]) for k in cameras}
    return {
        k: float(np.sqrt(solution.cameras[k, READOUT] ** 2 + room_sigmas**2 * v)) for k, v in variance.items()
    }


def _belong(network: Network, readouts: dict[int, float]) -> bool:
    """Whether given readouts are these."""
    given = network.cameras
    return all(abs(v - given[k].values[READOUT]) <= SETTLED * abs(v) for k, v in readouts.items())


def _where_they_meet(before: tuple[float, float] | None, now: tuple[float, float]) -> float:
    """Readout to give next, from those that were given and found: where both are the same, by the secant."""
    # A larger one gives gusts more room, and may be found smaller by more than it was larger.
    given, estimate = now
    if before is None or given == before[0]:
        return estimate
    slope = min((estimate - before[1]) / (given - before[0]), 0.5)
    return given + (estimate - given) / (1.0 - slope)


def with_lags(network: Network, solution: Solution, report: Report | None = None) -> tuple[Network, Solution]:
    """Let gusts move a frame for the times between its heads that are found, until its sigmas stay.

    How much later a head exposes is seldom known beforehand. The mean square of that time is the square of
    what is found and its variance: a time that is little known stays loose.
    """
    given, camera = (network, solution), network.exposures.camera
    for _ in range(ROUNDS if network.rig.gust.any() else 0):
        values = head_values(network, solution.state.common)
        variance = np.diag(solution.common_covariance)[-values.size :].reshape(values.shape)[:, LATER]
        # Larger where residuals are larger than stated.
        sigma = np.sqrt(variance * max(1.0, float(np.nan_to_num(solution.variance_factor))))
        rig = replace(network.rig, lag=np.column_stack([values[:, LATER], sigma]))
        if np.allclose(
            rig.relation_sigma(camera), network.rig.relation_sigma(camera), rtol=SETTLED, atol=0.0
        ):
            break
        network = replace(network, rig=rig)
        try:
            solution = adjust(network, report, solution.state)
        except (IllPosedError, NotConvergedError):
            return given
    return network, solution


def with_moving_images(
    network: Network, solution: Solution, report: Report | None = None
) -> tuple[Network, Solution, tuple[Readout, ...]]:
    """Estimate readouts and times of heads, and let images shake that vibrate while they are read.

    See `with_readouts`, `with_lags` and `with_shake`.
    """
    rolling, solution, readouts = with_readouts(network, solution, report)
    network, solution = with_lags(rolling, solution, report)
    shaking, solution = with_shake(network, solution, report)
    if shaking is not network:
        network = shaking
        # What vibrates may have passed for readout: gusts get their room anew, where images bear it.
        with suppress(IllPosedError, NotConvergedError):
            network, solution = _settled(shaking, solution, report, changed=False)
    place = {camera.id: k for k, camera in enumerate(network.cameras)}
    if network is not rolling:
        readouts = tuple(
            readout_of(network, solution, place[readout.camera]) if readout.estimated else readout
            for readout in readouts
        )
    return network, solution, readouts


Moved = tuple[Network, Solution, tuple[Readout, ...]]


def adjust_moving_images(network: Network, report: Report | None = None) -> Moved:
    """Adjust a network, see `adjust`, and what `with_moving_images` adds to it.

    Calibration and check of a flight ask for the same: where images may move the last one is kept.
    """
    rolls = any(camera.shutter == "unknown" or camera.estimated[READOUT] for camera in network.cameras)
    if network.exposures.motion is None or not rolls or network.relations.further:
        return with_moving_images(network, adjust(network, report), report)
    # Its fields alone: what it has worked out since is no content.
    content = hashlib.sha256(pickle.dumps(asdict(network))).digest()
    return _last_moved(_Asked(content, network, report))


@dataclass(frozen=True)
class _Asked:
    """A network by its content."""

    content: bytes
    network: Network = field(compare=False)
    report: Report | None = field(compare=False)


@lru_cache(maxsize=1)
def _last_moved(asked: _Asked) -> Moved:
    return with_moving_images(asked.network, adjust(asked.network, asked.report), asked.report)


def rolls_whatever_the_lens(network: Network, solution: Solution) -> bool:
    """Whether a readout is significant although c and principal point are held at values that are guesses.

    What a wrong principal point does over a flight there and back is much like a readout.
    """
    # What c and principal point may be wrong by where a lens is held that nobody has calibrated, as a share
    # of c. Of 12 simulated flights with c 0 to 3 % and the principal point 30 to 100 px off, each with a
    # readout of 0 and of 30 ms, shares from 0.002 to 1 give the same outcomes.
    lens_share = 0.05
    doubtful = {
        k: with_loose_sides(_loosened(_freed(camera), _LENS, lens_share * camera.value("c")))
        for k, camera in enumerate(network.cameras)
        if camera.shutter == "unknown" and not camera.rolling
    }
    try:
        tests = _tested(_with(network, doubtful), solution, list(doubtful))
    except IllPosedError:
        return False
    return any(test.p_value < policy.significance for test in tests.values())


def left_by_movement(network: Network, solution: Solution) -> float:
    """What is left of v'Pv, as a share, where images may move during a usual readout; 1 if none is unknown.

    Strips to and fro with the camera turned hide the duration of the readout: the motion of the flight acts
    alike on all images, so c and the positions absorb it. They do not absorb the motion by gusts.
    """
    # Readouts of cameras on small aircraft lie about this.
    usual_s = 0.02
    doubtful = {
        k: _freed(camera).changed(readout=usual_s)
        for k, camera in enumerate(network.cameras)
        if camera.shutter == "unknown" and not camera.rolling
    }
    if not doubtful or network.exposures.motion is None:
        return 1.0
    watched = _unless_stagnant(None, solution.chi_squared)
    try:
        minimum = minimum_of(_with(network, doubtful), watched, solution.state, _ROUGHLY)[1]
    except (IllPosedError, NotConvergedError):
        return 1.0
    return minimum.iterations[-1].chi_squared / solution.chi_squared


def with_loose_sides(camera: Camera) -> Camera:
    """Give a camera a scale of y against x as unknown, observed as one, if it has not."""
    # What the sides of pixels may differ by, as a share: sensors have square ones, but pictures are
    # resampled. Lines that are read while the camera flies on look much like that.
    square = 5e-5
    return _loosened(camera, (PARAMETERS.index("B2" if camera.affinity_form == "tank" else "B1"),), square)


def _loosened(camera: Camera, parameters: Iterable[int], sigma: float) -> Camera:
    """The camera with these parameters as unknowns, observed as they are where they were held."""
    held = [k for k in parameters if not camera.estimated[k]]
    estimated, prior = camera.estimated.copy(), camera.prior_sigma.copy()
    estimated[held], prior[held] = True, sigma
    return replace(camera, estimated=estimated, prior_sigma=prior)


def _tested(freed: Network, solution: Solution, cameras: list[int]) -> dict[int, Readout]:
    """Readouts of cameras that are adjusted as global, by the first step of the adjustment that frees them.

    The step and its covariance are the estimate where it is near zero, which is what the test asks.
    """
    at = factored(freed, solution.state)
    step = solve(at.problem.layout.envelope, at.normal.matrix, -at.normal.gradient)
    tests = {}
    for k in cameras:
        column = _column(at.problem, k)
        unit = np.zeros(at.problem.layout.size)
        unit[column] = 1.0
        variance = float(solve(at.problem.layout.envelope, at.normal.matrix, unit)[column])
        value, sigma = float(step[column]), float(np.sqrt(variance))
        tests[k] = replace(_judged(at.problem, solution, k, value, sigma), estimated=False)
    return tests


def readout_of(network: Network, solution: Solution, camera: int) -> Readout:
    """What an adjustment found of the readout of a camera that has one as unknown."""
    value = float(solution.cameras[camera, READOUT])
    sigma = float(np.sqrt(solution.camera_covariance[camera, READOUT, READOUT]))
    return _judged(prepare(network), solution, camera, value, sigma)


def _column(problem: Problem, camera: int) -> int:
    positions, columns = problem.layout.camera_columns[camera]
    return int(columns[positions == READOUT][0])


def _judged(problem: Problem, solution: Solution, camera: int, value: float, sigma: float) -> Readout:
    exposures, motion = problem.network.exposures, problem.network.exposures.motion
    larger = max(1.0, float(np.sqrt(np.nan_to_num(solution.variance_factor))))
    step = np.zeros(problem.layout.size)
    step[_column(problem, camera)] = value
    change = np.zeros(problem.network.rays.plane.shape)
    still = np.zeros_like(solution.points)
    along(problem.design, values_of(problem, solution.state), problem.layout.envelope, step, still, change)
    its_images = exposures.camera == camera
    of_camera = change[its_images[problem.network.rays.image]]
    speed = 0.0 if motion is None else float(np.median(np.linalg.norm(motion[its_images, :3], axis=1)))
    return Readout(
        problem.network.cameras[camera].id,
        value,
        sigma,
        float(2 * special.ndtr(-abs(value) / (sigma * larger))),
        True,
        float(np.sqrt(np.mean(np.sum(of_camera**2, axis=1)))) if len(of_camera) else 0.0,
        speed * abs(value),
    )


def _freed(camera: Camera) -> Camera:
    return replace(camera, estimated=camera.estimated | among("readout"), shutter="rolling")


def _forward(camera: Camera) -> Camera:
    """The same camera with a readout that is positive: from the other side where it was negative."""
    if camera.value("readout") > 0:
        return camera
    first, last = camera.readout_direction.split("-to-")
    other = cast("ReadoutDirection", f"{last}-to-{first}")
    return replace(camera.changed(readout=-camera.value("readout")), readout_direction=other)


def _with_values(network: Network, readouts: dict[int, float]) -> Network:
    return _with(network, {k: network.cameras[k].changed(readout=v) for k, v in readouts.items()})


def _with(network: Network, changed: dict[int, Camera]) -> Network:
    cameras = tuple(changed.get(k, camera) for k, camera in enumerate(network.cameras))
    return replace(network, cameras=cameras)
