"""What a check of a block found, in words."""

from __future__ import annotations

import math
from dataclasses import replace

from scipy import stats

from photocal.accuracy.findings import Finding
from photocal.accuracy.ground_points import name_list
from photocal.georeferencing.comparison import BlockCheck, Judged
from photocal.georeferencing.faults import fault_of
from photocal.georeferencing.freed_groups import MEANING, Estimate
from photocal.georeferencing.mistyped import Mistyped
from photocal.georeferencing.separation import separation_findings
from photocal.georeferencing.systematic import SystematicError

# Errors this many times as large as predicted, or as small, are worth a word.
_RATIO = 1.5
# Without ground points all points of a flight share the errors of its rig and of few images: at worst they
# err as one point, and their root of the mean d' C^-1 d / 3 as that of one (0.1 %).
_RATIO_DIRECT = math.sqrt(float(stats.chi2(3).ppf(0.999)) / 3.0)

# An error whose share of the gravest one's gain is less may be what the linear model leaves of that one.
_MINOR = 0.1


def block_findings(check: BlockCheck) -> tuple[Finding, ...]:
    """Say what was found: mistakes and errors first, each under one name, then what follows of them."""
    said = [*check.plausibility, *(_mistyped(one) for one in check.mistyped)]
    if check.systematic is not None:
        said += _causes(check.systematic.errors)
    for judged in check.judged:
        said += _judged(judged)
    if check.separation is not None:
        said += separation_findings(check.separation)
    if check.judged and not any(judged.check.names for judged in check.judged):
        said.append(Finding("no-check-points", "there is no check point, so nothing judges the accuracy."))
    return (*said, *_refused(check))


def _refused(check: BlockCheck) -> list[Finding]:
    """Say which methods the block does not allow; what it was never meant for is no fault."""
    without = not check.block.points.of_role("control").any()
    said = []
    for method, reason in check.refused:
        if method == "indirect" and without:
            text = (
                "there is no control point: nothing but the positions fixes the datum, and nothing checks it"
            )
            said.append(Finding("no-control", f"{text}; no indirect georeferencing."))
        else:
            said.append(Finding("method-refused", f"{method} georeferencing is not possible: {reason}"))
    return said


def estimate_text(estimate: Estimate) -> str:
    """Write one estimate with its standard deviation."""
    digits = max(0, 1 - math.floor(math.log10(estimate.sigma))) if estimate.sigma > 0 else 4
    return (
        f"{estimate.name} {estimate.correction:+.{digits}f} +- {estimate.sigma:.{digits}f} {estimate.unit} "
        f"(t {estimate.t:.1f})"
    )


def _mistyped(one: Mistyped) -> Finding:
    figures = ", ".join(
        f"{axis} {d:+.3f} +- {s:.3f}" for axis, d, s in zip("XYZ", one.d, one.sigma, strict=True)
    )
    cause = (
        f"as if mistyped, {one.slip}" if one.slip else "look at its coordinates and its image measurements"
    )
    text = (
        f"control point {one.point} contradicts the other control points by {figures} m (given less "
        f"computed): {cause}. Systematic errors were looked for without it."
    )
    return Finding("control-mistyped", text)


def _causes(errors: tuple[SystematicError, ...]) -> list[Finding]:
    """Name the grave errors; beside them small ones are no causes yet, for the model is linear."""
    if not errors:
        return []
    gravest = max(errors, key=lambda error: error.found.gain)
    limit = _MINOR * gravest.found.gain
    minor = " and ".join(error.found.name for error in errors if error.found.gain < limit)
    said = []
    for error in errors:
        if error.found.gain < limit:
            continue
        finding = fault_of(error) or _systematic(error)
        if minor and error is gravest:
            hint = f" What is left looks like {minor}: look again when this is corrected."
            finding = replace(finding, text=finding.text + hint)
        said.append(finding)
    return said


def _systematic(error: SystematicError) -> Finding:
    found = error.found
    figures = ", ".join(estimate_text(e) for e in found.estimates if e.significant)
    figures = figures or ", ".join(estimate_text(e) for e in found.estimates)
    text = f"{found.name}: {MEANING[found.name]}; correction {figures}."
    if error.same:
        text += (
            f" This flight cannot tell it from an error of {' or '.join(error.same)}: "
            "both explain the observations as well."
        )
    return Finding(found.name.replace(" ", "-"), text)


def _judged(judged: Judged) -> list[Finding]:
    method, said = judged.found.method, []
    if judged.check.suspected:
        said.append(
            Finding(
                "check-outside-prediction",
                f"{method}: check point {name_list(list(judged.check.suspected))} differs by more than its "
                "predicted covariance explains (0.1 %): a blunder of the point, or an error that the "
                "sigmas do not know.",
            )
        )
    if judged.control.suspected:
        said.append(
            Finding(
                "control-outside-prediction",
                f"{method}: control point {name_list(list(judged.control.suspected))} does not fit "
                "(0.1 %): look at its coordinates and its image measurements.",
            )
        )
    ratio = judged.check.ratio
    if ratio > (_RATIO_DIRECT if method == "direct" else _RATIO):
        said.append(
            Finding(
                "prediction-too-good",
                f"{method}: the errors at the check points are {ratio:.1f} times as large as predicted: "
                "trust the check points, not the predicted standard deviations.",
            )
        )
    test = judged.found.test
    if test is not None and not test.accepted and judged.found.chi_squared > test.upper:
        said.append(
            Finding(
                "global-test",
                f"{method}: v'Pv {judged.found.chi_squared:.0f} is above {test.upper:.0f} (95 %): the "
                "observations disagree by more than their sigmas.",
            )
        )
    return said
