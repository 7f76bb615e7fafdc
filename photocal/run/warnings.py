"""What the stages found doubtful, in one list: it is shown at the end and stands in the certificate."""

from __future__ import annotations

import json
import math
from collections.abc import Callable, Container, Iterable, Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

from photocal.findings.finding import Finding, of_global_test, verdict
from photocal.findings.hypotheses import FAULTS, Fault, fault
from photocal.findings.texts import findings_of
from photocal.geometry.camera import PARAMETERS
from photocal.results.folder import RESULT, read_result
from photocal.run.stage import is_stage

# A parameter that goes so many of its prior sigmas away.
CONTRADICTED = 4.0
# With two thirds of the positions fixed, it is they that carry what is found.
_JUDGED_FROM_PERCENT = 200.0 / 3.0
# What else looks like what the search for systematic errors blames: told instead of it.
_EXCUSES = ("rolling-shutter", "c-drift", "ppk-not-fixed")
_ORDER = ("refused", "grave", "doubtful", "consequence", "note")
_NOT_CHECKED = Finding("not-checked", "doubtful", stage="certificate")


def gather(work: Path, stages: Container[str] | None = None) -> tuple[Finding, ...]:
    """Collect the findings of the stages: causes, consequences, notes, each in the order of the stages."""
    listed: list[Finding] = []
    for stage, name, read in _SOURCES:
        path = work / stage / name
        content = read_json(path) if stages is None or stage in stages else None
        for one in read(content, path) if content is not None else ():
            if not any((one.code, one.subject) == (other.code, other.subject) for other in listed):
                listed.append(replace(one, stage=stage))
    ppk = read_json(work / "ppk" / "ppk.json")
    return causes_first(listed, 100.0 if ppk is None else float(ppk["fixed_percent"]))


def told_beside(run: Path) -> tuple[Finding, ...]:
    """Give what the whole processing found to a certificate that is made of one of its stages."""
    work = run.resolve().parent
    if not is_stage(run):
        return ()
    return gather(work) if (work / "georeferencing").is_dir() else (*gather(work), _NOT_CHECKED)


def project_verdict(work: Path, stages: Container[str] | None = None) -> Finding | None:
    """Give the one verdict over a project: that of its certificate, else over what its stages found.

    returns: none before there is an adjustment.
    """
    certified = read_json(work / "certificate" / "certificate.json")
    if certified is not None and (stages is None or "certificate" in stages):
        return findings_of([certified["verdict"]], work / "certificate")[0]
    run = work / "calibration"
    if not (run / RESULT).is_file():
        return None
    result, findings = read_result(run), gather(work, stages)
    estimated = any(one.code == "sigmas-from-residuals" for one in findings)
    accepted = None if result.global_test is None else result.global_test.accepted
    figures = result.chi_squared, result.degrees_of_freedom
    return verdict((*findings, of_global_test(*figures, accepted, estimated=estimated)))


def kind(finding: Finding) -> str:
    """Whether it tells a fault, what follows from faults that are told, or a limit of the flight."""
    return finding.severity if finding.severity in ("consequence", "note") else "warning"


def causes_first(
    given: Iterable[Finding], fixed_percent: float, table: tuple[Fault, ...] = FAULTS
) -> tuple[Finding, ...]:
    """Mark what follows from other findings, and put it behind them.

    A surveyor who reads two causes does not know which to believe. The search for systematic errors names
    no more than the observations need; here the other stages come in: what positions without fixed
    ambiguities contradict, or images whose rows are not of one moment, is no proof against base, antenna,
    lever arm or zoom.
    """
    findings = tuple(given)
    codes = {one.code for one in findings}
    if fixed_percent >= _JUDGED_FROM_PERCENT:
        codes.discard("ppk-not-fixed")
    excuse = next((entry for code in _EXCUSES if code in codes and (entry := fault(code, table))), None)
    if excuse is not None:
        findings = tuple(
            _not_judged(one, excuse.code)
            if one.stage == "georeferencing" and one.code in excuse.imitates
            else one
            for one in findings
        )
    codes = {one.code for one in findings}
    symptoms = {code for one in table if one.code in codes for code in one.symptoms}
    findings = tuple(replace(f, severity="consequence") if f.code in symptoms else f for f in findings)
    order = ("warning", "consequence", "note")
    return tuple(sorted(findings, key=lambda one: order.index(kind(one))))


def _not_judged(one: Finding, cause: str) -> Finding:
    """The same, where something else is known to be wrong that looks like it."""
    said = replace(one, code="not-judged", severity="consequence", subject=one.code, clauses=(), cause=cause)
    return replace(said, figures={**one.figures, "same": (one.code,)})


def read_json(path: Path) -> dict[str, Any] | None:
    """Read the figures of a stage; None when it was not made."""
    if not path.is_file():
        return None
    content: dict[str, Any] = json.loads(path.read_text(encoding="utf-8"))
    return content


def _stored(content: dict[str, Any], path: Path) -> Iterator[Finding]:
    yield from (one for one in findings_of(content.get("findings"), path) if one.severity in _ORDER)


def _of_calibration(_: dict[str, Any], path: Path) -> Iterator[Finding]:
    """Shutters that roll, and parameters that left what was known of them: something else went into them."""
    result = read_result(path.parent)
    for one in result.readouts:
        if one.estimated:
            effect_px = one.effect / result.cameras[one.camera].pitch[0]
            figures = {"camera": one.camera, "value_ms": 1e3 * one.value, "sigma_ms": 1e3 * one.sigma}
            figures |= {"effect_px": effect_px, "way_m": one.way}
            yield Finding("shutter-rolls", "note", one.camera, figures)
    for name, camera in result.cameras.items():
        given = camera.values if camera.given is None else camera.given
        for k, key in enumerate(PARAMETERS):
            prior, away = float(camera.prior_sigma[k]), abs(float(camera.values[k] - given[k]))
            if not 0 < prior < math.inf or away <= CONTRADICTED * prior:
                continue
            figures = {"camera": name, "parameter": key, "value": camera.value(key), "unit": camera.unit}
            figures |= {"given": float(given[k]), "sigmas": away / prior}
            yield Finding("prior-contradicted", "doubtful", f"{name} {key}", figures)


def _of_analysis(content: dict[str, Any], path: Path) -> Iterator[Finding]:
    """What the other stages cannot see; the rest of the analysis has its own part of the certificate."""
    yield from (one for one in _stored(content, path) if fault(one.code) and not one.small)


_SOURCES: tuple[tuple[str, str, Callable[[dict[str, Any], Path], Iterator[Finding]]], ...] = (
    ("ppk", "ppk.json", _stored),
    ("exposures", "exposures.json", _stored),
    ("measurements", "measurement.json", _stored),
    ("calibration", RESULT, _of_calibration),
    ("georeferencing", "check.json", _stored),
    ("analysis", "analysis.json", _of_analysis),
)
