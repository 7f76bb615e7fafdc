"""docs/faults.md, from the table of hypotheses: `python -m tests.docs` writes it anew."""

from __future__ import annotations

from pathlib import Path

from photocal.findings.texts import catalogue
from photocal.hypotheses.table import FAULTS, SYMPTOMS, Fault

PAGE = Path(__file__).parents[2] / "docs" / "faults.md"
HEAD = """# Faults that are looked for

Made from the one table of them (`photocal/hypotheses/table.py`) and its texts; what to do stands in
[the guide](guide/warnings.md). A new fault is one entry there and its texts `term.CODE`, `finding.CODE` and,
where there is something to do, `remedy.CODE` in `findings_en.toml` and `findings_pt-BR.toml`.

| code | what is wrong | the search frees or adds | prior (m, rad, s, share of c) | what it looks like |
|---|---|---|---|---|
"""


def page() -> str:
    """Write the page."""
    symptoms = ", ".join(f"`{code}`" for code in SYMPTOMS)
    return f"{HEAD}{''.join(map(_row, FAULTS))}\nWhat follows of them and goes with them: {symptoms}.\n"


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
