"""One hypothesis judged: what it gains, what it estimates, and whether that is worth a word."""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy import special

from photocal.adjustment.covariance import Shared
from photocal.adjustment.network import Network
from photocal.adjustment.solution import Solution
from photocal.base.arrays import Floats
from photocal.base.policy import policy
from photocal.geometry.camera import PARAMETERS
from photocal.hypotheses.causes import Candidates, Cause, columns_of, common_columns, of_camera, points_of
from photocal.hypotheses.control import control_points
from photocal.hypotheses.system import Beyond

_AXES = "XYZ"


@dataclass(frozen=True)
class Estimate:
    """One value of a hypothesis.

    unit: m, deg, s, mm or px.
    correction: estimated less given.
    significant: at 0.1 %, two-sided.
    """

    name: str
    unit: str
    correction: float
    value: float
    sigma: float
    t: float
    significant: bool


@dataclass(frozen=True)
class Hypothesis:
    """One fault of the table, its values freed.

    factor: variance factor that is left, by which gains are judged where it is above 1.
    f, critical: gain / unknowns over that, and its limit.
    moved, on_c: what it moves positions and principal distances by, in their standard deviations.
    subject, p_value: what is concerned; probability of such a gain by chance, times the tests of its level.
    value: gain over the factor, less what its unknowns and choices cost (Schwarz 1978; Chen and Chen 2008).
    change_of_c (cameras,): of each principal distance, in the unit of its camera.
    """

    name: str
    gain: float
    factor: float
    unknowns: int
    f: float
    critical: float
    significant: bool
    estimates: tuple[Estimate, ...]
    moved: float
    on_c: float
    subject: str = ""
    p_value: float = math.nan
    value: float = math.nan
    change_of_c: tuple[float, ...] = ()


@dataclass(frozen=True)
class Stated:
    """Principal distances and their standard deviations (0 where held), and stated sigmas of a position."""

    c: Floats
    sigma_c: Floats
    positions: Floats


def stated_of(shared: Shared, network: Network) -> Stated:
    """What is known before anything is freed."""
    sigma = np.sqrt(shared.camera_covariance[:, 0, 0])
    return Stated(shared.cameras[:, 0], sigma, network.positions.stated())


def limit_of(cause: Cause, families: int) -> float:
    """Level of one test: the families of a table share it (Holm 1979), and all choices within one."""
    return policy.family_significance / families / cause.choices


def judge(
    these: Candidates,
    cause: Cause,
    others: Sequence[Cause],
    before: Beyond,
    families: int,
    stated: Stated,
) -> Hypothesis:
    """Test a cause beside others that are free already.

    before: equations of what may be added beside these.
    raises IllPosedError: when it cannot be separated from them.
    """
    solution = these.adjusted.solution
    after, left = these.fall(before, others, cause)
    unknowns = max(cause.unknowns, 1)
    gain = max(before.chi_squared - after, 0.0)
    # As many weak observations as unknowns came in: the degrees of freedom are those of the data.
    had = before.degrees_of_freedom
    freedom = max(min(had, left) - (0 if left < had else unknowns), 1)
    factor = after / freedom
    # Rays that are better than stated make positions and what was measured of the mounting no better.
    scale = factor if cause.field is not None else max(factor, 1.0, _scatter(solution, cause, gain))
    f = gain / unknowns / max(scale, 1e-300)
    level = limit_of(cause, families)
    critical = float(special.fdtri(unknowns, freedom, 1.0 - level))
    p_value = min(1.0, float(special.fdtrc(unknowns, freedom, f)) * families * cause.choices)
    # Only control shows that a control point is wrong: a block of more rays makes it no less likely.
    of_control = cause.fault.each in ("point", "pair")
    telling = 3 * len(control_points(these.network)) if of_control else solution.observations
    cost = unknowns * math.log(telling) + 2.0 * math.log(cause.choices)
    empty = Hypothesis(
        cause.fault.code, gain, factor, cause.unknowns, f, critical, f > critical, (), 0.0, 0.0,
        cause.subject, p_value, gain / max(scale, 1e-300) - cost,
    )  # fmt: skip
    return detailed(these, empty, cause, others, stated) if f > policy.screened * critical else empty


def _scatter(solution: Solution, cause: Cause, gain: float) -> float:
    """Variance factor of the positions or control points beside what a cause of theirs explains.

    What stands out does so against the others, however well all of them were stated.
    """
    name = "control" if "control" in cause.fault.where else "position"
    if cause.fault.where[0] not in ("positions", "control"):
        return 1.0
    group = next((group for group in solution.groups if group.name == name), None)
    if group is None or group.redundancy - cause.unknowns < policy.fewest_redundant:
        return 1.0
    return max(1.0, (group.chi_squared - gain) / (group.redundancy - cause.unknowns))


def detailed(
    these: Candidates, tested: Hypothesis, cause: Cause, others: Sequence[Cause], stated: Stated
) -> Hypothesis:
    """The same with its estimates and what they move."""
    before, _ = these.solved(others)
    after, told = these.solved((*others, cause))
    moved, on_c = positions_moved(these.network, after, cause, stated), _moved_surely(before, after, stated)
    change = tuple((after.cameras[:, 0] - before.cameras[:, 0]).tolist())
    estimates = estimates_of(these.network, after, cause, *told.get(cause.key, (None, None)))
    return replace(tested, estimates=estimates, moved=moved, on_c=on_c, change_of_c=change)


def _moved_surely(before: Shared, after: Shared, stated: Stated) -> float:
    """The largest change of a principal distance that is sure, in its standard deviations before.

    What was freed costs precision, and may move c by as much (Hausman 1978). Where smaller sigmas of
    positions agree with the residuals, c is judged as it was stated: errors of GNSS that stay alike for
    minutes scatter less than they are large, and drag c along.
    """
    had, has = (np.sqrt(one.camera_covariance[:, 0, 0]) for one in (before, after))
    c, c_before = after.cameras[:, 0], before.cameras[:, 0]
    return moved_surely(c_before, had, c, has, stated)


def moved_surely(c_before: Floats, had: Floats, c: Floats, has: Floats, stated: Stated) -> float:
    """See `_moved_surely`: values and standard deviations before and after, and as they were stated."""
    change = np.abs(c - c_before)
    spread = np.sqrt(np.maximum(has**2 - had**2, 0.0))
    sure = (had > 0.0) & (change > -special.ndtri(policy.significance / 2.0) * spread)
    wider = stated.sigma_c > had
    moved = np.where(wider, np.abs(c - stated.c), change)
    sigma = np.maximum(stated.sigma_c, had)
    return float(np.max(np.divide(moved, sigma, out=0.0 * change, where=sure)))


def positions_moved(network: Network, solution: Shared, cause: Cause, stated: Stated) -> float:
    """How far what was freed moves the positions, in stated sigmas; infinite where it does not."""
    entry, positions, given = cause.fault, network.positions, network.mounting.values
    if "positions" not in entry.where or not len(positions.image) or not entry.frees or entry.each == "trend":
        return math.inf
    columns = np.array(common_columns(network, cause))
    moved = (solution.common[: len(given)] - given)[columns]
    covariance = solution.common_covariance[np.ix_(columns, columns)]
    axes = [columns_of(entry)[k % len(entry.frees)] for k in range(len(columns))]
    scale = np.array([stated.positions[k - 7] if 7 <= k < 10 else stated.positions[k % 3] for k in axes])
    if entry.frees == ("time_offset",):
        scale = stated.positions[:2].min() / np.median(
            np.linalg.norm(positions.velocity, axis=1), keepdims=True
        )
    elif entry.each == "strip":
        n = len(columns) // len(entry.frees)
        against = np.kron(np.eye(n) - (1.0 - np.eye(n)) / (n - 1), np.eye(len(entry.frees)))
        moved, covariance = against @ moved, against @ covariance @ against.T
    sure = np.abs(moved) > -special.ndtri(policy.significance / 2.0) * np.sqrt(np.diag(covariance))
    return float(np.max(np.abs(moved) / scale, where=sure, initial=0.0))


def estimate(name: str, unit: str, value: float, given: float, sigma: float) -> Estimate:
    """A freed value with its sigma and its test against the given one."""
    critical = float(-special.ndtri(policy.significance / 2.0))
    t = (value - given) / sigma if sigma > 0 else 0.0
    return Estimate(name, unit, value - given, value, sigma, t, abs(t) > critical)


def estimates_of(
    network: Network,
    solution: Shared,
    cause: Cause,
    amounts: Floats | None = None,
    spread: Floats | None = None,
) -> tuple[Estimate, ...]:
    """Give the values of one cause from the solution in which it is free."""
    entry = cause.fault
    sigma = np.zeros(0) if spread is None else np.sqrt(np.diag(spread))
    if entry.each == "part" and amounts is not None and cause.field is not None:
        return _changed(network, solution, cause, float(amounts[0]), float(sigma[0]))
    if amounts is not None and cause.trend is not None:
        return (estimate(entry.code, "1", float(amounts[0]), 0.0, float(sigma[0])),)
    if amounts is not None:
        unit = "m" if cause.field is None else cause.field.unit or _unit(network, cause)
        names = (
            [cause.field.name]
            if cause.field is not None
            else [f"{axis}[{name}]" for name in points_of(network, cause) for axis in _AXES]
        )
        return tuple(
            estimate(name, unit, float(v), 0.0, float(s))
            for name, v, s in zip(names, amounts, sigma, strict=True)
        )
    if of_camera(entry):
        return tuple(
            estimate(
                f"{PARAMETERS[k]}[{camera.id}]",
                camera.unit if k < 3 else "",
                float(solution.cameras[index, k]),
                float(camera.values[k]),
                math.sqrt(solution.camera_covariance[index, k, k]),
            )
            for index, camera in enumerate(network.cameras)
            for k in [PARAMETERS.index(name) for name in entry.frees]
        )
    if not entry.frees:
        return ()
    common, deviation = solution.common, np.sqrt(np.diag(solution.common_covariance))
    columns, per = common_columns(network, cause), len(entry.frees)
    strips = [(k - 11) // 6 for k in columns]
    labels = [
        entry.frees[n % per] + (f"[{strips[n]}]" if entry.each in ("strip", "one-strip") else "")
        for n in range(len(columns))
    ]
    unit = (
        "deg" if entry.frees[0].startswith("boresight") else "s" if entry.frees == ("time_offset",) else "m"
    )
    scale = math.degrees(1.0) if unit == "deg" else 1.0
    given = network.mounting.values
    return tuple(
        estimate(label, unit, common[k] * scale, given[k] * scale, deviation[k] * scale)
        for label, k in zip(labels, columns, strict=True)
    )


def _changed(
    network: Network, solution: Shared, cause: Cause, amount: float, sigma: float
) -> tuple[Estimate, ...]:
    """Principal distances before and after a change of a camera: half of it to either side."""
    k = cause.members[0]
    camera, c = network.cameras[k], float(solution.cameras[k, 0])
    spread = math.hypot(math.sqrt(solution.camera_covariance[k, 0, 0]), sigma / 2.0)
    given, image = float(camera.values[0]), cause.field.parameter if cause.field else ""
    return (
        estimate(f"c[{camera.id}]", camera.unit, c - amount / 2.0, given, spread),
        estimate(f"c[{camera.id}@{image}]", camera.unit, c + amount / 2.0, given, spread),
    )


def _unit(network: Network, cause: Cause) -> str:
    """Unit of the amount of a field."""
    unit = network.cameras[cause.members[0]].unit
    return unit if cause.fault.code in ("c-drift", "camera-change") else ""
