"""Accuracy standards: classes, limits, their sources, map scales; and what a product is judged for."""

from __future__ import annotations

import math
import re
from dataclasses import dataclass
from typing import Literal

from drivers.errors import ConfigurationError

Component = Literal["planimetry", "height"]
Basis = Literal["scale", "interval"]


@dataclass(frozen=True)
class Question:
    """What the product is to be judged for.

    scale_denominator: map scale 1:N of the product.
    interval_m: contour interval, m; when None, the one that a standard lists for the scale.
    confidence: level of all tests, 0 to 1: two-sided for the bias, one-sided for the precision.
    survey_horizontal_m, survey_vertical_m: RMSE of the survey of the check points, m; the horizontal one
        radial.
    target_horizontal_m, target_vertical_m: RMSE that the project asks for, m.
    """

    scale_denominator: float | None = None
    interval_m: float | None = None
    confidence: float = 0.90
    survey_horizontal_m: float | None = None
    survey_vertical_m: float | None = None
    target_horizontal_m: float | None = None
    target_vertical_m: float | None = None


@dataclass(frozen=True)
class ClassLimit:
    """What one class allows.

    name: name of the class, the best first in every table.
    pec_m: error that 90 % of the points may not exceed, m.
    ep_m: standard error that the RMSE may not exceed, m.
    """

    name: str
    pec_m: float
    ep_m: float


@dataclass(frozen=True)
class PublishedLimit:
    """One printed figure of a table, at a listed scale."""

    scale_denominator: float
    interval_m: float
    limit: ClassLimit


@dataclass(frozen=True)
class LimitTable:
    """The classes of one product of a standard.

    product: what is judged.
    component: which discrepancies judge it.
    basis: whether the limits grow with the scale denominator or with the contour interval.
    unit_limits: limits in m at a denominator of 1, or at an interval of 1 m.
    published: printed figures, with their rounding.
    source, source_note: where the figures come from and what to know about that.
    second_hand: whether the figures were taken from another place than the standard itself.
    """

    product: str
    component: Component
    basis: Basis
    unit_limits: tuple[ClassLimit, ...]
    published: tuple[PublishedLimit, ...]
    source: str
    source_note: str
    second_hand: bool

    def limits(self, size: float) -> tuple[ClassLimit, ...]:
        """Give the limits by the rule.

        size: scale denominator, or contour interval in m, as `basis` says.
        """
        return tuple(
            ClassLimit(limit.name, limit.pec_m * size, limit.ep_m * size) for limit in self.unit_limits
        )

    def limits_at(self, size: float) -> tuple[ClassLimit, ...]:
        """Give the printed limits where the size is listed, otherwise those by the rule.

        size: scale denominator, or contour interval in m, as `basis` says.
        """
        printed = {
            entry.limit.name: entry.limit
            for entry in self.published
            if (entry.scale_denominator if self.basis == "scale" else entry.interval_m) == size
        }
        return tuple(printed.get(limit.name, limit) for limit in self.limits(size))

    def interval_at(self, scale_denominator: float) -> float | None:
        """Give the contour interval that the standard lists for a scale.

        returns: interval in m; None where the scale is not listed or the table knows no intervals.
        """
        listed = [p.interval_m for p in self.published if p.scale_denominator == scale_denominator]
        return listed[0] if listed and self.basis == "interval" else None

    def sizes(self) -> tuple[float, ...]:
        """Give the listed sizes: scale denominators, or contour intervals in m, smallest first."""
        key = "scale_denominator" if self.basis == "scale" else "interval_m"
        return tuple(sorted({float(getattr(entry, key)) for entry in self.published}))


@dataclass(frozen=True)
class ScaleStandard:
    """A standard whose classes belong to a scale or a contour interval."""

    id: str
    title: str
    fraction_within_pec: float
    tables: tuple[LimitTable, ...]
    note: str


@dataclass(frozen=True)
class Figure:
    """One figure of a standard with its source."""

    value: float
    source: str
    source_note: str
    second_hand: bool


@dataclass(frozen=True)
class ValueStandard:
    """A standard whose class is the value reached.

    minimum_points, maximum_points: number of check points for a tested product; more than the maximum is
        never asked.
    mean_share_of_target: share of the target RMSE of the project above which a mean is to be investigated.
    survey_share_of_target: share of it that the survey of the check points may have.
    blunder_over_target: multiple of it, in a component, above which an error is to be investigated as a
        blunder.
    """

    id: str
    title: str
    minimum_points: Figure
    maximum_points: Figure
    survey_accuracy_included: Figure
    mean_share_of_target: Figure
    survey_share_of_target: Figure
    blunder_over_target: Figure
    note: str


Standard = ScaleStandard | ValueStandard


_SCALE = re.compile(r"^(?:1:)?(?P<denominator>[0-9]+(?:\.[0-9]+)?)$")


def parse_scale(text: str) -> float:
    """Read a scale; raises ConfigurationError when it is not a scale."""
    match = _SCALE.match(text.replace(" ", ""))
    if match is None or float(match["denominator"]) <= 0.0:
        raise ConfigurationError(f"{text!r} is not a scale", remedy="write it as 1:1000")
    return float(match["denominator"])


def scale_text(denominator: float) -> str:
    """Write a scale."""
    return f"1:{math.ceil(denominator - 1e-6):,}".replace(",", " ")


def size_text(basis: str, size: float) -> str:
    """Write a scale or a contour interval."""
    return scale_text(size) if basis == "scale" else f"interval {size:.4g} m"
