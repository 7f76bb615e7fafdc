"""What the product says of a simulated flight, and what is true: one record of plain values a flight."""

from __future__ import annotations

import json
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, TypeVar

import numpy as np

import photocal
from photocal.adjustment.ledger import ledger
from photocal.base.errors import PhotocalError
from photocal.findings.finding import Finding, verdict
from photocal.georeferencing.output import to_json
from tests.independent.faults import Fault
from tests.independent.flights import Design, Errors, World, measured, world
from tests.independent.folder import Placement, write_folder
from tests.independent.optics import Floats, omega_phi_kappa

Made = TypeVar("Made")
Record = dict[str, Any]
# What follows of errors, what a block cannot tell, and what is said of samples: none of it is a cause.
NO_CAUSES = (
    *("check-outside-prediction", "control-outside-prediction", "prediction-too-good", "global-test"),
    *("global-factor", "method-refused", "not-separated", "not-determined", "no-check-points", "no-control"),
    *("coarse-positions", "c-on-positions", "heights-on-positions", "small-sample", "single-check-point"),
    *("bias", "outliers", "not-normal", "c-bias", "significance", "jackknife", "not-explained"),
)
RANK = ("refused", "grave", "doubtful", "consequence", "note", "passed", "untested")
AS_FLOWN = Placement()


@dataclass(frozen=True)
class Flown:
    """A block folder, its truth, and the errors of its survey (m, in the frame of the block)."""

    folder: Path
    truth: World
    at: Placement
    survey_error: dict[str, Floats]


def fly(folder: Path, design: Design, errors: Errors, seed: int, at: Placement = AS_FLOWN) -> Flown:
    """Write the block of a flight; the same seed is the same flight, wherever it lies."""
    rng = np.random.default_rng([seed, design.images, design.control, design.check])
    truth = world(design, rng)
    observed = measured(truth, design, errors, rng)
    write_folder(folder, design, errors, truth, observed, at)
    apart = (observed.surveyed - truth.points) @ at.turn.T
    return Flown(folder, truth, at, dict(zip(at.point_names(truth), apart, strict=True)))


def judged(design: Design, errors: Errors, seed: int, at: Placement = AS_FLOWN) -> Record:
    """Fly, adjust, analyse and check."""
    with tempfile.TemporaryDirectory() as scratch:
        return record(fly(Path(scratch) / "block", design, errors, seed, at))


def record(flown: Flown) -> Record:
    """Say what the public face makes of a flight."""
    block = photocal.read_block(flown.folder)
    result, adjusted_s, _ = _tried(lambda: photocal.adjust(block))
    outcome, analysed_s, in_analysis = _tried(lambda: photocal.analyse(block))
    check, checked_s, in_check = _tried(lambda: photocal.check(block))
    content = {} if isinstance(check, str) else to_json(check)
    listed = [] if isinstance(outcome, str) else [_plain(finding) for finding in outcome.findings]
    told = [(f["code"], f["severity"], f.get("subject", "")) for f in content.get("findings", [])]
    final = "refused" if isinstance(outcome, str) else verdict(outcome.findings).code
    return {
        "adjust": result if isinstance(result, str) else result.sigma0_squared,
        "z": {} if isinstance(result, str) else errors_in_sigmas(result, flown),
        "analyse": listed,
        "analyse_verdict": final,
        "check": told,
        "check_verdict": content.get("verdict", {}).get("code", "refused"),
        "methods": {name: _at_checks(part, flown) for name, part in content.get("methods", {}).items()},
        "adjustments": (in_analysis, in_check),
        "seconds": (adjusted_s, analysed_s, checked_s),
    }


def by_command(folder: Path) -> Record:
    """Give findings and verdicts of the command line, as `record` does."""
    run = folder.parent / "run"
    _photocal("adjust", str(folder), "-o", str(run), "--json")
    analysed = _photocal("analyse", str(run), "--json")
    checked = _photocal("check", str(folder), "--json")
    return {
        "analyse": [(f["code"], f["severity"], f["subject"]) for f in analysed.get("findings", [])],
        "check": [(f["code"], f["severity"], f["subject"]) for f in checked.get("findings", [])],
        "check_verdict": checked.get("verdict", {}).get("code", "refused"),
    }


def causes(findings: Sequence[Sequence[str]]) -> list[tuple[str, str, str]]:
    """Give what is named as a cause, the gravest first."""
    named = [tuple(one) for one in findings if one[0] not in NO_CAUSES and one[1] != "passed"]
    return sorted(named, key=lambda one: RANK.index(one[1]))  # type: ignore[arg-type]


def right(fault: Fault, findings: Sequence[Sequence[str]]) -> bool:
    """Whether the first cause is the fault, and all that it concerns is named."""
    named = causes(findings)
    if not named or named[0][0] not in fault.names:
        return not fault.names and not any(one[1] in ("grave", "refused", "doubtful") for one in named)
    if not fault.subjects:
        return True
    subjects = " ".join(subject for code, _, subject in named if code in fault.names).split()
    return named[0][2].split()[0].strip(",") in fault.subjects and set(fault.subjects) <= {
        word.strip(",") for word in subjects
    }


def accused(fault: Fault, findings: Sequence[Sequence[str]]) -> list[str]:
    """Give what is gravely or doubtfully named although it is sound."""
    return [
        f"{code} {subject}".strip()
        for code, severity, subject in causes(findings)
        if severity in ("grave", "doubtful", "refused")
        and (code not in fault.names or (fault.subjects and not set(subject.split()) & set(fault.subjects)))
    ]


def _plain(finding: Finding) -> tuple[str, str, str]:
    return finding.code, finding.severity, finding.subject


def _tried(make: Callable[[], Made]) -> tuple[Made | str, float, int]:
    """Make something: it or why not, processor seconds, and adjustments made for it."""
    start, made = time.process_time(), ""
    with ledger() as entries:
        try:
            return make(), time.process_time() - start, len(entries)
        except PhotocalError as refusal:
            made = f"{type(refusal).__name__}: {refusal}"
    return made, time.process_time() - start, len(entries)


def errors_in_sigmas(result: photocal.Result, flown: Flown) -> dict[str, list[float]]:
    """Give true errors over standard deviations: camera, exposures (deg and m), tie points."""
    truth, at = flown.truth, flown.at
    given: dict[str, list[float]] = {}
    for camera in result.cameras.values():
        for name in camera.free:
            true = getattr(truth.lens, name, None)
            sigma = camera.sigma_of(name)
            if true is not None and sigma:
                given[name] = [float((camera.value(name) - true) / sigma)]
    angles = omega_phi_kappa(truth.camera_axes @ at.turn.T)
    apart = result.images.values - np.hstack([angles, at.placed(truth.centre)])
    apart[:, :3] = (apart[:, :3] + np.pi) % (2.0 * np.pi) - np.pi
    if result.images.covariance is not None:
        z = apart / np.sqrt(np.diagonal(result.images.covariance, axis1=1, axis2=2))
        given |= dict(zip(("omega", "phi", "kappa", "X0", "Y0", "Z0"), z.T.tolist(), strict=True))
    number = {name: j for j, name in enumerate(at.point_names(truth))}
    ties = [k for k, name in enumerate(result.points.names) if truth.role[number[name]] == "tie"]
    places = at.placed(truth.points)[[number[result.points.names[k]] for k in ties]]
    z = (result.points.values[ties] - places) / result.points.sigma[ties]
    return given | dict(zip("XYZ", z.T.tolist(), strict=True))


def _at_checks(method: Record, flown: Flown) -> Record:
    """Errors at check points against the truth, what was predicted for them, and the joint tests."""
    check = method["check"]
    joint = check.get("joint") or {}
    points = check["points"]
    apart = [[p[f"d{axis}_m"] for axis in "XYZ"] + flown.survey_error[p["point"]] for p in points]
    rmse = np.sqrt(np.mean(np.square(apart), axis=0)) if points else np.full(3, np.nan)
    predicted = np.array([check["predicted_m"][axis] or np.nan for axis in "XYZ"])
    return {
        "n": len(points),
        "rmse": rmse.tolist(),
        "damage": float(np.nanmax(rmse / predicted)) if points else None,
        "p": joint.get("p_value"),
        "p_mean": joint.get("mean_p_value"),
    }


def _photocal(*words: str) -> Record:
    ran = subprocess.run(
        [sys.executable, "-m", "photocal", *words], capture_output=True, text=True, check=False
    )
    try:
        made: Record = json.loads(ran.stdout)
    except json.JSONDecodeError:
        return {"refused": ran.stderr.strip()}
    return made
