"""Precision class, accuracy class and class as the value reached, and the largest scale that each admits."""

import math
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from photocal.analysis.accuracy import statistics
from photocal.analysis.accuracy.standard import (
    ClassLimit,
    LimitTable,
    Question,
    StandardFigure,
    ValueStandard,
)
from photocal.base.arrays import Floats
from photocal.findings.texts import Catalogue


@dataclass(frozen=True)
class Sample:
    """What is known of the check points of one product.

    lengths_m (n,): plane distances or absolute height differences, m; None when only moments were published.
    """

    components: tuple[statistics.Moments, ...]
    lengths_m: Floats | None = None

    @property
    def rmse_m(self) -> float:
        """Planimetric or height RMSE, m."""
        return math.sqrt(sum(component.rmse_m**2 for component in self.components))


@dataclass(frozen=True)
class ClassDecision:
    """Whether a product reaches one class at one scale or interval.

    precision: one for each component; empty with a single point.
    share_within: share of the points within PEC; None when only moments are known.
    """

    limit: ClassLimit
    precision: tuple[statistics.PrecisionTest, ...]
    rmse_within: bool
    share_within: float | None
    share_passes: bool | None

    @property
    def precise(self) -> bool:
        """Whether the spread alone reaches the class."""
        return bool(self.precision) and all(test.accepted for test in self.precision)

    @property
    def accurate(self) -> bool:
        """Whether RMSE, and the 90 % rule where points are known, reach the class."""
        return self.rmse_within and self.share_passes is not False


@dataclass(frozen=True)
class AdmittedSize:
    """Smallest scale denominator, or contour interval in m, at which a class is reached.

    precision: by the chi-square test of the spread; None with a single point.
    share: by the 90 % rule; None when only moments are known.
    """

    name: str
    precision: float | None
    rmse: float
    share: float | None

    @property
    def accuracy(self) -> float:
        """By both conditions of the standard."""
        return self.rmse if self.share is None else max(self.rmse, self.share)


def sample(vectors_m: Floats) -> Sample:
    """Make a sample from discrepancies."""
    return Sample(tuple(statistics.moments(column) for column in vectors_m.T), statistics.lengths(vectors_m))


def component_sigma(ep_m: float, components: int) -> float:
    """Divide the standard error of a class among the components."""
    return ep_m / math.sqrt(components)


def decide(product: Sample, limit: ClassLimit, share_required: float, confidence: float) -> ClassDecision:
    """Decide whether a product reaches a class."""
    sigma = component_sigma(limit.ep_m, len(product.components))
    testable = all(component.n > 1 for component in product.components)
    tests = (statistics.precision_test(component, sigma, confidence) for component in product.components)
    precision = tuple(tests) if testable else ()
    share = None if product.lengths_m is None else float(np.mean(product.lengths_m <= limit.pec_m))
    passes = None if share is None else share >= share_required - 1e-9
    return ClassDecision(limit, precision, product.rmse_m <= limit.ep_m, share, passes)


def admitted_size(
    product: Sample, table: LimitTable, name: str, share_required: float, confidence: float
) -> AdmittedSize:
    """Give the exact smallest scale denominator or contour interval at which a class is reached."""
    unit = next(limit for limit in table.unit_limits if limit.name == name)
    precision = None
    n = min(component.n for component in product.components)
    if n > 1:
        # chi^2 = (n - 1) s^2 / sigma^2 reaches its quantile at this sigma, for the worst component.
        sigma = max(
            component.std_m
            * math.sqrt((component.n - 1) / statistics.precision_quantile(component.n, confidence))
            for component in product.components
        )
        precision = sigma / component_sigma(unit.ep_m, len(product.components))
    share = None
    if product.lengths_m is not None:
        share = statistics.counted_error(product.lengths_m, share_required) / unit.pec_m
    return AdmittedSize(name, precision, product.rmse_m / unit.ep_m, share)


def smallest_listed(sizes: tuple[float, ...], exact: float) -> float | None:
    """Give the next listed scale denominator or contour interval."""
    return next((size for size in sizes if size >= exact), None)


@dataclass(frozen=True)
class ValueClass:
    """RMSE of a product with the survey accuracy of its check points.

    horizontal_m, vertical_m, vegetated_m, spatial_m: RMSE with the survey accuracy, m; None where the
        component was not checked.
    survey_included_horizontal, survey_included_vertical: whether a survey accuracy was given; without one the
        class is too good.
    target_horizontal_m, target_vertical_m: classes that the project asks for: what the limits below go by.
        None where nobody said.
    systematic: components whose mean exceeds the standard's share of the target.
    survey_too_coarse: components whose survey is worse than the standard's share of the target.
    blunders: points and components whose error exceeds the standard's multiple of the target; of an axis,
        that of the horizontal class over the root of 2.
    """

    standard: ValueStandard
    horizontal_m: float | None
    vertical_m: float | None
    vegetated_m: float | None
    spatial_m: float | None
    survey_included_horizontal: bool
    survey_included_vertical: bool
    points_horizontal: int
    points_vertical: int
    points_vegetated: int
    target_horizontal_m: float | None
    target_vertical_m: float | None
    systematic: tuple[str, ...]
    survey_too_coarse: tuple[str, ...]
    blunders: tuple[tuple[str, str], ...]

    @property
    def counts(self) -> tuple[int, ...]:
        """Number of points of each test that was made: horizontal, open and vegetated ground."""
        counts = (self.points_horizontal, self.points_vertical, self.points_vegetated)
        return tuple(count for count in counts if count)

    @property
    def enough_points(self) -> bool:
        """Whether every checked component has the number of points that the standard asks for."""
        return all(count >= self.required_points for count in self.counts)

    @property
    def least_points(self) -> int:
        """Points of the component that has fewest."""
        return min(self.counts, default=0)

    @property
    def required_points(self) -> int:
        """How many the standard asks for."""
        return int(self.standard.minimum_points.value)

    @property
    def includes_survey(self) -> bool:
        """Whether the accuracy of the survey is known for each component that was checked."""
        components = (
            (self.horizontal_m, self.survey_included_horizontal),
            (self.vertical_m, self.survey_included_vertical),
        )
        return all(included for rmse, included in components if rmse is not None)

    def condition(self, say: Catalogue) -> str:
        """Say what the class stands on, see `condition`."""
        return condition(self.least_points, self.required_points, self.includes_survey, say)


def class_cm(rmse_m: float) -> float:
    """Give the class that an RMSE reaches, in cm, rounded up to a tenth."""
    return math.ceil(rmse_m * 1000.0 - 1e-9) / 10.0


def value_class(
    standard: ValueStandard,
    plane: Sample | None,
    height: Sample | None,
    stated: Question,
    errors: Mapping[str, tuple[tuple[str, ...], Floats]] | None = None,
    vegetated: Sample | None = None,
) -> ValueClass:
    """Compute the class reached, and what goes by the class that was asked for."""
    horizontal = _with_survey(plane, stated.survey_horizontal_m)
    vertical = _with_survey(height, stated.survey_vertical_m)
    wide, high = stated.target_horizontal_m, stated.target_vertical_m
    means = [
        *zip("EN", (wide, wide), plane.components if plane else (), strict=False),
        *zip("h", (high,), height.components if height else (), strict=False),
    ]
    axis = None if wide is None else wide / math.sqrt(2.0)
    of_axis = {"E": axis, "N": axis, "h": high}
    surveys = (("horizontal", wide, stated.survey_horizontal_m), ("vertical", high, stated.survey_vertical_m))

    def beyond(value: float, limit: StandardFigure, target: float | None) -> bool:
        """Whether a figure exceeds what the standard allows of a target, where there is one."""
        return target is not None and abs(value) > limit.value * target

    return ValueClass(
        standard,
        horizontal,
        vertical,
        _with_survey(vegetated, stated.survey_vertical_m),
        None if horizontal is None or vertical is None else math.hypot(horizontal, vertical),
        stated.survey_horizontal_m is not None,
        stated.survey_vertical_m is not None,
        plane.components[0].n if plane else 0,
        height.components[0].n if height else 0,
        vegetated.components[0].n if vegetated else 0,
        wide if plane else None,
        high if height else None,
        tuple(k for k, target, part in means if beyond(part.mean_m, standard.mean_share_of_target, target)),
        tuple(k for k, target, m in surveys if m and beyond(m, standard.survey_share_of_target, target)),
        tuple(
            (point, name)
            for name, (points, values) in (errors or {}).items()
            for point, error in zip(points, values.tolist(), strict=True)
            if beyond(error, standard.blunder_over_target, of_axis[name])
        ),
    )


def _with_survey(product: Sample | None, survey_m: float | None) -> float | None:
    return None if product is None else math.hypot(product.rmse_m, survey_m or 0.0)


def condition(points: int, required: int, with_survey: bool, say: Catalogue) -> str:
    """Say what a class stands on: a class is tested with as many points as the standard asks for.

    with_survey: whether the accuracy of the survey is included.
    """
    parts = [say("assessed.tested", n=points)]
    if points < required:
        parts = [say("assessed.stated", n=points, required=required)]
    if not with_survey:
        parts.append(say("assessed.without_survey"))
    return ", ".join(parts)


def value_class_text(value: ValueClass, say: Catalogue) -> str:
    """Write the class reached, and what it stands on."""
    parts = (
        (say("assessed.horizontal"), value.horizontal_m),
        (say("assessed.vertical"), value.vertical_m),
        (say("assessed.vegetated"), value.vegetated_m),
        (say("assessed.space"), value.spatial_m),
    )
    reached = ", ".join(
        f"{name} {say.fixed(class_cm(rmse), 1)} cm" for name, rmse in parts if rmse is not None
    )
    return f"{reached} ({value.condition(say)})"
