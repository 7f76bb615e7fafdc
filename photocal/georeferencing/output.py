"""A block's check as JSON (schema `photocal.block-check/2`), as text, and as files."""

import math
from pathlib import Path
from typing import Any

import numpy as np

from photocal.accuracy.assessment import ComponentResult
from photocal.accuracy.classes import class_cm
from photocal.accuracy.discrepancies import SIGN
from photocal.accuracy.maps import check_figures, save_figures, write_geopackage
from photocal.accuracy.output import findings_text, finite
from photocal.accuracy.output import to_json as assessment_json
from photocal.accuracy.standard import size_text
from photocal.base.arrays import Floats, as_plain
from photocal.base.files import output_folder, rows_text, write_json
from photocal.base.geopackage import ReferenceSystem
from photocal.findings.finding import verdict
from photocal.findings.texts import Catalogue, catalogue, finding_json, finding_text
from photocal.georeferencing.comparison import BlockCheck, Judged
from photocal.georeferencing.differences import CRITICAL_W, ELLIPSE_PROBABILITY, Differences, cells
from photocal.georeferencing.findings import block_findings, estimate_text
from photocal.georeferencing.systematic import Hypothesis, SystematicErrors

SCHEMA = "photocal.block-check/2"
_AXES = ("X", "Y", "Z")
_POSE = ("omega_deg", "phi_deg", "kappa_deg", "X_m", "Y_m", "Z_m")


def standards_rows(check: BlockCheck) -> list[list[str]]:
    """Give one row for each statement, one column for each method that has check points."""
    judged = [(entry.result.method, entry.assessment) for entry in check.judged]
    known = [(method, assessment) for method, assessment in judged if assessment is not None]
    if not known:
        return []
    rows = [["", *(method for method, _ in known)]]
    for k, component in enumerate(known[0][1].components):
        means = [_mean(assessment.components[k]) for _, assessment in known]
        rows.append([f"mean d{component.name}", *means])
    for k, table in enumerate(known[0][1].tables):
        name, basis = f"{table.standard_id} {table.table.product}", table.table.basis
        results = [assessment.tables[k] for _, assessment in known]
        if table.size is not None:
            asked = size_text(basis, table.size)
            cells = [
                f"precision {result.precision_class or 'none'}, accuracy {result.accuracy_class or 'none'}"
                for result in results
            ]
            rows.append([f"{name} at {asked}", *cells])
        best = table.admitted[0].name
        smallest = [result.admitted[0] for result in results]
        cells = [
            f"precision {_size(basis, admitted.precision)}, accuracy {_size(basis, admitted.accuracy)}"
            for admitted in smallest
        ]
        rows.append([f"{name}, class {best} from", *cells])
    for k, value in enumerate(known[0][1].values):
        reached = [assessment.values[k] for _, assessment in known]
        cells = [
            f"{_class(least.horizontal_m)} horizontal, {_class(least.vertical_m)} vertical"
            for least in reached
        ]
        rows.append([f"{value.standard.id}, class reached", *cells])
    return rows


def _mean(component: ComponentResult) -> str:
    mean, bias = f"{component.moments.mean_m:+.4f} m", component.bias
    return f"{mean}, " + ("-" if bias is None else f"t {bias.t:+.2f}{' biased' if bias.significant else ''}")


def _size(basis: str, size: float | None) -> str:
    return "none" if size is None else size_text(basis, size).removeprefix("interval ")


def _class(rmse_m: float | None) -> str:
    return "-" if rmse_m is None else f"{class_cm(rmse_m):.1f} cm"


def to_json(check: BlockCheck, say: Catalogue | None = None) -> dict[str, Any]:
    """Give a block's check as a JSON value, its findings in a language (English when none is given).

    returns: lengths in m; null where a figure does not exist.
    """
    exposures, apart = check.exposures, check.separation
    findings, say = block_findings(check), say or catalogue("en")
    scale = np.array([*np.degrees(np.ones(3)), 1.0, 1.0, 1.0])
    content: dict[str, Any] = {
        "schema": SCHEMA,
        "block": check.block.name,
        "sign": SIGN,
        "methods": {judged.result.method: _method(check, judged) for judged in check.judged},
        "refused": [{"method": method, "reason": reason} for method, reason in check.refused],
        "exposures_direct_less_indirect": None
        if exposures is None
        else {
            "images": exposures.images,
            "mean": dict(zip(_POSE, exposures.mean * scale, strict=True)),
            "rmse": dict(zip(_POSE, exposures.rmse * scale, strict=True)),
        },
        "systematic_errors": None if check.systematic is None else _systematic(check.systematic),
        "separation": None
        if apart is None
        else {
            **{key: getattr(apart, key) for key in ("names", "sigma", "correlation")},
            "not_separated": apart.groups,
        },
        "mistyped": [
            {"point": mistyped.point, "d_m": mistyped.d, "sigma_m": mistyped.sigma, "slips": mistyped.slips}
            for mistyped in check.mistyped
        ],
        "verdict": finding_json(verdict(findings), say),
        "findings": [finding_json(finding, say) for finding in findings],
    }
    return {key: as_plain(part) for key, part in content.items()}


def _method(check: BlockCheck, judged: Judged) -> dict[str, Any]:
    result, seen = judged.result, judged.result.images
    return {
        "label": result.label,
        "chi_squared": result.chi_squared,
        "degrees_of_freedom": result.degrees_of_freedom,
        "global_test": result.test,
        "control": _differences(judged.control),
        "check": _differences(judged.check),
        "images": [
            {"image": name, "rays": n, "rms_x_px": x, "rms_y_px": y, "largest_w": w}
            for name, n, (x, y), w in zip(
                check.block.images.names, seen.rays, seen.rms, seen.largest, strict=True
            )
        ],
        "assessment": None if judged.assessment is None else assessment_json(judged.assessment),
    }


def _differences(differences: Differences) -> dict[str, Any]:
    joint = differences.joint
    return {
        "n": len(differences.names),
        "rmse_m": _by_axis(differences.rmse),
        "predicted_m": _by_axis(differences.predicted),
        "errors_over_prediction": differences.ratio,
        "critical_w": CRITICAL_W,
        "ellipse_probability": ELLIPSE_PROBABILITY,
        "joint": None
        if joint is None
        else {**as_plain(joint), "mean": _by_axis(joint.mean), "mean_sigma": _by_axis(joint.mean_sigma)},
        "points": [_point(differences, k) for k in range(len(differences.names))],
    }


def _by_axis(values: Floats) -> dict[str, float]:
    return dict(zip(_AXES, values, strict=True))


def _point(differences: Differences, k: int) -> dict[str, Any]:
    keyed: dict[str, Any] = {"point": differences.names[k]}
    for a, axis in enumerate(_AXES):
        keyed |= {
            f"d{axis}_m": differences.d[k, a],
            f"s{axis}_m": differences.product_sigma[k, a],
            f"w{axis}": differences.w[k, a],
        }
    major, minor = differences.ellipses.semi_axes[k]
    ellipse = {"semi_major_m": major, "semi_minor_m": minor}
    keyed |= {
        "chi_squared": differences.distance[k],
        "covariance_m2": differences.covariance[k][np.tril_indices(3)],
    }
    return {**keyed, "ellipse": ellipse | {"azimuth_deg": math.degrees(differences.ellipses.azimuth[k])}}


def _systematic(errors: SystematicErrors) -> dict[str, Any]:
    return {
        "tested": [_hypothesis(hypothesis) for hypothesis in errors.tested],
        "found": [
            {**_hypothesis(error.hypothesis), "not_separated_from": [_name(code) for code in error.same]}
            for error in errors.errors
        ],
        "together": errors.estimates,
        "untested": errors.untested,
        "stated_sigmas": errors.sigmas,
        "free_in_block": errors.free_in_block,
    }


def _name(code: str) -> str:
    """What schema 1 calls a fault."""
    return code.replace("-", " ")


def _hypothesis(hypothesis: Hypothesis) -> dict[str, Any]:
    return {**as_plain(hypothesis), "name": _name(hypothesis.name)}


def to_text(check: BlockCheck) -> str:
    """Write a block's check for people: several lines, figures in m."""
    lines = [f"{check.block.name}: differences are {SIGN}, in metres; sigma is predicted, a priori."]
    lines.append(
        f"{'method':<12}{'points':<9}{'n':>4}  {'RMSE X':>9}{'Y':>9}{'Z':>9}   {'sigma X':>9}{'Y':>9}{'Z':>9}"
        f"   {'error/sigma':>11}"
    )
    for judged in check.judged:
        lines += [_row(judged, group) for group in judged.differences]
    lines += ["", *map(_label, check.judged), ""]
    rows = standards_rows(check)
    widths = [max(map(len, column)) + 3 for column in zip(*rows, strict=True)]
    lines += ["".join(f"{c:<{w}}" for c, w in zip(row, widths, strict=True)).rstrip() for row in rows]
    lines.append("")
    for judged in check.judged:
        lines += _points(judged)
    if check.exposures is not None:
        e = check.exposures
        angles, places = cells(np.degrees(e.rmse[:3]), ".4f", " "), cells(e.rmse[3:], ".3f", " ")
        lines.append(
            f"orientation, direct less indirect, RMSE over {e.images} images: "
            f"omega phi kappa {angles} deg, X Y Z {places} m\n"
        )
    if check.systematic is not None:
        lines += ["systematic errors, each freed alone:"]
        for tested in check.systematic.tested:
            outcome = "significant" if tested.significant else "not significant"
            figures = ", ".join(estimate_text(e) for e in tested.estimates[:3])
            limit = f"limit {tested.critical:.1f}"
            lines.append(f"  {tested.name}: F {tested.f:.1f} ({limit}), {outcome}; {figures}")
        lines += [f"  {text}" for text in check.systematic.untested] + [""]
    if check.systematic is not None and check.systematic.free_in_block:
        free_in_block = [
            f"  {estimate_text(e)}, {'significant' if e.significant else 'not significant'}"
            for e in check.systematic.free_in_block
        ]
        lines += ["left free in block.toml, estimated by the integrated method:", *free_in_block, ""]
    lines += [f"{method}: not possible: {reason}" for method, reason in check.refused]
    findings = block_findings(check)
    lines += [findings_text(findings), finding_text(verdict(findings), catalogue("en"))]
    return "\n".join(lines)


def _label(judged: Judged) -> str:
    """What the method is, and how many check points lie within the ground sampling distance."""
    plane = judged.assessment.plane if judged.assessment else None
    if judged.assessment is None or plane is None or plane.within_gsd is None:
        return judged.result.label
    (within_one, within_two), gsd = plane.within_gsd, judged.assessment.question.gsd_m
    return (
        f"{judged.result.label}; of {plane.n} check points {within_one} lie in plane within a GSD "
        f"({gsd:.3f} m), {within_two} within two"
    )


def _row(judged: Judged, differences: Differences) -> str:
    ratio = "-" if math.isnan(differences.ratio) else f"{differences.ratio:.2f}"
    which = f"{judged.result.method:<12}{differences.role:<9}{len(differences.names):>4}"
    return f"{which}  {cells(differences.rmse)}   {cells(differences.predicted)}   {ratio:>11}"


def _points(judged: Judged) -> list[str]:
    lines = []
    for group in judged.differences:
        if group.joint is not None:
            joint = group.joint
            pairs = zip("XYZ", joint.mean, joint.mean_sigma, strict=True)
            means = ", ".join(f"{axis} {mean:+.4f} +- {sigma:.4f}" for axis, mean, sigma in pairs)
            lines.append(
                f"{judged.result.method}, check points jointly: d' C^-1 d {joint.chi_squared:.1f} over "
                f"{joint.degrees_of_freedom} (p {joint.p_value:.3f}); mean {means} "
                f"(p {joint.mean_p_value:.3f})"
            )
        lines.append(f"{judged.result.method}, {group.role} points: d, predicted sigma of the point, w")
        for name, d, s, w in zip(group.names, group.d, group.product_sigma, group.w, strict=True):
            tested = " ".join("     -" if math.isnan(x) else f"{x:6.2f}" for x in w.tolist())
            lines.append(f"  {name:<12}{cells(d, '+9.4f', ' ')}   {cells(s, '8.4f', ' ')}   {tested}")
    return [*lines, ""] if lines else []


def write_check(
    check: BlockCheck, content: dict[str, Any], folder: Path, system: ReferenceSystem, changed_utc: str
) -> tuple[str, ...]:
    """Write the results of a check.

    system: of the block's coordinates, for the GeoPackage.
    raises OutputError: when the folder cannot be written; nothing is then left half-written.
    """
    texts = {
        "ground_points.csv": _ground_points(check),
        "images.csv": _images(check),
        "report.md": _report(check),
    }
    if check.systematic is not None:
        texts["systematic_errors.csv"] = _systematic_csv(check)
    names = ["check.json", *texts]
    with output_folder(folder) as aside:
        write_json(aside / "check.json", content)
        for name, text in texts.items():
            (aside / name).write_text(text, encoding="utf-8")
        for judged in check.judged:
            method = judged.result.method
            groups = tuple((group.role, group.discrepancies()) for group in judged.differences[::-1])
            if groups:
                write_geopackage(aside / f"{method}.gpkg", groups, system, changed_utc)
                names.append(f"{method}.gpkg")
            if not judged.check.names:
                continue
            gsd = judged.assessment.question.gsd_m if judged.assessment else None
            names += save_figures(aside, check_figures(judged.check.discrepancies(), gsd, f"{method}_"))
    return tuple(names)


def _ground_points(check: BlockCheck) -> str:
    header = ["method", "role", "point"]
    header += [
        f"{what}{axis}{unit}" for what, unit in (("d", "_m"), ("s", "_m"), ("w", "")) for axis in "XYZ"
    ]
    header += ["chi_squared", "ellipse_major_m", "ellipse_minor_m", "ellipse_azimuth_deg"]
    rows: list[list[object]] = []
    for judged in check.judged:
        for group in judged.differences:
            axes, azimuth = group.ellipses.semi_axes, np.degrees(group.ellipses.azimuth)
            figures = np.column_stack([group.d, group.product_sigma, group.w, group.distance, axes, azimuth])
            rows += [
                [judged.result.method, group.role, name, *(finite(round(float(v), 6)) for v in values)]
                for name, values in zip(group.names, figures, strict=True)
            ]
    return rows_text(header, rows)


def _images(check: BlockCheck) -> str:
    header = ["image"]
    columns: list[list[object]] = [list(check.block.images.names)]
    for judged in check.judged:
        method, images = judged.result.method, judged.result.images
        header += [f"{method}_{name}" for name in ("rays", "rms_x_px", "rms_y_px", "largest_w")]
        columns += [images.rays.tolist(), *np.round(images.rms, 4).T.tolist()]
        columns.append(np.round(images.largest, 3).tolist())
    return rows_text(header, [list(row) for row in zip(*columns, strict=True)])


def _systematic_csv(check: BlockCheck) -> str:
    header = ["group", "name", "unit", "correction", "value", "sigma", "t", "f", "critical", "significant"]
    rows: list[list[object]] = []
    for tested in check.systematic.tested if check.systematic else ():
        judged = (tested.f, tested.critical, tested.significant)
        rows += [[tested.name, *(getattr(e, key) for key in header[1:7]), *judged] for e in tested.estimates]
    return rows_text(header, rows)


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
        for group in judged.differences:
            figures = " | ".join(f"{v:.4f}" for v in (*group.rmse, *group.predicted))
            head = f"| {judged.result.method} | {group.role} | {len(group.names)}"
            lines.append(f"{head} | {figures} | {group.ratio:.2f} |")
    lines += ["", *(f"- {_label(judged)}" for judged in check.judged), ""]
    rows = standards_rows(check)
    if rows:
        lines += ["## Bias and classes", "", *(f"| {' | '.join(row)} |" for row in rows[:1])]
        lines += ["|---" * len(rows[0]) + "|", *(f"| {' | '.join(row)} |" for row in rows[1:]), ""]
    lines += ["## Findings", ""]
    say = catalogue("en")
    findings = block_findings(check)
    lines += [f"- {finding_text(finding, say)}" for finding in findings] or ["- Nothing to remark."]
    return "\n".join(lines) + "\n"
