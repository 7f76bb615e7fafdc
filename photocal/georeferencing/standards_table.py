"""Bias and accuracy classes of the methods side by side."""

from __future__ import annotations

from photocal.accuracy.standard import size_text
from photocal.accuracy.value_class import class_cm
from photocal.georeferencing.comparison import BlockCheck


def standards_rows(check: BlockCheck) -> list[list[str]]:
    """Give one row for each statement, one column for each method that has check points."""
    judged = [(one.found.method, one.assessment) for one in check.judged]
    known = [(method, assessment) for method, assessment in judged if assessment is not None]
    if not known:
        return []
    rows = [["", *(method for method, _ in known)]]
    for k, component in enumerate(known[0][1].components):
        cells = []
        for _, assessment in known:
            one = assessment.components[k]
            t = "-" if one.bias is None else f"t {one.bias.t:+.2f}{' biased' if one.bias.significant else ''}"
            cells.append(f"{one.moments.mean_m:+.4f} m, {t}")
        rows.append([f"mean d{component.name}", *cells])
    for k, table in enumerate(known[0][1].tables):
        name, basis = f"{table.standard_id} {table.table.product}", table.table.basis
        results = [assessment.tables[k] for _, assessment in known]
        if table.size is not None:
            asked = size_text(basis, table.size)
            cells = [
                f"precision {one.precision_class or 'none'}, accuracy {one.accuracy_class or 'none'}"
                for one in results
            ]
            rows.append([f"{name} at {asked}", *cells])
        best = table.admitted[0].name
        smallest = [one.admitted[0] for one in results]
        cells = [
            f"precision {_size(basis, one.precision)}, accuracy {_size(basis, one.accuracy)}"
            for one in smallest
        ]
        rows.append([f"{name}, class {best} from", *cells])
    for k, value in enumerate(known[0][1].values):
        reached = [assessment.values[k] for _, assessment in known]
        cells = [
            f"{_class(one.horizontal_m)} horizontal, {_class(one.vertical_m)} vertical" for one in reached
        ]
        rows.append([f"{value.standard.id}, class reached", *cells])
    return rows


def _size(basis: str, size: float | None) -> str:
    return "none" if size is None else size_text(basis, size).removeprefix("interval ")


def _class(rmse_m: float | None) -> str:
    return "-" if rmse_m is None else f"{class_cm(rmse_m):.1f} cm"
