"""The search: as few causes of one table as explain the contradictions of a block.

One adjustment is given. Its factored equations judge all hypotheses at once, an adjustment confirms what was
chosen, and the model with it must pass (`adequacy`), or what was found is not reported as a cause. Gross rays
come first, then control points that contradict each other where they bend the block.
"""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy import special

from photocal.adjustment.adjusted import AdjustedNetwork, fit, with_measurements, without_member
from photocal.adjustment.condensed import Condensed
from photocal.adjustment.covariance import Shared
from photocal.adjustment.groups import CONTROL, GroupTest, Member, group_tests
from photocal.adjustment.ledger import because
from photocal.adjustment.network import Network
from photocal.adjustment.solution import Solution
from photocal.adjustment.solver import BENT
from photocal.adjustment.state import State
from photocal.adjustment.variance_components import rest_of_way, settled_factor
from photocal.base.arrays import Flags, Floats
from photocal.base.errors import IllPosedError, NotConvergedError
from photocal.base.policy import policy
from photocal.hypotheses.adequacy import Adequacy, Memory, fit_of, groups_of_ground, memory_of
from photocal.hypotheses.causes import (
    Candidates,
    Cause,
    candidates,
    freed,
    left_free,
    of_camera,
    subject_of,
)
from photocal.hypotheses.control import (
    Contradiction,
    WrongSigmas,
    begun_at_rays,
    contradiction,
    control_points,
    predicted,
)
from photocal.hypotheses.faults import FAULTS
from photocal.hypotheses.gross import ASIDE, without_gross_rays
from photocal.hypotheses.judged import Estimate, Hypothesis, Stated, estimate, estimates_of, stated_of
from photocal.hypotheses.selection import Selection, SystematicError, left_to_seek
from photocal.hypotheses.table import Fault

# Adjustments that confirm what was chosen.
_CONFIRMED = 2
# Rounds in which a factor of stated sigmas settles, and the share by which it may still change.
_SETTLING, _SETTLED = 4, 0.05
# Groups of which people state what they hope.
_STATED = ("position", "attitude", *CONTROL)


@dataclass(frozen=True)
class SystematicErrors:
    """The outcome of all tests.

    tested: each cause alone, in the first round; of many of one kind the best.
    errors: those that are needed, the gravest first.
    estimates: of everything found, estimated together.
    untested: causes that could not be freed, with the reason.
    free_in_block: values that the block itself leaves free, from its integrated adjustment.
    sigmas: groups whose stated standard deviations are wrong by a factor, which explains the block better
        than any error does; the errors were looked for with the standard deviations that agree.
    first, last: the network as it was given, and with everything that was found.
    gross (rays,): which rays were set aside as gross errors.
    fit: how well the last explains its observations.
    explained: share of what v'Pv was too large by that is explained; NaN where it was not too large.
    memory: what neighbouring positions share.
    shared: equations of what images share, with all free that a cause may free.
    undecided: control points that are wrong, where other points, or wrong sigmas of all control, explain it
        equally well.
    """

    tested: tuple[Hypothesis, ...]
    errors: tuple[SystematicError, ...]
    estimates: tuple[Estimate, ...]
    untested: tuple[str, ...]
    free_in_block: tuple[Estimate, ...]
    sigmas: tuple[GroupTest, ...]
    first: AdjustedNetwork
    last: AdjustedNetwork
    gross: Flags
    fit: Adequacy
    explained: float
    memory: Memory | None
    shared: Condensed
    undecided: Contradiction | None = None

    @property
    def adequate(self) -> bool:
        """Whether what was found may be called a cause: the model with it passes, or leaves hardly any."""
        return self.fit.passes or self.explained >= policy.explained


def straightened(
    network: Network, state: State | None = None
) -> tuple[AdjustedNetwork, SystematicError | None]:
    """Adjust a network; where that cannot be, without control that contradicts itself.

    returns: that control, too, which the search must know.
    raises IllPosedError, NotConvergedError: as the adjustment does, where no control is to blame.
    """
    try:
        return fit(network, state), None
    except (IllPosedError, NotConvergedError):
        without = without_wrong_control(network)
        if without is None:
            raise
        return without


def systematic_errors(
    first: AdjustedNetwork,
    at_once: SystematicError | None = None,
    table: tuple[Fault, ...] = FAULTS,
    done: Callable[[], None] = lambda: None,
) -> SystematicErrors:
    """Look for errors of the table in an adjusted network.

    at_once: control that was taken out of it before, since nothing could be adjusted with it.
    raises IllPosedError, NotConvergedError: when not even the given network can be judged.
    """
    straight = first
    if at_once is None and first.solution.variance_factor > BENT:
        # Wrong control bends the block so far that nothing else can be judged: its points are predicted by
        # an adjustment without it.
        without = without_wrong_control(first.network, first.solution)
        straight, at_once = without or (first, None)
    given, gross = without_gross_rays(straight)
    done()
    start, sigmas, these = given, dict[str, GroupTest](), candidates(given, table)
    contradicted = None if at_once else _contradicted(given, these)
    against = contradicted if isinstance(contradicted, Contradiction) else None
    undecided = contradicted.rival if isinstance(contradicted, WrongSigmas) else against
    if isinstance(contradicted, WrongSigmas):
        # What one factor explains is laid at no point's door.
        table = tuple(entry for entry in table if entry.each not in ("point", "pair"))
    if contradicted is not None:
        these = candidates(given, table, against)
    stated: Stated | None = None
    steps = dict[str, list[float]]()
    for _ in range(_SETTLING + 1):
        before, shared = these.solved(())[0], these.whole.shared
        now = stated_of(before, given.network)
        larger = now.positions if stated is None else np.maximum(stated.positions, now.positions)
        stated = replace(stated or now, positions=larger)
        search = Selection(these, stated)
        alone = search.beside(())
        wrong = _wrong_sigma(given, alone, steps, contradicted)
        if wrong is None or sum(map(len, steps.values())) == _SETTLING:
            break
        # Points are eliminated, with what is known of them: only an adjustment tells what their sigmas do.
        made = steps.setdefault(wrong.name, [])
        if wrong.name in CONTROL:
            factor, near = _step(wrong.factor, made), given.state
        else:
            factor, near = settled_factor(given.factored, wrong.name)
            made.append(math.log(factor))
        known = sigmas.get(wrong.name) or _scaled(wrong, 1.0 / wrong.factor)
        sigmas[wrong.name] = _scaled(known, factor)
        given = _with_sigmas(given.network, wrong.name, factor, near)
        these = candidates(given, table, against)
        done()
    accepted, search = _placed(search, search.chosen(alone), table, against)
    # What the candidates of a search hold of all rays goes before the next ones are made.
    del these
    last, errors, confirmed = given, list[SystematicError](), list[Cause]()
    total = dict[tuple[str, str], float]()
    for turn in range(_CONFIRMED):
        errors += search.errors(accepted)
        rest = search.these.left() if turn else {}
        # What gains little beside the gravest may be what linear equations leave of it: no adjustment asks.
        gravest = max((error.hypothesis.gain for error in errors), default=0.0)
        small = all(error.hypothesis.gain < policy.minor_gain * gravest for error in errors[len(confirmed) :])
        if not rest and (not accepted or (turn and small)):
            break
        tried = _confirmed(last, search.these, accepted, rest)
        if tried is None:
            break
        confirmed += accepted
        last, amounts = tried
        total |= {key: total.get(key, 0.0) + amount for key, amount in amounts.items()}
        done()
        if turn + 1 == _CONFIRMED:
            break
        fields = tuple(cause.key for cause in confirmed if cause.field is not None)
        stated = search.stated
        del search
        search = Selection(candidates(last, left_to_seek(table, confirmed), None, fields), stated)
        accepted = search.chosen(search.beside(()))
    errors = [_told(error, total, given, last, alone=len(errors) == 1) for error in errors]
    memory = memory_of(last)
    if memory is not None and memory.likely:
        # Errors that stay alike for minutes make shifts of their own.
        shared_errors = [error for error in errors if _by_memory(error, memory)]
        errors = [error for error in errors if error not in shared_errors]
        confirmed = [cause for cause in confirmed if all(e.cause is not cause for e in shared_errors)]
        last = last if errors or not shared_errors else given
    estimates = tuple(e for cause in confirmed for e in _final(given, last, cause, errors))
    excess = _excess(start if at_once is None else first, last)
    found = tuple(
        replace(error, share=error.hypothesis.gain / excess if excess > 0.0 else math.nan)
        for error in sorted([*filter(None, (at_once,)), *errors], key=lambda error: -error.hypothesis.gain)
    )
    fall = (start if at_once is None else first).solution.chi_squared - last.solution.chi_squared
    explained = fall / excess if excess > 0.0 else math.nan
    return SystematicErrors(
        _best_of_each(alone),
        found,
        estimates,
        tuple(f"{name}: {reason}" for name, reason in search.refused.items()),
        _free(first, table),
        _settled(sigmas, given),
        first,
        last,
        gross,
        fit_of(last),
        explained,
        memory,
        shared,
        undecided,
    )


def _placed(
    search: Selection, accepted: tuple[Cause, ...], table: tuple[Fault, ...], against: Contradiction | None
) -> tuple[tuple[Cause, ...], Selection]:
    """Look more finely for the place of a change of the camera, where there is one."""
    changes = [cause.field.parameter for cause in accepted if cause.fault.each == "part" and cause.field]
    if not changes:
        return accepted, search
    these = candidates(search.these.adjusted, table, against, near=changes[0])
    finer = Selection(these, search.stated)
    again = finer.chosen(finer.beside(()))
    return (again, finer) if again else (accepted, search)


def without_wrong_control(
    network: Network, solution: Solution | None = None
) -> tuple[AdjustedNetwork, SystematicError] | None:
    """Adjust without control that contradicts itself, or with exchanged points; None where it does not."""
    seen = predicted(network)
    against = None if seen is None else contradiction(seen)
    if not isinstance(against, Contradiction):
        return None
    entries = {entry.each: entry for entry in FAULTS}
    names = " ".join(network.point_names[j] for j in against.points)
    entry, count = entries["pair" if against.exchanged else "point"], 3 * len(against.points)
    cause = Cause(
        entry,
        names,
        choices=against.choices,
        members=against.points,
        unknowns=0 if against.exchanged else count,
    )
    try:
        with because(f"with {entry.code}"):
            applied = _applied(network, cause)
            fitted = fit(applied if against.exchanged else begun_at_rays(applied, np.array(against.points)))
    except (IllPosedError, NotConvergedError):
        return None
    gain = math.inf if solution is None else solution.chi_squared - fitted.solution.chi_squared
    given = tuple(
        estimate(f"{axis}[{network.point_names[j]}]", "m", -float(e), 0.0, float(s))
        for j, error, sigma in zip(against.points, against.error, against.sigma, strict=True)
        for axis, e, s in zip("XYZ", error, sigma, strict=True)
    )
    factor = max(fitted.solution.variance_factor, 1.0)
    f = gain / count / factor
    told = Hypothesis(
        entry.code, gain, factor, cause.unknowns, f, 0.0, True, given, math.inf, 0.0, names, 0.0, gain
    )
    return fitted, SystematicError(told, (), cause)


def _contradicted(given: AdjustedNetwork, these: Candidates) -> Contradiction | WrongSigmas | None:
    """Control points that contradict the others, where control does not fit at all.

    It may fit as a group, and each point with it: two that err alike hide each other.
    """
    control = next((test for test in groups_of_ground(given.solution) if test.name == "control"), None)
    rays = given.network.rays
    surveyed = np.isin(rays.point, control_points(given.network))
    # Precise control bends the block rather than its own coordinates: its rays tell.
    w = given.solution.standardised(rays.sigma)[surveyed]
    of_rays = float(np.nanmean(w**2)) if surveyed.any() else 1.0
    usual = max(given.solution.variance_factor if not surveyed.all() else 1.0, 1.0)
    # Of thousands of rays the largest residual is beyond any limit of a single one.
    limit = -special.ndtri(policy.significance / 2.0 / max(np.isfinite(w).sum(), 1))
    far = np.nanmax(np.abs(w), initial=0.0) > limit * np.sqrt(usual)
    alone = control is not None and control.p_value < policy.significance and control.factor >= 1.0
    together = _disagrees(given, these)
    if not (far or alone or together) or (together and _otherwise(given, these)):
        return None
    if of_rays < 1.0 and control is None:
        return None
    seen = predicted(given.network, given.state)
    return None if seen is None else contradiction(seen)


def _disagrees(given: AdjustedNetwork, these: Candidates, causes: Sequence[Cause] = ()) -> bool:
    """Whether control contradicts itself, whatever group and points say, with some causes free."""
    fall, count = these.of_control(causes)
    scale = max(given.solution.variance_factor, 1.0)
    return count > 0 and float(special.chdtrc(count, fall / scale)) < policy.significance


def _otherwise(given: AdjustedNetwork, these: Candidates) -> bool:
    """Whether the most probable cause outside of control leaves nothing that contradicts itself there."""
    tries = Selection(these, stated_of(these.solved(())[0], given.network)).beside(())
    others = [c for c, one in tries.items() if one.significant and c.fault.each not in ("point", "pair")]
    if not others:
        return False
    return not _disagrees(given, these, (max(others, key=lambda cause: tries[cause].value),))


def _wrong_sigma(
    given: AdjustedNetwork,
    tries: dict[Cause, Hypothesis],
    steps: dict[str, list[float]],
    contradicted: Contradiction | WrongSigmas | None,
) -> GroupTest | None:
    """Choose the group whose stated sigmas are wrong, rather than a cause.

    contradicted: what the differences of control say of it.

    A factor is one unknown, and gains likelihood where all residuals of a group are too large or too small;
    an error competes with it (Schwarz 1978). Too small residuals no error explains, and those of positions
    that share their errors tell nothing of their sigmas.
    """
    # As of causes: only control shows that its sigmas are wrong.
    of_control = math.log(max(3 * len(control_points(given.network)), 2))
    of_all = math.log(given.solution.observations)
    significant = [one for one in tries.values() if one.significant]
    cause = max((one.value for one in significant), default=0.0)
    gain = max((one.gain for one in significant), default=0.0)
    memory = memory_of(given)
    wrong = []
    groups = [one for one in group_tests(given.network, given.solution) if one.name in _STATED]
    stretched = contradicted if isinstance(contradicted, WrongSigmas) else None
    of_points = isinstance(contradicted, Contradiction) and not contradicted.as_scale
    for test in groups:
        # Once it is known to be wrong, its factor settles.
        if test.name in steps:
            if abs(test.factor - 1.0) > _SETTLED:
                return test
            continue
        preferred = stretched is not None and test.name in CONTROL
        # The differences of control have tested it before.
        before = stretched is not None and test.name == stretched.group
        if (test.p_value >= policy.significance and not before) or abs(
            test.factor - 1.0
        ) < policy.wrong_sigma:
            continue
        if of_points and test.name in CONTROL:
            continue
        too_large = test.chi_squared - test.redundancy
        unknown = of_control if test.name in CONTROL else of_all
        if (
            not preferred
            and test.factor > 1.0
            and (test.gain - unknown <= cause or gain >= policy.explained_group * too_large)
        ):
            continue
        shared = test.name == "position" and memory is not None and memory.likely
        if test.factor < 1.0 and (shared or test.name in CONTROL):
            continue
        wrong.append(test)
    return max(wrong, key=lambda test: test.gain, default=None)


def _step(factor: float, made: list[float]) -> float:
    """Factor to apply next, after the steps that were made."""
    made.append(math.log(factor))
    return math.exp(rest_of_way(made[-1], made[-2] if len(made) > 1 else 0.0))


def _scaled(test: GroupTest, by: float) -> GroupTest:
    """The factor of a group with its limits, times another one."""
    return replace(test, factor=by * test.factor, lower=by * test.lower, upper=by * test.upper)


def _settled(sigmas: dict[str, GroupTest], given: AdjustedNetwork) -> tuple[GroupTest, ...]:
    """The factors of groups over all rounds, with the limits of the last, where that still tests them."""
    last = {test.name: test for test in group_tests(given.network, given.solution)}
    settled = list[GroupTest]()
    for name, one in sigmas.items():
        test = replace(last[name], factor=1.0, p_value=one.p_value, gain=one.gain) if name in last else None
        settled.append(one if test is None else _scaled(test, one.factor))
    return tuple(settled)


def _with_sigmas(network: Network, name: str, factor: float, near: State) -> AdjustedNetwork:
    """Adjust with the standard deviations of a group that agree (Foerstner 1979)."""
    factor = factor**2
    if name == "position":
        positions = replace(network.positions, covariance=network.positions.covariance * factor)
        network = replace(network, positions=positions)
    elif name == "attitude":
        attitudes = replace(network.attitudes, covariance=network.attitudes.covariance * factor)
        network = replace(network, attitudes=attitudes)
    else:
        scale = np.ones(3)
        scale[CONTROL.index(name)] = 1.0 / math.sqrt(factor)
        weight = network.points.weight * scale[:, None] * scale
        network = replace(network, points=replace(network.points, weight=weight))
    with because(f"standard deviations of {name}s that agree"):
        return fit(network, near)


def _confirmed(
    given: AdjustedNetwork,
    these: Candidates,
    accepted: tuple[Cause, ...],
    rest: dict[tuple[str, str], float],
) -> tuple[AdjustedNetwork, dict[tuple[str, str], float]] | None:
    """Adjust with what was accepted, and what is left of amounts before; None where that cannot be."""
    _, told = these.solved(accepted)
    amounts = rest | {key: float(value[0]) for key, (value, _) in told.items()}
    network = with_causes(given.network, accepted, amounts)
    plane = network.rays.plane
    for field in these.fields:
        key = (field.code, subject_of(given.network, field))
        if key in rest:
            plane = plane + rest[key] * field.displacement
    try:
        with because(
            f"with {' and '.join(cause.fault.code for cause in accepted) or 'the remaining residuals'}"
        ):
            return fit(with_measurements(network, plane), given.state), amounts
    except (IllPosedError, NotConvergedError):
        return None


def _by_memory(error: SystematicError, memory: Memory) -> bool:
    """Whether positions that share their errors explain what looks like a shift or a lever arm of theirs."""
    cause, tested = error.cause, error.hypothesis
    common = cause is not None and (bool(cause.fault.frees) or cause.trend is not None)
    of_positions = cause is not None and cause.fault.where[0] == "positions"
    return common and of_positions and tested.f / memory.inflation < tested.critical


def _told(
    error: SystematicError,
    total: dict[tuple[str, str], float],
    given: AdjustedNetwork,
    last: AdjustedNetwork,
    *,
    alone: bool,
) -> SystematicError:
    """An error with its amount and gain as they were confirmed: the first step is not all of a large one."""
    tested, cause = error.hypothesis, error.cause
    if alone:
        fall = given.solution.chi_squared - last.solution.chi_squared
        tested = replace(tested, gain=max(fall, 0.0), f=tested.f * max(fall, 0.0) / max(tested.gain, 1e-300))
    if cause is not None and cause.fault.each == "field" and cause.key in total:
        (one,) = tested.estimates
        tested = replace(tested, estimates=(estimate(one.name, one.unit, total[cause.key], 0.0, one.sigma),))
    return replace(error, hypothesis=tested)


def with_causes(
    network: Network, accepted: Sequence[Cause], amounts: dict[tuple[str, str], float]
) -> Network:
    """The network with what causes free as unknowns, rays corrected, and wrong observations taken out."""
    cameras, mounting = freed(network, accepted)
    network, plane = replace(network, cameras=cameras, mounting=mounting), network.rays.plane
    for cause in accepted:
        if cause.field is not None:
            plane = plane + amounts[cause.key] * cause.field.displacement
        if cause.trend is not None:
            straight = network.positions.values - amounts[cause.key] * cause.trend
            network = replace(network, positions=replace(network.positions, values=straight))
        network = _applied(network, cause)
    return with_measurements(network, plane)


def _applied(network: Network, cause: Cause) -> Network:
    """The network without wrong observations, or with two points exchanged."""
    if cause.fault.each == "pair":
        values, pair = network.points.values.copy(), list(cause.members)
        values[pair] = values[pair[::-1]]
        return replace(network, points=replace(network.points, values=values))
    if cause.fault.each in ("image", "point"):
        kind = "position" if cause.fault.each == "image" else "control"
        for member in cause.members:
            network = _taken_out(network, kind, member)
    return network


def _taken_out(network: Network, kind: str, index: int) -> Network:
    """Without a position, or the coordinates of a control point, barely where one ray is left."""
    if kind == "control" and np.sum(network.rays.point == index) < 2:
        weight = network.points.weight.copy()
        weight[index] = weight[index] / ASIDE**2
        return replace(network, points=replace(network.points, weight=weight))
    nothing = np.zeros(0)
    return without_member(network, Member(kind, index, nothing, nothing, 0.0, 0))


def _excess(given: AdjustedNetwork, last: AdjustedNetwork) -> float:
    """What v'Pv is too large by, where rays scatter as they do within their cells with all that was found."""
    rays = float(last.solution.redundancy.sum())
    others = last.solution.degrees_of_freedom - rays
    return given.solution.chi_squared - fit_of(last).noise * rays - others


def _final(
    given: AdjustedNetwork, last: AdjustedNetwork, cause: Cause, errors: Sequence[SystematicError]
) -> tuple[Estimate, ...]:
    """Values of a cause from the last adjustment; of what was corrected or taken out, as it was tested."""
    if not cause.fault.frees or cause.field is not None:
        return next(
            (e.hypothesis.estimates for e in errors if e.cause is not None and e.cause.key == cause.key), ()
        )
    return estimates_of(given.network, shared_of(last), cause)


def shared_of(adjusted: AdjustedNetwork) -> Shared:
    """What all images share at a minimum."""
    solution = adjusted.solution
    cameras = solution.cameras, solution.camera_covariance
    freedom, common = solution.degrees_of_freedom, (solution.state.common, solution.common_covariance)
    return Shared(solution.chi_squared, freedom, *cameras, *common)


def _free(first: AdjustedNetwork, table: tuple[Fault, ...]) -> tuple[Estimate, ...]:
    """Values of the mounting that the block itself leaves free."""
    network, shared = first.network, shared_of(first)
    return tuple(
        e
        for entry in table
        if entry.frees and not of_camera(entry) and entry.each in ("block", "strip") and not entry.kind_of
        if len(network.positions.image) and left_free(network, entry)
        for e in estimates_of(network, shared, Cause(entry))
    )


def _best_of_each(tried: dict[Cause, Hypothesis]) -> tuple[Hypothesis, ...]:
    """Of many of one kind the best, in the order of the table."""
    best = dict[tuple[str, str], Hypothesis]()
    for cause, tested in tried.items():
        name = cause.field.name if cause.field is not None and cause.fault.each == "field" else ""
        key = (tested.name, name)
        if key not in best or tested.f / tested.critical > best[key].f / best[key].critical:
            best[key] = tested
    return tuple(best.values())


def changed_points(errors: SystematicErrors) -> Floats:
    """How far all that was found moves the points, root mean square along X, Y, Z, m."""
    moved = errors.last.state.points - errors.first.state.points
    return np.asarray(np.sqrt(np.mean(moved**2, axis=0)))
