"""docs/faults.md, from the table of hypotheses: `python -m tests.docs` writes it anew."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from scipy import stats

from photocal.base.policy import policy
from photocal.findings.texts import catalogue
from photocal.hypotheses.faults import FAULTS
from photocal.hypotheses.table import SYMPTOMS, Fault

PAGE = Path(__file__).parents[2] / "docs" / "faults.md"
HEAD = """# Faults that are tested

Made from the table of faults (`photocal/hypotheses/table.py`) and its texts; [the guide](guide/warnings.md)
says what to do. A new fault is one entry in the table with its texts `term.CODE`, `finding.CODE` and, where
there is something to do, `remedy.CODE` in `findings_en.toml` and `findings_pt-BR.toml`.

| code | what is wrong | the search frees or adds | prior (m, rad, s, share of c) | what it looks like |
|---|---|---|---|---|
"""
# Of control by the coordinates that others check, and the share of cases.
REDUNDANCY, SHARES = (2, 3, 4, 6, 8, 12, 20, 30), (policy.power, 0.95)


def page() -> str:
    """Write the page."""
    symptoms = ", ".join(f"`{code}`" for code in SYMPTOMS)
    return (
        f"{HEAD}{''.join(map(_row, FAULTS))}\n"
        f"Symptoms of these faults, which disappear with them: {symptoms}.\n{_scatter()}"
    )


def found_factor(redundancy: float, share: float) -> float:
    """Give the factor of too small sigmas that a test of their v'Pv finds in a share of cases."""
    limit = stats.chi2.isf(policy.significance / 2.0, redundancy)
    return float(np.sqrt(limit / stats.chi2.ppf(1.0 - share, redundancy)))


def _scatter() -> str:
    """How wrong the sigmas of control must be to be found: what few coordinates can tell."""
    rows = "".join(
        f"| {r} | {' | '.join(f'{found_factor(r, share):.1f}' for share in SHARES)} |\n" for r in REDUNDANCY
    )
    example = float(np.hypot(2, 5) / 2)
    few, many = (_power(redundancy, example) for redundancy in (6, 12))
    return f"""
## Control that is worse than stated

v'Pv of an axis of control is judged against chi-squared (two-sided, {policy.significance:.1%}). The table
gives the factor by which the stated sigmas must be too small for this test alone to detect it. The redundancy
of an axis is the number of its coordinates minus the unknowns that they determine. Such control is not named
where a cause explains as much.

| redundancy | {" | ".join(f"found in {share:.0%}" for share in SHARES)} |
|---|---|---|
{rows}
Heights stated 2 cm that err by 5 cm more are wrong by the root of 2² + 5² over 2, {example:.1f}: of six
redundant ones the test finds that in {few:.0%} of cases, of twelve in {many:.0%}.
"""


def _power(redundancy: float, factor: float) -> float:
    limit = stats.chi2.isf(policy.significance / 2.0, redundancy)
    return float(stats.chi2.sf(limit / factor**2, redundancy))


def _row(one: Fault) -> str:
    each = {
        "strip": ", each strip",
        "one-strip": ", one strip",
        "part": ", before and after an image",
        "trend": ", and a trend of all positions",
    }.get(one.each, "")
    added = {
        "field": "a field of the image coordinates",
        "image": "the position of one image",
        "point": "the coordinates of control points, one or up to a third of them",
        "pair": "two control points that changed places",
    }.get(one.each, "-")
    frees = f"{', '.join(one.frees)}{each}" if one.frees else f"as `{one.kind_of}`" if one.kind_of else added
    prior = "-" if not one.frees else f"{one.prior:g}"
    like = (
        "everything else" if "*" in one.imitates else ", ".join(f"`{code}`" for code in one.imitates) or "-"
    )
    return f"| `{one.code}` | {catalogue('en')(f'term.{one.code}')} | {frees} | {prior} | {like} |\n"


def main() -> None:
    """Write it into docs."""
    PAGE.write_text(page(), encoding="utf-8")
