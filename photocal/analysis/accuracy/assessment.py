"""The whole judgement of a product at its check points: statistics, tests and classes."""

import math
from collections.abc import Mapping
from dataclasses import dataclass, replace
from itertools import chain

import numpy as np

from photocal.analysis.accuracy import classes, statistics
from photocal.analysis.accuracy.discrepancies import COMPONENTS, SIGN, Discrepancies
from photocal.analysis.accuracy.standard import (
    LimitTable,
    Question,
    ScaleStandard,
    Standard,
    ValueStandard,
    size_text,
)
from photocal.analysis.accuracy.statistics import PROBABLE_ERROR, LengthStatistics
from photocal.base.errors import ConfigurationError
from photocal.base.policy import policy
from photocal.findings.finding import Figure, Finding

# The side on which a product lies, and what puts it there: the mean positive, and negative.
_SIDES = {
    "E": ("east", "west", "bias-in-plane"),
    "N": ("north", "south", "bias-in-plane"),
    "h": ("high", "low", "bias-in-height"),
}


@dataclass(frozen=True)
class ComponentResult:
    """Statistics and tests of one component; tests are None where the sample is too small.

    points, spread, normality, outliers: none where only moments are known.
    """

    name: str
    moments: statistics.Moments
    bias: statistics.BiasTest | None
    rmse_after_trend_removal_m: float | None
    points: tuple[str, ...] = ()
    spread: statistics.Spread | None = None
    normality: statistics.NormalityTest | None = None
    outliers: tuple[str, ...] = ()


@dataclass(frozen=True)
class TableResult:
    """One table of a standard applied to the product.

    size: scale denominator or interval in m that was asked for; None when none was.
    decisions: for each class at that size; empty without a size.
    admitted: for each class the exact smallest size.
    """

    standard_id: str
    standard_title: str
    table: LimitTable
    size: float | None
    decisions: tuple[classes.ClassDecision, ...]
    admitted: tuple[classes.AdmittedSize, ...]

    @property
    def precision_class(self) -> str | None:
        """Best class by the spread alone; None for no class."""
        return next((decision.limit.name for decision in self.decisions if decision.precise), None)

    @property
    def accuracy_class(self) -> str | None:
        """Best class by the standard's own conditions; None for no class."""
        return next((decision.limit.name for decision in self.decisions if decision.accurate), None)

    @property
    def differ(self) -> bool:
        """Whether precision class and accuracy class differ."""
        return bool(self.decisions) and self.precision_class != self.accuracy_class


@dataclass(frozen=True)
class Assessment:
    """The assessment of a product at its check points.

    Attributes
    ----------
    discrepancies
        Product minus reference, m; no points where only their moments are known.
    question
        Standards, scale and confidence that were asked for.
    components
        Statistics and tests of E, N and h, those that were measured.
    plane, height, space
        Lengths of the errors in plane, height and space, m; None where they were not measured.
    similarity
        Shift, turn and scale of the plane errors; None without positions.
    tables
        Classes by standards whose limits belong to a scale or a contour interval.
    values
        Classes by standards whose class is the value reached.
    """

    discrepancies: Discrepancies
    question: Question
    components: tuple[ComponentResult, ...]
    tables: tuple[TableResult, ...]
    values: tuple[classes.ValueClass, ...]
    plane: LengthStatistics | None = None
    height: LengthStatistics | None = None
    space: LengthStatistics | None = None
    similarity: statistics.SimilarityTrend | None = None

    def __repr__(self) -> str:
        """Say number, mean and root mean square of each component."""
        each = ((one.name, one.moments) for one in self.components)
        told = (f"{name}: {m.n} points, mean {m.mean_m:.4f} m, rms {m.rmse_m:.4f} m" for name, m in each)
        return "\n".join(told)


def assess(discrepancies: Discrepancies, standards: tuple[Standard, ...], question: Question) -> Assessment:
    """Judge a product at its check points.

    raises ConfigurationError: for a scale, interval or survey accuracy that cannot be.
    """
    for name, value in (
        ("scale denominator", question.scale_denominator),
        ("contour interval", question.interval_m),
        ("survey accuracy", question.survey_horizontal_m),
        ("survey accuracy", question.survey_vertical_m),
        ("target accuracy", question.target_horizontal_m),
        ("target accuracy", question.target_vertical_m),
        ("ground sampling distance", question.gsd_m),
    ):
        if value is not None and not (math.isfinite(value) and value > 0.0):
            raise ConfigurationError(f"{name} {value} is not a positive number")
    plane = discrepancies.planimetric()[1]
    height = discrepancies.component("h")[1][:, np.newaxis]
    given = {"planimetry": plane, "height": height}
    products = {name: classes.sample(vectors) for name, vectors in given.items() if len(vectors)}
    ground = discrepancies.of_ground("open"), discrepancies.of_ground("vegetated")
    heights = [part.component("h")[1][:, np.newaxis] for part in ground]
    values = tuple(
        classes.value_class(
            standard,
            products.get("planimetry"),
            classes.sample(heights[0]) if len(heights[0]) else None,
            question,
            {name: (ground[0] if name == "h" else discrepancies).component(name) for name in COMPONENTS},
            classes.sample(heights[1]) if len(heights[1]) else None,
        )
        for standard in standards
        if isinstance(standard, ValueStandard)
    )
    space, gsd_m = discrepancies.spatial()[1], question.gsd_m

    def circle(_: float) -> float:
        """Radius that holds half of the plane errors, by their covariance."""
        return statistics.circular_error(plane.T @ plane / len(plane), PROBABLE_ERROR)

    def line(rms_m: float) -> float:
        """Half-width that holds half of the height errors, by their rms."""
        return statistics.linear_error(rms_m, PROBABLE_ERROR)

    return Assessment(
        discrepancies,
        question,
        tuple(
            _component(discrepancies, name, question.confidence)
            for name in COMPONENTS
            if len(discrepancies.component(name)[0])
        ),
        _tables(standards, products, question),
        values,
        statistics.length_statistics(statistics.lengths(plane), gsd_m, circle) if len(plane) else None,
        statistics.length_statistics(np.abs(height[:, 0]), gsd_m, line) if len(height) else None,
        statistics.length_statistics(statistics.lengths(space), gsd_m) if len(space) else None,
        _similarity(discrepancies),
    )


def assess_moments(
    moments: Mapping[str, statistics.Moments], standards: tuple[Standard, ...], question: Question
) -> Assessment:
    """Judge a product by the moments of its discrepancies, by component; the 90 % rule needs the points."""
    products = {
        kind: classes.Sample(tuple(moments[part] for part in parts))
        for kind, parts in (("planimetry", ("E", "N")), ("height", ("h",)))
        if parts[0] in moments
    }
    values = (
        classes.value_class(standard, products.get("planimetry"), products.get("height"), question)
        for standard in standards
        if isinstance(standard, ValueStandard)
    )
    return Assessment(
        Discrepancies((), np.zeros((0, 3))),
        question,
        tuple(_tested_moments(n, moments[n], question.confidence) for n in COMPONENTS if n in moments),
        _tables(standards, products, question),
        tuple(values),
    )


def _component(discrepancies: Discrepancies, name: str, confidence: float) -> ComponentResult:
    points, values = discrepancies.component(name)
    return replace(
        _tested_moments(name, statistics.moments(values), confidence),
        points=points,
        spread=statistics.spread(values),
        normality=statistics.normality_test(values, confidence),
        outliers=tuple(points[row] for row in statistics.outliers(values, confidence)),
    )


def _tested_moments(name: str, figures: statistics.Moments, confidence: float) -> ComponentResult:
    """What the moments of a component alone say."""
    if figures.n < 2:
        return ComponentResult(name, figures, None, None)
    trend_removed = statistics.rmse_after_trend_removal(figures, confidence)
    return ComponentResult(name, figures, statistics.bias_test(figures, confidence), trend_removed)


def _similarity(discrepancies: Discrepancies) -> statistics.SimilarityTrend | None:
    if discrepancies.positions_m is None:
        return None
    both = np.column_stack((discrepancies.positions_m[:, :2], discrepancies.d_m[:, :2]))
    both = both[np.isfinite(both).all(axis=1)]
    if len(both) < 3 or not np.ptp(both[:, :2], axis=0).any():
        return None
    return statistics.similarity_trend(both[:, :2], both[:, 2:])


def _tables(
    standards: tuple[Standard, ...], products: Mapping[str, classes.Sample], question: Question
) -> tuple[TableResult, ...]:
    """Apply the tables of all standards to the products that they are of."""
    return tuple(
        _apply_table(standard, table, products[table.component], question)
        for standard in standards
        if isinstance(standard, ScaleStandard)
        for table in standard.tables
        if table.component in products
    )


def _apply_table(
    standard: ScaleStandard, table: LimitTable, product: classes.Sample, question: Question
) -> TableResult:
    """Apply one table of a standard to a product."""
    size = question.scale_denominator if table.basis == "scale" else question.interval_m
    if size is None and table.basis == "interval" and question.scale_denominator is not None:
        size = table.interval_at(question.scale_denominator)
    share, confidence = standard.fraction_within_pec, question.confidence
    limits = () if size is None else table.limits_at(size)
    decisions = tuple(classes.decide(product, limit, share, confidence) for limit in limits)
    names = (limit.name for limit in table.unit_limits)
    admitted = tuple(classes.admitted_size(product, table, name, share, confidence) for name in names)
    return TableResult(standard.id, standard.title, table, size, decisions, admitted)


def findings(assessment: Assessment) -> tuple[Finding, ...]:
    """Say what an assessment found."""
    components = assessment.components
    listed = [_sample_sizes(components), *map(_bias, components), *map(_shape, components)]
    return tuple(chain(*listed, *map(_classes, assessment.tables), *map(_value_class, assessment.values)))


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
        elif n < policy.small_sample:
            low, high = statistics.std_interval_factors(n, policy.confidence)
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


def _value_class(value: classes.ValueClass) -> list[Finding]:
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
    shared = ({"axis": kind, "share": share} for kind in value.survey_too_coarse)
    listed += [Finding("survey-too-coarse", "doubtful", standard.id, figures) for figures in shared]
    if value.systematic:
        shares = {"components": value.systematic, "share": standard.mean_share_of_target.value}
        listed.append(Finding("systematic", "doubtful", standard.id, shares))
    if value.blunders:
        blunders = tuple(f"{point} {component}" for point, component in value.blunders)
        times: dict[str, Figure] = {"points": blunders, "times": standard.blunder_over_target.value}
        listed.append(Finding("beyond-target", "doubtful", standard.id, times))
    if value.vegetated_m is not None:
        grown = {"rmse_m": value.vegetated_m, "n": float(value.points_vegetated)}
        grown |= {"required": standard.minimum_points.value}
        listed.append(Finding("vva", "note", standard.id, grown))
    return listed + _tested(value)


def _tested(value: classes.ValueClass) -> list[Finding]:
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
