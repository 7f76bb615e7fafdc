"""An assessment as a JSON value (schema `photocal.check/2`), and as a document.

Check points of which only moments were printed: the same tests and classes as of the points themselves.
"""

import math
import re
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from photocal.analysis.accuracy import classes, statistics
from photocal.analysis.accuracy.assessment import Assessment, ComponentResult, TableResult, findings
from photocal.analysis.accuracy.discrepancies import COMPONENTS, SIGN
from photocal.analysis.accuracy.standard import scale_text, size_text
from photocal.analysis.accuracy.statistics import LengthStatistics
from photocal.base.arrays import as_plain, picked
from photocal.base.errors import InputMalformedError
from photocal.base.text_tables import TextTable, read_table, refuse
from photocal.findings.document import Paragraph, Piece, Remarks, Section, TablePart, table, text
from photocal.findings.finding import Finding
from photocal.findings.texts import Catalogue, catalogue, finding_json, finding_text

SCHEMA = "photocal.check/2"
_NONE = "-"
_NUMBER = re.compile(r"(\d)\.(\d)")


def to_json(assessment: Assessment, say: Catalogue | None = None) -> dict[str, Any]:
    """Give an assessment as a JSON value: lengths in m; null where a figure does not exist."""
    trend, question = assessment.similarity, assessment.question
    return {
        "schema": SCHEMA,
        "sign": SIGN,
        "unit": "m",
        "points": len(assessment.discrepancies.points),
        "question": {key: figure for key, figure in vars(question).items() if "target" not in key},
        "components": {component.name: _component(component) for component in assessment.components},
        "planimetry": _vector(assessment.plane, ce90_m="probable_m"),
        "height": _vector(assessment.height, le90_m="probable_m"),
        "space": _vector(assessment.space),
        "iso_19157": quality_measures(assessment),
        "similarity_trend": trend
        and {**picked(trend, "shift_m", "scale", "rmse_left_m"), "rotation_mrad": trend.rotation_rad * 1e3},
        "standards": [*map(table_record, assessment.tables), *map(value_record, assessment.values)],
        "findings": [finding_json(finding, say or catalogue("en")) for finding in findings(assessment)],
    }


def quality_measures(assessment: Assessment) -> list[dict[str, Any]]:
    """Give the figures as measures of absolute positional accuracy, by their identifiers in ISO 19157.

    In metres, with the sign of all figures; identifiers of Annex D (28, 35, 39, 44, 47, 128).
    """
    found = [
        (number, name, component.name, figure)
        for component in assessment.components
        for number, name, figure in (
            (128, "bias of positions", component.moments.mean_m),
            (39, "root mean square error", component.moments.rmse_m),
        )
    ]
    lengths = {"planimetry": assessment.plane, "height": assessment.height, "space": assessment.space}
    for of, vector in lengths.items():
        if vector is not None:
            found.append((28, "mean value of positional uncertainties", of, vector.mean_m))
    if assessment.plane is not None:
        found.append((47, "root mean square error of planimetry", "planimetry", assessment.plane.rms_m))
    for number, name, of in (
        (44, "circular error at 90 %", "planimetry"),
        (35, "linear error at 90 %", "height"),
    ):
        if (vector := lengths[of]) is not None and vector.probable_m is not None:
            found.append((number, name, of, vector.probable_m))
    return [
        {"measure": number, "name": name, "of": of, "value_m": figure} for number, name, of, figure in found
    ]


def _component(component: ComponentResult) -> dict[str, Any]:
    moments, bias, normality = component.moments, component.bias, component.normality
    record = picked(moments, "n", "mean_m", "std_m", "rmse_m")
    record |= picked(component, "rmse_after_trend_removal_m")
    tested = {"bias_test": bias and {**as_plain(bias), "biased": bias.significant}}
    if component.spread is None:
        return record | tested
    record |= {**picked(component, "outliers"), **vars(component.spread), "correction_m": -moments.mean_m}
    return record | tested | {"normality_test": normality and picked(normality, "w", "p_value", "rejected")}


def _vector(lengths: LengthStatistics | None, **probable: str) -> dict[str, Any] | None:
    if lengths is None:
        return None
    renamed = {"rmse_m": "rms_m", "mean_length_m": "mean_m", "counted_90_m": "counted_m", **probable}
    within = dict(zip(("within_1_gsd", "within_2_gsd"), lengths.within_gsd or (), strict=False))
    return picked(lengths, "n", "maximum_m", **renamed) | within


def table_record(result: TableResult) -> dict[str, Any]:
    """Give one table of a standard as plain values."""
    table = result.table
    return {
        **picked(result, "size", "precision_class", "accuracy_class", "differ", standard="standard_id"),
        **picked(table, "product", "basis", "source", "second_hand", "source_note"),
        "classes": [_decision(decision) for decision in result.decisions],
        "smallest": [
            {
                **picked(admitted, "precision", "rmse", "share", "accuracy", **{"class": "name"}),
                "next_listed": classes.smallest_listed(table.sizes(), admitted.accuracy),
            }
            for admitted in result.admitted
        ],
    }


def _decision(decision: classes.ClassDecision) -> dict[str, Any]:
    names = {"class": "limit.name", "pec_m": "limit.pec_m", "ep_m": "limit.ep_m", "precision": "precise"}
    names |= {"rmse_within_ep": "rmse_within", "share_within_pec": "share_within"}
    return {
        **picked(decision, **names, share_enough="share_passes", accuracy="accurate"),
        "chi_squared": [test.chi_squared for test in decision.precision],
        "chi_squared_limit": decision.precision[0].critical if decision.precision else None,
    }


def value_record(value: classes.ValueClass) -> dict[str, Any]:
    """Give the class as the value reached as plain values."""
    reached = {"horizontal": value.horizontal_m, "vertical": value.vertical_m}
    reached |= {"vegetated": value.vegetated_m, "space": value.spatial_m}
    included = {axis: f"survey_included_{axis}" for axis in ("horizontal", "vertical")}
    return {
        **{
            name: None if rmse is None else {"rmse_m": rmse, "class_cm": classes.class_cm(rmse)}
            for name, rmse in reached.items()
        },
        **picked(value, "enough_points", standard="standard.id"),
        "survey_included": picked(value, **included),
        "required_points": value.required_points,
        "points": value.least_points,
        "condition": value.condition(catalogue("en")),
    }


def to_text(assessment: Assessment, say: Catalogue | None = None) -> str:
    """Write an assessment for people, in English unless asked otherwise: figures in m."""
    say = say or catalogue("en")
    count, level = len(assessment.discrepancies.points), assessment.question.confidence
    head = say("assessed.head", count=count, sign=say("shown.sign"), level=f"{level:.0%}")
    parts: list[Piece] = [Paragraph(head)]
    parts += [part(assessment, say) for part in (_points, _statistics, _vectors, _tests)]
    similarity = assessment.similarity
    if similarity is not None:
        figures = {
            "scale": f"{similarity.scale:+.3%}",
            "rotation": f"{similarity.rotation_rad * 1e3:+.3f}",
            "left": f"{similarity.rmse_left_m:.3f}",
        }
        parts.append(Paragraph(say("assessed.similarity", **marked(figures, say))))
    for result in assessment.tables:
        parts += standard_parts(result, say)
    parts += _reached(assessment, say)
    return text([Section("", (*parts, remarks(findings(assessment), say)))])


def marked(figures: dict[str, str], say: Catalogue) -> dict[str, str]:
    """Give printed numbers the decimal mark of the language."""
    return {name: figure.replace(".", say.mark) for name, figure in figures.items()}


def localised(rows: Iterable[Sequence[str]], say: Catalogue, names: int = 0) -> list[tuple[str, ...]]:
    """Give the numbers in rows of cells the decimal mark of the language; what is no number stays.

    names: how many cells at the start of each row are names, which stay too.
    """
    mark = rf"\1{say.mark}\2"
    return [(*row[:names], *(_NUMBER.sub(mark, cell) for cell in row[names:])) for row in rows]


def told_table(
    key: str,
    rows: Iterable[Sequence[str]],
    say: Catalogue,
    *,
    caption: str | None = None,
    more: Sequence[str] = (),
    note: str = "",
    names: int = 0,
) -> TablePart:
    """Make a table whose caption and heads (`KEY_heads`) are in the catalogue.

    caption: in place of that of the catalogue.
    more: heads of further columns.
    names: as of `localised`.
    """
    heads = [*say(f"{key}_heads").split("|"), *more]
    return table(say(key) if caption is None else caption, heads, localised(rows, say, names), note)


def remarks(findings: tuple[Finding, ...], say: Catalogue) -> Remarks | Paragraph:
    """Write findings one below the other, or that there are none."""
    texts = tuple(finding_text(finding, say) for finding in findings)
    return Remarks(texts) if texts else Paragraph(say("assessed.nothing"))


def _points(assessment: Assessment, say: Catalogue) -> TablePart:
    given = assessment.discrepancies
    pairs = zip(given.points, given.d_m.tolist(), strict=True)
    rows = [(point, *(_metres(value, "+.3f") for value in row)) for point, row in pairs]
    heads = [say("assessed.point"), *(f"d{name}" for name in COMPONENTS)]
    return table(say("assessed.points"), heads, localised(rows, say, 1))


def _statistics(assessment: Assessment, say: Catalogue) -> TablePart:
    rows = []
    for c in assessment.components:
        m, s = c.moments, c.spread
        if s is None:
            continue
        spreads = (_metres(value) for value in (m.std_m, m.rmse_m, c.rmse_after_trend_removal_m))
        ordered = (_metres(value, "+.3f") for value in (s.minimum_m, s.maximum_m, s.median_m))
        rows.append(
            (f"d{c.name}", str(m.n), _metres(m.mean_m, "+.3f"), *spreads, *ordered, _metres(s.nmad_m))
        )
    return told_table("assessed.statistics", rows, say, names=1)


def _vectors(assessment: Assessment, say: Catalogue) -> TablePart:
    gsd = assessment.question.gsd_m
    gsd_heads = "" if gsd is None else say("assessed.gsd_heads", **marked({"gsd": f"{gsd:.3f}"}, say))
    lengths = assessment.plane, assessment.height, assessment.space
    rows = []
    for name, s in zip(say("assessed.vectors").split("|"), lengths, strict=True):
        if s is not None:
            figures = (s.rms_m, s.mean_m, s.maximum_m, s.probable_m, s.counted_m)
            counts = [say("assessed.counted", k=k, n=s.n) for k in s.within_gsd or ()]
            rows.append((name, str(s.n), *map(_metres, figures), *counts))
    more = [head for head in gsd_heads.split("|") if head]
    return told_table("assessed.lengths", rows, say, more=more, names=1)


def _tests(assessment: Assessment, say: Catalogue) -> TablePart:
    rows = []
    for c in assessment.components:
        normal, normality = (_NONE, _NONE), c.normality
        if normality is not None:
            normal = f"{normality.p_value:.3f}", _yes(not normality.rejected, say)
        rows.append((f"d{c.name}", *_bias_cells(c, say), *normal, ", ".join(c.outliers) or _NONE))
    return told_table("assessed.tests", rows, say, names=1)


def _bias_cells(component: ComponentResult, say: Catalogue) -> tuple[str, str, str]:
    bias = component.bias
    if bias is None:
        return _NONE, _NONE, _NONE
    return f"{bias.t:.3f}", f"{bias.critical:.4f}", _yes(bias.significant, say)


def standard_parts(result: TableResult, say: Catalogue) -> list[Piece]:
    """Write one table of a standard."""
    title = f"{say.term(result.standard_title)}: {say.term(result.table.product)}"
    parts: list[Piece] = [] if result.size is None else [_decisions(result, title, result.size, say)]
    parts.append(_smallest(result, title, say))
    if result.table.second_hand:
        parts.append(Paragraph(say("assessed.second_hand", source=result.table.source)))
    return parts


def _decisions(result: TableResult, title: str, size: float, say: Catalogue) -> TablePart:
    rows = [
        (
            decision.limit.name,
            f"{decision.limit.pec_m:.3f}",
            f"{decision.limit.ep_m:.3f}",
            " ".join(f"{test.chi_squared:.2f}" for test in decision.precision) or _NONE,
            f"{decision.precision[0].critical:.2f}" if decision.precision else _NONE,
            _yes(decision.precise, say),
            _NONE if decision.share_within is None else f"{decision.share_within:.0%}",
            say("assessed.within_ep" if decision.rmse_within else "assessed.above_ep"),
            _yes(decision.accurate, say),
        )
        for decision in result.decisions
    ]
    none = say("shown.none")
    reached = {"precise": result.precision_class or none, "accurate": result.accuracy_class or none}
    caption = say("assessed.at", title=title, size=size_text(result.table.basis, size))
    note = say("assessed.classes", **reached)
    return told_table("assessed.classes", rows, say, caption=caption, note=note)


def _smallest(result: TableResult, title: str, say: Catalogue) -> TablePart:
    basis = result.table.basis
    what = say("assessed.largest_scale" if basis == "scale" else "assessed.smallest_interval")
    rows = []
    for admitted in result.admitted:
        listed = classes.smallest_listed(result.table.sizes(), admitted.accuracy)
        sizes = (admitted.precision, admitted.accuracy, admitted.rmse, admitted.share, listed)
        rows.append((admitted.name, *(_size(basis, size, say) for size in sizes)))
    return told_table("assessed.smallest", rows, say, caption=f"{title}: {what}")


def _size(basis: str, size: float | None, say: Catalogue) -> str:
    if size is None:
        return _NONE
    if size <= 0.0:
        return say("shown.any")
    return scale_text(size) if basis == "scale" else f"{size:.4f}"


def _yes(decision: bool, say: Catalogue) -> str:
    return say("shown.yes" if decision else "shown.no")


def _metres(value: float | None, form: str = ".3f") -> str:
    return _NONE if value is None or not math.isfinite(value) else f"{value:{form}}"


MOMENTS_SCHEMA = "photocal.check-moments/1"
_FORMS = (("mean_m", "std_m"), ("rmse_m", "t"))


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
    refuse(rows, ~((n >= 2) & (n == np.round(n))), "n is not a whole number of at least 2", "correct it")
    which, kinds = rows.names("component")
    refuse(rows, np.array([kinds[k] not in COMPONENTS for k in which]), "component is not known", "E, N or h")
    first, second = (rows.numbers(name) for name in form)
    spread = form[1] if form == _FORMS[0] else form[0]
    refuse(rows, rows.numbers(spread) < 0.0, f"{spread} is negative", "correct it")
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
            raise InputMalformedError(f"{component} appears twice", "keep one", where=rows.place(row))
        of_set[component] = one
    for name, of_set in answer.items():
        if ("E" in of_set) != ("N" in of_set):
            raise InputMalformedError(f"set {name} has only one of E and N", "give both", where=path)
    return answer


def moments_record(judged: Mapping[str, Assessment]) -> dict[str, Any]:
    """Give assessments of moments, by the names of their sets, as plain values, ready for JSON."""
    return {
        "schema": MOMENTS_SCHEMA,
        "sign": SIGN,
        "unit": "m",
        "sets": [
            {
                "set": name or None,
                "components": {part.name: _component(part) for part in one.components},
                "standards": [*map(table_record, one.tables), *map(value_record, one.values)],
            }
            for name, one in judged.items()
        ],
    }


def moments_text(judged: Mapping[str, Assessment], say: Catalogue) -> str:
    """Write assessments of moments for people: figures in m."""
    named = [(say("assessed.set", name=name) if name else "", one) for name, one in judged.items()]
    return text([Section(title, _pieces(one, say)) for title, one in named])


def _pieces(one: Assessment, say: Catalogue) -> tuple[Piece, ...]:
    rows = [
        (
            f"d{part.name}",
            str(part.moments.n),
            f"{part.moments.mean_m:+.3f}",
            *map(_metres, (part.moments.std_m, part.moments.rmse_m, part.rmse_after_trend_removal_m)),
            *_bias_cells(part, say),
        )
        for part in one.components
    ]
    head = say("assessed.head_moments", sign=say("shown.sign"), level=f"{one.question.confidence:.0%}")
    parts: list[Piece] = [Paragraph(head), told_table("assessed.moments", rows, say)]
    for result in one.tables:
        parts += standard_parts(result, say)
    return (*parts, *_reached(one, say))


def _reached(one: Assessment, say: Catalogue) -> list[Piece]:
    """Classes that are values, each in a line."""
    return [
        Paragraph(f"{say.term(value.standard.title)}: {classes.value_class_text(value, say)}")
        for value in one.values
    ]
