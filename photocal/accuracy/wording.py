"""An assessment in words for a surveyor: what the figures mean and what to do."""

from __future__ import annotations

from photocal.accuracy.assessment import Assessment, ComponentResult, TableResult
from photocal.accuracy.discrepancies import SIGN
from photocal.accuracy.findings import Finding
from photocal.accuracy.map_scale import size_text
from photocal.accuracy.significance_tests import std_interval_factors
from photocal.accuracy.value_class import ValueClass, class_cm

# Below this number the standard deviation is known to worse than about a quarter of itself (95 %).
SMALL_SAMPLE = 30
_INTERVAL_CONFIDENCE = 0.95

# What makes a whole product lie beside or below the truth.
_PLANE_CAUSES = "datum, lever arm, time offset of the exposures, principal point"
_CAUSES = {
    "E": _PLANE_CAUSES,
    "N": _PLANE_CAUSES,
    "h": "geoid or kind of height, vertical lever arm, principal distance",
}


def findings(assessment: Assessment) -> tuple[Finding, ...]:
    """Say in words what an assessment found.

    Parameters
    ----------
    assessment : Assessment
        The figures.

    Returns
    -------
    tuple of Finding
        What limits the judgement first, then bias, outliers, and where the classes differ.
    """
    said = _sample_sizes(assessment.components)
    for component in assessment.components:
        said += _bias(component)
    for component in assessment.components:
        said += _shape(component)
    for table in assessment.tables:
        said += _classes(table)
    for value in assessment.values:
        said += _value_class(value)
    return tuple(said)


def _sample_sizes(components: tuple[ComponentResult, ...]) -> list[Finding]:
    """Say once for all components with the same number of points what that number is worth."""
    by_number: dict[int, list[str]] = {}
    for component in components:
        by_number.setdefault(component.moments.n, []).append(component.name)
    said = []
    for n, names in sorted(by_number.items()):
        which = ", ".join(names)
        if n == 1:
            text = f"{which}: one check point only: it can show a blunder, but neither precision nor bias."
            said.append(Finding("single-check-point", text))
        elif n < SMALL_SAMPLE:
            low, high = std_interval_factors(n, _INTERVAL_CONFIDENCE)
            text = (
                f"{which}: small sample: with {n} check points the true standard deviation lies anywhere "
                f"between {low:.2f} and {high:.2f} times the one found (95 %)."
            )
            said.append(Finding("small-sample", text))
    return said


def _bias(component: ComponentResult) -> list[Finding]:
    test = component.bias
    if test is None or not test.significant:
        return []
    figures = component.moments
    text = (
        f"{component.name}: there is a bias of {figures.mean_m:+.3f} m ({SIGN}; |t| = {abs(test.t):.2f}, "
        f"limit {test.critical:.3f} at {test.confidence:.0%}). The product is too "
        f"{_direction(component.name, figures.mean_m)}; adding {figures.mean_m:+.3f} m to it would remove "
        f"the bias, but look for the cause first ({_CAUSES[component.name]}). Without "
        f"the bias the RMSE is {figures.rmse_without_mean_m:.3f} m instead of {figures.rmse_m:.3f} m."
    )
    return [Finding("bias", text)]


def _direction(name: str, mean: float) -> str:
    low, high = {"E": ("far west", "far east"), "N": ("far south", "far north"), "h": ("low", "high")}[name]
    return low if mean > 0.0 else high


def _shape(component: ComponentResult) -> list[Finding]:
    said = []
    if component.outliers:
        said.append(
            Finding(
                "outliers",
                f"{component.name}: check point {', '.join(component.outliers)}: too far from the others "
                "(test of Rosner 1983); look at the mark and its survey. It stays in all figures.",
            )
        )
    normality = component.normality
    if normality is not None and normality.rejected:
        said.append(
            Finding(
                "not-normal",
                f"{component.name}: the discrepancies are not normally distributed (Shapiro-Wilk p = "
                f"{normality.p_value:.3g}): the levels of the t and chi-square tests are only approximate, "
                "the 90 % rule is not affected.",
            )
        )
    return said


def _classes(table: TableResult) -> list[Finding]:
    if table.size is None or not table.differ:
        return []
    precision, accuracy = table.precision_class, table.accuracy_class
    best = table.decisions[0]
    at = size_text(table.table.basis, table.size)
    reason = "the chi-square test sees the spread only, the bias was removed"
    if not best.precise and any(d.accurate and not d.precise for d in table.decisions):
        reason = "the chi-square test is stricter than the standard's own rule"
    elif best.share_passes is False and best.rmse_within:
        reason = f"only {best.share_within:.0%} of the points lie within PEC"
    return [
        Finding(
            "class-differs",
            f"{table.standard_id}, {table.table.product}, {at}: by precision {_class_text(precision)}, but "
            f"by accuracy {_class_text(accuracy)}: {reason}. The accuracy class is the one to claim.",
        )
    ]


def _class_text(name: str | None) -> str:
    return "no class" if name is None else f"class {name}"


def _value_class(value: ValueClass) -> list[Finding]:
    said = []
    standard = value.standard
    counts = [count for count in (value.points_horizontal, value.points_vertical) if count]
    if not value.enough_points:
        said.append(
            Finding(
                "too-few-check-points",
                f"{standard.id}: {min(counts)} check points, {standard.minimum_points.value:.0f} are "
                "required: the accuracy may be stated, but not as tested to this standard.",
            )
        )
    missing = [
        name
        for name, checked, included in (
            ("horizontal", value.horizontal_m is not None, value.survey_included_horizontal),
            ("vertical", value.vertical_m is not None, value.survey_included_vertical),
        )
        if checked and not included
    ]
    if missing:
        said.append(
            Finding(
                "survey-accuracy-missing",
                f"{standard.id}: the {' and '.join(missing)} accuracy of the survey of the check points was "
                "not given and is not in the class, which is therefore too good.",
            )
        )
    said.extend(
        Finding(
            "survey-too-coarse",
            f"{standard.id}: the {kind} survey of the check points is worse than "
            f"{standard.survey_share_of_product.value:.0%} of the accuracy that it should test.",
        )
        for kind in value.survey_too_coarse
    )
    if value.systematic:
        said.append(
            Finding(
                "systematic",
                f"{standard.id}: the mean of {', '.join(value.systematic)} exceeds "
                f"{standard.mean_share_of_rmse.value:.0%} of the RMSE: to be investigated as systematic.",
            )
        )
    return said


def value_class_text(value: ValueClass) -> str:
    """Write the class reached."""
    parts = (("horizontal", value.horizontal_m), ("vertical", value.vertical_m), ("3D", value.spatial_m))
    return ", ".join(f"{name} {class_cm(rmse):.1f} cm" for name, rmse in parts if rmse is not None)
