"""`photocal adopt`: the project of another program, checked for gross errors and adjusted anew.

How far an adoption is: the step of how many, and an estimate of the time that is left from the start.

What the quality report of another program says of its project: roles, sigmas, and figures beside ours.
"""

import datetime as dt
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import AbstractContextManager, contextmanager
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from scipy import special

from photocal.adjustment.adjusted import AdjustedNetwork
from photocal.adjustment.envelope import on_one_thread
from photocal.adjustment.groups import member_tests
from photocal.adjustment.mounting import Positions
from photocal.adjustment.network import covariance_matrices
from photocal.adjustment.variance_components import estimate_components
from photocal.base.arrays import Floats
from photocal.base.errors import IllPosedError, NotConvergedError, PhotocalError
from photocal.base.files import write_json
from photocal.base.policy import policy
from photocal.base.progress import Progress
from photocal.block.folder import read_block
from photocal.block.model import ROLES, Block
from photocal.block.mounting import make_mounting
from photocal.block.network import assemble
from photocal.block.results.adjusted import (
    AdjustedBlock,
    adjusted,
    adjustment_of,
    residuals_of,
    write_adjusted,
)
from photocal.block.results.result import Residuals, Result
from photocal.block.setup import MountingKeys
from photocal.exchange.foreign_project import ForeignProject, free_nonzero_parameters, never_estimated
from photocal.exchange.formats import read_foreign_project
from photocal.exchange.quality_report import QualityReport, report_of
from photocal.geometry.camera import held_camera
from photocal.measurement.measurement_record import SCHEMA as MEASURED
from photocal.measurement.measurement_record import MeasuredBlock
from photocal.run.adopt_rays import (
    by_rays_alone,
    crossed,
    some_of,
    with_control,
    without_gross_rays,
    without_weak_parts,
)
from photocal.run.adoption_figures import (
    camera_figures,
    control_figures,
    exterior_figures,
    head_figures,
    position_figures,
    sigma_figures,
    ties_of,
)

# Whose reports belong to whose projects, where names differ.
_FAMILY = {"PhotoScan": "Metashape", "OpenSfM": "ODM"}
_AXES = ("X", "Y", "Z")


def with_report(given: ForeignProject, path: Path) -> tuple[ForeignProject, QualityReport | None]:
    """Find the report of a project; its check points are not used, and its sigmas are given with ours."""
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


Step = Callable[[str], AbstractContextManager[None]]
# Share of the whole time that each step takes, of 581 images of one camera and of 1420 of five heads.
SHARES = {
    "reading the project": 0.10, "gross errors of the rays": 0.15, "weights of the image coordinates": 0.20,
    "adjustment": 0.15, "analysis": 0.30, "sigmas of control and positions": 0.05, "certificate": 0.05,
}  # fmt: skip
# A project before it is read: seconds that its start takes, and each MB of its largest text.
START_S, PER_MB_S = 8.0, 4.0


def steps(progress: Progress, path: Path) -> Step:
    """Make what tells each step: the first estimate goes by the size of the files, others by the time so far.

    path: folder or file of the project.
    """
    began, done = time.monotonic(), 0.0
    names = list(SHARES)
    largest = max((file.stat().st_size for file in _files(path)), default=0)
    whole_s = START_S + PER_MB_S * largest / 1e6

    @contextmanager
    def step(name: str) -> Iterator[None]:
        """Tell a step, with what is left of the whole."""
        nonlocal done
        passed = time.monotonic() - began
        left = whole_s if done == 0.0 else passed * (1 - done) / done
        at = f"{names.index(name) + 1} of {len(names)}"
        with progress(f"{at}, {name} (about {_rounded(left)} left in all)", None):
            yield
        done = sum(SHARES[each] for each in names[: names.index(name) + 1])

    return step


def _files(path: Path) -> list[Path]:
    if path.is_file():
        return [path]
    return [
        file for file in path.rglob("*") if file.suffix.lower() in (".txt", ".json", ".csv", ".bin", ".xml")
    ]


def _rounded(seconds: float) -> str:
    return f"{seconds / 60:.0f} min" if seconds > 90 else f"{max(seconds, 1):.0f} s"


SCHEMA = "photocal.adoption/1"
FIGURES = "adoption.json"


@on_one_thread
def adopt(
    path: Path, output: Path, day: dt.date, progress: Progress, gcp: Path | None = None
) -> dict[str, Any]:
    """Adjust a project anew; `output` gets its block, the run, `adoption.json` and the certificate.

    raises PhotocalError: for a project that cannot be read or adjusted.
    """
    from photocal.analysis.analyse_run import analyse_searched, write_analysis
    from photocal.analysis.searched_block import SearchedBlock
    from photocal.findings.texts import catalogue, finding_json, finding_text, plain
    from photocal.report.certificate_metadata import read_particulars
    from photocal.report.issue import issue

    step = steps(progress, path)
    with step("reading the project"):
        foreign, report = with_report(with_control(read_foreign_project(path), path, gcp), path)
        foreign = without_weak_parts(_freed(foreign))
    source, run = output / "block", output / "calibration"
    output.mkdir(parents=True, exist_ok=True)
    with step("gross errors of the rays"):
        foreign = without_weak_parts(without_gross_rays(foreign, output))
    try:
        foreign, made = _adjusted(foreign, output, step)
    except (IllPosedError, NotConvergedError) as refusal:
        foreign, made = _adjusted(_held(foreign, refusal), output, step)
    result = made.result
    with step("analysis"):
        outcome = write_analysis(run, analyse_searched(SearchedBlock(made)), made.block, result)
    with step("sigmas of control and positions"):
        sigmas = sigma_figures(foreign, result, _as_residuals_agree(outcome.search.first))
    control = control_figures(foreign, result)
    figures = {
        "schema": SCHEMA,
        "program": foreign.program,
        "project": path.name,
        "images": len(foreign.block.images.names),
        "points": len(foreign.block.points.names),
        "observations": 2 * len(foreign.block.observations.image),
        "remarks": list(foreign.remarks),
        "sigma0_squared": result.sigma0_squared,
        "cameras": camera_figures(foreign, result),
        "heads": head_figures(foreign, result),
        "sigmas": sigmas,
        "positions": position_figures(foreign, result, sigmas),
        "control": control,
        "report": report_figures(report, foreign, result, control),
        "exterior": exterior_figures(foreign, result),
        "findings": [finding_json(finding, catalogue("en")) for finding in outcome.findings],
        "hidden": [finding_text(finding, catalogue("en"), plain) for finding in outcome.findings],
    }
    write_json(output / FIGURES, figures)
    with step("certificate"):
        issue(run, output / "certificate", read_particulars(None, day), block=source)
    return figures


def _freed(foreign: ForeignProject) -> ForeignProject:
    """Estimate the cameras, also one that the program never did, which is named."""
    assumed = [] if foreign.weighted else never_estimated(foreign.block)
    remarks = [f"camera {name} was never estimated by {foreign.program}: estimated here" for name in assumed]
    block = free_nonzero_parameters(foreign.block, weighted=foreign.weighted)
    return replace(foreign, block=block, remarks=(*foreign.remarks, *remarks))


def _with_positions(foreign: ForeignProject) -> Block:
    """The block that is adjusted; positions may be shifted all alike where control says so."""
    block = foreign.block
    known = np.flatnonzero(np.isfinite(foreign.position).all(axis=1))
    controlled = int(block.points.of_role("control").sum()) >= policy.fewest_control
    held = np.isfinite(block.images.sigma).any()
    if not (len(known) or block.points.of_role("control").any() or held):
        return replace(block, datum="free")
    if not len(known):
        return block
    place, none = foreign.position[known], np.zeros(len(known))
    covariance = covariance_matrices(foreign.position_sigma[known], np.zeros((len(known), 3)))
    strip = np.zeros(len(known), dtype=np.int64)
    positions = Positions(known, place, covariance, np.zeros_like(place), strip, none, place[:, 2])
    keys = MountingKeys(flight_shift_sigma_m="free" if controlled else 0.0)
    return replace(block, positions=positions, mounting=make_mounting(keys, 1))


def _held(foreign: ForeignProject, refusal: PhotocalError) -> ForeignProject:
    """Hold the cameras where the block does not determine what the program's camera has."""
    if not any(camera.estimated.any() for camera in foreign.block.cameras):
        raise refusal
    remark = f"the cameras are held as the program has them: {refusal.what}"
    block = replace(foreign.block, cameras=tuple(map(held_camera, foreign.block.cameras)))
    return replace(foreign, block=block, remarks=(*foreign.remarks, remark))


def _adjusted(foreign: ForeignProject, output: Path, step: Step) -> tuple[ForeignProject, AdjustedBlock]:
    """Weigh and adjust, into `block` and `calibration` of the output."""
    source = output / "block"
    with step("weights of the image coordinates"):
        if not foreign.weighted:
            foreign = _weighted(foreign)
        block = _with_positions(foreign)
        MeasuredBlock(block, {"schema": MEASURED, "kind": f"project of {foreign.program}"}).write(source)
    with step("adjustment"):
        block = read_block(source)
        made = adjustment_of(block)
        write_adjusted(made, source, output / "calibration")
        return foreign, made


def _weighted(foreign: ForeignProject) -> ForeignProject:
    """Estimate the sigmas of tie points and of marks from their residuals, px."""
    block, tie = foreign.block, foreign.block.points.of_role("tie")[foreign.block.observations.point]
    # How often the sigmas of image coordinates are estimated, where the program states none.
    weightings = 2
    fewest_free = 5.0
    # Two variances are different from this significance on.
    least = 0.0005
    for _ in range(weightings):
        try:
            # Control that is exchanged says nothing of the marks.
            residuals = _residuals(by_rays_alone(block))
        except (IllPosedError, NotConvergedError):
            residuals = _residuals(_with_positions(replace(foreign, block=block)))
        kinds = tie if len(residuals) == len(tie) else tie[crossed(block)]
        free = [float(np.nansum(residuals.redundancy[rays])) for rays in (kinds, ~kinds)]
        squares = [float(np.nansum(residuals.residual[rays] ** 2)) for rays in (kinds, ~kinds)]
        sigma = np.full_like(block.observations.sigma, np.sqrt(sum(squares) / sum(free)))
        # Marks get a sigma of their own where theirs is another for certain.
        if min(free) > fewest_free:
            ratio = squares[1] / free[1] / (squares[0] / free[0])
            if not least < float(special.fdtr(free[1], free[0], ratio)) < 1 - least:
                for rays, square, count in zip((tie, ~tie), squares, free, strict=True):
                    sigma[rays] = np.sqrt(square / count)
        block = replace(block, observations=replace(block.observations, sigma=sigma))
        # With one sigma for all nothing moves.
        if np.ptp(sigma) == 0.0:
            break
    # What was estimated from the residuals is not tested with them.
    return replace(foreign, block=replace(block, global_test=(block.global_test[0], "none")))


def _as_residuals_agree(first: AdjustedNetwork) -> dict[str, Floats]:
    """Variances of control points and of positions along the axes, m^2, (3,), that the residuals show."""
    try:
        # Sigmas are found to one per cent.
        settled = 0.02
        # Frames may be as stiff as they are stated to be, or stiffer.
        estimated = estimate_components(first.network, hold=("rig",), start=first, settled=settled)
        members = member_tests(estimated.fitted.factored, estimated.solution)
    except (IllPosedError, NotConvergedError):
        return {}
    points, positions = estimated.network.points, estimated.network.positions
    given = dict(zip(positions.image.tolist(), positions.covariance, strict=True))
    variances: dict[str, list[Floats]] = {}
    for member in members:
        own = (
            given[member.index] if member.kind == "position" else np.linalg.pinv(points.weight[member.index])
        )
        # What the others say departs from an observation by its error and by theirs.
        variances.setdefault(member.kind, []).append(
            np.where(
                np.isfinite(np.diag(member.covariance)),
                member.error**2 - np.diag(member.covariance - own),
                np.nan,
            )
        )
    return {kind: np.nanmean(rows, axis=0) for kind, rows in variances.items() if np.isfinite(rows).any()}


def _residuals(block: Block) -> Residuals:
    return residuals_of(block, *adjusted(assemble(block)))
