"""A block's check as JSON (schema `photocal.block-check/2`), as a document, and as files."""

import math
from pathlib import Path
from typing import Any

import numpy as np

from photocal.analysis.accuracy.classes import ValueClass, class_cm
from photocal.analysis.accuracy.discrepancies import SIGN
from photocal.analysis.accuracy.maps import check_figures, save_figures, write_geopackage
from photocal.analysis.accuracy.output import localised, marked, remarks, told_table
from photocal.analysis.accuracy.output import to_json as assessment_json
from photocal.analysis.accuracy.standard import size_text
from photocal.analysis.georeferencing.comparison import CRITICAL_W, BlockCheck, Differences, Judged
from photocal.analysis.georeferencing.findings import block_findings
from photocal.base.arrays import Floats, as_plain, picked
from photocal.base.files import output_folder, rows_text, write_json
from photocal.base.geopackage import ReferenceSystem
from photocal.base.policy import policy
from photocal.findings.document import Paragraph, Piece, Remarks, Section, TablePart, markdown, table, text
from photocal.findings.finding import Finding
from photocal.findings.texts import Catalogue, catalogue, finding_json
from photocal.findings.verdict import Verdict, judge, verdict_json, verdict_section
from photocal.hypotheses.findings import estimate_text
from photocal.hypotheses.judged import Hypothesis
from photocal.hypotheses.search import SystematicErrors

SCHEMA = "photocal.block-check/2"
_TITLE = "Georeferencing of {}, judged at the ground points"
_AXES = ("X", "Y", "Z")
_POSE = ("omega_deg", "phi_deg", "kappa_deg", "X_m", "Y_m", "Z_m")


def _standards(check: BlockCheck, say: Catalogue) -> list[TablePart]:
    """Give one row for each statement, one column for each method that has check points."""
    judged = [(entry, entry.assessment) for entry in check.judged if entry.assessment is not None]
    if not judged:
        return []
    known = [assessment for _, assessment in judged]
    rows: list[tuple[str, ...]] = [
        (say("checked.mean", axis=axis), *(_mean(entry.check, k, say) for entry, _ in judged))
        for k, axis in enumerate("XYZ")
    ]
    for results in zip(*(assessment.tables for assessment in known), strict=True):
        first, basis = results[0], results[0].table.basis
        name = f"{first.standard_id} {first.table.product}"
        if first.size is not None:
            asked = {"size": size_text(basis, first.size), "points": len(known[0].discrepancies.points)}
            classes = (_both(one.precision_class, one.accuracy_class, say) for one in results)
            rows.append((say("checked.asked", name=name, **asked), *classes))
        best = [one.admitted[0] for one in results]
        sizes = (_both(_size(basis, one.precision), _size(basis, one.accuracy), say) for one in best)
        rows.append((say("checked.from", name=name, best=best[0].name), *sizes))
    for values in zip(*(assessment.values for assessment in known), strict=True):
        reached = (_value_class(value, say) for value in values)
        rows.append((say("checked.reached", name=values[0].standard.id), *reached))
    heads = ["", *(f"{say(f'shown.{entry.result.method}')}<" for entry, _ in judged)]
    return [table("", heads, localised(rows, say, 1))]


def _both(precise: str | None, accurate: str | None, say: Catalogue) -> str:
    none = say("shown.none")
    return say("checked.both", precise=precise or none, accurate=accurate or none)


def _mean(check: Differences, axis: int, say: Catalogue) -> str:
    """Give a mean with its sigma; whether check points are biased is asked once, for all axes."""
    mean, joint = f"{check.d[:, axis].mean():+.4f}", check.joint
    if joint is None:
        return f"{mean} m"
    return f"{mean} +- {joint.mean_sigma[axis]:.4f} m{say('checked.biased') if joint.biased else ''}"


def _size(basis: str, size: float | None) -> str | None:
    return None if size is None else size_text(basis, size).removeprefix("interval ")


def _value_class(value: ValueClass, say: Catalogue) -> str:
    horizontal, vertical = (
        "-" if rmse_m is None else f"{say.fixed(class_cm(rmse_m), 1)} cm"
        for rmse_m in (value.horizontal_m, value.vertical_m)
    )
    said = value.condition(say)
    return say("checked.reached_both", horizontal=horizontal, vertical=vertical, condition=said)


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
            "images": exposures[0],
            "mean": dict(zip(_POSE, exposures[1] * scale, strict=True)),
            "rmse": dict(zip(_POSE, exposures[2] * scale, strict=True)),
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
    axes = dict(zip(("semi_major_m", "semi_minor_m"), differences.ellipses[0][k], strict=True))
    return {
        **keyed,
        "chi_squared": differences.distance[k],
        "covariance_m2": differences.covariance[k][np.tril_indices(3)],
        "ellipse": axes | {"azimuth_deg": math.degrees(differences.ellipses[1][k])},
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
    placed = block.datum != "free"
    return judge(findings, len(block.images.names), placed=placed, calibrated=calibrated)


def sections(
    check: BlockCheck, say: Catalogue, given: Verdict | None = None, *, details: bool = True
) -> list[Section]:
    """Say what is known of a block: figures in m.

    given: the verdict of the project that the block belongs to; else that of the check alone.
    details: points, tests and findings in full, beside the verdict and the figures of the methods.
    """
    rows = [_row(judged, group, say) for judged in check.judged for group in judged.differences]
    methods = told_table("checked.methods", rows, say, caption="", names=2)
    labels = Remarks(tuple(_label(judged, say) for judged in check.judged))
    untested = say("checked.untested") if check.block.global_test[1] == "none" else ""
    intro = Paragraph(say("checked.intro", sign=say("shown.sign"), untested=untested))
    found = block_findings(check)
    points = [piece for judged in check.judged for piece in _points(judged, say)]
    listed = [
        verdict_section(given or block_verdict(check, found), say),
        Section("", (intro, methods, labels)),
        Section(say("checked.classes"), tuple(_standards(check, say))),
    ]
    if details:
        listed += [
            Section(say("checked.points"), tuple(points)),
            Section(say("checked.errors"), tuple(_errors(check, say))),
            Section(say("checked.findings"), (remarks(found, say),)),
        ]
    return [section for section in listed if section.pieces]


def to_text(
    check: BlockCheck, given: Verdict | None = None, say: Catalogue | None = None, *, details: bool = True
) -> str:
    """Write a block's check for people, in English unless asked otherwise; the rest as of `sections`."""
    return f"{check.block.name}\n{text(sections(check, say or catalogue('en'), given, details=details))}"


def _errors(check: BlockCheck, say: Catalogue) -> list[Piece]:
    pieces: list[Piece] = []
    if check.exposures is not None:
        images, _, rmse = check.exposures
        angles = " ".join(f"{v:.4f}" for v in np.degrees(rmse[:3]))
        places = " ".join(f"{v:.3f}" for v in rmse[3:])
        figures = marked({"angles": angles, "places": places}, say)
        pieces.append(Paragraph(say("checked.exposures", images=images, **figures)))
    if check.systematic is not None:
        rows = [
            (
                tested.name,
                f"{tested.f:.1f}",
                f"{tested.critical:.1f}",
                _significant(tested.significant, say),
                ", ".join(estimate_text(e) for e in tested.estimates[:3]),
            )
            for tested in check.systematic.tested
        ]
        note = "\n".join(check.systematic.untested)
        pieces.append(told_table("checked.freed", rows, say, note=note))
        free = check.systematic.free_in_block
        left = [f"{estimate_text(e)}, {_significant(e.significant, say)}" for e in free]
        pieces += [Paragraph("\n".join([say("checked.left"), *left]))] if left else []
    refused = [say("checked.refused", method=method, reason=reason) for method, reason in check.refused]
    return [*pieces, Paragraph("\n".join(refused))] if refused else pieces


def _significant(decision: bool, say: Catalogue) -> str:
    return say("checked.significant" if decision else "checked.not_significant")


def _label(judged: Judged, say: Catalogue) -> str:
    """What the method is, and how many check points lie within the ground sampling distance."""
    plane = judged.assessment.plane if judged.assessment else None
    if judged.assessment is None or plane is None or plane.within_gsd is None:
        return judged.result.label
    (within_one, within_two), gsd = plane.within_gsd, judged.assessment.question.gsd_m
    counts = {"n": plane.n, "one": within_one, "two": within_two}
    return say("checked.within", label=judged.result.label, **counts, **marked({"gsd": f"{gsd:.3f}"}, say))


def _row(judged: Judged, group: Differences, say: Catalogue) -> tuple[str, ...]:
    ratio = "-" if math.isnan(group.ratio) else f"{group.ratio:.2f}"
    figures = (f"{v:.4f}" for v in (*group.rmse, *group.predicted, *group.survey))
    names = say(f"shown.{judged.result.method}"), say(f"shown.{group.role}")
    return (*names, str(len(group.names)), *figures, ratio)


def _points(judged: Judged, say: Catalogue) -> list[Piece]:
    pieces: list[Piece] = []
    for group in judged.differences:
        method, joint = say(f"shown.{judged.result.method}"), group.joint
        note = ""
        if joint is not None:
            pairs = zip("XYZ", joint.mean, joint.mean_sigma, strict=True)
            means = ", ".join(f"{axis} {mean:+.4f} +- {sigma:.4f}" for axis, mean, sigma in pairs)
            figures = {"chi": f"{joint.chi_squared:.1f}", "p": f"{joint.p_value:.3f}", "means": means}
            figures |= {"mean_p": f"{joint.mean_p_value:.3f}"}
            freedom = joint.degrees_of_freedom
            note = say("checked.jointly", method=method, freedom=freedom, **marked(figures, say))
        rows = [
            (
                name,
                *(f"{x:+.4f}" for x in d),
                *(f"{x:.4f}" for x in s),
                *("-" if math.isnan(x) else f"{x:.2f}" for x in w),
            )
            for name, d, s, w in zip(group.names, group.d, group.product_sigma, group.w, strict=True)
        ]
        title = say("checked.points_title", method=method, role=say(f"shown.{group.role}"))
        pieces.append(told_table("checked.points", rows, say, caption=title, note=note, names=1))
    return pieces


def write_check(
    check: BlockCheck,
    content: dict[str, Any],
    folder: Path,
    system: ReferenceSystem,
    changed_utc: str,
    given: Verdict | None = None,
    say: Catalogue | None = None,
) -> None:
    """Write the results of a check.

    system: of the block's coordinates, for the GeoPackage.
    given, say: as of `sections`; English where no language is given.
    raises OutputError: when the folder cannot be written; nothing is then left half-written.
    """
    words = say or catalogue("en")
    texts = {
        "ground_points.csv": _ground_points(content["methods"]),
        "images.csv": _images(check),
        "report.md": markdown(_TITLE.format(check.block.name), sections(check, words, given)),
    }
    if check.systematic is not None:
        texts["systematic_errors.csv"] = _systematic_csv(check.systematic)
    with output_folder(folder) as aside:
        write_json(aside / "check.json", content)
        for name, text in texts.items():
            (aside / name).write_text(text, encoding="utf-8")
        for judged in check.judged:
            method = judged.result.method
            groups = tuple((group.role, group.discrepancies()) for group in judged.differences[::-1])
            if groups:
                write_geopackage(aside / f"{method}.gpkg", groups, system, changed_utc)


def draw_check(check: BlockCheck, folder: Path, say: Catalogue | None = None) -> None:
    """Draw the figures of the check points of each method; raises OutputError as `write_check` does."""
    with output_folder(folder) as aside:
        for judged in check.judged:
            if judged.check.names:
                gsd = judged.assessment.question.gsd_m if judged.assessment else None
                prefix = f"{judged.result.method}_"
                save_figures(
                    aside, check_figures(judged.check.discrepancies(), gsd, say or catalogue("en"), prefix)
                )


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
