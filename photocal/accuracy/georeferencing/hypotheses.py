"""Which systematic error of positions, attitudes and camera a block shows: tested one by one, then named.

The integrated adjustment is repeated with one group of values freed at a time. The group that lowers v'Pv
most, for the unknowns that it costs, is accepted when an F test finds it significant; then the others
are tested again beside it. Groups that explain the same as the accepted one are said with it: the flight
cannot tell them apart.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy import stats

from drivers.errors import IllPosedError, NotConvergedError
from photocal.accuracy.georeferencing.camera_change import Change, best_change, split_at
from photocal.adjustment.adjust import adjust
from photocal.adjustment.mounting import BORESIGHT, COMMON, LEVER, SHIFT, STRIPS, TIME
from photocal.adjustment.solution import Solution
from photocal.block.model import Block
from photocal.block.network import assemble
from photocal.geometry.camera import PARAMETERS

Floats = NDArray[np.float64]

SIGNIFICANCE = 0.001
# Akaike (1974): models this close are not told apart; in units of v'Pv.
_AS_GOOD = 10.0
# A share of the gain: what explains as much of it is another name for the same error.
_SAME_GAIN = 0.95
_ROUNDS = 4
_MOUNTED = ("lever arm", "boresight", "time offset", "strip shifts")
# What a freed value may be at most, as a weak observation that keeps the network regular: m, rad, s, m.
_LOOSE = {"lever arm": 100.0, "boresight": 1.0, "time offset": 10.0, "datum shift": 1000.0}
_LOOSE_CAMERA = 0.1
MEANING = {
    "lever arm": "the lever arm from camera to antenna is wrong",
    "boresight": "the boresight angles between camera and inertial unit are wrong",
    "time offset": "exposures and positions are not on the same time",
    "datum shift": "positions and control are in different datums (base station coordinates, geoid, epoch)",
    "strip shifts": "the positions jump from strip to strip (GNSS ambiguities)",
    "principal distance": "the principal distance is not the one given",
    "principal point": "the principal point is not the one given",
    "camera change": "the principal distance is not the same in all images (zoom, focus, another camera)",
}
_CHANGE = "camera change"
# A principal distance that differs by less is no other camera, zoom or focus: warmth and correlated tie
# points do that too.
_NOTEWORTHY = 1e-3


@dataclass(frozen=True)
class Estimate:
    """One value of a freed group.

    Attributes
    ----------
    name : str
    unit : str
        m, deg, s, mm or px.
    correction : float
        Estimated less given.
    value : float
        Estimated.
    sigma : float
        A priori.
    t : float
        correction / sigma.
    significant : bool
        At 0.1 %, two-sided.
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
    """One group of values freed.

    Attributes
    ----------
    name : str
    gain : float
        By which v'Pv falls.
    unknowns : int
        Freed values.
    f, critical : float
        gain / unknowns over the variance factor that is left, and its limit.
    significant : bool
    estimates : tuple of Estimate
    """

    name: str
    gain: float
    unknowns: int
    f: float
    critical: float
    significant: bool
    estimates: tuple[Estimate, ...]


@dataclass(frozen=True)
class SystematicError:
    """An error that was found, and what else might have caused it.

    Attributes
    ----------
    found : Hypothesis
        Tested beside all that were found before it.
    same : tuple of str
        Groups that explain it as well.
    """

    found: Hypothesis
    same: tuple[str, ...]


@dataclass(frozen=True)
class SystematicErrors:
    """The outcome of all tests.

    Attributes
    ----------
    tested : tuple of Hypothesis
        Each group alone, in the first round.
    errors : tuple of SystematicError
        In the order in which they were found.
    estimates : tuple of Estimate
        Of everything found, estimated together.
    untested : tuple of str
        Groups that could not be freed, with the reason.
    own : tuple of Estimate
        Values that the block itself leaves free, from its integrated adjustment.
    """

    tested: tuple[Hypothesis, ...]
    errors: tuple[SystematicError, ...]
    estimates: tuple[Estimate, ...]
    untested: tuple[str, ...]
    own: tuple[Estimate, ...]


def systematic_errors(block: Block, done: Callable[[], None] = lambda: None) -> SystematicErrors:
    """Look for systematic errors of the georeference.

    Parameters
    ----------
    block : Block
        With positions (see `as_mounted`) and control.
    done : callable
        Called after each adjustment.

    Returns
    -------
    SystematicErrors

    Raises
    ------
    PhotocalError
        When the block cannot be adjusted as it is.
    """
    base, solution = block, _adjusted(block)
    first = solution
    change = best_change(block, solution.cameras[0], _LOOSE_CAMERA)
    names = _names(block) + (() if change is None else (_CHANGE,))
    accepted: list[str] = []
    errors: list[SystematicError] = []
    tested: tuple[Hypothesis, ...] = ()
    untested: list[str] = []
    for turn in range(_ROUNDS):
        tries: dict[str, Hypothesis] = {}
        for name in names:
            if name in accepted or _settled(name, accepted):
                continue
            try:
                freed = _freed(base, name, change)
                tries[name] = _compare(block, solution, name, freed, _adjusted(freed), len(names))
            except (IllPosedError, NotConvergedError) as refusal:
                if turn == 0:
                    untested.append(f"{name}: {refusal.what}")
            done()
        if turn == 0:
            tested = tuple(tries.values())
        best = _best(tuple(tries.values()), solution.observations)
        if best is None:
            break
        errors.append(SystematicError(best, _same(best, tuple(tries.values()))))
        accepted.append(best.name)
        base = _freed(base, best.name, change)
        solution = _adjusted(base)
    estimates = tuple(e for name in accepted for e in _estimates(block, base, solution, name))
    own = tuple(
        e for name in _MOUNTED if _left_free(block, name) for e in _estimates(block, block, first, name)
    )
    return SystematicErrors(tested, tuple(errors), estimates, tuple(untested), own)


def _settled(name: str, accepted: list[str]) -> bool:
    """Whether a group is part of one that was accepted: two principal distances leave no common one."""
    distances = ("principal distance", _CHANGE)
    return name in distances and any(other in accepted for other in distances)


def _left_free(block: Block, name: str) -> bool:
    """Whether the block itself leaves all values of a group free."""
    sigma = block.mounting.sigma
    if name == "strip shifts":
        return len(sigma) > STRIPS and bool(np.isinf(sigma[STRIPS : STRIPS + 3]).all())
    return bool(np.isinf(sigma[_columns(name)]).all())


def _names(block: Block) -> tuple[str, ...]:
    """Groups that this block may be tested for."""
    names = ["lever arm", "datum shift"]
    if len(block.attitudes.image):
        names.append("boresight")
    if np.any(block.positions.velocity):
        names.append("time offset")
    if len(np.unique(block.positions.strip)) > 1:
        names.append("strip shifts")
    if all(not _free(camera.estimated[0], camera.prior_sigma[0]) for camera in block.cameras):
        names.append("principal distance")
    if all(not _free(camera.estimated[k], camera.prior_sigma[k]) for camera in block.cameras for k in (1, 2)):
        names.append("principal point")
    # With a shift of its own for each strip nothing is left of a common one.
    taken = {name for name in _MOUNTED if _left_free(block, name)}
    if "strip shifts" in taken:
        taken.add("datum shift")
    return tuple(name for name in names if name not in taken)


def _free(estimated: object, prior: float) -> bool:
    return bool(estimated) and not math.isfinite(prior)


def _freed(block: Block, name: str, change: Change | None) -> Block:
    """Return the block with one group freed, weakly observed at its given value."""
    if name == _CHANGE and change is not None:
        return split_at(block, change, _LOOSE_CAMERA)
    if name in ("principal distance", "principal point"):
        which = [0] if name == "principal distance" else [1, 2]
        cameras = []
        for camera in block.cameras:
            estimated, sigma = camera.estimated.copy(), camera.prior_sigma.copy()
            estimated[which], sigma[which] = True, _LOOSE_CAMERA * camera.value("c")
            cameras.append(replace(camera, estimated=estimated, prior_sigma=sigma))
        return replace(block, cameras=tuple(cameras))
    sigma = block.mounting.sigma.copy()
    if name == "strip shifts":
        # Images without position have no strip: their columns stay held.
        for strip in np.unique(block.positions.strip):
            at = STRIPS + 6 * int(strip)
            sigma[at : at + 3] = _LOOSE["datum shift"]
    else:
        sigma[_columns(name)] = _LOOSE[name]
    return replace(block, mounting=replace(block.mounting, sigma=sigma))


def _columns(name: str) -> slice:
    return {
        "lever arm": LEVER,
        "boresight": BORESIGHT,
        "time offset": slice(TIME, TIME + 1),
        "datum shift": SHIFT,
    }[name]


def _adjusted(block: Block) -> Solution:
    return adjust(assemble(block).network)


def _compare(
    block: Block, before: Solution, name: str, freed: Block, after: Solution, tests: int
) -> Hypothesis:
    estimates = _estimates(block, freed, after, name)
    gain = max(before.chi_squared - after.chi_squared, 0.0)
    unknowns = len(estimates)
    # As many weak observations as unknowns came in: the degrees of freedom are those of the data.
    freedom = max(before.degrees_of_freedom - unknowns, 1)
    factor = max(after.chi_squared / freedom, 1e-300)
    f = gain / unknowns / factor
    critical = float(stats.f(unknowns, freedom).ppf(1.0 - SIGNIFICANCE / tests))
    return Hypothesis(name, gain / factor, unknowns, f, critical, f > critical, estimates)


def _best(tries: tuple[Hypothesis, ...], observations: int) -> Hypothesis | None:
    """Most probable significant hypothesis (Schwarz 1978): gain less ln(n) for each unknown."""
    significant = [one for one in tries if one.significant]
    if not significant:
        return None
    others = [one for one in significant if one.name != _CHANGE]
    change = [one for one in significant if one.name == _CHANGE and _relative_change(one) > _NOTEWORTHY]
    best = max(others, key=lambda one: one.gain - one.unknowns * math.log(observations), default=None)
    # Two principal distances imitate a wrong height where there are two heights: they must explain more.
    if change and (best is None or best.gain < _as_good(change[0])):
        return change[0]
    return best


def _relative_change(one: Hypothesis) -> float:
    """Difference of two principal distances over one of them."""
    before, after = one.estimates[0].value, one.estimates[1].value
    return abs(after - before) / before


def _as_good(one: Hypothesis) -> float:
    """Gain from which another hypothesis explains as much."""
    return min(one.gain - _AS_GOOD, _SAME_GAIN * one.gain)


def _same(best: Hypothesis, tries: tuple[Hypothesis, ...]) -> tuple[str, ...]:
    """Other hypotheses that explain nearly all of what the best one explains."""
    limit = _as_good(best)
    silent = ("strip shifts", _CHANGE)
    # A shift of its own for each strip can imitate every other error, two principal distances those of
    # c and of the height: that says nothing.
    return tuple(
        one.name
        for one in tries
        if one is not best and one.name not in silent and one.significant and one.gain >= limit
    )


def _estimates(block: Block, freed: Block, solution: Solution, name: str) -> tuple[Estimate, ...]:
    """Values of one group from the solution in which it is freed; `block` has the given ones."""
    critical = float(stats.norm.ppf(1.0 - SIGNIFICANCE / 2.0))

    def one(label: str, unit: str, value: float, given: float, sigma: float) -> Estimate:
        t = (value - given) / sigma if sigma > 0 else 0.0
        return Estimate(label, unit, value - given, value, sigma, t, abs(t) > critical)

    if name in ("principal distance", "principal point", _CHANGE):
        which = [1, 2] if name == "principal point" else [0]
        return tuple(
            one(
                f"{PARAMETERS[k]} of {own.id}",
                own.unit,
                float(solution.cameras[index, k]),
                float(own.values[k]),
                math.sqrt(solution.camera_covariance[index, k, k]),
            )
            for index, own in enumerate(freed.cameras if name == _CHANGE else block.cameras)
            for k in which
        )
    common, sigma = solution.state.common, np.sqrt(np.diag(solution.common_covariance))
    given = block.mounting.values
    if name == "strip shifts":
        labels = [
            (f"shift_{axis}[{strip}]", STRIPS + 6 * strip + k)
            for strip in np.unique(freed.positions.strip).tolist()
            for k, axis in enumerate("xyz")
        ]
        return tuple(
            one(label, "m", float(common[at]), float(given[at]), float(sigma[at])) for label, at in labels
        )
    unit = {"boresight": "deg", "time offset": "s"}.get(name, "m")
    scale = math.degrees(1.0) if name == "boresight" else 1.0
    return tuple(
        one(COMMON[k], unit, common[k] * scale, given[k] * scale, sigma[k] * scale)
        for k in range(*_columns(name).indices(len(COMMON)))
    )
