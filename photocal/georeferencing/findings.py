"""What a check of a block found: mistakes and errors under their names, then what follows of them."""

import math
from dataclasses import replace
from itertools import permutations, product

import numpy as np
from scipy import stats

from photocal.adjustment.groups import GroupTest
from photocal.base import policy
from photocal.findings.digits import with_sigma
from photocal.findings.finding import FACTOR, Figure, Finding, untested
from photocal.findings.hypotheses import fault
from photocal.georeferencing.comparison import BlockCheck, Judged, coarsely_placed
from photocal.georeferencing.differences import Differences
from photocal.georeferencing.freed_groups import Estimate, Separation
from photocal.georeferencing.ground_mistakes import Mistyped
from photocal.georeferencing.methods import Method
from photocal.georeferencing.systematic import Hypothesis, SystematicError

# Without ground points all points of a flight share the errors of its rig and of few images: at worst they
# err as one point, and their root of the mean d' C^-1 d / 3 as that of one (0.1 %).
_RATIO_DIRECT = math.sqrt(float(stats.chi2(3).ppf(0.999)) / 3.0)
# A fall of v'Pv is worth less for each unknown more: by the logarithm of the usual number of observations.
_UNKNOWN = 10.0
# An estimate is the permuted given one when it comes this near: standard deviations, and metres at least.
_NEAR, _NEAR_M = 4.0, 0.02
_AXES = ("forward", "right", "down")


def block_findings(check: BlockCheck) -> tuple[Finding, ...]:
    """Give what was found: mistakes and errors first, each under one name, then what follows of them."""
    listed = [*check.plausibility, *(_mistyped(mistyped) for mistyped in check.mistyped)]
    if check.systematic is not None:
        listed += [_stated_sigma(group) for group in check.systematic.sigmas]
        listed += named(check.systematic.errors)
    elif coarsely_placed(check.block):
        listed.append(Finding("coarse-positions", "note"))
    for judged in check.judged:
        listed += _judged(judged)
    if check.separation is not None:
        listed += separation_findings(check.separation)
    if check.judged and not any(judged.check.names for judged in check.judged):
        listed.append(Finding("no-check-points", "note"))
    return (*listed, *_refused(check))


def _refused(check: BlockCheck) -> list[Finding]:
    """Name the methods that the block does not allow; what it was never meant for is no fault."""
    block = check.block
    without = not block.points.of_role("control").any()
    # An attitude of one image only keeps a block level.
    known = np.isfinite(block.images.sigma)
    places, angles = known[:, 3:].any(), known[:, :3].all(axis=1).sum() > 1
    positions, attitudes = places or len(block.positions.image), angles or len(block.attitudes.image)
    meant = {"direct": positions and attitudes, "integrated": positions or attitudes, "indirect": True}
    return [
        Finding("no-control", "note")
        if method == "indirect" and without
        else Finding("method-refused", "doubtful", method, {"method": method, "reason": reason})
        for method, reason in check.refused
        if meant[method]
    ]


def estimate_text(estimate: Estimate) -> str:
    """Write one estimate with its standard deviation, without words."""
    corrected = with_sigma(estimate.correction, estimate.sigma, "+")
    return f"{estimate.name} {corrected} {estimate.unit} (t {estimate.t:.1f})"


def _mistyped(point: Mistyped) -> Finding:
    axes = zip("XYZ", point.d, point.sigma, strict=True)
    figures: dict[str, Figure] = {
        "numbers": tuple(f"{axis} {d:+.3f} +- {s:.3f}" for axis, d, s in axes),
        "slips": point.slips,
    }
    remedy = "" if point.slips else "look-at-point"
    cause = "slip" if point.slips else ""
    return Finding("control-mistyped", "grave", point.point, figures, cause=cause, remedy=remedy)


def _stated_sigma(group: GroupTest) -> Finding:
    """Name standard deviations that are wrong by a factor: too large ones only cost precision."""
    figures = {"group": group.name, "factor": group.factor, "lower": group.lower, "upper": group.upper}
    if group.factor > 1.0:
        return Finding("sigmas-too-small", "doubtful", group.name, figures)
    return Finding("sigmas-too-large", "note", group.name, figures)


def named(errors: tuple[SystematicError, ...]) -> list[Finding]:
    """Name the grave errors; beside them small ones are no causes yet, for the model is linear."""
    if not errors:
        return []
    gravest = max(errors, key=lambda error: error.hypothesis.gain)
    limit = policy.MINOR_GAIN * gravest.hypothesis.gain
    minor = tuple(error.hypothesis.name for error in errors if error.hypothesis.gain < limit)
    listed = []
    for error in errors:
        if error.hypothesis.gain < limit:
            continue
        finding = _named(error)
        finding = replace(finding, figures={**finding.figures, "fall": _fall(error.hypothesis)})
        if minor and error is gravest:
            figures = {**finding.figures, "minor": minor}
            finding = replace(finding, figures=figures, clauses=(*finding.clauses, "left-over"))
        listed.append(finding)
    return listed


def _fall(hypothesis: Hypothesis) -> float:
    """Fall of v'Pv, less what unknowns gain: of a shift, a height alone is one and two are chance."""
    known = fault(hypothesis.name)
    of_block = known is not None and known.each == "block"
    significant = sum(estimate.significant for estimate in hypothesis.estimates)
    needed = max(significant if of_block else hypothesis.unknowns, 1)
    return hypothesis.gain - _UNKNOWN * (needed - 1) - (hypothesis.unknowns - needed)


def _named(error: SystematicError) -> Finding:
    """Name the mistake that a systematic error looks like; else the error itself."""
    same = (error.hypothesis, *error.alternatives)
    shift = next((hypothesis for hypothesis in same if hypothesis.name == "datum-shift"), None)
    special = None
    if shift is not None:
        # What explains as much as a shift in plane leaves no mistake of the base alone.
        alone = error.hypothesis.name == "datum-shift" and not error.alternatives
        changes = (other for other in same if (known := fault(other.name)) and known.each == "part")
        special = _shift(shift.estimates, alone, next(changes, None))
    elif error.hypothesis.name == "lever-arm":
        special = _swapped_axes(error.hypothesis.estimates)
    return special or _systematic(error)


def _systematic(error: SystematicError) -> Finding:
    hypothesis = error.hypothesis
    shown = [e for e in hypothesis.estimates if e.significant] or list(hypothesis.estimates)
    figures: dict[str, Figure] = {"numbers": tuple(estimate_text(e) for e in shown), "same": error.same}
    return Finding(
        hypothesis.name, "grave", figures=figures, clauses=("correction", *(["same"] * bool(error.same)))
    )


def _shift(estimates: tuple[Estimate, ...], in_plane: bool, change: Hypothesis | None) -> Finding | None:
    """A shift common to all positions: of the height alone, or of the base."""
    axes = {estimate.name.removeprefix("shift_"): estimate for estimate in estimates}
    significant = {axis: estimate for axis, estimate in axes.items() if estimate.significant}
    noteworthy = {
        axis for axis, estimate in significant.items() if abs(estimate.correction) > policy.OTHER_PLACE_M
    }
    if noteworthy == {"z"}:
        z = axes["z"]
        side = "above" if z.correction > 0 else "below"
        figures: dict[str, Figure] = {"shift_m": abs(z.correction), "sigma_m": z.sigma, "side": side}
        if change is None:
            return Finding("antenna-height", "grave", figures=figures)
        # The camera was calibrated over two heights: a second principal distance looks the same.
        before, after = change.estimates
        figures |= {"percent": 100.0 * (after.value / before.value - 1.0), "second": after.name}
        return Finding("antenna-height", "grave", figures=figures, clauses=("or-change",))
    if not noteworthy or not in_plane:
        return None
    shift = tuple(f"{axis.upper()} {e.correction:+.3f} +- {e.sigma:.3f}" for axis, e in axes.items())
    return Finding("base-position", "grave", figures={"numbers": shift}, clauses=("against-control",))


def _swapped_axes(estimates: tuple[Estimate, ...]) -> Finding | None:
    """A lever arm that was given with its axes in another order or with another sign."""
    value = np.array([estimate.value for estimate in estimates])
    given = value - np.array([estimate.correction for estimate in estimates])
    tolerance = np.maximum(_NEAR * np.array([estimate.sigma for estimate in estimates]), _NEAR_M)
    best: tuple[int, tuple[str, ...]] | None = None
    if np.all(np.abs(given - value) <= tolerance):
        return None
    for order in permutations(range(3)):
        for sign in product((1.0, -1.0), repeat=3):
            meant = given[list(order)] * np.array(sign)
            # Equal or zero components make many orders the same vector: the least change is named.
            changed = [k for k in range(3) if order[k] != k or sign[k] < 0]
            fits = bool(np.all(np.abs(meant - value) <= tolerance))
            if fits and (best is None or len(changed) < best[0]):
                best = len(changed), _changes(order, sign)
    if best is None:
        return None
    numbers, stated = (tuple(f"{v:+.3f}" for v in vector) for vector in (value, given))
    figures: dict[str, Figure] = {"stated": stated, "numbers": numbers, "changes": best[1]}
    return Finding("lever-arm-axes", "grave", figures=figures, clauses=("stated-and-found",))


def _changes(order: tuple[int, ...], sign: tuple[float, ...]) -> tuple[str, ...]:
    """Codes of what was exchanged and turned."""
    moved = [_AXES[k] for k in range(3) if order[k] != k]
    parts = [f"exchanged {moved[0]} {moved[1]}"] if len(moved) == 2 else ["reordered"] if moved else []
    return (*parts, *(f"opposite {_AXES[k]}" for k in range(3) if sign[k] < 0))


def _judged(judged: Judged) -> list[Finding]:
    method, listed = judged.result.method, []
    if not judged.result.predicted:
        return [untested("check-outside-prediction", "start-values-used", {"method": method})]
    for code, differences in (
        ("check-outside-prediction", judged.check),
        ("control-outside-prediction", judged.control),
    ):
        if differences.suspected:
            figures: dict[str, Figure] = {"method": method, "points": tuple(differences.suspected)}
            listed.append(Finding(code, "doubtful", method, figures))
    listed += _together(method, judged.check)
    test = judged.result.test
    if test is not None and not test.accepted:
        chi_squared, freedom = judged.result.chi_squared, judged.result.degrees_of_freedom
        if chi_squared > freedom * (1.0 + FACTOR) ** 2:
            figures = {"method": method, "chi_squared": chi_squared, "upper": test.upper}
            listed.append(Finding("global-test", "doubtful", method, figures))
    return listed


def _together(method: Method, check: Differences) -> list[Finding]:
    """Judge all check points together: one by one they count again and again the errors that they share."""
    joint = check.joint
    if joint is None:
        limit = _RATIO_DIRECT if method == "direct" else policy.WORTH_A_WORD
        figures: dict[str, Figure] = {"method": method, "ratio": check.ratio}
        return [Finding("prediction-too-good", "doubtful", method, figures)] if check.ratio > limit else []
    listed = []
    if joint.exceeds:
        figures = {"method": method, "ratio": math.sqrt(joint.chi_squared / joint.degrees_of_freedom)}
        listed.append(Finding("prediction-too-good", "doubtful", method, figures))
    if joint.biased:
        pairs = zip("XYZ", joint.mean, joint.mean_sigma, strict=True)
        numbers = tuple(f"{axis} {mean:+.3f} +- {sigma:.3f}" for axis, mean, sigma in pairs)
        listed.append(Finding("check-mean", "doubtful", method, {"method": method, "numbers": numbers}))
    return listed


def separation_findings(separation: Separation) -> tuple[Finding, ...]:
    """Name what the flight cannot separate, and what would."""
    groups = [tuple(dict.fromkeys(name.split("[")[0] for name in group)) for group in separation.groups]
    # A finding each would be the same one for whoever collects them.
    alone = tuple(dict.fromkeys(group[0] for group in groups if len(group) == 1))
    together = [group for group in groups if len(group) > 1]
    return tuple(
        Finding(code, "note", " ".join(terms), {"terms": terms}, _advice(frozenset(terms)))
        for code, terms in (*(("not-separated", group) for group in together), ("not-determined", alone))
        if terms
    )


def _advice(names: frozenset[str]) -> tuple[str, ...]:
    advice = []
    if "c" in names:
        advice.append("fly-two-heights")
    if {"lever_arm_z", "shift_z"} <= names:
        advice.append("measure-lever-arm")
    if "time_offset" in names:
        advice.append("fly-two-speeds")
    if names & {"x0", "y0"}:
        advice.append("fly-opposite")
    return tuple(advice) or ("add-control",)
