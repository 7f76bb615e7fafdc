"""Accuracy standards: classes, limits and sources, how they are read, what a product is judged for.

A standard is one TOML file; an installed package brings its text under an entry point:

    [project.entry-points."photocal.standards"]
    toy = "toy_standard:TEXT"
"""

import math
import re
import tomllib
from dataclasses import dataclass
from fractions import Fraction
from functools import cached_property
from importlib import resources
from pathlib import Path
from typing import Annotated, Literal

from pydantic import AfterValidator, Field

from photocal.base.checked_toml import Table, checked_tables, parse_toml
from photocal.base.errors import ConfigurationError, InputNotFoundError
from photocal.base.extensions import STANDARDS, brought

Component = Literal["planimetry", "height"]
Basis = Literal["scale", "interval"]
# Text over several lines of a file, as one.
Prose = Annotated[str, AfterValidator(lambda text: " ".join(text.split()))]
_SCALE = re.compile(r"^(?:1:)?(?P<denominator>[0-9]+(?:\.[0-9]+)?)$")
SHIPPED = ("decree-89817", "pec-pcd", "asprs-2024")


@dataclass(frozen=True)
class Question:
    """What the product is to be judged for.

    interval_m: contour interval, m; when None, the one that a standard lists for the scale.
    confidence: level of all tests, 0 to 1: two-sided for the bias, one-sided for the precision.
    survey_horizontal_m, survey_vertical_m: RMSE of the survey of the check points, m; the horizontal one
        radial.
    target_horizontal_m, target_vertical_m: RMSE that the project asks for, m.
    gsd_m: ground sampling distance of the product, m.
    """

    scale_denominator: float | None = None
    interval_m: float | None = None
    confidence: float = 0.90
    survey_horizontal_m: float | None = None
    survey_vertical_m: float | None = None
    target_horizontal_m: float | None = None
    target_vertical_m: float | None = None
    gsd_m: float | None = None


@dataclass(frozen=True)
class ClassLimit:
    """What one class allows.

    pec_m: error that 90 % of the points may not exceed, m.
    ep_m: standard error that the RMSE may not exceed, m.
    """

    name: str
    pec_m: float
    ep_m: float


class LimitTable(Table):
    """The classes of one product of a standard.

    basis: whether the limits grow with the scale denominator or with the contour interval.
    pec, ep: limits of each class: mm at map scale, or shares of the interval, as numbers or fractions.
    listed: printed figures: class, scale denominator, interval (m), PEC and EP (m).
    source, source_note: where the figures come from and what to know about that.
    second_hand: whether the figures were taken from another place than the standard itself.
    """

    product: str
    component: Component
    basis: Basis
    pec: dict[str, float | str]
    ep: dict[str, float | str]
    source: str
    source_note: str = ""
    second_hand: bool
    listed: list[tuple[str, float, float, float, float]] = Field(default=[], alias="published")

    @cached_property
    def unit_limits(self) -> tuple[ClassLimit, ...]:
        """Limits in m at a denominator of 1, or at an interval of 1 m; ValueError for what is no limit."""
        # Millimetres at map scale become metres on the ground at a denominator of 1.
        factor = Fraction(1, 1000) if self.basis == "scale" else Fraction(1)
        if list(self.pec) != list(self.ep):
            raise ValueError(f"pec and ep of {self.product!r} do not have the same classes")
        return tuple(
            ClassLimit(name, _metres(pec, factor), _metres(self.ep[name], factor))
            for name, pec in self.pec.items()
        )

    def limits(self, size: float) -> tuple[ClassLimit, ...]:
        """Give the limits by the rule."""
        return tuple(
            ClassLimit(limit.name, limit.pec_m * size, limit.ep_m * size) for limit in self.unit_limits
        )

    def limits_at(self, size: float) -> tuple[ClassLimit, ...]:
        """Give the printed limits where the size is listed, otherwise those by the rule."""
        printed = {
            name: ClassLimit(name, pec, ep)
            for name, scale, interval, pec, ep in self.listed
            if (scale if self.basis == "scale" else interval) == size
        }
        return tuple(printed.get(limit.name, limit) for limit in self.limits(size))

    def interval_at(self, scale_denominator: float) -> float | None:
        """Give the contour interval that the standard lists for a scale."""
        listed = [interval for _, scale, interval, _, _ in self.listed if scale == scale_denominator]
        return listed[0] if listed and self.basis == "interval" else None

    def sizes(self) -> tuple[float, ...]:
        """Give the listed sizes: scale denominators, or contour intervals in m, smallest first."""
        return tuple(
            sorted({scale if self.basis == "scale" else interval for _, scale, interval, _, _ in self.listed})
        )


class StandardFigure(Table):
    """One figure of a standard with its source."""

    value: float
    source: str
    source_note: str = ""
    second_hand: bool


class ValueStandard(Table):
    """A standard whose class is the value reached.

    minimum_points, maximum_points: number of check points for a tested product; more than the maximum is
        never asked.
    mean_share_of_target: share of the target RMSE of the project above which a mean is to be investigated.
    survey_share_of_target: share of it that the survey of the check points may have.
    blunder_over_target: multiple of it, in a component, above which an error is to be investigated as a
        blunder.
    """

    id: str
    kind: Literal["value"]
    title: str
    authority: str
    note: Prose = ""
    minimum_points: StandardFigure
    maximum_points: StandardFigure
    survey_accuracy_included: StandardFigure
    mean_share_of_target: StandardFigure
    survey_share_of_target: StandardFigure
    blunder_over_target: StandardFigure


def parse_scale(text: str) -> float:
    """Read a scale; raises ConfigurationError when it is not a scale."""
    match = _SCALE.match(text.replace(" ", ""))
    if match is None or float(match["denominator"]) <= 0.0:
        raise ConfigurationError(f"{text!r} is not a scale", "write it as 1:1000")
    return float(match["denominator"])


def scale_text(denominator: float) -> str:
    """Write a scale."""
    return f"1:{math.ceil(denominator - 1e-6):,}".replace(",", " ")


def size_text(basis: str, size: float) -> str:
    """Write a scale or a contour interval."""
    return scale_text(size) if basis == "scale" else f"interval {size:.4g} m"


class ScaleStandard(Table):
    """A standard whose classes belong to a scale or a contour interval."""

    id: str
    kind: Literal["scale"]
    title: str
    authority: str
    fraction_within_pec: float
    note: Prose = ""
    tables: tuple[LimitTable, ...] = Field(alias="table")


Standard = ScaleStandard | ValueStandard


def load_standard(name: str) -> Standard:
    """Find and read a standard.

    name: name of a shipped standard (`decree-89817`, `pec-pcd`, `asprs-2024`), of one that an installed
        package brings, or the path of a TOML file of the same form.
    raises InputNotFoundError: when there is neither a shipped standard nor a file of that name.
    raises ConfigurationError: when the file has not the form of a standard.
    """
    if name in SHIPPED:
        shipped = resources.files("photocal.analysis.accuracy.standards") / f"{name}.toml"
        return parse_standard(shipped.read_text(encoding="utf-8"), name)
    others = brought(STANDARDS, str)
    if name in others:
        return parse_standard(others[name], name)
    path = Path(name)
    if path.suffix != ".toml" or not path.is_file():
        raise InputNotFoundError(
            f"unknown standard {name!r}", f"take {', '.join((*SHIPPED, *others))}, or the path of a TOML file"
        )
    try:
        return parse_standard(path.read_text(encoding="utf-8-sig"), name)
    except UnicodeDecodeError as refusal:
        raise ConfigurationError("is not UTF-8 text", "save it as UTF-8", where=name) from refusal


def parse_standard(text: str, where: str) -> Standard:
    """Read a standard from the text of its TOML file."""
    try:
        content = parse_toml(text)
        if content.get("kind") == "value":
            return checked_tables(content, ValueStandard, where)
        standard = checked_tables(content, ScaleStandard, where)
        _ = [
            table.unit_limits for table in standard.tables
        ]  # worked out here, where what is wrong with them can be said
    except tomllib.TOMLDecodeError as refusal:
        raise ConfigurationError(f"is not TOML ({refusal})", where=where) from refusal
    except (ValueError, ZeroDivisionError) as refusal:
        raise ConfigurationError(f"a limit is not a number ({refusal})", where=where) from refusal
    return standard


def _metres(value: float | str, factor: Fraction) -> float:
    # Through the printed decimals: 0.3 mm is 3/10 mm, not the nearest binary number.
    metres = float(Fraction(str(value)) * factor)
    if not metres > 0.0:
        raise ValueError(f"{value} is not positive")
    return metres
