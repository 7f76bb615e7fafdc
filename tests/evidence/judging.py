"""What the product says of a simulated flight, and what is true of it: a row a flight."""

from __future__ import annotations

import json
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, TypeVar

import numpy as np

import photocal
from photocal.adjustment.ledger import ledger
from photocal.analysis.georeferencing.output import to_json
from photocal.base.errors import PhotocalError
from photocal.findings.verdict import judge
from tests.independent.flights import Design, Errors, World, measured, world
from tests.independent.folder import Placement, write_folder
from tests.independent.optics import Floats, omega_phi_kappa
from tests.independent.rows import Row, Told, cell

Made = TypeVar("Made")
AS_FLOWN = Placement()


@dataclass(frozen=True)
class Flown:
    """A block folder, its truth, and the errors of its survey (m, in the frame of the block)."""

    folder: Path
    design: Design
    truth: World
    at: Placement
    survey_error: dict[str, Floats]


def chance(design: Design, seed: int) -> np.random.Generator:
    """Give the generator of a flight, which draws its world first."""
    return np.random.default_rng([seed, design.images, design.control, design.check])


def fly(folder: Path, design: Design, errors: Errors, seed: int, at: Placement = AS_FLOWN) -> Flown:
    """Write the block of a flight; the same seed is the same flight, wherever it lies."""
    rng = chance(design, seed)
    truth = world(design, rng)
    observed = measured(truth, design, errors, rng)
    write_folder(folder, design, errors, truth, observed, at)
    apart = (observed.surveyed - truth.points) @ at.turn.T
    return Flown(folder, design, truth, at, dict(zip(at.point_names(truth), apart, strict=True)))


def judged(kind: str, name: str, design: Design, errors: Errors, seed: int, at: Placement = AS_FLOWN) -> Row:
    """Fly, adjust, analyse and check, by the public face."""
    with tempfile.TemporaryDirectory() as scratch:
        flown = fly(Path(scratch) / "block", design, errors, seed, at)
        block = photocal.read_block(flown.folder)
        result, adjust_s, _ = _tried(lambda: photocal.adjust(block))
        outcome, analyse_s, in_analysis = _tried(lambda: photocal.analyse(block, result))
        checked, check_s, in_check = _tried(lambda: photocal.check(block))
    content: dict[str, Any] = {} if checked is None else to_json(checked)
    methods = content.get("methods", {})
    best = methods.get("integrated") or methods.get("indirect")
    at_checks = at_check_points(best, flown) if best else None
    listed = () if outcome is None else outcome.findings
    return Row(
        kind,
        name,
        seed,
        content.get("verdict", {}).get("code", "refused"),
        "refused" if outcome is None else judge(listed).outcome.code,
        told_by_check(content),
        cell(Told(one.code, one.severity, one.subject, one.cause, rivals(one.figures)) for one in listed),
        *(at_checks or (np.nan, np.nan, np.nan, 0)),
        np.nan if result is None else float(result.sigma0_squared or np.nan),
        in_analysis,
        in_check,
        adjust_s,
        analyse_s,
        check_s,
    )


def told_by_check(content: dict[str, Any]) -> str:
    """Give the findings of `check --json` as a cell."""
    return cell(
        Told(
            *(one["code"], one["severity"], one.get("subject") or "", one.get("cause") or ""),
            rivals(one.get("figures") or {}),
        )
        for one in content.get("findings", [])
    )


def rivals(figures: Mapping[str, Any]) -> str:
    """Codes of what a flight cannot tell from a finding, separated by commas."""
    said = [one for key in ("same", "alike", "instead") for one in figures.get(key) or ()]
    return ",".join(str(one).partition(" ")[0] for one in said)


def by_command(folder: Path) -> tuple[str, str, str]:
    """Give findings of analyse and check, and the verdict, as the command line has them."""
    run = folder.parent / "run"
    _photocal("adjust", str(folder), "-o", str(run), "--json")
    analysed = _photocal("analyse", str(run), "--json")
    checked = _photocal("check", str(folder), "--json")
    return told_by_check(analysed), told_by_check(checked), checked.get("verdict", {}).get("code", "refused")


def errors_in_sigmas(result: photocal.Result, flown: Flown) -> dict[str, list[float]]:
    """Give true errors over standard deviations: camera, exposures (deg and m), tie points."""
    truth, at = flown.truth, flown.at
    given: dict[str, list[float]] = {}
    for camera in result.cameras.values():
        for name in camera.free:
            true = flown.design.readout_s if name == "readout" else getattr(truth.lens, name, None)
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


def at_check_points(method: dict[str, Any], flown: Flown) -> tuple[float, float, float, int] | None:
    """Damage, p of the joint test and of its mean, and whether the standards' test says biased."""
    check, assessed = method["check"], method.get("assessment") or {}
    if not check["points"]:
        return None
    apart = [[p[f"d{axis}_m"] for axis in "XYZ"] + flown.survey_error[p["point"]] for p in check["points"]]
    rmse = np.sqrt(np.mean(np.square(apart), axis=0))
    predicted = np.array([check["predicted_m"][axis] or np.nan for axis in "XYZ"])
    joint = check.get("joint") or {}
    components = assessed.get("components", {}).values()
    biased = any((part.get("bias_test") or {}).get("biased") for part in components)
    p, p_mean = (joint.get(key, np.nan) for key in ("p_value", "mean_p_value"))
    return float(np.nanmax(rmse / predicted)), float(p), float(p_mean), int(biased)


def _tried(make: Callable[[], Made]) -> tuple[Made | None, float, int]:
    """Make something, or nothing where that is refused; processor seconds, and adjustments made for it."""
    start = time.process_time()
    made = None
    with ledger() as entries:
        try:
            made = make()
        except PhotocalError as refusal:
            sys.stderr.write(f"{type(refusal).__name__}: {str(refusal)[:100]}\n")
    return made, time.process_time() - start, len(entries)


def _photocal(*words: str) -> dict[str, Any]:
    ran = subprocess.run(
        [sys.executable, "-m", "photocal", *words], capture_output=True, text=True, check=False
    )
    try:
        made: dict[str, Any] = json.loads(ran.stdout)
    except json.JSONDecodeError:
        return {"refused": ran.stderr.strip()}
    return made
