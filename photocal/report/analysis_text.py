"""The analysis of a run for a person at the terminal."""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from drivers.arrays import as_plain
from photocal.analysis.components import Components
from photocal.analysis.method import MethodCheck
from photocal.analysis.outcome import CameraAnalysis, Outcome
from photocal.analysis.published import PublishedSet
from photocal.findings.digits import Number
from photocal.findings.texts import Catalogue, finding_text, need_words, plain
from photocal.geometry.camera import PARAMETERS


def analysis_text(outcome: Outcome, say: Catalogue) -> str:
    """Turn an analysis into text."""
    parts = [_findings(outcome, say)]
    for k, one in enumerate(outcome.cameras):
        if one is not None:
            parts.append("\n".join(_camera(k, one, outcome, say)))
    parts.append("\n".join([say("console.methods"), *(_method(one, say) for one in outcome.methods)]))
    return "\n\n".join(parts)


def _findings(outcome: Outcome, say: Catalogue) -> str:
    if not outcome.findings:
        return say("analysis.hidden_none")
    lines = [f"  {n}. {finding_text(one, say, plain)}" for n, one in enumerate(outcome.findings, start=1)]
    return "\n".join([say("analysis.hidden_first"), *lines])


def _camera(k: int, one: CameraAnalysis, outcome: Outcome, say: Catalogue) -> list[str]:
    name = outcome.search.first.network.cameras[k].id
    lines = [say("console.camera", camera=name, alpha=_number(outcome.alpha, say)), *_tests(one, say)]
    if one.correlations or one.exterior:
        lines.append(say("console.correlations", camera=name, threshold=_number(outcome.threshold, say)))
    lines += [
        f"  {p.first}-{p.second} {_number(p.value, say):+.3f}: {say(f'cause.{p.cause}')}"
        for p in one.correlations
    ]
    for p in one.exterior:
        where = say("console.in_images", image=p.image, images=p.images)
        pair = f"{p.parameter}-{p.element} {_number(p.value, say):+.3f}"
        lines.append(f"  {pair} {where}: {say(f'cause.{p.cause}')}")
    lines.append(say("console.components", camera=name))
    lines += [f"  {finding_text(remark, say, plain)}" for remark in one.proposal.findings]
    return [
        *lines,
        *_left_out(k, one, outcome, say),
        *_lenses(k, outcome, say),
        *_within(k, one, outcome, say),
        *_jackknife(k, outcome, say),
    ]


def _lenses(k: int, outcome: Outcome, say: Catalogue) -> list[str]:
    fits, camera = outcome.lenses[k], outcome.search.first.network.cameras[k]
    lines = [say("console.lenses", camera=camera.id)] if len(fits) > 1 else []
    for one in fits if len(fits) > 1 else ():
        text = say(
            "console.lens",
            chi=_number(one.chi_squared, say),
            left_out=_number(one.left_out, say),
            change=_number(one.change_of_c, say),
            unit=camera.unit,
        )
        if one.check_rmse_m is not None:
            x, y, z = (_number(1000.0 * v, say) for v in one.check_rmse_m)
            text += say("console.checks", x=x, y=y, z=z)
        lines.append(f"  {one.model:<14} {' '.join(one.terms)}: {text}")
    return lines


def _number(value: float, say: Catalogue) -> Number:
    return Number(value, say.mark)


def _tests(one: CameraAnalysis, say: Catalogue) -> list[str]:
    lines = []
    effects = {effect.parameters: effect for effect in one.effects}
    for test in one.tests:
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


def _left_out(k: int, one: CameraAnalysis, outcome: Outcome, say: Catalogue) -> list[str]:
    camera = outcome.search.first.network.cameras[k]
    lines = [say("console.left_out", camera=camera.id)] if one.left_out else []
    for left in one.left_out:
        said = say(
            "console.without",
            c=_number(left.c, say),
            unit=camera.unit,
            change=_number(left.change_of_c, say),
            factor=_number(left.sigma0_squared, say),
        )
        if left.check_rmse_m is not None:
            x, y, z = (_number(1000.0 * float(v), say) for v in left.check_rmse_m)
            said += say("console.checks", x=x, y=y, z=z)
        lines.append(f"  {left.parameter:<3} {said}")
    return lines


def _within(k: int, one: CameraAnalysis, outcome: Outcome, say: Catalogue) -> list[str]:
    """c, x0 and y0 in the thirds of the flight, against the first one."""
    camera = outcome.search.first.network.cameras[k]
    lines = [say("console.within", camera=camera.id, unit=camera.unit)] if one.within else []
    for parameter in one.within:
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


def _jackknife(k: int, outcome: Outcome, say: Catalogue) -> list[str]:
    """Formal standard deviation of every parameter, and beside it what images tell of it."""
    search, camera = outcome.search, outcome.search.first.network.cameras[k]
    beside = [
        np.sqrt(np.diag(search.first.solution.camera_covariance[k])),
        search.jackknife_first.standard_error[k],
        outcome.robust.sandwich[k],
    ]
    beside += [] if outcome.robust.bootstrap is None else [outcome.robust.bootstrap[k]]
    lines = [
        f"  {PARAMETERS[i]:<3} " + " / ".join(f"{_number(float(one[i]), say):.3g}" for one in beside)
        for i in np.flatnonzero(camera.estimated)
    ]
    return [say("console.jackknife", camera=camera.id), *lines] if lines else []


def _method(one: MethodCheck, say: Catalogue) -> str:
    name = say(f"calibration_method.{one.method}")
    missing = [
        say("console.needs", **need_words(need.code, need.figures, say))
        for need in one.requirements
        if need.severity != "passed"
    ]
    if not missing:
        return f"  {name}: {say('analysis.satisfied')}"
    return f"  {name}: {say('analysis.not_satisfied')}: {'; '.join(missing)}"


SCHEMA = "photocal.published/1"


def published_text(sets: tuple[PublishedSet, ...], say: Catalogue) -> str:
    """Write tests, strong correlations and principal components of every set."""
    return "\n\n".join("\n".join(_published_lines(one, say)) for one in sets)


def published_record(sets: tuple[PublishedSet, ...]) -> dict[str, Any]:
    """Give the same as plain values, ready for JSON; what is not known is null."""
    return {"schema": SCHEMA, "sets": [_published_record(one) for one in sets]}


def _published_lines(one: PublishedSet, say: Catalogue) -> list[str]:
    lines = [say("published.set", name=one.name)] if one.name else []
    for test in one.tests:
        verdict = say("console.is_significant" if test.significant else "console.not_significant")
        kind, critical = say(f"test.{test.kind}"), f"{test.critical:.2f}"
        lines.append(
            f"  {' '.join(test.parameters):<12}{kind:<11} F {test.statistic:>10.4g} / {critical}  {verdict}"
        )
    lines += [
        f"  {pair.first}-{pair.second} {pair.value:+.3f}: {say(f'cause.{pair.cause}')}"
        for pair in one.correlations
    ]
    return lines if one.components is None else [*lines, *_components_table(one.components, say)]


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


def _published_record(one: PublishedSet) -> dict[str, Any]:
    shown = ("eigenvalues", "percent", "cumulative_percent", "loadings")
    return {
        "set": one.name or None,
        "parameters": list(one.estimates.names),
        "degrees_of_freedom": as_plain(one.degrees_of_freedom),
        "tests": as_plain(one.tests),
        "correlations": as_plain(one.correlations),
        "components": one.components and {key: as_plain(getattr(one.components, key)) for key in shown},
    }
