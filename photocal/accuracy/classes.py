"""Precision class and accuracy class of a product, and the largest scale that each admits.

Many papers take the chi-square test of the spread for a test of accuracy. It is a test of precision:
the bias is removed first. The class that the standards mean asks for 90 % of the points within PEC
and for an RMSE, which contains the bias, within the standard error. Both are given side by side.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from drivers.arrays import Floats
from photocal.accuracy.significance_tests import PrecisionTest, precision_quantile, precision_test
from photocal.accuracy.standard import ClassLimit, LimitTable
from photocal.accuracy.statistics import Moments, combined_rmse, counted_error, lengths, moments


@dataclass(frozen=True)
class Sample:
    """What is known of the check points of one product.

    components: E and N for planimetry, h for heights.
    lengths_m (n,): plane distances or absolute height differences, m; None when only moments were published.
    """

    components: tuple[Moments, ...]
    lengths_m: Floats | None = None

    @property
    def rmse_m(self) -> float:
        """Planimetric or height RMSE, m."""
        return combined_rmse(*self.components)


@dataclass(frozen=True)
class ClassDecision:
    """Whether a product reaches one class at one scale or interval.

    limit: what the class allows.
    precision: one for each component; empty with a single point.
    rmse_within: whether the RMSE is within the standard error.
    share_within: share of the points within PEC; None when only moments are known.
    share_passes: whether that share is enough.
    """

    limit: ClassLimit
    precision: tuple[PrecisionTest, ...]
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

    name: the class.
    precision: by the chi-square test of the spread; None with a single point.
    rmse: by RMSE within the standard error.
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
    return Sample(tuple(moments(column) for column in vectors_m.T), lengths(vectors_m))


def component_sigma(ep_m: float, components: int) -> float:
    """Divide the standard error of a class among the components."""
    return ep_m / math.sqrt(components)


def decide(product: Sample, limit: ClassLimit, share_required: float, confidence: float) -> ClassDecision:
    """Decide whether a product reaches a class."""
    sigma = component_sigma(limit.ep_m, len(product.components))
    testable = all(component.n > 1 for component in product.components)
    precision = (
        tuple(precision_test(component, sigma, confidence) for component in product.components)
        if testable
        else ()
    )
    share = None if product.lengths_m is None else float(np.mean(product.lengths_m <= limit.pec_m))
    return ClassDecision(
        limit,
        precision,
        product.rmse_m <= limit.ep_m,
        share,
        None if share is None else share >= share_required - 1e-9,
    )


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
            component.std_m * math.sqrt((component.n - 1) / precision_quantile(component.n, confidence))
            for component in product.components
        )
        precision = sigma / component_sigma(unit.ep_m, len(product.components))
    share = (
        None if product.lengths_m is None else counted_error(product.lengths_m, share_required) / unit.pec_m
    )
    return AdmittedSize(name, precision, product.rmse_m / unit.ep_m, share)


def smallest_listed(sizes: tuple[float, ...], exact: float) -> float | None:
    """Give the next listed scale denominator or contour interval."""
    return next((size for size in sizes if size >= exact), None)
