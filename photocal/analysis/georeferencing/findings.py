"""What a check of a block found: mistakes and errors under their names, then what follows of them.

Strips that show no control point: only their neighbours hold them, as often with outer strips.
"""

import math
from collections.abc import Sequence
from collections.abc import Set as AbstractSet
from typing import Any

import numpy as np
from scipy import special

from photocal.adjustment.adjusted import AdjustedNetwork
from photocal.analysis.georeferencing.causes import Separation, by_navigation_fixes
from photocal.analysis.georeferencing.comparison import BlockCheck, Differences, Judged
from photocal.analysis.georeferencing.methods import Georeferenced, Method
from photocal.analysis.shutters import shutters_of
from photocal.base.arrays import Integers
from photocal.base.policy import policy
from photocal.block.model import Block
from photocal.findings.finding import FACTOR, Figure, Finding, Severity, untested
from photocal.geometry.strips import lines_of_places, order_of_places
from photocal.hypotheses.findings import asked_of, cause_findings


def control_by_strip(block: Block, names: Sequence[str], strip: Integers) -> list[dict[str, Any]]:
    """Count the images of each strip, and the control points that they show.

    names, strip (n,): images in the order of the flight, and their strips, numbered from 1.
    """
    own = {name: int(number) for name, number in zip(names, strip.tolist(), strict=True)}
    of_image = np.array([own.get(name, -1) for name in block.images.names])
    control = block.points.of_role("control")[block.observations.point]
    rows = []
    for number in dict.fromkeys(strip.tolist()):
        seen = control & (of_image[block.observations.image] == number)
        points = len(np.unique(block.observations.point[seen]))
        first = names[int(np.argmax(strip == number))]
        images = int(np.sum(strip == number))
        rows.append({"strip": number + 1, "first": first, "images": images, "control_points": points})
    return rows


def held_by_positions(block: Block) -> bool:
    """Whether positions better than navigation fixes hold strips that show no control."""
    of_images, of_positions = block.images.sigma[:, 3:5], block.positions.stated()[:2]
    return any(bool((sigma < policy.coarse_m).any()) for sigma in (of_images, of_positions))


def strip_findings(block: Block, result: Georeferenced, target_m: float | None = None) -> tuple[Finding, ...]:
    """Name strips without control where nothing else holds them: no positions better than navigation fixes.

    target_m: root mean square error that is asked of the block; it says from which sigma on that harms.
    """
    # Shorter ones are turns.
    fewest_images = 3
    known = np.flatnonzero(np.isfinite(result.exposures).all(axis=1))
    if held_by_positions(block) or len(block.cameras) > 1 or len(known) < 2 * fewest_images:
        return ()
    time = block.images.time[known]
    timed = np.isfinite(time).all()
    listed = [block.images.names[k] for k in known]
    order = known[
        np.argsort(time, kind="stable") if timed else order_of_places(listed, result.exposures[known, 3:])
    ]
    strip = lines_of_places(result.exposures[order, 3:])
    names = [block.images.names[k] for k in order]
    rows = [row for row in control_by_strip(block, names, strip) if row["images"] >= fewest_images]
    bare = [row for row in rows if not row["control_points"]]
    if not bare or len(bare) == len(rows):
        return ()
    figures: dict[str, Figure] = {
        "strips": tuple(str(row["strip"]) for row in bare),
        "first": tuple(row["first"] for row in bare),
        "images": float(sum(row["images"] for row in bare)),
        "of": float(len(names)),
    }
    severity: Severity = "note"
    clauses: tuple[str, ...] = ()
    if result.adjusted is not None:
        outside = {names[k] for k in np.flatnonzero(np.isin(strip + 1, [row["strip"] for row in bare]))}
        there, elsewhere = _height_sigmas(result.adjusted, outside)
        if math.isfinite(there) and math.isfinite(elsewhere):
            figures |= {"there_m": there, "elsewhere_m": elsewhere}
            clauses = ("bare-heights",)
            limit = asked_of(result.adjusted, target_m).ground_m
            severity = "doubtful" if there > max(limit, policy.worth_a_word * elsewhere) else "note"
    return (Finding("strips-without-control", severity, figures=figures, clauses=clauses),)


def _height_sigmas(adjusted: AdjustedNetwork, images: AbstractSet[str]) -> tuple[float, float]:
    """Root mean square sigma of the heights of points that these images alone show, and of the others, m."""
    rays = adjusted.network.rays
    own = np.array([name in images for name in adjusted.network.image_names])
    count = len(adjusted.network.point_names)
    seen, within = np.bincount(rays.point, minlength=count), np.bincount(rays.point, own[rays.image], count)
    variance = adjusted.solution.point_covariance[:, 2, 2]
    alone, others = (seen > 0) & (within == seen), within < seen
    there, elsewhere = (
        math.sqrt(variance[rows].mean()) if rows.any() else math.nan for rows in (alone, others)
    )
    return there, elsewhere


# Without ground points all points of a flight share the errors of its rig and of few images: at worst they
# err as one point, and their root of the mean d' C^-1 d / 3 as that of one (0.1 %).
_RATIO_DIRECT = math.sqrt(float(special.chdtri(3, 0.001)) / 3.0)


def block_findings(check: BlockCheck) -> tuple[Finding, ...]:
    """Give what was found: mistakes and errors first, each under one name, then what follows of them."""
    listed = [*check.plausibility]
    causes = () if check.systematic is None else cause_findings(check.systematic, check.slips, _target(check))
    if by_navigation_fixes(check.block):
        # That their errors persist is known beforehand, and their sigmas are assumed.
        expected = ("positions-share-errors", "unexplained")
        causes = tuple(one for one in causes if one.code not in expected and one.subject != "position")
        listed.append(Finding("coarse-positions", "note"))
    listed += causes
    # The points of all methods are one family: check and control of each share its level (Bonferroni).
    groups = sum(len(judged.differences) for judged in check.judged if judged.result.predicted)
    for judged in check.judged:
        listed += _judged(judged, policy.family_significance / max(groups, 1))
    if check.separation is not None:
        listed += separation_findings(check.separation)
    if check.judged and not any(judged.check.names for judged in check.judged):
        listed.append(Finding("no-check-points", "note"))
    adjusted = next((one.result for one in check.judged if one.result.method != "direct"), None)
    if adjusted is not None:
        listed += strip_findings(check.block, adjusted, _target(check))
        listed += () if adjusted.adjusted is None else shutters_of(adjusted.adjusted)
    return (*listed, *_refused(check))


def _target(check: BlockCheck) -> float | None:
    """The smallest root mean square error that is asked of the product, m."""
    questions = (judged.assessment.question for judged in check.judged if judged.assessment is not None)
    asked = next(((q.target_horizontal_m, q.target_vertical_m) for q in questions), ())
    return min((target for target in asked if target is not None), default=None)


def _refused(check: BlockCheck) -> list[Finding]:
    """Name the methods that the block does not allow; what it was never meant for is no fault."""
    block = check.block
    without = not block.points.of_role("control").any()
    # An attitude of one image only keeps a block level.
    known = np.isfinite(block.images.sigma)
    places, angles = known[:, 3:].any(), known[:, :3].all(axis=1).sum() > 1
    positions, attitudes = places or len(block.positions.image), angles or len(block.attitudes.image)
    meant = {"direct": positions and attitudes, "integrated": positions or attitudes, "indirect": True}
    # What should have been possible and is not has a cause that nobody has found.
    control = int(block.points.of_role("control").sum())
    needed = {"direct": False, "integrated": True, "indirect": control >= policy.fewest_control}
    return [
        Finding("no-control", "note")
        if method == "indirect" and without
        else Finding(
            "method-refused",
            "grave" if needed[method] else "doubtful",
            method,
            {"method": method, "reason": reason},
        )
        for method, reason in check.refused
        if meant[method]
    ]


def _judged(judged: Judged, level: float) -> list[Finding]:
    """Judge the ground points of one method; any of sound ones stands out with the probability `level`."""
    method, listed = judged.result.method, []
    if not judged.result.predicted:
        return [untested("check-outside-prediction", "start-values-used", {"method": method})]
    for code, differences in (
        ("check-outside-prediction", judged.check),
        ("control-outside-prediction", judged.control),
    ):
        # Where all together exceed their prediction, which ones do is no alarm of its own.
        together = differences.joint is not None and differences.joint.exceeds
        points = differences.suspected if together else differences.suspected_at(level)
        if points:
            figures: dict[str, Figure] = {"method": method, "points": points}
            listed.append(Finding(code, "doubtful", method, figures))
    listed += _together(method, judged.check)
    test = judged.result.test
    if test is not None and not test.accepted:
        chi_squared, freedom = judged.result.chi_squared, judged.result.degrees_of_freedom
        factor = math.sqrt(chi_squared / freedom)
        if factor > 1.0 + FACTOR:
            figures = {"method": method, "chi_squared": chi_squared, "upper": test.upper}
            # Size counts, whatever the cause: beyond that no standard deviation says what is behind it.
            severity: Severity = "grave" if factor > policy.worth_a_word else "doubtful"
            listed.append(Finding("global-test", severity, method, figures))
    return listed


def _together(method: Method, check: Differences) -> list[Finding]:
    """Judge all check points together: one by one they count again and again the errors that they share."""
    joint = check.joint
    if joint is None:
        limit = _RATIO_DIRECT if method == "direct" else policy.worth_a_word
        figures: dict[str, Figure] = {"method": method, "ratio": check.ratio}
        return [Finding("prediction-too-good", "doubtful", method, figures)] if check.ratio > limit else []
    listed = []
    if joint.exceeds:
        ratio = math.sqrt(joint.chi_squared / joint.degrees_of_freedom)
        figures = {"method": method, "ratio": ratio, "p": joint.p_value}
        # Of direct georeferencing another method takes the place; single points may be wrong themselves.
        harmful = method != "direct" and ratio > 1.0 + FACTOR and not by_single_points(check)
        severity: Severity = "grave" if harmful else "doubtful"
        listed.append(Finding("prediction-too-good", severity, method, figures))
    if joint.biased:
        pairs = zip("XYZ", joint.mean, joint.mean_sigma, strict=True)
        numbers = tuple(f"{axis} {mean:+.3f} +- {sigma:.3f}" for axis, mean, sigma in pairs)
        listed.append(Finding("check-mean", "doubtful", method, {"method": method, "numbers": numbers}))
    return listed


def by_single_points(check: Differences) -> bool:
    """Whether few points that stand out, a third at most, make up what the others together do not contradict.

    Which points stand out is Holm's test over all of them, and whether the others agree the joint test of
    these at 95 %: an error of the block is in its points alike, by their covariance.
    """
    few, rest = 0 < len(check.suspected) <= policy.single_points * len(check.names), check.rest
    if not few or rest is None:
        return False
    return rest.p_value >= 1.0 - policy.confidence or rest.chi_squared <= rest.degrees_of_freedom


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
