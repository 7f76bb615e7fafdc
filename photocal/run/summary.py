"""What a run has found: doubts of its stages in one list, and all of it on one screen and as JSON."""

import json
import math
from collections.abc import Callable, Container, Iterable, Iterator, Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from photocal.analysis.accuracy.classes import condition
from photocal.analysis.shutters import shutter_findings
from photocal.base.arrays import as_plain
from photocal.base.policy import policy
from photocal.block.model import InputFile
from photocal.block.results.folder import RESULT, changed_inputs, read_result
from photocal.block.results.result import Result
from photocal.findings.digits import with_sigma
from photocal.findings.finding import Finding
from photocal.findings.listed import Findings
from photocal.findings.texts import Catalogue, catalogue, finding_json, finding_text, findings_of, plain
from photocal.findings.verdict import (
    Verdict,
    by_methods,
    held_and_contradicted,
    read_verdict,
    verdict_json,
    verdict_text,
)
from photocal.geometry.camera import PARAMETERS
from photocal.hypotheses.faults import FAULTS, fault, searched
from photocal.hypotheses.table import Fault
from photocal.measurement.maker_camera import tag_finding
from photocal.report.certificate import judged, tested
from photocal.report.stored_analysis import AnalysedRun, read_run
from photocal.run.block import FINDINGS as BLOCK
from photocal.run.control import FIGURES as CONTROL
from photocal.run.exposures import FIGURES as EXPOSED
from photocal.run.exposures import ExposureFigures
from photocal.run.left_out import settled
from photocal.run.ppk import FIGURES as PPK
from photocal.run.stage import StageResult, is_stage

if TYPE_CHECKING:
    from photocal.navigation.ppk_result import PpkFigures

# With two thirds of the positions fixed, it is they that carry what is found.
_JUDGED_FROM_PERCENT = 200.0 / 3.0
# What else looks like what the search for systematic errors blames: told instead of it.
_EXCUSES = ("ppk-not-fixed",)
# Stages that search for causes.
_OF_CAUSES = ("georeferencing", "analysis")
_ORDER = ("refused", "grave", "doubtful", "consequence", "note")
_NOT_CHECKED = Finding("not-checked", "doubtful", stage="certificate")


def gather(work: Path, stages: Container[str] | None = None) -> tuple[Finding, ...]:
    """Collect the findings of the stages: causes, consequences, notes, each in the order of the stages."""
    listed: list[Finding] = []
    sought = False
    for stage, name, read in _SOURCES:
        path = work / stage / name
        if not path.is_file() or (stages is not None and stage not in stages):
            continue
        found = read(path)
        if stage == "analysis" and sought:
            # The same search on the same block, which the check has told.
            found = (finding for finding in found if not searched(finding.code))
        add_new(listed, found, stage)
        # A check looked for causes, rather than had no hold for them.
        sought |= stage == "georeferencing" and bool((read_json(path) or {}).get("systematic_errors"))
    ppk = _ppk(work)
    return causes_first(settled(listed), 100.0 if ppk is None else ppk.fixed_percent)


def _ppk(work: Path) -> "PpkFigures | None":
    """Figures of the PPK, where there is one."""
    path = work / "ppk" / PPK
    if not path.is_file():
        return None
    from photocal.navigation.ppk_result import PpkFigures

    return PpkFigures.read(path)


def add_new(listed: list[Finding], findings: Iterable[Finding], stage: str) -> None:
    """Add the findings of a stage that no earlier one has told."""
    for finding in findings:
        if not any(same_matter(finding, other) for other in listed):
            listed.append(replace(finding, stage=stage))


def same_matter(finding: Finding, other: Finding) -> bool:
    """Whether two findings tell the same, by whatever figures."""
    return (finding.code, finding.subject, finding.cause) == (other.code, other.subject, other.cause)


def stage_findings(run: Path) -> tuple[Finding, ...]:
    """Give what the whole processing found to a certificate that is made of one of its stages."""
    work = run.resolve().parent
    if not is_stage(run):
        return ()
    return gather(work) if (work / "georeferencing").is_dir() else (*gather(work), _NOT_CHECKED)


def flown_figures(run: Path) -> dict[str, Any] | None:
    """Give what stage `flown` measured to a certificate that is made of another stage of that run."""
    return read_json(run.resolve().parent / "flown" / "flown.json") if is_stage(run) else None


def project_verdict(work: Path, stages: Container[str] | None = None) -> Verdict | None:
    """Give the one verdict over a project: that of its certificate, else over what its stages found.

    stages: those that count; all that there are when not given.
    returns: none before the block, as it is now, was adjusted and analysed.
    """
    if outdated(work):
        return None
    certified = read_json(work / "certificate" / "certificate.json")
    if certified is not None and (stages is None or "certificate" in stages):
        return read_verdict(certified["verdict"], work / "certificate")
    run, analysed = work / "calibration", work / "analysis" / RESULT
    if not analysed.is_file() or (stages is not None and "analysis" not in stages):
        return None
    result, findings = read_result(run), gather(work, stages)
    return judged(result, (*findings, tested(result, findings)))


def project_findings(work: Path) -> tuple[Finding, ...]:
    """Give what decides over a project, and its notes: what stages, adjustment and analysis found."""
    certified = read_json(work / "certificate" / "certificate.json")
    verdict = None if certified is None else read_verdict(certified["verdict"], work / "certificate")
    analysed = work / "analysis" / "analysis.json"
    gathered, run = gather(work), work / "calibration"
    listed = Findings.read(analysed).listed if analysed.is_file() else ()
    found = (one for one in listed if not any(same_matter(one, other) for other in gathered))
    adjusted = [tested(read_result(run), gathered)] if (run / RESULT).is_file() else []
    # What a certificate derives beside, its lines tell.
    lines = () if verdict is None else verdict.lines
    return (*gathered, *adjusted, *found, *(line.worst for line in lines))


def outdated(work: Path) -> bool:
    """Whether the certificate of a project, or else its adjustment, was made of another block than this."""
    certified = read_json(work / "certificate" / "certificate.json")
    adjusted = read_json(work / "calibration" / RESULT) if certified is None else certified.get("result")
    inputs = tuple(InputFile(**entry) for entry in (adjusted or {}).get("inputs", ()))
    return bool(changed_inputs(inputs, work / "block"))


def kind(finding: Finding) -> str:
    """Whether it tells a fault, what follows from faults that are reported, or a limit of the flight."""
    return finding.severity if finding.severity in ("consequence", "note") else "warning"


def causes_first(
    given: Iterable[Finding], fixed_percent: float, table: tuple[Fault, ...] = FAULTS
) -> tuple[Finding, ...]:
    """Mark what follows from other findings, and put it behind them.

    A surveyor who reads two causes does not know which to believe. The search of `hypotheses` names no more
    than the observations need, and its rivals with each; here the stages outside of it come in: what
    positions without fixed ambiguities contradict is no proof against base, antenna or lever arm.
    """
    findings = tuple(given)
    codes = {finding.code for finding in findings}
    if fixed_percent >= _JUDGED_FROM_PERCENT:
        codes.discard("ppk-not-fixed")
    excuse = next((entry for code in _EXCUSES if code in codes and (entry := fault(code, table))), None)
    if excuse is not None:
        alike = [f for f in findings if f.stage in _OF_CAUSES and f.code in excuse.imitates]
        findings = tuple(_not_judged(f, excuse.code) if f in alike else f for f in findings)
    codes = {finding.code for finding in findings}
    symptoms = {code for cause in table if cause.code in codes for code in cause.symptoms}
    findings = tuple(replace(f, severity="consequence") if f.code in symptoms else f for f in findings)
    findings = held_and_contradicted(findings)
    order = ("warning", "consequence", "note")
    return tuple(sorted(findings, key=lambda finding: order.index(kind(finding))))


def _not_judged(finding: Finding, cause: str) -> Finding:
    """The same, where something else is known to be wrong that looks like it."""
    figures = {**finding.figures, "same": (finding.code,)}
    unjudged = replace(finding, code="not-judged", severity="consequence", figures=figures)
    return replace(unjudged, subject=finding.code, clauses=(), cause=cause)


def read_json(path: Path) -> dict[str, Any] | None:
    """Read the figures of a stage; None when it was not made."""
    if not path.is_file():
        return None
    content: dict[str, Any] = json.loads(path.read_text(encoding="utf-8"))
    return content


def _stored(path: Path) -> Iterator[Finding]:
    yield from (finding for finding in Findings.read(path) if finding.severity in _ORDER)


def _of_calibration(path: Path) -> Iterator[Finding]:
    yield from calibration_findings(read_result(path.parent))


def calibration_findings(result: Result) -> Iterator[Finding]:
    """Shutters that roll, and parameters that left what was known of them: something else went into them."""
    yield from shutter_findings(result.cameras, result.readouts)
    for name, camera in result.cameras.items():
        if camera.stated_by:
            # What contradicts a maker's tag says something about the tag.
            yield from filter(None, [tag_finding(camera)])
            continue
        given = camera.values if camera.given is None else camera.given
        for k, key in enumerate(PARAMETERS):
            prior, away = float(camera.prior_sigma[k]), abs(float(camera.values[k] - given[k]))
            if not 0 < prior < math.inf or away <= policy.contradicted * prior:
                continue
            figures = {"camera": name, "parameter": key, "value": camera.value(key), "unit": camera.unit}
            figures |= {"given": float(given[k]), "sigmas": away / prior}
            yield Finding("prior-contradicted", "doubtful", f"{name} {key}", figures)


def _of_analysis(path: Path) -> Iterator[Finding]:
    """What the other stages cannot see; the rest of the analysis has its own part of the certificate."""
    yield from hidden_faults(_stored(path))


def hidden_faults(findings: Iterable[Finding]) -> Iterator[Finding]:
    """Give those findings of an analysis that are reported with those of the stages."""
    yield from (finding for finding in findings if fault(finding.code) and not finding.small)


_SOURCES: tuple[tuple[str, str, Callable[[Path], Iterator[Finding]]], ...] = (
    ("control", CONTROL, _stored),
    ("ppk", PPK, _stored),
    ("exposures", EXPOSED, _stored),
    ("measurements", "measurement.json", _stored),
    ("block", BLOCK, _stored),
    ("calibration", RESULT, _of_calibration),
    ("flown", "flown.json", _stored),
    ("georeferencing", "check.json", _stored),
    ("analysis", "analysis.json", _of_analysis),
)


SCHEMA = "photocal.run/1"
_PPK = ("epochs", "fixed", "float", "single", "fixed_percent")
_LEVER = ("lever_arm_x", "lever_arm_y", "lever_arm_z")
_BORESIGHT = ("boresight_x", "boresight_y", "boresight_z")


def summary(
    name: str, work: Path, made: Sequence[StageResult], verdict: Verdict | None = None
) -> dict[str, Any]:
    """Collect the figures of the stages.

    verdict: of the certificate that is being made of them.
    """
    done, say = {result.name for result in made}, catalogue("en")

    def figures(stage: str, file: str) -> dict[str, Any] | None:
        """Read the figures of a stage that is done."""
        return read_json(work / stage / file) if stage in done else None

    positions, seen = _ppk(work) if "ppk" in done else None, work / "exposures" / EXPOSED
    ppk = None if positions is None else positions.record
    exposures = ExposureFigures.read(seen) if "exposures" in done and seen.is_file() else None
    check, control = figures("georeferencing", "check.json"), figures("control", CONTROL)
    assessed = check and (check["methods"].get("integrated") or {}).get("assessment")
    adjusted = next((stage for stage in ("analysis", "calibration") if stage in done), None)
    final = verdict or project_verdict(work, done)
    return {
        "schema": SCHEMA,
        "project": name,
        "work": str(work),
        "stages": [
            {
                "stage": result.name,
                "kept": result.kept,
                "seconds": round(result.seconds, 2),
                "adjustments": list(result.adjustments),
                "folder": str(result.folder),
            }
            for result in made
        ],
        "control": None if control is None else {key: control[key] for key in ("points", "marks")},
        "ppk": None if ppk is None else {key: ppk[key] for key in _PPK},
        "exposures": None if exposures is None else _exposures(exposures),
        "calibration": None if adjusted is None else _calibration(read_run(work / adjusted)),
        "check_points": None if check is None else _check_points(check),
        # Judgement of the integrated method, which is the product.
        "classes": None if check is None else assessed["standards"] if assessed else [],
        "warnings": [{"kind": kind(finding), **finding_json(finding, say)} for finding in gather(work, done)],
        "verdict": None if final is None else verdict_json(final, say),
        "certificate": str(work / "certificate") if "certificate" in done else None,
    }


def _exposures(figures: ExposureFigures) -> dict[str, Any]:
    cameras = figures.cameras
    return {
        "events": figures.events,
        "placed": figures.placed,
        "images": sum(camera.matched + len(camera.unmatched_images) for camera in cameras),
        "matched": sum(camera.matched for camera in cameras),
        "events_without_image": sum(len(camera.unmatched_events) for camera in cameras),
    }


def _calibration(run: AnalysedRun) -> dict[str, Any]:
    result = run.result
    return {
        "images": len(result.images),
        "observations": result.observations,
        "degrees_of_freedom": result.degrees_of_freedom,
        "sigma0_squared": result.sigma0_squared,
        "global_test_accepted": None if result.global_test is None else result.global_test.accepted,
        "cameras": {
            name: {
                "unit": camera.unit,
                "parameters": {
                    key: {
                        "value": camera.value(key),
                        "sigma": camera.sigma_of(key),
                        "stated": run.stated(name, key)[0],
                    }
                    for key in camera.free
                },
            }
            for name, camera in result.cameras.items()
        },
        "mounting": as_plain(result.mounting),
    }


def _check_points(check: dict[str, Any]) -> dict[str, Any]:
    return {
        name: {
            "n": method["check"]["n"],
            "rmse_m": method["check"]["rmse_m"],
            "predicted_m": _predicted(method["check"]["points"]),
            "errors_over_prediction": method["check"]["errors_over_prediction"],
        }
        for name, method in check["methods"].items()
    }


def _predicted(points: list[dict[str, Any]]) -> dict[str, float | None]:
    """Predicted RMSE of the differences: product and survey together."""
    if not points:
        return dict.fromkeys("XYZ")
    # Lower triangle, row by row: the variances stand at 0, 2 and 5.
    return {
        axis: math.sqrt(sum(point["covariance_m2"][k] for point in points) / len(points))
        for axis, k in zip("XYZ", (0, 2, 5), strict=True)
    }


def summary_text(figures: dict[str, Any], say: Catalogue | None = None, *, details: bool = False) -> str:
    """Write a summary for people.

    say: its language, English when none is given.
    details: all warnings and notes in full, beside the verdict.
    """
    say = say or catalogue("en")
    kept = sum(stage["kept"] for stage in figures["stages"])
    seconds = sum(stage["seconds"] for stage in figures["stages"] if not stage["kept"])
    made = len(figures["stages"]) - kept
    head = {"project": figures["project"], "made": made, "kept": kept, "work": figures["work"]}
    lines = [say("ran.head", seconds=say.fixed(seconds, 1), **head)]
    if figures["control"] is not None:
        points, marks = figures["control"]["points"], figures["control"]["marks"]
        lines.append(_line(say("ran.control"), say("ran.control_text", **points, **marks)))
    if figures["ppk"] is not None:
        p = figures["ppk"]
        fixed = say.fixed(p["fixed_percent"], 1)
        lines.append(_line(say("ran.ppk"), say("ran.ppk_text", **{**p, "fixed": fixed})))
    if figures["exposures"] is not None:
        e = figures["exposures"]
        text = say("ran.exposures_text", without=e["events_without_image"], **e)
        lines.append(_line(say("ran.exposures"), text))
    if figures["calibration"] is not None:
        lines += _calibration_lines(figures["calibration"], say)
    if figures["check_points"] is not None:
        lines += _check_lines(figures["check_points"], say)
    if figures["classes"]:
        lines += [
            _line(say("ran.class") if k == 0 else "", text)
            for k, text in enumerate(_class_texts(figures["classes"], say))
        ]
    # Before the block is analysed there is no verdict, and whatever was found stands for itself.
    if details or figures["verdict"] is None:
        lines += _warning_lines(figures["warnings"], figures["verdict"], say)
    if figures["certificate"] is not None:
        lines.append(certificate_line(figures, say))
    # Whoever reads one paragraph reads the last.
    if figures["verdict"] is not None:
        notes = sum(warning["kind"] == "note" for warning in figures["warnings"])
        lines += _verdict_lines(read_verdict(figures["verdict"], figures["work"]), notes, say)
    else:
        lines.append(_line(say("judgement.section").lower(), say("ran.no_verdict")))
    return "\n".join(lines)


def certificate_line(figures: dict[str, Any], say: Catalogue) -> str:
    """Say where the certificate of a project lies."""
    return _line(say("ran.certificate"), figures["certificate"])


def _verdict_lines(final: Verdict, notes: int, say: Catalogue) -> Iterator[str]:
    """The one verdict, and the number of notes."""
    paragraph, *said = verdict_text(final, say)
    says = [paragraph, *(f"* {line}" for line in said)]
    if notes:
        says.append(say("judgement.notes", n=notes))
    for k, text in enumerate(says):
        yield _line(say("judgement.section").lower() if k == 0 else "", text)


def _line(word: str, text: str) -> str:
    # Of the column of words.
    word_width = 14
    return f"{word:<{word_width}}{text}"


def _calibration_lines(figures: dict[str, Any], say: Catalogue) -> Iterator[str]:
    factor = figures["sigma0_squared"]
    shown = "" if factor is None else say("ran.residuals", factor=say.fixed(math.sqrt(factor), 3))
    counts = {key: figures[key] for key in ("images", "observations")}
    yield _line(say("ran.adjustment"), say("ran.adjustment_text", shown=shown, **counts))
    for name, camera in figures["cameras"].items():
        values = camera["parameters"]
        texts = [
            f"{key} {with_sigma(values[key]['value'], values[key]['stated']).replace('.', say.mark)}"
            for key in values
            if key in ("c", "x0", "y0")
        ]
        if texts:
            several = f"{name}: " if len(figures["cameras"]) > 1 else ""
            yield _line(say("ran.camera"), f"{several}{', '.join(texts)} {camera['unit']}")
    mounting = figures["mounting"]
    if mounting is None:
        return
    for word, names, unit in (("lever_arm", _LEVER, "m"), ("boresight", _BORESIGHT, "deg")):
        values = [mounting[key] for key in names]
        if any(value["estimated"] for value in values):
            both = (with_sigma(value["value"], value["sigma"]).replace(".", say.mark) for value in values)
            yield _line(say(f"ran.{word}"), f"{', '.join(both)} {unit}")
    offset = mounting["time_offset"]
    if offset["estimated"]:
        late = with_sigma(offset["value"] * 1e3, offset["sigma"] * 1e3).replace(".", say.mark)
        yield _line(say("ran.time_offset"), f"{late} ms")


def _check_lines(methods: dict[str, Any], say: Catalogue) -> Iterator[str]:
    if any(check["n"] for check in methods.values()):
        yield _line(say("ran.check_points"), say("ran.check_text"))
    for name, check in methods.items():
        if check["n"]:
            cells = ", ".join(
                f"{1e3 * check['rmse_m'][axis]:.0f}/{1e3 * check['predicted_m'][axis]:.0f}" for axis in "XYZ"
            )
            ratio = check["errors_over_prediction"]
            over = "" if ratio is None else say("ran.over", ratio=say.fixed(ratio, 2))
            row = say("ran.check_row", cells=cells, n=check["n"], over=over)
            yield _line(f"  {say(f'shown.{name}')}", row)


def _class_texts(standards: list[dict[str, Any]], say: Catalogue) -> Iterator[str]:
    for standard in standards:
        if "product" in standard:
            if standard["size"] is None:
                continue
            size = f"1:{standard['size']:g}" if standard["basis"] == "scale" else f"{standard['size']:g} m"
            kinds = ("accuracy", "precision")
            reached = {kind: standard[f"{kind}_class"] or say("shown.none") for kind in kinds}
            name = f"{standard['standard']} {standard['product']} {size}"
            yield say("ran.class_text", name=name, **reached)
        elif standard["horizontal"] is not None and standard["vertical"] is not None:
            axes = ("horizontal", "vertical")
            reached = {axis: say.fixed(standard[axis]["class_cm"], 1) for axis in axes}
            with_survey = all(standard["survey_included"][axis] for axis in axes)
            on = condition(standard["points"], standard["required_points"], with_survey, say)
            yield say("ran.class_value", name=standard["standard"], condition=on, **reached)


def _warning_lines(
    warnings: list[dict[str, Any]], final: dict[str, Any] | None, say: Catalogue
) -> Iterator[str]:
    for group in ("warning", "consequence", "note"):
        of_group = [warning for warning in warnings if warning["kind"] == group]
        texts = [
            f"{one.code}: {finding_text(one, say, plain)}"
            for one in by_methods(findings_of(of_group, SCHEMA))
        ]
        if not texts and group == "warning":
            # Nothing is called clean while the verdict is not.
            clean = final is None or final["severity"] == "passed"
            texts = [say("ran.clean" if clean else "ran.see_verdict")]
        for k, text in enumerate(texts):
            yield _line(say(f"ran.{group}s") if k == 0 else "", text)
