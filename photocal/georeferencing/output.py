"""A block's check as JSON (schema `photocal.block-check/2`), as a document, and as files."""

import math
from pathlib import Path
from typing import Any

import numpy as np

from photocal.accuracy.classes import class_cm, condition
from photocal.accuracy.discrepancies import SIGN
from photocal.accuracy.maps import check_figures, save_figures, write_geopackage
from photocal.accuracy.output import remarks
from photocal.accuracy.output import to_json as assessment_json
from photocal.accuracy.standard import size_text
from photocal.base.arrays import Floats, as_plain, picked
from photocal.base.files import output_folder, rows_text, write_json
from photocal.base.geopackage import ReferenceSystem
from photocal.base.policy import policy
from photocal.findings.document import Paragraph, Piece, Remarks, Section, TablePart, markdown, table, text
from photocal.findings.finding import Finding
from photocal.findings.texts import Catalogue, catalogue, finding_json
from photocal.findings.verdict import Known, Verdict, judge, verdict_json, verdict_section
from photocal.georeferencing.comparison import BlockCheck, Judged
from photocal.georeferencing.differences import CRITICAL_W, Differences
from photocal.georeferencing.findings import block_findings
from photocal.hypotheses.findings import estimate_text
from photocal.hypotheses.judged import Hypothesis
from photocal.hypotheses.search import SystematicErrors

SCHEMA = "photocal.block-check/2"
_TITLE = "Georeferencing of {}, judged at the ground points"
_AXES = ("X", "Y", "Z")
_POSE = ("omega_deg", "phi_deg", "kappa_deg", "X_m", "Y_m", "Z_m")


def _standards(check: BlockCheck) -> list[TablePart]:
    """Give one row for each statement, one column for each method that has check points."""
    judged = [(entry.result.method, entry.assessment) for entry in check.judged]
    known = [(method, assessment) for method, assessment in judged if assessment is not None]
    if not known:
        return []
    heads = ["", *(f"{method}<" for method, _ in known)]
    rows: list[tuple[str, ...]] = []
    for k, axis in enumerate("XYZ"):
        means = [_mean(entry.check, k) for entry in check.judged if entry.assessment is not None]
        rows.append((f"mean d{axis}", *means))
    for k, judged_by in enumerate(known[0][1].tables):
        name, basis = f"{judged_by.standard_id} {judged_by.table.product}", judged_by.table.basis
        results = [assessment.tables[k] for _, assessment in known]
        if judged_by.size is not None:
            asked = size_text(basis, judged_by.size)
            cells = [
                f"precision {result.precision_class or 'none'}, accuracy {result.accuracy_class or 'none'}"
                for result in results
            ]
            points = len(known[0][1].discrepancies.points)
            rows.append((f"{name} at {asked}, {points} check points", *cells))
        best = judged_by.admitted[0].name
        smallest = [result.admitted[0] for result in results]
        cells = [
            f"precision {_size(basis, admitted.precision)}, accuracy {_size(basis, admitted.accuracy)}"
            for admitted in smallest
        ]
        rows.append((f"{name}, class {best} from", *cells))
    for k, value in enumerate(known[0][1].values):
        reached = [assessment.values[k] for _, assessment in known]
        cells = [
            f"{_class(least.horizontal_m)} horizontal, {_class(least.vertical_m)} vertical "
            f"({condition(least)})"
            for least in reached
        ]
        rows.append((f"{value.standard.id}, class reached", *cells))
    return [table("", heads, rows)]


def _mean(check: Differences, axis: int) -> str:
    """Give a mean with its sigma; whether check points are biased is asked once, for all axes."""
    mean, joint = f"{check.d[:, axis].mean():+.4f}", check.joint
    if joint is None:
        return f"{mean} m"
    return f"{mean} +- {joint.mean_sigma[axis]:.4f} m{', biased' if joint.biased else ''}"


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
        "exposures_direct_less_indirect": exposures
        and {
            "images": exposures.images,
            "mean": dict(zip(_POSE, exposures.mean * scale, strict=True)),
            "rmse": dict(zip(_POSE, exposures.rmse * scale, strict=True)),
        },
        "systematic_errors": check.systematic and _systematic(check.systematic),
        "separation": apart and picked(apart, "names", "sigma", "correlation", not_separated="groups"),
        "mistyped": [picked(one, "point", "slips", d_m="d", sigma_m="sigma") for one in check.mistyped],
        "verdict": verdict_json(block_verdict(check, findings), say),
        "findings": [finding_json(finding, say) for finding in findings],
    }
    return {key: as_plain(part) for key, part in content.items()}


def _method(check: BlockCheck, judged: Judged) -> dict[str, Any]:
    result, seen = judged.result, judged.result.images
    return {
        **picked(result, "label", "chi_squared", "degrees_of_freedom", global_test="test"),
        "control": _differences(judged.control),
        "check": _differences(judged.check),
        "images": [
            {"image": name, "rays": n, "rms_x_px": x, "rms_y_px": y, "largest_w": w}
            for name, n, (x, y), w in zip(
                check.block.images.names, seen.rays, seen.rms, seen.largest, strict=True
            )
        ],
        "assessment": judged.assessment and assessment_json(judged.assessment),
    }


def _differences(differences: Differences) -> dict[str, Any]:
    joint = differences.joint
    return {
        "n": len(differences.names),
        "rmse_m": _by_axis(differences.rmse),
        "predicted_m": _by_axis(differences.predicted),
        "survey_m": _by_axis(differences.survey),
        "errors_over_prediction": differences.ratio,
        "critical_w": CRITICAL_W,
        "ellipse_probability": policy.confidence,
        "joint": joint
        and {**as_plain(joint), "mean": _by_axis(joint.mean), "mean_sigma": _by_axis(joint.mean_sigma)},
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
    axes = dict(zip(("semi_major_m", "semi_minor_m"), differences.ellipses.semi_axes[k], strict=True))
    return {
        **keyed,
        "chi_squared": differences.distance[k],
        "covariance_m2": differences.covariance[k][np.tril_indices(3)],
        "ellipse": axes | {"azimuth_deg": math.degrees(differences.ellipses.azimuth[k])},
    }


def _systematic(errors: SystematicErrors) -> dict[str, Any]:
    return {
        "tested": [_hypothesis(hypothesis) for hypothesis in errors.tested],
        "found": [
            {
                **_hypothesis(error.hypothesis),
                "not_separated_from": [_name(code) for code in error.same],
                "share": error.share,
            }
            for error in errors.errors
        ],
        **picked(errors, "untested", "free_in_block", "adequate", "explained", "fit", "memory"),
        **picked(errors, together="estimates", stated_sigmas="sigmas"),
    }


def _name(code: str) -> str:
    """What schema 1 calls a fault."""
    return code.replace("-", " ")


def _hypothesis(hypothesis: Hypothesis) -> dict[str, Any]:
    return {**as_plain(hypothesis), "name": _name(hypothesis.name)}


def block_verdict(check: BlockCheck, findings: tuple[Finding, ...]) -> Verdict:
    """Judge a block by what its check found."""
    block = check.block
    calibrated = any(camera.estimated.any() for camera in block.cameras)
    return judge(findings, Known(len(block.images.names), block.datum != "free", calibrated))


def sections(check: BlockCheck, given: Verdict | None = None, *, details: bool = True) -> list[Section]:
    """Say what is known of a block: figures in m.

    given: the verdict of the project that the block belongs to; else that of the check alone.
    details: points, tests and findings in full, beside the verdict and the figures of the methods.
    """
    heads = ["method", "points", "n", "RMSE X", "Y", "Z", "sigma X", "Y", "Z"]
    heads += ["survey X", "Y", "Z", "error/sigma"]
    rows = [_row(judged, group) for judged in check.judged for group in judged.differences]
    labels = Remarks(tuple(map(_label, check.judged)))
    assumed = ", from standard deviations that are assumed: nothing tests them"
    untested = assumed if check.block.global_test[1] == "none" else ""
    intro = Paragraph(
        f"Differences are {SIGN}, in metres; sigma is predicted, a priori{untested}; survey is what the "
        "survey states of its own points."
    )
    found, points = block_findings(check), [piece for judged in check.judged for piece in _points(judged)]
    listed = [
        verdict_section(given or block_verdict(check, found), catalogue("en")),
        Section("", (intro, table("", heads, rows), labels)),
        Section("Bias and classes", tuple(_standards(check))),
    ]
    if details:
        listed += [
            Section("Ground points", tuple(points)),
            Section("Orientations and systematic errors", tuple(_errors(check))),
            Section("Findings", (remarks(found),)),
        ]
    return [section for section in listed if section.pieces]


def to_text(check: BlockCheck, given: Verdict | None = None, *, details: bool = True) -> str:
    """Write a block's check for people; parameters as of `sections`."""
    return f"{check.block.name}\n{text(sections(check, given, details=details))}"


def _errors(check: BlockCheck) -> list[Piece]:
    pieces: list[Piece] = []
    if check.exposures is not None:
        e = check.exposures
        angles = " ".join(f"{v:.4f}" for v in np.degrees(e.rmse[:3]))
        places = " ".join(f"{v:.3f}" for v in e.rmse[3:])
        said = f"orientation, direct less indirect, RMSE over {e.images} images: "
        pieces.append(Paragraph(f"{said}omega phi kappa {angles} deg, X Y Z {places} m"))
    if check.systematic is not None:
        rows = [
            (
                tested.name,
                f"{tested.f:.1f}",
                f"{tested.critical:.1f}",
                _significant(tested.significant),
                ", ".join(estimate_text(e) for e in tested.estimates[:3]),
            )
            for tested in check.systematic.tested
        ]
        note = "\n".join(check.systematic.untested)
        heads = ("freed", "F", "limit", "<", "estimates<")
        pieces.append(table("systematic errors, each freed alone", heads, rows, note))
        left = [f"{estimate_text(e)}, {_significant(e.significant)}" for e in check.systematic.free_in_block]
        title = "left free in block.toml, estimated by the integrated method:"
        pieces += [Paragraph("\n".join([title, *left]))] if left else []
    refused = [f"{method}: not possible: {reason}" for method, reason in check.refused]
    return [*pieces, Paragraph("\n".join(refused))] if refused else pieces


def _significant(decision: bool) -> str:
    return "significant" if decision else "not significant"


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


def _row(judged: Judged, group: Differences) -> tuple[str, ...]:
    ratio = "-" if math.isnan(group.ratio) else f"{group.ratio:.2f}"
    figures = (f"{v:.4f}" for v in (*group.rmse, *group.predicted, *group.survey))
    return (judged.result.method, group.role, str(len(group.names)), *figures, ratio)


def _points(judged: Judged) -> list[Piece]:
    pieces: list[Piece] = []
    for group in judged.differences:
        method, joint = judged.result.method, group.joint
        note = ""
        if joint is not None:
            pairs = zip("XYZ", joint.mean, joint.mean_sigma, strict=True)
            means = ", ".join(f"{axis} {mean:+.4f} +- {sigma:.4f}" for axis, mean, sigma in pairs)
            note = (
                f"{method}, check points jointly: d' C^-1 d {joint.chi_squared:.1f} over "
                f"{joint.degrees_of_freedom} (p {joint.p_value:.3f}); mean {means} "
                f"(p {joint.mean_p_value:.3f})"
            )
        heads = ["point", *(f"{what}{axis}" for what in ("d", "sigma ", "w ") for axis in "XYZ")]
        rows = [
            (
                name,
                *(f"{x:+.4f}" for x in d),
                *(f"{x:.4f}" for x in s),
                *("-" if math.isnan(x) else f"{x:.2f}" for x in w),
            )
            for name, d, s, w in zip(group.names, group.d, group.product_sigma, group.w, strict=True)
        ]
        title = f"{method}, {group.role} points: d, predicted sigma of the point, w"
        pieces.append(table(title, heads, rows, note))
    return pieces


def write_check(
    check: BlockCheck,
    content: dict[str, Any],
    folder: Path,
    system: ReferenceSystem,
    changed_utc: str,
    given: Verdict | None = None,
) -> tuple[str, ...]:
    """Write the results of a check.

    system: of the block's coordinates, for the GeoPackage.
    given: as of `sections`.
    raises OutputError: when the folder cannot be written; nothing is then left half-written.
    """
    texts = {
        "ground_points.csv": _ground_points(content["methods"]),
        "images.csv": _images(check),
        "report.md": markdown(_TITLE.format(check.block.name), sections(check, given)),
    }
    if check.systematic is not None:
        texts["systematic_errors.csv"] = _systematic_csv(check.systematic)
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


def _ground_points(methods: dict[str, Any]) -> str:
    named = [f"{what}{axis}{unit}" for what, unit in (("d", "_m"), ("s", "_m"), ("w", "")) for axis in _AXES]
    ellipse = ["ellipse_major_m", "ellipse_minor_m", "ellipse_azimuth_deg"]
    rows: list[list[object]] = []
    for method, judged in methods.items():
        for role in ("check", "control"):
            for point in judged[role]["points"]:
                figures = (*(point[key] for key in (*named, "chi_squared")), *point["ellipse"].values())
                cut = (v if v is None else round(v, 6) for v in figures)
                rows.append([method, role, point["point"], *cut])
    return rows_text(["method", "role", "point", *named, "chi_squared", *ellipse], rows)


def _images(check: BlockCheck) -> str:
    header = ["image"]
    columns: list[list[object]] = [list(check.block.images.names)]
    for judged in check.judged:
        method, images = judged.result.method, judged.result.images
        header += [f"{method}_{name}" for name in ("rays", "rms_x_px", "rms_y_px", "largest_w")]
        columns += [images.rays.tolist(), *np.round(images.rms, 4).T.tolist()]
        columns.append(np.round(images.largest, 3).tolist())
    return rows_text(header, [list(row) for row in zip(*columns, strict=True)])


def _systematic_csv(systematic: SystematicErrors) -> str:
    header = ["group", "name", "unit", "correction", "value", "sigma", "t", "f", "critical", "significant"]
    rows: list[list[object]] = []
    for tested in systematic.tested:
        judged = (tested.f, tested.critical, tested.significant)
        rows += [[tested.name, *(getattr(e, key) for key in header[1:7]), *judged] for e in tested.estimates]
    return rows_text(header, rows)
