"""The analysis of a run for a person at the terminal."""

import math
from typing import Any

import numpy as np

from photocal.analysis.components import Components
from photocal.analysis.lens_models import LensFit
from photocal.analysis.method import MethodCheck
from photocal.analysis.outcome import CameraAnalysis, Opinions, Outcome
from photocal.analysis.published import PublishedSet
from photocal.analysis.systematic_errors.refit import LeftOut
from photocal.base.arrays import as_plain
from photocal.findings.digits import Number
from photocal.findings.texts import Catalogue, finding_text, need_words, plain
from photocal.geometry.camera import Camera

SCHEMA = "photocal.published/1"


def analysis_text(outcome: Outcome, say: Catalogue) -> str:
    """Turn an analysis into text."""
    parts = [_findings(outcome, say)]
    for camera in outcome.search.first.network.cameras:
        judged = outcome.cameras[camera.id]
        if judged is not None:
            parts.append("\n".join(_camera(camera, judged, outcome, say)))
    parts.append("\n".join([say("console.methods"), *(_method(method, say) for method in outcome.methods)]))
    return "\n\n".join(parts)


def _findings(outcome: Outcome, say: Catalogue) -> str:
    if not outcome.findings:
        return say("analysis.hidden_none")
    lines = [
        f"  {n}. {finding_text(finding, say, plain)}" for n, finding in enumerate(outcome.findings, start=1)
    ]
    return "\n".join([say("analysis.hidden_first"), *lines])


def _camera(camera: Camera, judged: CameraAnalysis, outcome: Outcome, say: Catalogue) -> list[str]:
    name = camera.id
    lines = [say("console.camera", camera=name, alpha=_number(outcome.alpha, say)), *_tests(judged, say)]
    if judged.correlations or judged.correlations_with_exterior:
        threshold = _number(outcome.correlation_threshold, say)
        lines.append(say("console.correlations", camera=name, threshold=threshold))
    lines += [
        f"  {p.first}-{p.second} {_number(p.value, say):+.3f}: {say(f'cause.{p.cause}')}"
        for p in judged.correlations
    ]
    for p in judged.correlations_with_exterior:
        where = say("console.in_images", image=p.image, images=p.images)
        pair = f"{p.parameter}-{p.element} {_number(p.value, say):+.3f}"
        lines.append(f"  {pair} {where}: {say(f'cause.{p.cause}')}")
    lines.append(say("console.components", camera=name))
    lines += [f"  {finding_text(remark, say, plain)}" for remark in judged.components.remarks]
    return [
        *lines,
        *_left_out(camera, judged, say),
        *_lenses(camera, outcome, say),
        *_within(camera, judged, say),
        *_jackknife(camera, outcome.jackknife[name], say),
    ]


def _lenses(camera: Camera, outcome: Outcome, say: Catalogue) -> list[str]:
    fits = outcome.lens_models[camera.id]
    if len(fits) < 2:
        return []
    lines = [say("console.lenses", camera=camera.id)]
    for fit in fits:
        text = say(
            "console.lens",
            chi=_number(fit.chi_squared, say),
            left_out=_number(fit.left_out, say),
            change=_number(fit.change_of_c, say),
            unit=camera.unit,
        )
        lines.append(f"  {fit.model:<14} {' '.join(fit.terms)}: {text}{_checks(fit, say)}")
    return lines


def _checks(fit: LensFit | LeftOut, say: Catalogue) -> str:
    if fit.check_rmse_m is None:
        return ""
    x, y, z = (_number(1000.0 * float(v), say) for v in fit.check_rmse_m)
    return say("console.checks", x=x, y=y, z=z)


def _number(value: float, say: Catalogue) -> Number:
    return Number(value, say.mark)


def _tests(camera: CameraAnalysis, say: Catalogue) -> list[str]:
    lines = []
    effects = {effect.parameters: effect for effect in camera.effects}
    for test in camera.significance:
        effect = effects.get(test.parameters)
        in_px = ""
        if effect is not None and test.kind != "cumulative" and math.isfinite(effect.largest_px):
            alone, left = (_number(v, say) for v in (effect.largest_px, effect.remaining_largest_px))
            in_px = f"   {say('console.alone', alone=alone, remaining=left)}"
        verdict = say("console.is_significant" if test.significant else "console.not_significant")
        statistic = f"{format(_number(test.statistic, say), '.4g'):>10}"
        against = say("console.against", statistic=statistic, critical=_number(test.critical, say))
        head = f"  {' '.join(test.parameters):<12}{say(f'test.{test.kind}'):<11} F {against}"
        lines.append(f"{head}  {verdict:<17}{in_px}".rstrip())
    return lines


def _left_out(camera: Camera, judged: CameraAnalysis, say: Catalogue) -> list[str]:
    lines = [say("console.left_out", camera=camera.id)] if judged.left_out else []
    for left in judged.left_out:
        text = say(
            "console.without",
            c=_number(left.c, say),
            unit=camera.unit,
            change=_number(left.change_of_c, say),
            factor=_number(left.sigma0_squared, say),
        )
        lines.append(f"  {left.parameter:<3} {text}{_checks(left, say)}")
    return lines


def _within(camera: Camera, judged: CameraAnalysis, say: Catalogue) -> list[str]:
    """c, x0 and y0 in the thirds of the flight, against the first one."""
    lines = [say("console.within", camera=camera.id, unit=camera.unit)] if judged.within_flight else []
    for parameter in judged.within_flight:
        thirds = "; ".join(
            f"{_number(amount, say):+.3g} ± {_number(sigma, say):.2g}"
            for amount, sigma in parameter.parts[1:]
        )
        courses = "; ".join(
            say(f"course.{key}") + f" {_number(amount, say):+.3g} ± {_number(sigma, say):.2g}"
            for key, (amount, sigma, _) in parameter.drifts.items()
        )
        p = f"p = {_number(parameter.p_value, say):.2g}"
        lines.append(f"  {parameter.parameter:<3} {thirds} ({p}); {courses}")
    return lines


def _jackknife(camera: Camera, opinions: Opinions, say: Catalogue) -> list[str]:
    """Formal standard deviation of every parameter, and beside it what images tell of it."""
    beside = [opinions.formal, opinions.standard_error, opinions.sandwich]
    beside += [] if opinions.bootstrap is None else [opinions.bootstrap]
    lines = [
        f"  {name:<3} " + " / ".join(f"{_number(sigmas[name], say):.3g}" for sigmas in beside)
        for name in opinions.formal
    ]
    return [say("console.jackknife", camera=camera.id), *lines] if lines else []


def _method(method: MethodCheck, say: Catalogue) -> str:
    name = say(f"calibration_method.{method.method}")
    missing = [
        say("console.needs", **need_words(need.code, need.figures, say))
        for need in method.requirements
        if need.severity != "passed"
    ]
    if not missing:
        return f"  {name}: {say('analysis.satisfied')}"
    return f"  {name}: {say('analysis.not_satisfied')}: {'; '.join(missing)}"


def published_text(sets: tuple[PublishedSet, ...], say: Catalogue) -> str:
    """Write tests, strong correlations and principal components of every set."""
    return "\n\n".join("\n".join(_published_lines(published, say)) for published in sets)


def published_record(sets: tuple[PublishedSet, ...]) -> dict[str, Any]:
    """Give the same as plain values, ready for JSON; what is not known is null."""
    return {"schema": SCHEMA, "sets": [_published_record(published) for published in sets]}


def _published_lines(published: PublishedSet, say: Catalogue) -> list[str]:
    lines = [say("published.set", name=published.name)] if published.name else []
    for test in published.tests:
        verdict = say("console.is_significant" if test.significant else "console.not_significant")
        kind, critical = say(f"test.{test.kind}"), f"{test.critical:.2f}"
        lines.append(
            f"  {' '.join(test.parameters):<12}{kind:<11} F {test.statistic:>10.4g} / {critical}  {verdict}"
        )
    lines += [
        f"  {pair.first}-{pair.second} {pair.value:+.3f}: {say(f'cause.{pair.cause}')}"
        for pair in published.correlations
    ]
    return lines if published.components is None else [*lines, *_components_table(published.components, say)]


def _components_table(components: Components, say: Catalogue) -> list[str]:
    """Eigenvalues, their shares, and the correlation of each parameter with each component (MCCP)."""
    rows: list[tuple[str, np.ndarray[Any, Any], str]] = [
        (say("published.eigenvalue"), components.eigenvalues, ".4f"),
        (say("published.percent"), components.percent, ".2f"),
        (say("published.cumulative"), components.cumulative_percent, ".2f"),
        *((name, row, ".2f") for name, row in zip(components.names, components.loadings, strict=True)),
    ]
    width = max(len(label) for label, _, _ in rows)
    head = "".join(f"{f'Y{k}':>9}" for k in range(1, len(components.names) + 1))
    return [f"  {'':<{width}}{head}"] + [
        f"  {label:<{width}}{''.join(f'{value:>9{form}}' for value in values.tolist())}"
        for label, values, form in rows
    ]


def _published_record(published: PublishedSet) -> dict[str, Any]:
    shown = ("eigenvalues", "percent", "cumulative_percent", "loadings")
    return {
        "set": published.name or None,
        "parameters": list(published.estimates.names),
        "degrees_of_freedom": as_plain(published.degrees_of_freedom),
        "tests": as_plain(published.tests),
        "correlations": as_plain(published.correlations),
        "components": published.components
        and {key: as_plain(getattr(published.components, key)) for key in shown},
    }
