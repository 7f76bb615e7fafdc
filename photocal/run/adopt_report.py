"""What the quality report of another program says of its project: roles, sigmas, and figures beside ours."""

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from photocal.base.arrays import Floats
from photocal.block.model import ROLES
from photocal.exchange.foreign_project import ForeignProject
from photocal.exchange.quality_report import QualityReport, report_of
from photocal.results.result import Result
from photocal.run.adopt_rays import some_of
from photocal.run.adoption_figures import ties_of

# Whose reports belong to whose projects, where names differ.
_FAMILY = {"PhotoScan": "Metashape", "OpenSfM": "ODM"}
_AXES = ("X", "Y", "Z")


def with_report(given: ForeignProject, path: Path) -> tuple[ForeignProject, QualityReport | None]:
    """Find the report of a project; its check points take no part, and its sigmas stand beside ours."""
    family = _FAMILY.get(given.program, given.program)
    folder = path if path.is_dir() else path.parent
    report, refusals = report_of(folder.resolve(), lambda program: program == family)
    given = replace(given, remarks=(*given.remarks, *refusals))
    if report is None:
        return given, None
    points = given.block.points
    named = np.isin(np.array(points.names, dtype=object), np.array(report.checks, dtype=object))
    checks = np.flatnonzero(named & points.of_role("control"))
    if len(checks):
        role = points.role.copy()
        role[checks] = ROLES.index("check")
        names = some_of([points.names[k] for k in checks])
        remark = f"{len(checks)} check points by {report.file.name}: {names}"
        block = replace(given.block, points=replace(points, role=role))
        given = replace(given, block=block, remarks=(*given.remarks, remark))
    cameras = given.block.cameras
    if len(report.camera_sigma_px) == len(cameras):
        sigma = {
            camera.id: {name: value for name, value in stated.items() if value > 0}
            for camera, stated in zip(cameras, report.camera_sigma_px, strict=True)
            if camera.unit == "px"
        }
        given = replace(given, camera_sigma=sigma | given.camera_sigma)
    return given, report


def report_figures(
    report: QualityReport | None, foreign: ForeignProject, result: Result, control: Sequence[dict[str, Any]]
) -> dict[str, Any] | None:
    """Their figures of the whole block, and ours of the same kind; None without a report."""
    if report is None:
        return None
    length = np.linalg.norm(result.residuals.residual[ties_of(foreign, result)], axis=1)
    length = length[np.isfinite(length)]
    mean = float(np.sqrt(np.mean(length**2)) if report.kind == "rms" else np.mean(length))
    known = np.isfinite(foreign.position).all(axis=1)
    away = (result.images.values[:, 3:] - foreign.position)[known]
    rows = [
        _row(f"{report.kind} reprojection error of tie points", "px", report.reprojection_px, mean),
        _row("images with an orientation", "", report.calibrated or np.nan, len(result.images.names)),
    ]
    for what, theirs, ours in (
        ("control points", report.control_m, _errors(control, "control")),
        ("check points", report.check_m, _errors(control, "check")),
        ("positions", report.position_m, away),
    ):
        rms = np.sqrt(np.mean(ours**2, axis=0)) if len(ours) else np.full(3, np.nan)
        rows += [
            _row(f"rms of {what}, {axis}", "m", *pair)
            for axis, *pair in zip(_AXES, theirs, rms.tolist(), strict=True)
        ]
    said = [row for row in rows if row["theirs"] is not None]
    return {"program": report.program, "file": report.file.name, "rows": said}


def _errors(control: Sequence[dict[str, Any]], role: str) -> Floats:
    return np.array([row["ours_m"] for row in control if row["role"] == role], dtype=float).reshape(-1, 3)


def _row(what: str, unit: str, theirs: float, ours: float) -> dict[str, Any]:
    values = {"theirs": float(theirs), "ours": float(ours)}
    return {"what": what, "unit": unit} | {k: v if np.isfinite(v) else None for k, v in values.items()}
