"""The search: the most significant error is corrected, then the next is looked for."""

from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace

import numpy as np

from photocal.adjustment.groups import CONTROL, GroupTest, Member, group_tests
from photocal.adjustment.ledger import because
from photocal.adjustment.variance_components import VarianceComponents, estimate_components
from photocal.analysis.estimates import Estimates
from photocal.analysis.robust import Jackknife, jackknife
from photocal.analysis.systematic_errors import candidates, scatter, shifts
from photocal.analysis.systematic_errors.candidates import Candidate, ExtraParameter
from photocal.analysis.systematic_errors.refit import (
    AdjustedNetwork,
    fit,
    with_measurements,
    with_sigmas,
    without_member,
)
from photocal.base import policy
from photocal.base.arrays import Floats
from photocal.base.errors import IllPosedError, NotConvergedError
from photocal.geometry.camera import PARAMETERS, plane_to_pixel

ROUNDS = 6
# Share of itself by which a variance may still change.
_SETTLED = 0.02
# What positions, attitudes and control points were stated to be: of these people write down what they hope.
_STATED = ("position", "attitude", "control")
# Steps in which an error is corrected, until this share of its standard deviation is left of it.
_STEPS, _NEAR = 5, 0.005
# A step has its place beside its size, the best of several: it must explain so much more than a drift, in F.
STEP_ADVANTAGE = 6.0


@dataclass(frozen=True)
class Round:
    """One error that was found and corrected."""

    parameter: ExtraParameter
    before: AdjustedNetwork
    after: AdjustedNetwork


@dataclass(frozen=True)
class Search:
    """Everything that the search found.

    rounds: errors in the order in which they were found, the worst first.
    first, last: the network as it was adjusted, and with all corrections.
    members: positions and control points with gross errors, the worst first; `last` is without them.
    positions: what a common shift of all observed positions would be and do; None where it is free.
    shift: the same where it is significant; it is then free in `last`.
    sigma: of the image coordinates, at the end.
    groups: each group of observations against its stated standard deviations, at the end.
    strips: a shift of the positions of each strip, at the end.
    images, axes, cameras: scatter by image, by image axis and by camera, at the end.
    shifts: scale and principal point of each image, at the end.
    maps: for each camera, at the end; None for a camera without rays.
    jackknife_first, jackknife_last: before and after the corrections.
    """

    rounds: tuple[Round, ...]
    first: AdjustedNetwork
    last: AdjustedNetwork
    members: tuple[Member, ...]
    positions: shifts.PositionShift | None
    shift: shifts.PositionShift | None
    sigma: scatter.AssumedSigma
    groups: tuple[GroupTest, ...]
    strips: tuple[shifts.StripShift, ...]
    images: tuple[scatter.VarianceComponent, ...]
    axes: tuple[scatter.VarianceComponent, ...]
    cameras: tuple[scatter.VarianceComponent, ...]
    shifts: tuple[shifts.ImageShift, ...]
    maps: tuple[scatter.ResidualMap | None, ...]
    jackknife_first: Jackknife
    jackknife_last: Jackknife


def search(first: AdjustedNetwork, done: Callable[[], None] = lambda: None) -> Search:
    """Look for systematic errors in an adjusted network."""
    rounds = list[Round]()
    members, last = _without_gross_errors(first)
    positions = shifts.position_shift(last)
    shift = positions if positions is not None and positions.p_value < policy.FAMILY_SIGNIFICANCE else None
    with because("positions shifted in common"):
        last = last if shift is None else fit(shifts.with_free_shift(last.network), last.state)
    while len(rounds) < ROUNDS:
        suspected = _suspected(last, tuple(correction.parameter.candidate for correction in rounds), done)
        step = next(filter(None, (_corrected(last, worst) for worst in suspected)), None)
        if step is None:
            break
        rounds.append(step)
        last = step.after
    before = jackknife(first, done)
    after = jackknife(last, done) if last is not first else before
    solution, rays = last.solution, last.network.rays
    squares, redundancy = (solution.residuals / rays.sigma) ** 2, solution.redundancy
    sigma = scatter.assumed_sigma(rays.sigma, solution.residuals, redundancy)
    factor, ids = float(squares.sum() / redundancy.sum()), tuple(given.id for given in last.network.cameras)
    both = np.repeat(rays.image, 2)
    camera = last.network.exposures.camera[both]
    axis = np.tile(np.array([0, 1]), len(rays.image))
    flat, checked = squares.ravel(), redundancy.ravel()
    return Search(
        tuple(rounds),
        first,
        last,
        members,
        positions,
        shift,
        sigma,
        _groups(last, sigma),
        shifts.strip_shifts(last),
        scatter.variance_components(last.network.image_names, both, flat, checked),
        scatter.variance_components(("x", "y"), axis, flat, checked),
        scatter.variance_components(ids, camera, flat, checked),
        shifts.image_shifts(last, factor, done),
        tuple(_map(last, k, factor) for k in range(len(last.network.cameras))),
        before,
        after,
    )


def _without_gross_errors(first: AdjustedNetwork) -> tuple[tuple[Member, ...], AdjustedNetwork]:
    """Take out positions and control points that contradict all others, one after the other."""
    members, last = list[Member](), first
    while len(members) < ROUNDS:
        worst = shifts.gross_error(last, policy.FAMILY_SIGNIFICANCE)
        if worst is None:
            break
        try:
            with because("without a gross error"):
                last = fit(without_member(last.network, worst), last.state)
        except (IllPosedError, NotConvergedError):
            break
        members.append(worst)
    return tuple(members), last


def camera_estimates(fitted: AdjustedNetwork, camera: int) -> Estimates:
    """Give the estimated parameters of a camera with their a priori covariance."""
    at = np.flatnonzero(fitted.network.cameras[camera].estimated)
    return Estimates(
        tuple(PARAMETERS[i] for i in at),
        fitted.solution.cameras[camera][at],
        fitted.solution.camera_covariance[camera][np.ix_(at, at)],
    )


def _suspected(
    last: AdjustedNetwork, named: tuple[Candidate, ...], done: Callable[[], None]
) -> Iterator[ExtraParameter]:
    """Test every candidate that was not yet found; give the significant ones, the worst first."""
    known = {(candidate.kind, candidate.name, candidate.camera) for candidate in named}
    fresh = [
        candidate
        for candidate in candidates.candidates(last.network, last.state, last.computed)
        if (candidate.kind, candidate.name, candidate.camera) not in known
    ]
    # Rows are read one after the other, never backwards: that would be something else.
    tested = [
        parameter
        for parameter in candidates.estimated_amounts(last, fresh)
        if parameter.candidate.kind != "rolling-shutter" or parameter.amount > 0.0
    ]
    for _ in fresh:
        done()
    level = policy.FAMILY_SIGNIFICANCE / max(len(tested), 1)
    significant = [parameter for parameter in tested if max(parameter.p_value, parameter.by_images) < level]
    for suspect in sorted(significant, key=lambda other: -other.statistic):
        worst = _step_or_drift(last, suspect)
        alike = worst.alike + tuple(
            other.candidate.name
            for other in significant
            if other is not worst
            and other.statistic > policy.ALIKE_FIELDS * worst.statistic
            and _parallel(last, other, worst)
        )
        yield replace(worst, alike=alike, tested=len(tested))


def _step_or_drift(last: AdjustedNetwork, drift: ExtraParameter) -> ExtraParameter:
    """A step of c in place of a drift of it, where it explains so much more; else beside it, if as much."""
    if drift.candidate.kind != "c-drift":
        return drift
    steps = candidates.steps_of_c(last.network, last.state, last.computed, drift.candidate.camera)
    best = max(candidates.estimated_amounts(last, steps), key=lambda step: step.statistic, default=drift)
    if best.statistic > drift.statistic + STEP_ADVANTAGE:
        return best
    as_good = best is not drift and best.statistic > drift.statistic - policy.AS_GOOD
    return replace(drift, alike=(best.candidate.name,)) if as_good else drift


def _parallel(last: AdjustedNetwork, first: ExtraParameter, second: ExtraParameter) -> bool:
    a, b = ((each.candidate.displacement / last.network.rays.sigma).ravel() for each in (first, second))
    return bool(abs(a @ b) > policy.ALIKE_FIELDS * np.linalg.norm(a) * np.linalg.norm(b))


def _corrected(before: AdjustedNetwork, worst: ExtraParameter) -> Round | None:
    """Correct an error step by step, as large ones are not linear; None when it then is not significant.

    It is neither when the images do not agree about it.
    A step that does not lower v'Pv is halved. What is claimed is what the last adjustment shows. Positions
    three times worse than stated pull at the rays, and look like an error of the camera: where they are so
    with the correction, too, it must be significant with the sigmas that residuals agree with.
    """
    amount, step, after = 0.0, worst.amount, before
    for _ in range(_STEPS):
        plane = before.network.rays.plane + (amount + step) * worst.candidate.displacement
        try:
            with because(f"corrected for {worst.candidate.name}"):
                trial = fit(with_measurements(before.network, plane), after.state)
        except (IllPosedError, NotConvergedError):
            # What cannot be adjusted with a correction is not corrected so.
            step /= 2.0
            continue
        if trial.solution.chi_squared >= after.solution.chi_squared:
            step /= 2.0
            continue
        amount, after = amount + step, trial
        rest = candidates.estimated_amount(after, worst.candidate)
        if rest is None or abs(rest.amount) < _NEAR * rest.sigma:
            break
        step = rest.amount
    fall = before.solution.chi_squared - after.solution.chi_squared
    outcome = candidates.judged(before, worst.candidate, amount, worst.sigma, fall)
    level = policy.FAMILY_SIGNIFICANCE / worst.tested
    if outcome.p_value >= level or candidates.agreed(after, worst.candidate, amount) >= level:
        return None
    weighed = None if _as_residuals_agree(after) is None else _as_residuals_agree(before)
    if weighed is not None:
        other = candidates.estimated_amount(weighed, worst.candidate)
        if other is None or other.p_value >= level:
            return None
    return Round(replace(outcome, alike=worst.alike, tested=worst.tested), before, after)


def _groups(last: AdjustedNetwork, sigma: scatter.AssumedSigma) -> tuple[GroupTest, ...]:
    """Test groups of observations, with the sigma of the rays that was found where it differs."""
    ratio = sigma.found / sigma.assumed
    if sigma.p_value < policy.FAMILY_SIGNIFICANCE and abs(ratio - 1.0) > policy.WRONG_SIGMA:
        with because("sigma of the image coordinates that agrees"):
            last = fit(with_sigmas(last.network, ratio), last.state)
    tests = group_tests(last.network, last.solution)
    components = _components(last, tests)
    if components is None:
        return tests
    applied = {component.name: component.factor for component in components.components}
    retests = group_tests(components.network, components.solution)
    settled, judged = {(group.name, group.of): group for group in retests}, list[GroupTest]()
    for test in tests:
        name, retest = "control" if test.name in CONTROL else test.name, settled.get((test.name, test.of))
        if retest is not None and name in _STATED:
            # One factor was applied before the other was found.
            limits = {key: applied[name] * getattr(retest, key) for key in ("factor", "lower", "upper")}
            test = replace(test, **limits)
        judged.append(test)
    return tuple(judged)


def _components(last: AdjustedNetwork, tests: tuple[GroupTest, ...]) -> VarianceComponents | None:
    """Estimate the variances of the rays and of wrongly stated groups together; None where all is well."""
    far = {
        "control" if group.name in CONTROL else group.name
        for group in tests
        if group.p_value < policy.FAMILY_SIGNIFICANCE / len(tests)
        and not 1.0 / policy.JUDGED_ANEW < group.factor < policy.JUDGED_ANEW
    }
    wrong = far & set(_STATED)
    hold = {group.name for group in last.solution.groups} - wrong - {"image"}
    try:
        with because("standard deviations that agree"):
            return (
                estimate_components(last.network, None, hold, None, last.state, _SETTLED) if wrong else None
            )
    except (IllPosedError, NotConvergedError):
        return None


def _as_residuals_agree(last: AdjustedNetwork) -> AdjustedNetwork | None:
    """The network with larger sigmas of positions, attitudes or control, where residuals ask for them."""
    components = _components(last, group_tests(last.network, last.solution))
    if components is None or all(
        component.factor < policy.JUDGED_ANEW
        for component in components.components
        if component.name in _STATED
    ):
        return None
    return fit(components.network, components.solution.state)


def _map(last: AdjustedNetwork, camera: int, factor: float) -> scatter.ResidualMap | None:
    of_camera = last.network.exposures.camera[last.network.rays.image] == camera
    if not of_camera.any():
        return None
    interior = last.network.cameras[camera]
    down = np.array([1.0, -1.0])
    pixel: Floats = plane_to_pixel(interior.size_px, interior.pitch, last.network.rays.plane[of_camera])
    residual = last.solution.residuals[of_camera] / np.array(interior.pitch) * down
    w = last.solution.standardised(last.network.rays.sigma)[of_camera] * down
    return scatter.residual_map(interior.size_px, pixel, residual, w, factor, policy.FAMILY_SIGNIFICANCE)
