"""The iteration: Gauss-Newton steps, damped after Levenberg and Marquardt where they would fail."""

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from photocal.adjustment.datum import at_rest, full_solution, inner_state, wholly_open
from photocal.adjustment.envelope import factorise, solve
from photocal.adjustment.equations import Equations
from photocal.adjustment.kernels.data import Eliminated
from photocal.adjustment.kernels.residuals import evaluate
from photocal.adjustment.kernels.substitution import back_substitute
from photocal.adjustment.ledger import enter
from photocal.adjustment.normal import (
    Normal,
    Problem,
    diagonal_addresses,
    normal_equations,
    other_equations,
    values_of,
)
from photocal.adjustment.rank import (
    SINGULAR,
    SUSPECT,
    RankLimits,
    explain_singular,
    only_the_datum_is_weak,
    share_of_datum,
    weakest_pivot,
)
from photocal.adjustment.sensitivity import across, along, pulls
from photocal.adjustment.state import State, moved_exposures, round_the_middle
from photocal.adjustment.unknowns import unknowns
from photocal.base.arrays import Floats
from photocal.base.errors import NotConvergedError

# Squared distance to the minimum, in units of the standard deviations, that is left of a solution.
CONVERGED = 1e-12
# A step this short that no longer lowers the sum of squares shows that rounding is reached.
ROUNDING = 1e-6
# Images that move while they are read, each in its own way, take up to twice as many. So may a block that
# far wrong control bends (v'Pv so many times the coordinates): steps without damping are on their way.
ITERATIONS, AT_MOST, BENT = 50, 100, 25.0
# Where a step gains no more than these shares of what the one before has gained, and of v'Pv, or is shorter
# than a sigma, the rest of the way is gone with the factor that there is, in so many steps at most: each
# costs a small part of a whole one. They may grow by this much where the ground is flatter than it seemed.
FAST, MILD, WITHIN, CHORDS, FLATTER = 1e-2, 5e-2, 1.0, 16, 16.0
# Where the iteration comes to no end, a step this short (sigmas) is none.
NEARLY = 0.01
# A step so far against the one before (cosine), and so long beside it, shows that both are too long.
AGAINST, AGAIN = -0.9, 0.3
# A step that moves the block as a whole, but for this little, is one of the datum alone.
WHOLE = 0.99
# A step that would gain no more than this share of v'Pv, and gains nothing, is too long for a valley that
# bends (a precise block that something imprecise holds in space): it bends with it, or parts of it do, before
# damping. The bend is seen over so much of the step.
VALLEY, PARTS, LOOK = 0.01, (1.0, 1 / 4, 1 / 16, 1 / 64), 0.1
# A block is moved as a whole where that gains this share of what the step gains, or so much of v'Pv.
WORTH, MUCH = 0.01, 10.0
# Below this share of a diagonal element that remains after elimination, rounding decides.
SINGULAR_PIVOT = 1e-13
FIRST_DAMPING = 1e-3


@dataclass(frozen=True)
class Iteration:
    """One line of the iteration's record.

    chi_squared: sum of v'Pv after the step.
    decrement: squared length of the step in units of the standard deviations.
    damping: 0 for a pure Gauss-Newton step.
    """

    number: int
    chi_squared: float
    decrement: float
    damping: float


@dataclass(frozen=True)
class Minimum:
    """Where the iteration ended.

    normal: normal equations there, without damping; None when the last steps needed none.
    factored: whether their matrix is the Cholesky factor already.
    room: of normal equations on the way, for those at the minimum: fresh memory takes its time.
    """

    state: State
    normal: Normal | None
    iterations: tuple[Iteration, ...]
    factored: bool = False
    room: Eliminated | None = None


def minimise(
    problem: Problem, state: State, report: Callable[[Iteration], None] | None = None, near: float = CONVERGED
) -> Minimum:
    """Find the state of least v'Pv, and enter it into the open ledgers.

    near: squared distance to the minimum, in units of the standard deviations, that may be left.
    raises IllPosedError: when the observations do not determine the unknowns.
    raises NotConvergedError: when the iteration does not end.
    """
    minimum = _minimum(problem, state, report, near)
    network = problem.network
    enter(len(network.image_names), len(network.rays.image), len(minimum.iterations))
    return minimum


def _minimum(
    problem: Problem, state: State, report: Callable[[Iteration], None] | None, near: float
) -> Minimum:
    damping, decrement, steps = 0.0, np.inf, list[Iteration]()
    tried, bends, worked, start = np.inf, False, FIRST_DAMPING, state
    normal = normal_equations(problem, state)
    gone: tuple[Floats, float] | None = None
    most = ITERATIONS if problem.network.exposures.motion_sigma is None else AT_MOST
    # Only between steps this short, in units of what may be left, is that rate known: the first steps shrink
    # much faster than the last.
    short = 1e4
    # After one this short the normal equations are those from before it.
    negligible = 1e-12
    bent = BENT * problem.network.rays.plane.size
    while len(steps) < (AT_MOST if damping == 0.0 and normal.chi_squared > bent else most):
        step, share = _not_too_far(problem, normal, damping, gone)
        if step is None and damping == 0.0 and decrement < ROUNDING:
            explain_singular(problem, state)
        along_a_valley, there = False, None
        if step is not None:
            moved, step_decrement = _moved_to_rest(problem, state, normal, step, near)
            # Steps shrink at a steady rate: the next one tells how far the minimum still is.
            shrinking = min(1.0, step_decrement / decrement) if steps else 1.0
            left, whole = step_decrement * shrinking, damping == 0.0
            last = whole and step_decrement < short * near and left < near
            if last and step_decrement < negligible and not len(problem.stiffened):
                # Over so short a step the normal equations do not change by what shows in any figure.
                normal = replace(normal, chi_squared=normal.chi_squared - step_decrement)
                _tell(steps, report, [Iteration(len(steps) + 1, normal.chi_squared, step_decrement, damping)])
                return Minimum(moved, normal, tuple(steps), factored=True)
            fast = step_decrement < min(FAST * decrement, MILD * normal.chi_squared)
            if whole and (fast or step_decrement < min(WITHIN, FAST * tried)):
                tried = step_decrement
                there = _by_chords(problem, normal, moved, near, step_decrement, steps, report)
            if there is not None:
                return _released(problem, Minimum(there, None, tuple(steps), room=normal.kept), start)
            along_a_valley = ROUNDING < step_decrement < VALLEY * normal.chi_squared
            if bends and along_a_valley:
                moved = _around_the_bend(problem, normal, state, step) or moved
            calmer = damping / 10 if damping > 1e-6 and step_decrement >= ROUNDING else 0.0
            trial = normal_equations(problem, moved, calmer, normal.kept)
            lower = trial.chi_squared < normal.chi_squared
            # So near, v'Pv tells less of the way than that the steps become shorter.
            settling = whole and step_decrement < min(NEARLY**2, decrement)
            if lower or settling or (whole and step_decrement < ROUNDING):
                worked = damping or worked
                gone = (step, share) if whole else None
                state, normal, decrement, damping = moved, trial, step_decrement, calmer
                _tell(steps, report, [Iteration(len(steps) + 1, normal.chi_squared, decrement, damping)])
                if last or (whole and not lower and not settling):
                    return _released(problem, Minimum(state, normal, tuple(steps)), start)
                continue
        if along_a_valley and not bends:
            bends = True
        else:
            # What worked last is where to begin anew.
            damping = 10 * damping if damping else worked
        if damping > 1e8:
            return _released(problem, _ended(problem, state, steps, SINGULAR), start)
        normal = normal_equations(problem, state, damping, normal.kept)
    return _released(problem, _ended(problem, state, steps, SUSPECT), start)


def _not_too_far(
    problem: Problem, normal: Normal, damping: float, gone: tuple[Floats, float] | None
) -> tuple[Floats | None, float]:
    """Step to the minimum of the normal equations, or the share of it that the step before it tells.

    gone: that step, and which share of a whole one it was. A step that turns back by much of it shows that
        v'Pv is curved by more than normal equations know.
    """
    weight = normal.matrix[diagonal_addresses(problem)]
    step = reduced_step(problem, normal, damping)
    if step is None or damping > 0.0 or gone is None:
        return step, 1.0
    before, share = gone
    length, along = float(weight @ before**2), float((weight * before) @ step)
    if along > AGAINST * np.sqrt(length * float(weight @ step**2)) or -along < AGAIN * length:
        return step, 1.0
    share = 1.0 / (1.0 / share - along / length)
    return share * step, share


def _moved_to_rest(
    problem: Problem, state: State, normal: Normal, step: Floats, near: float
) -> tuple[State, float]:
    """State after a step, with the whole block at rest, see `at_rest`, where the rays do not resist that."""
    moved, decrement = moved_by(problem, state, normal, step)
    rested = at_rest(problem, moved, min(WORTH * decrement, MUCH)) if decrement > near else None
    if rested is not None and _height(problem, rested) < _height(problem, moved):
        moved = rested
    return moved, decrement


def _height(problem: Problem, state: State) -> float:
    """Give v'Pv; infinite where a point lies behind a camera, which damping brings before it."""
    try:
        return gradient(problem, state, _others(problem, state))[0]
    except NotConvergedError:
        return np.inf


def _around_the_bend(problem: Problem, normal: Normal, state: State, step: Floats) -> State | None:
    """State lower along a step that bends as the ground does; None where there is none.

    To the second order: geodesic acceleration (Transtrum and Sethna 2012, arXiv:1201.5885).
    """
    design, structure, layout = problem.design, problem.layout.envelope, problem.layout
    points, threads = np.zeros_like(state.points), len(design.pieces) - 1
    back_substitute(design, structure, step, normal.kept, normal.kept.gradient, points)
    points[layout.kept_points] = step[layout.point_columns]
    here, there, change = np.zeros((3, *design.plane.shape))
    depth, values = np.zeros(len(design.plane)), values_of(problem, state)
    ahead = values_of(problem, moved_along(problem, state, LOOK * step, LOOK * points))
    evaluate(design, values, here, depth)
    evaluate(design, ahead, there, depth)
    along(design, values, structure, step, points, change)
    reduced, of_points = np.zeros((threads, layout.size)), np.zeros_like(points)
    across(design, values, structure, 2 / LOOK * ((there - here) / LOOK - change), reduced, of_points)
    right = reduced.sum(axis=0)
    right[layout.point_columns] += of_points[layout.kept_points]
    bend, bend_points = full_solution(problem, normal, -right, -of_points)
    best: State | None = None
    lowest = normal.chi_squared
    for part in PARTS:
        before = lowest
        bent = part**2 / 2
        around = moved_along(problem, state, part * step + bent * bend, part * points + bent * bend_points)
        # Far from where it was evaluated the curvature may differ: try the straight step, too.
        for moved in (around, moved_by(problem, state, normal, part * step)[0]):
            chi_squared = _height(problem, moved)
            if chi_squared < lowest:
                best, lowest = moved, chi_squared
        if best is not None and lowest == before:
            break
    return best


def _others(problem: Problem, state: State) -> list[Equations]:
    return list(other_equations(problem, state).values())


def _tell(steps: list[Iteration], report: Callable[[Iteration], None] | None, made: list[Iteration]) -> None:
    """Record steps."""
    for iteration in made:
        steps.append(iteration)
        if report:
            report(iteration)


def _by_chords(
    problem: Problem,
    normal: Normal,
    state: State,
    near: float,
    decrement: float,
    steps: list[Iteration],
    report: Callable[[Iteration], None] | None,
) -> State | None:
    """Go the rest of the way, after a step, with its factor; None, and no steps, where that is slow."""
    made = [Iteration(len(steps) + 1, np.inf, decrement, 0.0)]

    def progress(chi_squared: float, length: float) -> None:
        """Note a step; the one before it learns its chi-squared from it."""
        if len(made) == 1:
            made[0] = replace(made[0], chi_squared=chi_squared + length)
        made.append(Iteration(made[-1].number + 1, chi_squared, length, 0.0))

    # With a factor from elsewhere the rate is known less well: so much less is to be left.
    surer = 1e-2
    there = chords(problem, normal, state, surer * near, decrement, progress=progress)
    if not there.reached:
        return None
    _tell(steps, report, made)
    return there.state


def _ended(problem: Problem, state: State, steps: list[Iteration], limits: RankLimits) -> Minimum:
    """Where the iteration did not come to its end: the minimum for all purposes, or why it is none."""
    normal = normal_equations(problem, state)
    if not np.isfinite(normal.chi_squared):
        _explain_behind(problem, state)
    size = np.sqrt(np.maximum(normal.matrix[diagonal_addresses(problem)], 0.0))
    step = reduced_step(problem, normal, 0.0)
    decrement = np.inf if step is None else moved_by(problem, state, normal, step)[1]
    if decrement < NEARLY**2:
        return Minimum(state, normal_equations(problem, state), tuple(steps))
    drifts = step is not None and share_of_datum(problem, state, step, size) > WHOLE
    # A datum that is held, if loosely, is to blame only where what is left of the way is the datum's own.
    if limits == SINGULAR or drifts or not only_the_datum_is_weak(problem, state):
        explain_singular(problem, state, limits)
    moving = ""
    if step is not None:
        named = unknowns(problem)
        load = np.abs(step) * size * np.array([unknown is not None for unknown in named])
        largest = (named[k] for k in np.argsort(-load)[:3] if load[k] > 0)
        some = ", ".join(unknown.name for unknown in largest if unknown is not None)
        moving = f": {some} still changing" if some else ""
    raise NotConvergedError(
        f"not converged after {len(steps)} iterations (last step {np.sqrt(decrement):.2g} sigma){moving}",
        "check start values, units and axes of images and points, look for gross errors, and add "
        "observations that determine what still changes",
    )


def _explain_behind(problem: Problem, state: State) -> None:
    """Name the points that lie behind cameras that see them."""
    rays = problem.network.rays
    residuals, depth = np.empty(rays.plane.shape), np.empty(len(rays.image))
    evaluate(problem.design, values_of(problem, state), residuals, depth)
    behind = np.flatnonzero(~(depth > 0.0))
    points, images = problem.network.point_names, problem.network.image_names
    some = ", ".join(f"{points[rays.point[r]]} of {images[rays.image[r]]}" for r in behind[:3])
    raise NotConvergedError(
        f"{len(behind)} ray(s) come from a point behind the camera ({some}), also after all iterations",
        "correct the start values of these images or points, or leave them out to be computed",
    )


def _released(problem: Problem, minimum: Minimum, start: State) -> Minimum:
    """Move a free network onto its start values."""
    if not len(problem.stiffened):
        return minimum
    normal = minimum.normal
    if normal is None and not wholly_open(problem):
        normal = normal_equations(problem, minimum.state, room=minimum.room)
    state = inner_state(problem, normal, minimum.state, start)
    return Minimum(state, None, minimum.iterations, room=normal.kept if normal else minimum.room)


def reduced_step(problem: Problem, normal: Normal, damping: float) -> Floats | None:
    """Solve the reduced system, in place of its matrix; None when it is singular."""
    diagonal = diagonal_addresses(problem)
    before = normal.matrix[diagonal]
    if len(normal.singular) or factorise(problem.layout.envelope, normal.matrix) >= 0:
        return None
    if damping == 0.0 and weakest_pivot(normal.matrix[diagonal], before) < SINGULAR_PIVOT:
        return None
    step = solve(problem.layout.envelope, normal.matrix, -normal.gradient)
    step[problem.held] = 0.0
    return step


def moved_by(problem: Problem, state: State, normal: Normal, step: Floats) -> tuple[State, float]:
    """State after a step and the step's squared length in units of the standard deviations."""
    moved = moved_exposures(problem.network, problem.layout, state, step)
    points = state.points.copy()
    kept = normal.kept
    decrease = back_substitute(problem.design, problem.layout.envelope, step, kept, kept.gradient, points)
    points[problem.layout.kept_points] += step[problem.layout.point_columns]
    moved = round_the_middle(problem.network, state, replace(moved, points=points))
    return moved, float(decrease - normal.gradient @ step)


@dataclass(frozen=True)
class Near:
    """A minimum near a known one.

    left: bound of the squared distance to it that is left, in units of the standard deviations.
    reached: whether as near as was asked.
    """

    state: State
    chi_squared: float
    left: float
    reached: bool = True


def gradient(problem: Problem, state: State, equations: list[Equations]) -> tuple[float, Floats, Floats]:
    """Sum of v'Pv, and half its derivatives to the unknowns of the reduced system and to the points."""
    design, structure, layout = problem.design, problem.layout.envelope, problem.layout
    threads = len(design.pieces) - 1
    totals, reduced, points = np.zeros(threads), np.zeros((threads, layout.size)), np.zeros_like(state.points)
    pulls(design, values_of(problem, state), structure, totals, reduced, points)
    if not np.all(np.isfinite(totals)):
        raise NotConvergedError("a point came to lie behind a camera", "check the start values")
    known = problem.network.points.known
    off = state.points[known] - design.prior_points[known]
    pull = np.einsum("nab,nb->na", design.prior_weight[known], off)
    points[known] += pull * design.point_free[known]
    total = reduced.sum(axis=0)
    total[layout.point_columns] += points[layout.kept_points]
    chi_squared = float(totals.sum() + np.sum(off * pull))
    for rows in equations:
        weighted = np.repeat(rows.weight * rows.residual, np.diff(rows.start))
        np.add.at(total, rows.column, rows.coefficient * weighted)
        chi_squared += rows.chi_squared()
    total[problem.held] = 0.0
    return chi_squared, total, points


def chords(
    problem: Problem,
    normal: Normal,
    state: State,
    near: float,
    before: float,
    hold: tuple[int, Floats, Floats] | None = None,
    equations: Callable[[State], list[Equations]] | None = None,
    progress: Callable[[float, float], None] = lambda *_: None,
) -> Near:
    """Step to a minimum with a factor that is given, after a step of squared length `before`.

    equations: gives the observations beside the rays, where these are not all of the problem's.
    progress: gets v'Pv after each step, and the step's squared length.
    returns: the lowest place on the way, when the steps do not come to an end soon; its v'Pv is infinite
        where a point lies behind a camera from the beginning.

    The curvature that the gradients show corrects the factor (limited-memory BFGS, Nocedal 1980): along
    weakly determined directions the curvature of the residuals matters, which normal equations leave out.
    """
    size = problem.layout.size

    def solved(right: Floats) -> Floats:
        """Solve for one right-hand side, points last; an unknown that is held stays where it is."""
        step, moved = full_solution(problem, normal, right[:size], right[size:].reshape(-1, 3))
        if hold is not None:
            column, along, along_points = hold
            share = step[column] / along[column]
            step, moved = step - share * along, moved - share * along_points
        return np.concatenate([step, moved.ravel()])

    pairs, last, step = list[tuple[Floats, Floats, float]](), None, np.zeros(0)
    best, best_state, rates = np.inf, state, list[float]()
    for _ in range(CHORDS):
        others = _others(problem, state) if equations is None else equations(state)
        try:
            chi_squared, reduced, points = gradient(problem, state, others)
        except NotConvergedError:
            break
        if chi_squared < best:
            best, best_state = chi_squared, state
        # Points that stay in the reduced system stand in both parts.
        points[problem.layout.kept_points] = 0.0
        slope = np.concatenate([reduced, points.ravel()])
        if last is not None:
            curvature = _times(step, slope - last)
            if curvature > 0.0:
                pairs.append((step, slope - last, curvature))
        step = _mended(solved, pairs, slope)
        length = -_times(slope, step)
        # The way to where something is held is no step of this kind.
        if last is not None or hold is None:
            rates.append(length / before)
        last = slope
        if not (0.0 <= length < FLATTER * before or length < ROUNDING):
            break
        state = moved_along(problem, state, step[:size], step[size:].reshape(-1, 3))
        progress(chi_squared - length, length)
        # Steps shrink at a steady rate, the slower of the last two: it tells how far the minimum still is.
        left = length * min(1.0, max(rates[-2:], default=1.0))
        # Steps this short that do not become shorter are rounding.
        if left < near or (length < ROUNDING**2 and length > before / 2):
            return Near(state, chi_squared - length, max(left, 0.0))
        before = length
    return Near(best_state, best, before, reached=False)


def _times(first: Floats, second: Floats) -> float:
    # The library's product would wake all of its threads for each.
    return float(np.einsum("n,n->", first, second))


def _mended(
    solved: Callable[[Floats], Floats], pairs: list[tuple[Floats, Floats, float]], slope: Floats
) -> Floats:
    """Step against a slope, by a factor and by how slopes have changed along steps (Nocedal 1980).

    pairs: steps, changes of the slope along them, and products of both.
    """
    right, shares = -slope, list[float]()
    for s, y, curvature in reversed(pairs):
        shares.append(_times(s, right) / curvature)
        right -= shares[-1] * y
    step = solved(right)
    for (s, y, curvature), share in zip(pairs, reversed(shares), strict=True):
        step += (share - _times(y, step) / curvature) * s
    return step


def moved_along(problem: Problem, state: State, step: Floats, points: Floats) -> State:
    """State after a step of the reduced system and of the points."""
    exposures = moved_exposures(problem.network, problem.layout, state, step)
    return replace(exposures, points=state.points + points)
