"""An assessment as a JSON value (schema `photocal.check/2`) and as text for the terminal."""

import io
import math
import textwrap
from typing import Any

from rich.box import SIMPLE_HEAD
from rich.console import Console
from rich.table import Table

from photocal.accuracy import classes
from photocal.accuracy.assessment import Assessment, ComponentResult, TableResult, findings
from photocal.accuracy.discrepancies import COMPONENTS, SIGN
from photocal.accuracy.standard import scale_text, size_text
from photocal.accuracy.statistics import LengthStatistics
from photocal.findings.finding import Finding
from photocal.findings.texts import Catalogue, catalogue, finding_json, finding_text, plain

SCHEMA = "photocal.check/2"
_WIDTH = 118
_NONE = "-"


def to_json(assessment: Assessment, say: Catalogue | None = None) -> dict[str, Any]:
    """Give an assessment as a JSON value: lengths in m; null where a figure does not exist."""
    question = assessment.question
    space = assessment.space
    similarity = assessment.similarity
    return {
        "schema": SCHEMA,
        "sign": SIGN,
        "unit": "m",
        "points": len(assessment.discrepancies.points),
        "question": {key: figure for key, figure in vars(question).items() if "target" not in key},
        "components": {component.name: _component(component) for component in assessment.components},
        "planimetry": _vector(assessment.plane, "ce90"),
        "height": _vector(assessment.height, "le90"),
        "space": _vector(space, None),
        "similarity_trend": None
        if similarity is None
        else {
            "shift_m": list(similarity.shift_m),
            "scale": similarity.scale,
            "rotation_mrad": similarity.rotation_rad * 1e3,
            "rmse_left_m": similarity.rmse_left_m,
        },
        "standards": [*map(_standard_record, assessment.tables), *map(_value, assessment.values)],
        "findings": [finding_json(finding, say or catalogue("en")) for finding in findings(assessment)],
    }


def _component(component: ComponentResult) -> dict[str, Any]:
    figures, bias, normality = component.moments, component.bias, component.normality
    return {
        "n": figures.n,
        "mean_m": figures.mean_m,
        "correction_m": -figures.mean_m,
        "std_m": finite(figures.std_m),
        "rmse_m": figures.rmse_m,
        "rmse_after_trend_removal_m": component.rmse_after_trend_removal_m,
        **vars(component.spread),
        "bias_test": None
        if bias is None
        else {**vars(bias), "t": finite(bias.t), "biased": bias.significant},
        "normality_test": None
        if normality is None
        else {"w": normality.w, "p_value": normality.p_value, "rejected": normality.rejected},
        "outliers": list(component.outliers),
    }


def _vector(lengths: LengthStatistics | None, name: str | None) -> dict[str, Any] | None:
    if lengths is None:
        return None
    figures: dict[str, Any] = {
        "n": lengths.n,
        "rmse_m": lengths.rms_m,
        "mean_length_m": lengths.mean_m,
        "maximum_m": lengths.maximum_m,
        "counted_90_m": lengths.counted_m,
    }
    if name is not None:
        figures[f"{name}_m"] = lengths.probable_m
    if lengths.within_gsd is not None:
        figures["within_1_gsd"], figures["within_2_gsd"] = lengths.within_gsd
    return figures


def _standard_record(result: TableResult) -> dict[str, Any]:
    table = result.table
    return {
        "standard": result.standard_id,
        "product": table.product,
        "basis": table.basis,
        "size": result.size,
        "precision_class": result.precision_class,
        "accuracy_class": result.accuracy_class,
        "differ": result.differ,
        "classes": [_decision(decision) for decision in result.decisions],
        "smallest": [
            {
                "class": admitted.name,
                "precision": admitted.precision,
                "rmse": admitted.rmse,
                "share": admitted.share,
                "accuracy": admitted.accuracy,
                "next_listed": classes.smallest_listed(table.sizes(), admitted.accuracy),
            }
            for admitted in result.admitted
        ],
        "source": table.source,
        "second_hand": table.second_hand,
        "source_note": table.source_note,
    }


def _decision(decision: classes.ClassDecision) -> dict[str, Any]:
    return {
        "class": decision.limit.name,
        "pec_m": decision.limit.pec_m,
        "ep_m": decision.limit.ep_m,
        "chi_squared": [test.chi_squared for test in decision.precision],
        "chi_squared_limit": decision.precision[0].critical if decision.precision else None,
        "precision": decision.precise,
        "rmse_within_ep": decision.rmse_within,
        "share_within_pec": decision.share_within,
        "share_enough": decision.share_passes,
        "accuracy": decision.accurate,
    }


def _value(value: classes.ValueClass) -> dict[str, Any]:
    def rmse(figure: float | None) -> dict[str, float] | None:
        return None if figure is None else {"rmse_m": figure, "class_cm": classes.class_cm(figure)}

    return {
        "standard": value.standard.id,
        "horizontal": rmse(value.horizontal_m),
        "vertical": rmse(value.vertical_m),
        "vegetated": rmse(value.vegetated_m),
        "space": rmse(value.spatial_m),
        "survey_included": {
            "horizontal": value.survey_included_horizontal,
            "vertical": value.survey_included_vertical,
        },
        "enough_points": value.enough_points,
        "required_points": int(value.standard.minimum_points.value),
    }


def finite(value: float) -> float | None:
    """Give a number that JSON knows, or None."""
    return value if math.isfinite(value) else None


def to_text(assessment: Assessment) -> str:
    """Write an assessment for people: several lines, figures in m."""
    count, level = len(assessment.discrepancies.points), assessment.question.confidence
    parts = [
        f"{count} check points; discrepancies are {SIGN}, in metres; tests at {level:.0%}.",
        *(part(assessment) for part in (_points, _statistics, _vectors, _tests)),
    ]
    similarity = assessment.similarity
    if similarity is not None:
        parts.append(
            f"Similarity over the plane: the product is {similarity.scale:+.3%} too large and turned by "
            f"{similarity.rotation_rad * 1e3:+.3f} mrad; "
            f"planimetric RMSE left {similarity.rmse_left_m:.3f} m.\n"
        )
    parts += [_standard(table) for table in assessment.tables]
    parts += [f"{value.standard.title}: {classes.value_class_text(value)}\n" for value in assessment.values]
    parts.append(findings_text(findings(assessment)))
    return "\n".join(parts)


def findings_text(findings: tuple[Finding, ...]) -> str:
    """Write findings one below the other."""
    if not findings:
        return "Nothing to remark."
    say = catalogue("en")
    texts = [finding_text(finding, say, plain) for finding in findings]
    return "\n".join(textwrap.fill(t, _WIDTH, initial_indent="* ", subsequent_indent="  ") for t in texts)


def _points(assessment: Assessment) -> str:
    table = _table("Discrepancies", "point", *(f"d{name}" for name in COMPONENTS))
    for point, row in zip(
        assessment.discrepancies.points, assessment.discrepancies.d_m.tolist(), strict=True
    ):
        table.add_row(point, *(_metres(value, sign=True) for value in row))
    return _render(table)


def _statistics(assessment: Assessment) -> str:
    table = _table(
        "Statistics", "", "n", "mean", "std (n-1)", "RMSE", "without trend", "min", "max", "median", "NMAD"
    )
    for c in assessment.components:
        mean, spreads = c.moments.mean_m, (c.moments.std_m, c.moments.rmse_m, c.rmse_after_trend_removal_m)
        cells = [_metres(mean, sign=True), *(_metres(value) for value in spreads)]
        ordered = (c.spread.minimum_m, c.spread.maximum_m, c.spread.median_m)
        cells += [*(_metres(value, sign=True) for value in ordered), _metres(c.spread.nmad_m)]
        table.add_row(f"d{c.name}", str(c.moments.n), *cells)
    return _render(table)


def _vectors(assessment: Assessment) -> str:
    gsd = assessment.question.gsd_m
    circles = () if gsd is None else (f"in 1 GSD ({gsd:.3f})", "in 2 GSD")
    table = _table(
        "Lengths", "", "n", "RMSE", "mean length", "maximum", "90 % normal", "90 % counted", *circles
    )
    lengths = assessment.plane, assessment.height, assessment.space
    for name, s in zip(("planimetry (CE90)", "height (LE90)", "3D"), lengths, strict=True):
        if s is not None:
            figures = (s.rms_m, s.mean_m, s.maximum_m, s.probable_m, s.counted_m)
            counts = (f"{k} of {s.n}" for k in s.within_gsd or ())
            table.add_row(name, str(s.n), *map(_metres, figures), *counts)
    return _render(table)


def _tests(assessment: Assessment) -> str:
    table = _table("Tests", "", "t", "limit", "bias", "Shapiro-Wilk p", "normal", "outliers")
    for c in assessment.components:
        cells, bias, normality = [_NONE] * 5, c.bias, c.normality
        if bias is not None:
            cells[:3] = f"{bias.t:.3f}", f"{bias.critical:.4f}", _yes(bias.significant)
        if normality is not None:
            cells[3:] = f"{normality.p_value:.3f}", _yes(not normality.rejected)
        table.add_row(f"d{c.name}", *cells, ", ".join(c.outliers) or _NONE)
    return _render(table)


def _standard(result: TableResult) -> str:
    title = f"{result.standard_title}: {result.table.product}"
    parts = [] if result.size is None else [_decisions(result, title)]
    parts.append(_smallest(result, title))
    if result.table.second_hand:
        parts.append(textwrap.fill(f"(second-hand figures: {result.table.source})", _WIDTH) + "\n")
    return "\n".join(parts)


def _decisions(result: TableResult, title: str) -> str:
    at = "" if result.size is None else size_text(result.table.basis, result.size)
    heads = ("class", "PEC", "EP", "chi2", "limit", "precision", "within PEC", "RMSE", "accuracy")
    table = _table(f"{title} at {at}", *heads)
    for decision in result.decisions:
        table.add_row(
            decision.limit.name,
            f"{decision.limit.pec_m:.3f}",
            f"{decision.limit.ep_m:.3f}",
            " ".join(f"{test.chi_squared:.2f}" for test in decision.precision) or _NONE,
            f"{decision.precision[0].critical:.2f}" if decision.precision else _NONE,
            _yes(decision.precise),
            _NONE if decision.share_within is None else f"{decision.share_within:.0%}",
            "within EP" if decision.rmse_within else "above EP",
            _yes(decision.accurate),
        )
    return _render(table) + (
        f"precision class {result.precision_class or 'none'} (bias removed), "
        f"accuracy class {result.accuracy_class or 'none'} (90 % rule and RMSE)\n"
    )


def _smallest(result: TableResult, title: str) -> str:
    basis = result.table.basis
    what = "largest scale" if basis == "scale" else "smallest contour interval (m)"
    table = _table(
        f"{title}: {what}", "class", "by precision", "by accuracy", "= RMSE", "and 90 %", "next listed"
    )
    for admitted in result.admitted:
        listed = classes.smallest_listed(result.table.sizes(), admitted.accuracy)
        sizes = (admitted.precision, admitted.accuracy, admitted.rmse, admitted.share, listed)
        table.add_row(admitted.name, *(_size(basis, size) for size in sizes))
    return _render(table)


def _size(basis: str, size: float | None) -> str:
    if size is None:
        return _NONE
    if size <= 0.0:
        return "any"
    return scale_text(size) if basis == "scale" else f"{size:.4f}"


def _yes(decision: bool) -> str:
    return "yes" if decision else "no"


def _table(title: str, first: str, *columns: str) -> Table:
    table = Table(title=title, title_justify="left", box=SIMPLE_HEAD, pad_edge=False, title_style="")
    table.add_column(first)
    for column in columns:
        table.add_column(column, justify="right")
    return table


def _render(table: Table) -> str:
    page = io.StringIO()
    Console(file=page, width=_WIDTH, color_system=None).print(table, markup=False)
    return "\n".join(line.rstrip() for line in page.getvalue().splitlines()) + "\n"


def _metres(value: float | None, *, sign: bool = False) -> str:
    if value is None or not math.isfinite(value):
        return _NONE
    return f"{value:+.3f}" if sign else f"{value:.3f}"
