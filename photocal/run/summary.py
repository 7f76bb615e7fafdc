"""What a run has found, on one screen and as JSON."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

from photocal.findings.catalogue import catalogue
from photocal.findings.texts import finding_json
from photocal.report.stored_analysis import Run, read_run
from photocal.run.stage import StageResult
from photocal.run.warnings import gather, kind, project_verdict, read_json

SCHEMA = "photocal.run/1"
_WORD = 14
_LEVER = ("lever_arm_x", "lever_arm_y", "lever_arm_z")
_BORESIGHT = ("boresight_x", "boresight_y", "boresight_z")


def summary(name: str, work: Path, made: Sequence[StageResult]) -> dict[str, Any]:
    """Collect the figures of the stages."""
    done, say = {one.name for one in made}, catalogue("en")

    def figures(stage: str, file: str) -> dict[str, Any] | None:
        return read_json(work / stage / file) if stage in done else None

    ppk, exposures = figures("ppk", "ppk.json"), figures("exposures", "exposures.json")
    check = figures("georeferencing", "check.json")
    adjusted = next((one for one in ("analysis", "calibration") if one in done), None)
    final = project_verdict(work, done)
    return {
        "schema": SCHEMA,
        "project": name,
        "work": str(work),
        "stages": [
            {"stage": one.name, "kept": one.kept, "seconds": round(one.seconds, 2), "folder": str(one.folder)}
            for one in made
        ],
        "ppk": None if ppk is None else _ppk(ppk),
        "exposures": None if exposures is None else _exposures(exposures),
        "calibration": None if adjusted is None else _calibration(read_run(work / adjusted)),
        "check_points": None if check is None else _check_points(check),
        "classes": None if check is None else _classes(check),
        "warnings": [{"kind": kind(one), **finding_json(one, say)} for one in gather(work, done)],
        "verdict": None if final is None else finding_json(final, say),
        "certificate": str(work / "certificate") if "certificate" in done else None,
    }


def _ppk(figures: dict[str, Any]) -> dict[str, Any]:
    return {key: figures[key] for key in ("epochs", "fixed", "float", "single", "fixed_percent")}


def _exposures(figures: dict[str, Any]) -> dict[str, Any]:
    cameras = figures["cameras"]
    return {
        "events": figures["events"],
        "placed": figures["placed"],
        "images": sum(one["matched"] + len(one["unmatched_images"]) for one in cameras),
        "matched": sum(one["matched"] for one in cameras),
        "events_without_image": sum(len(one["unmatched_events"]) for one in cameras),
    }


def _calibration(run: Run) -> dict[str, Any]:
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
        "mounting": None
        if result.mounting is None
        else {key: dict(vars(value)) for key, value in result.mounting.items()},
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
        axis: math.sqrt(sum(one["covariance_m2"][k] for one in points) / len(points))
        for axis, k in zip("XYZ", (0, 2, 5), strict=True)
    }


def _classes(check: dict[str, Any]) -> list[dict[str, Any]]:
    """Judgement of the integrated method, which is the product."""
    assessment = (check["methods"].get("integrated") or {}).get("assessment")
    return [] if assessment is None else list(assessment["standards"])


def summary_text(figures: dict[str, Any]) -> str:
    """Write a summary for people."""
    kept = sum(one["kept"] for one in figures["stages"])
    seconds = sum(one["seconds"] for one in figures["stages"] if not one["kept"])
    made = len(figures["stages"]) - kept
    lines = [f"{figures['project']}: {made} stages made in {seconds:.1f} s, {kept} kept; {figures['work']}"]
    if figures["ppk"] is not None:
        p = figures["ppk"]
        rest = f"{p['float']} float, {p['single']} single"
        lines.append(_line("PPK", f"{p['fixed_percent']:.1f} % of {p['epochs']} epochs fixed, {rest}"))
    if figures["exposures"] is not None:
        e = figures["exposures"]
        rest = (
            f"{e['placed']} of {e['events']} events with position, {e['events_without_image']} without image"
        )
        lines.append(_line("exposures", f"{e['matched']} of {e['images']} images matched; {rest}"))
    if figures["calibration"] is not None:
        lines += _calibration_lines(figures["calibration"])
    if figures["check_points"] is not None:
        lines += _check_lines(figures["check_points"])
    if figures["classes"]:
        lines += [
            _line("class" if k == 0 else "", text) for k, text in enumerate(_class_texts(figures["classes"]))
        ]
    lines += _warning_lines(figures["warnings"], figures["verdict"])
    if figures["verdict"] is not None:
        lines.append(_line("verdict", figures["verdict"]["text"].partition(": ")[2]))
    if figures["certificate"] is not None:
        lines.append(_line("certificate", figures["certificate"]))
    # Whoever reads one line reads the last.
    first = next((one for one in figures["warnings"] if one["kind"] == "warning"), None)
    if first is not None:
        lines.append(_line("look at first", f"{first['code']}: {first['text']}"))
    return "\n".join(lines)


def _line(word: str, text: str) -> str:
    return f"{word:<{_WORD}}{text}"


def _calibration_lines(figures: dict[str, Any]) -> Iterator[str]:
    factor = figures["sigma0_squared"]
    shown = "" if factor is None else f", residuals {math.sqrt(factor):.3f} times the stated sigmas"
    yield _line("adjustment", f"{figures['images']} images, {figures['observations']} observations{shown}")
    for name, camera in figures["cameras"].items():
        values = camera["parameters"]
        texts = [
            f"{key} {with_sigma(values[key]['value'], values[key]['stated'])}"
            for key in values
            if key in ("c", "x0", "y0")
        ]
        if texts:
            yield _line(f"camera {name}"[: _WORD - 1], ", ".join(texts) + f" {camera['unit']}")
    mounting = figures["mounting"]
    if mounting is None:
        return
    for word, names, unit in (("lever arm", _LEVER, "m"), ("boresight", _BORESIGHT, "deg")):
        values = [mounting[key] for key in names]
        if any(one["estimated"] for one in values):
            yield _line(
                word, ", ".join(with_sigma(one["value"], one["sigma"]) for one in values) + f" {unit}"
            )
    offset = mounting["time_offset"]
    if offset["estimated"]:
        yield _line("time offset", f"{with_sigma(offset['value'] * 1e3, offset['sigma'] * 1e3)} ms")


def _check_lines(methods: dict[str, Any]) -> Iterator[str]:
    if any(one["n"] for one in methods.values()):
        yield _line("check points", "RMSE in X, Y, Z / predicted with the survey's own sigma, mm")
    for name, one in methods.items():
        if one["n"]:
            cells = ", ".join(
                f"{1e3 * one['rmse_m'][axis]:.0f}/{1e3 * one['predicted_m'][axis]:.0f}" for axis in "XYZ"
            )
            ratio = one["errors_over_prediction"]
            over = "" if ratio is None else f"; errors {ratio:.2f} times the prediction"
            yield _line(f"  {name}", f"{cells} at {one['n']} points{over}")


def _class_texts(standards: list[dict[str, Any]]) -> Iterator[str]:
    for one in standards:
        if "product" in one:
            if one["size"] is None:
                continue
            size = f"1:{one['size']:g}" if one["basis"] == "scale" else f"{one['size']:g} m"
            classes = (
                f"accuracy {one['accuracy_class'] or 'none'}, precision {one['precision_class'] or 'none'}"
            )
            yield f"{one['standard']} {one['product']} {size}: {classes}"
        elif one["horizontal"] is not None and one["vertical"] is not None:
            yield (
                f"{one['standard']}: horizontal {one['horizontal']['class_cm']} cm, "
                f"vertical {one['vertical']['class_cm']} cm"
            )


def _warning_lines(warnings: list[dict[str, str]], final: dict[str, Any] | None) -> Iterator[str]:
    for group in ("warning", "consequence", "note"):
        texts = [f"{one['code']}: {one['text']}" for one in warnings if one["kind"] == group]
        if not texts and group == "warning":
            # Nothing is called clean while the verdict is not.
            texts = ["none"] if final is None or final["severity"] == "passed" else ["see the verdict"]
        for k, text in enumerate(texts):
            yield _line(f"{group}s" if k == 0 else "", text)


def with_sigma(value: float, sigma: float) -> str:
    """Write a value and its standard deviation with two significant digits of the latter."""
    digits = max(0, 1 - math.floor(math.log10(sigma))) if sigma > 0 else 4
    return f"{value:.{digits}f} +- {sigma:.{digits}f}"
