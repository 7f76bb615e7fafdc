"""The analysis for a person."""

from __future__ import annotations

from photocal.analysis.camera_analysis import CameraAnalysis
from photocal.analysis.method import MethodCheck
from photocal.analysis.outcome import Outcome


def as_text(outcome: Outcome) -> str:
    """Turn an analysis into text.

    Parameters
    ----------
    outcome : Outcome
        The analysis.

    Returns
    -------
    str
        Findings first, worst first; then each camera; then the methods.
    """
    parts = [_findings(outcome)]
    cameras = outcome.search.first.network.cameras
    parts += [
        _camera(camera.id, camera.unit, one, outcome)
        for camera, one in zip(cameras, outcome.cameras, strict=True)
        if one is not None
    ]
    parts.append("\n".join(["Methods", *(_method(one) for one in outcome.methods)]))
    return "\n\n".join(parts)


def _findings(outcome: Outcome) -> str:
    if not outcome.findings:
        return "Hidden errors: none found"
    lines = [f"  {n}. {one.sentence}" for n, one in enumerate(outcome.findings, start=1)]
    return "\n".join(["Hidden errors, worst first", *lines])


def _camera(name: str, unit: str, one: CameraAnalysis, outcome: Outcome) -> str:
    lines = [f"Camera {name}: significance at {outcome.alpha:g}, effect over the format"]
    effects = {effect.parameters: effect for effect in one.effects}
    for test in one.tests:
        effect = effects.get(test.parameters)
        in_px = ""
        if effect is not None and test.kind != "cumulative":
            followed = f"{effect.remaining_largest_px:.2f} px when the others follow"
            in_px = f"   {effect.largest_px:.2f} px alone, {followed}"
        verdict = "significant" if test.significant else "NOT significant"
        lines.append(
            f"  {' '.join(test.parameters):<12}{test.kind:<11} F {test.statistic:>10.4g} against "
            f"{test.critical:.2f}  {verdict:<15}{in_px}".rstrip()
        )
    if one.correlations or one.exterior:
        lines.append(f"Camera {name}: correlations from {outcome.threshold:g}")
        lines += [f"  {p.first}-{p.second} {p.value:+.3f}: {p.cause}" for p in one.correlations]
        lines += [
            f"  {p.parameter}-{p.element} {p.value:+.3f} in image {p.image}, {p.images} image(s): {p.cause}"
            for p in one.exterior
        ]
    lines.append(f"Camera {name}: principal components")
    lines += [f"  {sentence}" for sentence in one.proposal.sentences]
    if one.left_out:
        lines.append(f"Camera {name}: adjusted anew without a parameter")
        for left in one.left_out:
            rmse = () if left.check_rmse_m is None else left.check_rmse_m
            at_checks = "".join(f" {each * 1000:.1f}" for each in rmse)
            lines.append(
                f"  {left.parameter:<3} c {left.c:.5g} {unit} ({left.change_of_c:+.3g}), a posteriori "
                f"variance factor {left.sigma0_squared:.4g}"
                + (f"; check points{at_checks} mm" if at_checks else "")
            )
    return "\n".join(lines)


def _method(one: MethodCheck) -> str:
    missing = [need for need in one.requirements if not need.met]
    if not missing:
        return f"  {one.method}: satisfied"
    wants = "; ".join(f"{need.name}: {need.found}, {need.needed} needed: {need.advice}" for need in missing)
    return f"  {one.method}: not satisfied: {wants}"
