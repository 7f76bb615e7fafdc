"""The whole judgement of a product at its check points: statistics, tests and classes."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from drivers.arrays import Floats
from drivers.errors import ConfigurationError
from photocal.accuracy.classes import (
    AdmittedSize,
    ClassDecision,
    Sample,
    ValueClass,
    admitted_size,
    decide,
    sample,
    value_class,
)
from photocal.accuracy.discrepancies import COMPONENTS, Discrepancies
from photocal.accuracy.standard import LimitTable, Question, ScaleStandard, Standard, ValueStandard
from photocal.accuracy.statistics import (
    BiasTest,
    LengthStatistics,
    Moments,
    NormalityTest,
    SimilarityTrend,
    Spread,
    bias_test,
    circular_error,
    counted_error,
    length_statistics,
    lengths,
    linear_error,
    moments,
    normality_test,
    outliers,
    rmse_after_trend_removal,
    similarity_trend,
    spread,
)

PROBABLE_ERROR = 0.90


@dataclass(frozen=True)
class ComponentResult:
    """Statistics and tests of one component; tests are None where the sample is too small."""

    name: str
    points: tuple[str, ...]
    moments: Moments
    spread: Spread
    bias: BiasTest | None
    normality: NormalityTest | None
    outliers: tuple[str, ...]
    rmse_after_trend_removal_m: float | None


@dataclass(frozen=True)
class VectorResult:
    """Plane or space vectors, or absolute height differences, summed up.

    probable_m: CE90 (plane) or LE90 (height) from the second moments, m; None in space.
    counted_m: length that 90 % of the points do not exceed, m.
    """

    statistics: LengthStatistics
    probable_m: float | None
    counted_m: float


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
    decisions: tuple[ClassDecision, ...]
    admitted: tuple[AdmittedSize, ...]

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
    """Everything that is said about a product at its check points."""

    discrepancies: Discrepancies
    question: Question
    components: tuple[ComponentResult, ...]
    plane: VectorResult | None
    height: VectorResult | None
    space: VectorResult | None
    similarity: SimilarityTrend | None
    tables: tuple[TableResult, ...]
    values: tuple[ValueClass, ...]


def assess(discrepancies: Discrepancies, standards: tuple[Standard, ...], question: Question) -> Assessment:
    """Judge a product at its check points.

    raises ConfigurationError: for a scale, interval or survey accuracy that cannot be.
    """
    _require_positive(question)
    plane = discrepancies.planimetric()[1]
    height = discrepancies.component("h")[1][:, np.newaxis]
    products: dict[str, Sample] = {}
    if len(plane):
        products["planimetry"] = sample(plane)
    if len(height):
        products["height"] = sample(height)
    tables = tuple(
        _apply(standard, table, products[table.component], question)
        for standard in standards
        if isinstance(standard, ScaleStandard)
        for table in standard.tables
        if table.component in products
    )
    ground = discrepancies.of_ground("open"), discrepancies.of_ground("vegetated")
    heights = [part.component("h")[1][:, np.newaxis] for part in ground]
    values = tuple(
        value_class(
            standard,
            products.get("planimetry"),
            sample(heights[0]) if len(heights[0]) else None,
            question,
            {name: (ground[0] if name == "h" else discrepancies).component(name) for name in COMPONENTS},
            sample(heights[1]) if len(heights[1]) else None,
        )
        for standard in standards
        if isinstance(standard, ValueStandard)
    )
    space = discrepancies.spatial()[1]
    return Assessment(
        discrepancies,
        question,
        tuple(
            _component(discrepancies, name, question.confidence)
            for name in COMPONENTS
            if len(discrepancies.component(name)[0])
        ),
        _vectors(lengths(plane), lambda _: circular_error(plane.T @ plane / len(plane), PROBABLE_ERROR)),
        _vectors(np.abs(height[:, 0]), lambda rms_m: linear_error(rms_m, PROBABLE_ERROR)),
        _vectors(lengths(space), lambda _: None),
        _similarity(discrepancies),
        tables,
        values,
    )


def _component(discrepancies: Discrepancies, name: str, confidence: float) -> ComponentResult:
    points, values = discrepancies.component(name)
    figures = moments(values)
    enough = figures.n > 1
    return ComponentResult(
        name,
        points,
        figures,
        spread(values),
        bias_test(figures, confidence) if enough else None,
        normality_test(values, confidence),
        tuple(points[row] for row in outliers(values, confidence)),
        rmse_after_trend_removal(figures, confidence) if enough else None,
    )


def _vectors(lengths_m: Floats, probable: Callable[[float], float | None]) -> VectorResult | None:
    """Sum up lengths, with the probable error of their root mean square; None without any."""
    if not len(lengths_m):
        return None
    statistics = length_statistics(lengths_m)
    return VectorResult(statistics, probable(statistics.rms_m), counted_error(lengths_m, PROBABLE_ERROR))


def _similarity(discrepancies: Discrepancies) -> SimilarityTrend | None:
    if discrepancies.positions_m is None:
        return None
    both = np.column_stack((discrepancies.positions_m[:, :2], discrepancies.d_m[:, :2]))
    both = both[np.isfinite(both).all(axis=1)]
    if len(both) < 3 or not np.ptp(both[:, :2], axis=0).any():
        return None
    return similarity_trend(both[:, :2], both[:, 2:])


def _apply(standard: ScaleStandard, table: LimitTable, product: Sample, question: Question) -> TableResult:
    size = question.scale_denominator if table.basis == "scale" else question.interval_m
    if size is None and table.basis == "interval" and question.scale_denominator is not None:
        size = table.interval_at(question.scale_denominator)
    share = standard.fraction_within_pec
    return TableResult(
        standard.id,
        standard.title,
        table,
        size,
        ()
        if size is None
        else tuple(decide(product, limit, share, question.confidence) for limit in table.limits_at(size)),
        tuple(
            admitted_size(product, table, limit.name, share, question.confidence)
            for limit in table.unit_limits
        ),
    )


def _require_positive(question: Question) -> None:
    for name, value in (
        ("scale denominator", question.scale_denominator),
        ("contour interval", question.interval_m),
        ("survey accuracy", question.survey_horizontal_m),
        ("survey accuracy", question.survey_vertical_m),
        ("target accuracy", question.target_horizontal_m),
        ("target accuracy", question.target_vertical_m),
    ):
        if value is not None and not (math.isfinite(value) and value > 0.0):
            raise ConfigurationError(f"{name} {value} is not a positive number")
