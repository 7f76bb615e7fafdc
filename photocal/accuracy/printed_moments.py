"""Check points of which only moments were printed: the same tests and classes as of the points themselves."""

import math
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from photocal.accuracy import classes, statistics
from photocal.accuracy.assessment import TableResult, apply_table
from photocal.accuracy.discrepancies import COMPONENTS, SIGN
from photocal.accuracy.output import standard_parts, table_record, value_record
from photocal.accuracy.standard import Question, ScaleStandard, Standard
from photocal.base.arrays import as_plain, picked
from photocal.base.errors import InputMalformedError
from photocal.block.table import TextTable, read_table, refuse
from photocal.findings.document import Paragraph, Piece, Section, table, text
from photocal.findings.texts import catalogue

SCHEMA = "photocal.check-moments/1"
_FORMS = (("mean_m", "std_m"), ("rmse_m", "t"))


@dataclass(frozen=True)
class ComponentMoments:
    """Moments of one component and what follows from them.

    trend_removed_m: RMSE after a significant mean has been subtracted, m.
    """

    name: str
    moments: statistics.Moments
    bias: statistics.BiasTest
    trend_removed_m: float


@dataclass(frozen=True)
class MomentsAssessment:
    """What is said about a product of which only moments are known."""

    name: str
    components: tuple[ComponentMoments, ...]
    tables: tuple[TableResult, ...]
    values: tuple[classes.ValueClass, ...]


def read_moments(path: Path) -> dict[str, dict[str, statistics.Moments]]:
    """Read printed moments: by the name of the set, by component.

    path: table with the columns component (E, N, h), n, and either mean_m and std_m (with n - 1), or rmse_m
        and t; optional set. Means are reference minus product, as studies print them.
    raises InputNotFoundError, InputMalformedError: when it is not such a table; the message says the line.
    """
    optional = ("set", *(name for form in _FORMS for name in form))
    rows = read_table(path, ("component", "n"), optional)
    form = next((names for names in _FORMS if all(rows.has(name) for name in names)), None)
    if form is None:
        raise InputMalformedError("has no moments", "give mean_m and std_m, or rmse_m and t", where=path)
    n = rows.numbers("n")
    refuse(rows, ~((n >= 2) & (n == np.round(n))), "n is no number of two or more points", "write it")
    which, kinds = rows.names("component")
    refuse(rows, np.array([kinds[k] not in COMPONENTS for k in which]), "component is not known", "E, N or h")
    first, second = (rows.numbers(name) for name in form)
    refuse(
        rows, (second if form == _FORMS[0] else first) < 0.0, f"{form[0]} and {form[1]} cannot be", "correct"
    )
    pairs = zip(first.tolist(), second.tolist(), n.tolist(), strict=True)
    made = [_of_mean(*row) if form == _FORMS[0] else _of_rmse(*row) for row in pairs]
    return _by_set(rows, [kinds[k] for k in which], made, path)


def _of_mean(mean: float, std: float, n: float) -> statistics.Moments:
    return statistics.Moments(int(n), -mean, std)


def _of_rmse(rmse: float, t: float, n: float) -> statistics.Moments:
    """Solve rmse^2 = mean^2 + (n - 1)/n s^2 with t = mean sqrt(n)/s for mean and s."""
    std = rmse * math.sqrt(n / (t * t + n - 1.0))
    return statistics.Moments(int(n), -t * std / math.sqrt(n), std)


def _by_set(
    rows: TextTable, components: list[str], made: list[statistics.Moments], path: Path
) -> dict[str, dict[str, statistics.Moments]]:
    sets = rows.texts("set") if rows.has("set") else ("",) * len(made)
    answer: dict[str, dict[str, statistics.Moments]] = {}
    for row, (name, component, one) in enumerate(zip(sets, components, made, strict=True)):
        of_set = answer.setdefault(name, {})
        if component in of_set:
            raise InputMalformedError(f"{component} stands twice", "keep one", where=rows.place(row))
        of_set[component] = one
    for name, of_set in answer.items():
        if ("E" in of_set) != ("N" in of_set):
            raise InputMalformedError(f"set {name} has only one of E and N", "give both", where=path)
    return answer


def assess_moments(
    name: str,
    moments: dict[str, statistics.Moments],
    standards: tuple[Standard, ...],
    question: Question,
) -> MomentsAssessment:
    """Judge a product by the moments of its discrepancies; the 90 % rule needs the points."""
    products = {
        kind: classes.Sample(tuple(moments[part] for part in parts))
        for kind, parts in (("planimetry", ("E", "N")), ("height", ("h",)))
        if parts[0] in moments
    }
    level = question.confidence
    return MomentsAssessment(
        name,
        tuple(
            ComponentMoments(
                part,
                moments[part],
                statistics.bias_test(moments[part], level),
                statistics.rmse_after_trend_removal(moments[part], level),
            )
            for part in COMPONENTS
            if part in moments
        ),
        tuple(
            apply_table(standard, limits, products[limits.component], question)
            for standard in standards
            if isinstance(standard, ScaleStandard)
            for limits in standard.tables
            if limits.component in products
        ),
        tuple(
            classes.value_class(standard, products.get("planimetry"), products.get("height"), question)
            for standard in standards
            if not isinstance(standard, ScaleStandard)
        ),
    )


def moments_record(judged: tuple[MomentsAssessment, ...]) -> dict[str, Any]:
    """Give assessments as plain values, ready for JSON."""
    return {
        "schema": SCHEMA,
        "sign": SIGN,
        "unit": "m",
        "sets": [
            {
                "set": one.name or None,
                "components": {part.name: _component(part) for part in one.components},
                "standards": [*map(table_record, one.tables), *map(value_record, one.values)],
            }
            for one in judged
        ],
    }


def _component(part: ComponentMoments) -> dict[str, Any]:
    return {
        **picked(part.moments, "n", "mean_m", "std_m", "rmse_m"),
        "rmse_after_trend_removal_m": part.trend_removed_m,
        "bias_test": {**as_plain(part.bias), "biased": part.bias.significant},
    }


def moments_text(judged: tuple[MomentsAssessment, ...], question: Question) -> str:
    """Write assessments for people: figures in m."""
    return text([Section(f"set {one.name}" if one.name else "", _pieces(one, question)) for one in judged])


def _pieces(one: MomentsAssessment, question: Question) -> tuple[Piece, ...]:
    heads = ("", "n", "mean", "std (n-1)", "RMSE", "without trend", "t", "limit", "bias")
    rows = [
        (
            f"d{part.name}",
            str(part.moments.n),
            f"{part.moments.mean_m:+.3f}",
            *(f"{value:.3f}" for value in (part.moments.std_m, part.moments.rmse_m, part.trend_removed_m)),
            f"{part.bias.t:.3f}",
            f"{part.bias.critical:.4f}",
            "yes" if part.bias.significant else "no",
        )
        for part in one.components
    ]
    head = f"moments as printed; discrepancies are {SIGN}, in metres; tests at {question.confidence:.0%}."
    parts: list[Piece] = [Paragraph(head), table("Moments", heads, rows)]
    for result in one.tables:
        parts += standard_parts(result, catalogue("en"))
    parts += [Paragraph(f"{v.standard.title}: {classes.value_class_text(v)}") for v in one.values]
    return tuple(parts)
