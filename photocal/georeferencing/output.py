"""The files of a block's check: tables, figures, GeoPackage, report section."""

from __future__ import annotations

import csv
import io
import json
from pathlib import Path
from typing import Any

import numpy as np

from acquire.outputs import output_folder
from photocal.accuracy.as_json import finite
from photocal.accuracy.discrepancies import SIGN
from photocal.accuracy.figures import histograms, residual_map
from photocal.accuracy.geopackage import write_geopackage
from photocal.findings.catalogue import catalogue
from photocal.findings.texts import finding_text
from photocal.geopackage import ReferenceSystem
from photocal.georeferencing.comparison import BlockCheck
from photocal.georeferencing.differences import Differences
from photocal.georeferencing.findings import block_findings
from photocal.georeferencing.standards_table import standards_rows


def write_check(
    check: BlockCheck, content: dict[str, Any], folder: Path, system: ReferenceSystem, changed_utc: str
) -> tuple[str, ...]:
    """Write the results of a check.

    system: of the block's coordinates, for the GeoPackage.
    raises OutputError: when the folder cannot be written; nothing is then left half-written.
    """
    texts = {
        "check.json": json.dumps(content, indent=1, allow_nan=False) + "\n",
        "ground_points.csv": _ground_points(check),
        "images.csv": _images(check),
        "report.md": _report(check),
    }
    if check.systematic is not None:
        texts["systematic_errors.csv"] = _systematic(check)
    names = list(texts)
    with output_folder(folder) as aside:
        for name, text in texts.items():
            (aside / name).write_text(text, encoding="utf-8")
        for judged in check.judged:
            method = judged.found.method
            groups = tuple(
                (found.role, found.discrepancies()) for found in (judged.control, judged.check) if found.names
            )
            if groups:
                write_geopackage(aside / f"{method}.gpkg", groups, system, changed_utc)
                names.append(f"{method}.gpkg")
            if not judged.check.names:
                continue
            points = judged.check.discrepancies()
            drawn = {"residual_map": residual_map(points), "histograms": histograms(points)}
            for kind, figure in drawn.items():
                if figure is not None:
                    figure.savefig(aside / f"{method}_{kind}.pdf", metadata={"CreationDate": None})
                    names.append(f"{method}_{kind}.pdf")
    return tuple(names)


def _table(header: list[str], rows: list[list[object]]) -> str:
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow(header)
    writer.writerows([["" if v is None else v for v in row] for row in rows])
    return text.getvalue()


def _ground_points(check: BlockCheck) -> str:
    header = ["method", "role", "point"]
    header += [
        f"{what}{axis}{unit}" for what, unit in (("d", "_m"), ("s", "_m"), ("w", "")) for axis in "XYZ"
    ]
    header += ["chi_squared", "ellipse_major_m", "ellipse_minor_m", "ellipse_azimuth_deg"]
    rows: list[list[object]] = []
    for judged in check.judged:
        for found in (judged.check, judged.control):
            rows += [
                [judged.found.method, found.role, name, *_figures(found, k)]
                for k, name in enumerate(found.names)
            ]
    return _table(header, rows)


def _figures(found: Differences, k: int) -> list[object]:
    values = [*found.d[k], *found.product_sigma[k], *found.w[k], found.distance[k]]
    values += [*found.ellipses.semi_axes[k], np.degrees(found.ellipses.azimuth[k])]
    return [finite(round(float(value), 6)) for value in values]


def _images(check: BlockCheck) -> str:
    header = ["image"]
    columns: list[list[object]] = [list(check.block.images.names)]
    for judged in check.judged:
        method, images = judged.found.method, judged.found.images
        header += [f"{method}_{name}" for name in ("rays", "rms_x_px", "rms_y_px", "largest_w")]
        columns += [images.rays.tolist(), *np.round(images.rms, 4).T.tolist()]
        columns.append(np.round(images.largest, 3).tolist())
    return _table(header, [list(row) for row in zip(*columns, strict=True)])


def _systematic(check: BlockCheck) -> str:
    header = ["group", "name", "unit", "correction", "value", "sigma", "t", "f", "critical", "significant"]
    rows: list[list[object]] = []
    for one in check.systematic.tested if check.systematic else ():
        rows += [
            [
                one.name,
                e.name,
                e.unit,
                e.correction,
                e.value,
                e.sigma,
                e.t,
                one.f,
                one.critical,
                one.significant,
            ]
            for e in one.estimates
        ]
    return _table(header, rows)


def _report(check: BlockCheck) -> str:
    """Section of the technical report."""
    lines = [
        f"# Georeferencing of {check.block.name}, judged at the ground points",
        "",
        f"Differences are {SIGN}, in metres; predicted standard deviations are a priori.",
        "",
        "| method | points | n | RMSE X | Y | Z | sigma X | Y | Z | error/sigma |",
        "|---|---|---|---|---|---|---|---|---|---|",
    ]
    for judged in check.judged:
        for found in (judged.check, judged.control):
            if not found.names:
                continue
            cells = " | ".join(f"{v:.4f}" for v in (*found.rmse, *found.predicted))
            n = len(found.names)
            lines.append(f"| {judged.found.method} | {found.role} | {n} | {cells} | {found.ratio:.2f} |")
    lines += ["", *(f"- {judged.found.label}" for judged in check.judged), ""]
    rows = standards_rows(check)
    if rows:
        lines += ["## Bias and classes", "", *(f"| {' | '.join(row)} |" for row in rows[:1])]
        lines += ["|---" * len(rows[0]) + "|", *(f"| {' | '.join(row)} |" for row in rows[1:]), ""]
    lines += ["## Findings", ""]
    say = catalogue("en")
    lines += [f"- {finding_text(one, say)}" for one in block_findings(check)] or ["- Nothing to remark."]
    return "\n".join(lines) + "\n"
