"""A block's check as text for the terminal."""

from __future__ import annotations

import math

import numpy as np

from photocal.accuracy.as_text import findings_text
from photocal.accuracy.discrepancies import SIGN
from photocal.findings.catalogue import catalogue
from photocal.findings.finding import verdict
from photocal.findings.texts import finding_text
from photocal.georeferencing.comparison import BlockCheck, Judged
from photocal.georeferencing.differences import Differences
from photocal.georeferencing.findings import block_findings, estimate_text
from photocal.georeferencing.standards_table import standards_rows


def to_text(check: BlockCheck) -> str:
    """Write a block's check for people: several lines, figures in m."""
    lines = [f"{check.block.name}: differences are {SIGN}, in metres; sigma is predicted, a priori."]
    lines.append(
        f"{'method':<12}{'points':<9}{'n':>4}  {'RMSE X':>9}{'Y':>9}{'Z':>9}   {'sigma X':>9}{'Y':>9}{'Z':>9}"
        f"   {'error/sigma':>11}"
    )
    for judged in check.judged:
        lines += [_row(judged, found) for found in (judged.check, judged.control) if found.names]
    lines += ["", *(f"{judged.found.label}" for judged in check.judged), ""]
    lines += _aligned(standards_rows(check))
    lines.append("")
    for judged in check.judged:
        lines += _points(judged)
    if check.exposures is not None:
        e = check.exposures
        angles = " ".join(f"{v:.4f}" for v in np.degrees(e.rmse[:3]))
        places = " ".join(f"{v:.3f}" for v in e.rmse[3:])
        lines.append(
            f"orientation, direct less indirect, RMSE over {e.images} images: "
            f"omega phi kappa {angles} deg, X Y Z {places} m\n"
        )
    if check.systematic is not None:
        lines += ["systematic errors, each freed alone:"]
        for one in check.systematic.tested:
            outcome = "significant" if one.significant else "not significant"
            figures = ", ".join(estimate_text(e) for e in one.estimates[:3])
            lines.append(f"  {one.name}: F {one.f:.1f} (limit {one.critical:.1f}), {outcome}; {figures}")
        lines += [f"  {text}" for text in check.systematic.untested] + [""]
    if check.systematic is not None and check.systematic.own:
        own = [
            f"  {estimate_text(e)}, {'significant' if e.significant else 'not significant'}"
            for e in check.systematic.own
        ]
        lines += ["left free in block.toml, estimated by the integrated method:", *own, ""]
    lines += [f"{method}: not possible: {reason}" for method, reason in check.refused]
    findings = block_findings(check)
    lines += [findings_text(findings), finding_text(verdict(findings), catalogue("en"))]
    return "\n".join(lines)


def _aligned(rows: list[list[str]]) -> list[str]:
    """Rows of cells as lines with columns as wide as they must be."""
    widths = [max(len(cell) for cell in column) + 3 for column in zip(*rows, strict=True)]
    return ["".join(f"{c:<{w}}" for c, w in zip(row, widths, strict=True)).rstrip() for row in rows]


def _row(judged: Judged, found: Differences) -> str:
    ratio = "-" if math.isnan(found.ratio) else f"{found.ratio:.2f}"
    left = f"{judged.found.method:<12}{found.role:<9}{len(found.names):>4}  "
    return (
        left
        + "".join(f"{v:9.4f}" for v in found.rmse)
        + "   "
        + "".join(f"{v:9.4f}" for v in found.predicted)
        + f"   {ratio:>11}"
    )


def _points(judged: Judged) -> list[str]:
    lines = []
    for found in (judged.check, judged.control):
        if not found.names:
            continue
        if found.joint is not None:
            one = found.joint
            pairs = zip("XYZ", one.mean, one.mean_sigma, strict=True)
            means = ", ".join(f"{axis} {mean:+.4f} +- {sigma:.4f}" for axis, mean, sigma in pairs)
            lines.append(
                f"{judged.found.method}, check points jointly: d' C^-1 d {one.chi_squared:.1f} over "
                f"{one.degrees_of_freedom} (p {one.p_value:.3f}); mean {means} (p {one.mean_p_value:.3f})"
            )
        lines.append(f"{judged.found.method}, {found.role} points: d, predicted sigma of the point, w")
        for name, d, s, w in zip(found.names, found.d, found.product_sigma, found.w, strict=True):
            tested = " ".join("     -" if math.isnan(x) else f"{x:6.2f}" for x in w.tolist())
            lines.append(
                f"  {name:<12}"
                + " ".join(f"{x:+9.4f}" for x in d.tolist())
                + "   "
                + " ".join(f"{x:8.4f}" for x in s.tolist())
                + f"   {tested}"
            )
    return [*lines, ""] if lines else []
