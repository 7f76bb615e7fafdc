"""What an assessment found: what limits the judgement, bias, outliers, classes that differ."""

from __future__ import annotations

from photocal.accuracy.assessment import Assessment, ComponentResult, TableResult
from photocal.accuracy.classes import ValueClass
from photocal.accuracy.discrepancies import SIGN
from photocal.accuracy.standard import size_text
from photocal.accuracy.statistics import std_interval_factors
from photocal.findings.finding import Figure, Finding

# Below this number the standard deviation is known to worse than about a quarter of itself (95 %).
SMALL_SAMPLE = 30
_INTERVAL_CONFIDENCE = 0.95

# The side on which a product lies, and what puts it there: the mean positive, and negative.
_SIDES = {
    "E": ("east", "west", "bias-in-plane"),
    "N": ("north", "south", "bias-in-plane"),
    "h": ("high", "low", "bias-in-height"),
}


def findings(assessment: Assessment) -> tuple[Finding, ...]:
    """Say what an assessment found."""
    listed = _sample_sizes(assessment.components)
    for component in assessment.components:
        listed += _bias(component)
    for component in assessment.components:
        listed += _shape(component)
    for table in assessment.tables:
        listed += _classes(table)
    for value in assessment.values:
        listed += _value_class(value)
    return tuple(listed)


def _sample_sizes(components: tuple[ComponentResult, ...]) -> list[Finding]:
    """Say once for all components with the same number of points what that number is worth."""
    by_number: dict[int, list[str]] = {}
    for component in components:
        by_number.setdefault(component.moments.n, []).append(component.name)
    listed = []
    for n, names in sorted(by_number.items()):
        which = ", ".join(names)
        if n == 1:
            listed.append(Finding("single-check-point", "note", which))
        elif n < SMALL_SAMPLE:
            low, high = std_interval_factors(n, _INTERVAL_CONFIDENCE)
            listed.append(Finding("small-sample", "note", which, {"n": float(n), "low": low, "high": high}))
    return listed


def _bias(component: ComponentResult) -> list[Finding]:
    test, moments = component.bias, component.moments
    if test is None or not test.significant:
        return []
    east, west, cause = _SIDES[component.name]
    figures = {
        "mean_m": moments.mean_m,
        "correction_m": -moments.mean_m,
        "sign": SIGN,
        "t": abs(test.t),
        "critical": test.critical,
        "confidence": test.confidence,
        "side": east if moments.mean_m > 0.0 else west,
        "rmse_m": moments.rmse_m,
        "rmse_without_m": moments.rmse_without_mean_m,
    }
    return [Finding("bias", "doubtful", component.name, figures, cause=cause)]


def _shape(component: ComponentResult) -> list[Finding]:
    listed = []
    if component.outliers:
        listed.append(Finding("outliers", "doubtful", component.name, {"points": component.outliers}))
    normality = component.normality
    if normality is not None and normality.rejected:
        listed.append(Finding("not-normal", "note", component.name, {"p": normality.p_value}))
    return listed


def _classes(table: TableResult) -> list[Finding]:
    if table.size is None or not table.differ:
        return []
    best, cause = table.decisions[0], "bias-removed"
    if not best.precise and any(d.accurate and not d.precise for d in table.decisions):
        cause = "chi-square-stricter"
    elif best.share_passes is False and best.rmse_within:
        cause = "share-within-pec"
    figures = {
        "standard": table.standard_id,
        "product": table.table.product,
        "at": size_text(table.table.basis, table.size).removeprefix("interval "),
        "precision_class": table.precision_class or "no-class",
        "accuracy_class": table.accuracy_class or "no-class",
        "share": best.share_within,
    }
    return [Finding("class-differs", "note", table.standard_id, figures, cause=cause)]


def _value_class(value: ValueClass) -> list[Finding]:
    standard, listed = value.standard, []
    if not value.enough_points:
        figures = {"n": float(min(value.counts)), "required": standard.minimum_points.value}
        listed.append(Finding("too-few-check-points", "note", standard.id, figures))
    missing = tuple(
        name
        for name, checked, included in (
            ("horizontal", value.horizontal_m is not None, value.survey_included_horizontal),
            ("vertical", value.vertical_m is not None, value.survey_included_vertical),
        )
        if checked and not included
    )
    if missing:
        listed.append(Finding("survey-accuracy-missing", "doubtful", standard.id, {"axes": missing}))
    share = standard.survey_share_of_target.value
    for kind in value.survey_too_coarse:
        figures_of_survey = {"axis": kind, "share": share}
        listed.append(Finding("survey-too-coarse", "doubtful", standard.id, figures_of_survey))
    if value.systematic:
        limit = standard.mean_share_of_target.value
        shares = {"components": value.systematic, "share": limit}
        listed.append(Finding("systematic", "doubtful", standard.id, shares))
    if value.blunders:
        blunders = tuple(f"{point} {component}" for point, component in value.blunders)
        times: dict[str, Figure] = {"points": blunders, "times": standard.blunder_over_target.value}
        listed.append(Finding("beyond-target", "doubtful", standard.id, times))
    if value.vegetated_m is not None:
        grown = {"rmse_m": value.vegetated_m, "n": float(value.points_vegetated)}
        listed.append(
            Finding("vva", "note", standard.id, {**grown, "required": standard.minimum_points.value})
        )
    return listed + _tested(value)


def _tested(value: ValueClass) -> list[Finding]:
    """Give the standard's statement of what was tested, for each component."""
    listed = []
    required = value.standard.minimum_points.value
    for axis, target, reached, n in (
        ("horizontal", value.target_horizontal_m, value.horizontal_m, value.points_horizontal),
        ("vertical", value.target_vertical_m, value.vertical_m, value.points_vertical),
    ):
        if reached is None:
            continue
        figures: dict[str, Figure] = {"axis": axis, "n": float(n), "required": required, "rmse_m": reached}
        if target is None:
            listed.append(Finding("no-target", "note", value.standard.id, figures))
            continue
        figures["target_m"] = target
        if reached > target:
            listed.append(Finding("target-missed", "doubtful", value.standard.id, figures))
        else:
            code = "target-met" if n >= required else "target-met-reduced"
            listed.append(Finding(code, "note", value.standard.id, figures))
    return listed
