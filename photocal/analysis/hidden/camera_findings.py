"""Findings about cameras: extra parameters, assumed sigma, bias of c, significance, stability."""

from __future__ import annotations

import numpy as np

from photocal.analysis.estimates import Estimates, scaled
from photocal.analysis.hidden.extra_parameter import ExtraParameter
from photocal.analysis.hidden.finding import SMALL_PX, SMALL_SIGMAS, Finding, ground_effect, metres
from photocal.analysis.hidden.refit import Fit
from photocal.analysis.hidden.search import LEVEL, Round, Search, camera_estimates
from photocal.analysis.significance import f_test
from photocal.geometry.camera import PARAMETERS, Camera

# A jackknife error of a parameter this many times its formal one is worth a line.
UNSTABLE = 3.0
# Less than this is no wrong sigma: `brown-observed` alone stretches the noise at the edge by some percent.
WRONG_SIGMA = 0.10
ALPHA = 0.10


def of_round(one: Round) -> Finding:
    """Describe an error that was found and corrected.

    Parameters
    ----------
    one : Round
        The error.

    Returns
    -------
    Finding
        One line.
    """
    parameter, camera = one.parameter, one.before.network.cameras[one.parameter.candidate.camera]
    change = float(
        one.before.solution.cameras[parameter.candidate.camera, 0]
        - one.after.solution.cameras[parameter.candidate.camera, 0]
    )
    sigma_c = float(np.sqrt(one.before.solution.camera_covariance[parameter.candidate.camera, 0, 0]))
    small = parameter.effect_px < SMALL_PX and abs(change) < SMALL_SIGMAS * sigma_c
    figure, unit, text = _figure(parameter, camera)
    ground = ground_effect(one.before, parameter.candidate.camera, change)
    sentence = (
        f"Camera {camera.id}: {text}; up to {parameter.effect_px:.2f} px in the image "
        f"(F = {parameter.statistic:.0f})"
    )
    if change:
        sentence += f", it shifts c by {change:+.3g} {camera.unit} and heights by {metres(ground)}"
    if parameter.alike:
        sentence += f"; {' and '.join(parameter.alike)} would explain it as well"
    return Finding(
        parameter.candidate.kind,
        sentence + (": small." if small else "."),
        figure,
        parameter.sigma,
        unit,
        change,
        ground,
        parameter.effect_px,
        small,
    )


def _figure(parameter: ExtraParameter, camera: Camera) -> tuple[float, str, str]:
    candidate = parameter.candidate
    if candidate.kind == "y-scale":
        factor = 1.0 + parameter.amount
        return (
            factor,
            "1",
            f"y scale factor {factor:.5f} +- {parameter.sigma:.5f}{_pixel_ratio(parameter, camera)}",
        )
    if candidate.kind == "rolling-shutter":
        text = f"{candidate.name}: the rows are read in {parameter.amount:.3g} of the exposure interval"
        return parameter.amount, "exposure intervals", text
    if candidate.kind == "shear":
        text = f"{candidate.name} {parameter.amount:.2e} +- {parameter.sigma:.1e}"
        return parameter.amount, "1", text
    text = f"{candidate.name} is missing from the model, {parameter.amount:.3g} +- {parameter.sigma:.2g}"
    return parameter.amount, f"powers of {camera.unit}", text


def _pixel_ratio(parameter: ExtraParameter, camera: Camera) -> str:
    ratio = camera.pitch[0] / camera.pitch[1]
    if ratio != 1.0 and abs(1.0 + parameter.amount - ratio) < 3.0 * parameter.sigma:
        return (
            f", the ratio of the two pixel pitches {camera.pitch[0]:.7g} and {camera.pitch[1]:.7g} mm: "
            "the pixels are square and the image was scaled to a rounded format"
        )
    return ": x and y were scaled differently"


def of_sigma(search: Search) -> list[Finding]:
    """Describe the assumed standard deviation of the image coordinates, when it is wrong.

    Parameters
    ----------
    search : Search
        What was found.

    Returns
    -------
    list of Finding
        No line, or one for each that is concerned.
    """
    sigma = search.sigma
    if sigma.p_value >= LEVEL or abs(sigma.found / sigma.assumed - 1.0) < WRONG_SIGMA:
        return []
    camera = search.last.network.cameras[0]
    scale, unit = (1000.0, "um") if camera.unit == "mm" else (1.0, "px")
    ratio = sigma.found / sigma.assumed
    honest = "the precisions are too good" if ratio > 1.0 else "the precisions are too poor"
    hidden = " and the global test could not see what is listed here" if ratio < 1.0 and search.rounds else ""
    # Residuals are smaller than errors: their rms is the plain figure where too much was assumed, but only
    # the one that counts the redundancy can show that too little was.
    figure = sigma.rms if ratio < 1.0 else sigma.found
    by = f"rms of the residuals; sigma {sigma.found * scale:.2f} {unit} by their redundancy"
    how = by if ratio < 1.0 else "by the residuals and their redundancy"
    sentence = (
        f"Image coordinates: sigma {sigma.assumed * scale:.3g} {unit} was assumed where "
        f"{figure * scale:.2g} {unit} is found ({how}, {sigma.lower * scale:.2f} to "
        f"{sigma.upper * scale:.2f} at 95 %): {honest}{hidden}."
    )
    return [
        Finding(
            "observation-sigma",
            sentence,
            figure * scale,
            (sigma.upper - sigma.lower) / 4.0 * scale,
            unit,
            0.0,
            0.0,
            figure / min(camera.pitch),
            ratio < 1.2 and not search.rounds,
        )
    ]


def of_bias(search: Search) -> list[Finding]:
    """Describe the bias of every c, when it is beyond its precision.

    Parameters
    ----------
    search : Search
        What was found.

    Returns
    -------
    list of Finding
        No line, or one for each that is concerned.
    """
    if not search.rounds:
        return []
    listed = []
    for k, camera in enumerate(search.first.network.cameras):
        before, after = search.first.solution.cameras[k, 0], search.last.solution.cameras[k, 0]
        sigma = float(np.sqrt(search.first.solution.camera_covariance[k, 0, 0]))
        bias = float(before - after)
        if not sigma > 0.0 or abs(bias) < SMALL_SIGMAS * sigma:
            continue
        ground = ground_effect(search.first, k, bias)
        sentence = (
            f"Camera {camera.id}: c is biased by {bias:+.3f} {camera.unit} ({before:.4f} adjusted, "
            f"{after:.4f} corrected; {abs(bias) / sigma:.1f} formal standard deviations): "
            f"heights are wrong by {metres(ground)} at the distance of this block, {abs(bias) / after:.2%} "
            "of any distance."
        )
        listed.append(Finding("c-bias", sentence, bias, sigma, camera.unit, bias, ground, None, False))
    return listed


def of_significance(search: Search) -> list[Finding]:
    """Name the parameters whose significance changes with the corrections.

    Parameters
    ----------
    search : Search
        What was found.

    Returns
    -------
    list of Finding
        No line, or one for each that is concerned.
    """
    if not search.rounds:
        return []
    listed = []
    for k, camera in enumerate(search.first.network.cameras):
        before, after = _honest(search.first, k), _honest(search.last, k)
        redundancy = search.last.solution.degrees_of_freedom
        for name in before.names:
            was = f_test(before, (name,), redundancy, ALPHA)
            now = f_test(after, (name,), redundancy, ALPHA)
            if was.significant == now.significant:
                continue
            at = after.names.index(name)
            value, sigma = float(after.values[at]), float(after.sigmas[at])
            verdict = "not significant" if was.significant else "significant"
            sentence = (
                f"Camera {camera.id}: {name} is {verdict} once corrected ({value:.3g} +- {sigma:.2g}, F = "
                f"{now.statistic:.1f} against {now.critical:.2f}; before, F = {was.statistic:.1f})."
            )
            unit = f"powers of {camera.unit}"
            listed.append(
                Finding("significance", sentence, now.statistic, None, unit, None, None, None, False)
            )
    return listed


def of_jackknife(search: Search) -> list[Finding]:
    """Describe parameters that hang on single images.

    Parameters
    ----------
    search : Search
        What was found.

    Returns
    -------
    list of Finding
        No line, or one for each that is concerned.
    """
    listed = []
    for k, camera in enumerate(search.first.network.cameras):
        formal = np.sqrt(np.diag(search.first.solution.camera_covariance[k])) * np.sqrt(_factor(search.first))
        before = search.jackknife_first.standard_error[k]
        ratio = np.divide(before, formal, out=np.zeros_like(before), where=formal > 0.0)
        if not np.any(ratio > UNSTABLE):
            continue
        worst = 0 if ratio[0] > UNSTABLE else int(np.nanargmax(ratio))
        after = search.jackknife_last.standard_error[k]
        name = PARAMETERS[worst]
        then = f", by {after[worst]:.2g} once corrected" if search.rounds else ""
        sentence = (
            f"Camera {camera.id}: leaving out one image at a time moves {name} by {before[worst]:.2g} "
            f"{camera.unit} (jackknife standard error){then}; the formal standard deviation is "
            f"{formal[worst]:.2g}."
        )
        effect = float(before[0]) if worst == 0 else None
        ground = ground_effect(search.first, k, effect) if effect is not None else None
        listed.append(
            Finding(
                "jackknife", sentence, float(before[worst]), None, camera.unit, effect, ground, None, False
            )
        )
    return listed


def _factor(fitted: Fit) -> float:
    """Give the variance factor for judging: a posteriori, but never below 1.

    Where the residuals are smaller than assumed the formal precision would become better than the one that
    was promised, while hidden errors show in the parameters and not in the residuals.
    """
    return max(1.0, fitted.solution.variance_factor)


def _honest(fitted: Fit, camera: int) -> Estimates:
    return scaled(camera_estimates(fitted, camera), _factor(fitted))
