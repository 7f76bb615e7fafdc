"""Long study: of clean flights, how many get a grave, a doubtful or a noted cause, by both commands.

Writes `docs/evidence/clean_flights.md`. The flights are those of `tests.independent`, which shares no code
with the product: eleven designs, thirty flights of each. Whatever cause is named is invented. An image
without which the camera is not determined (`image-needed`) is counted by itself.

Run: `make evidence`, or `python -m tests.evidence.clean_flights`, in portions as `tests.evidence.portions`
says.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import astuple
from pathlib import Path
from typing import Any

from tests.evidence.hypotheses import LARGE
from tests.evidence.hypotheses_tables import COMMANDS, by_name, said
from tests.evidence.judging import judged
from tests.evidence.portions import outcomes
from tests.independent.faults import CLEAN
from tests.independent.flights import Errors
from tests.independent.rows import HARSH, Row

OUTPUT = Path(__file__).parents[2] / "docs" / "evidence" / "clean_flights.md"
DESIGNS = {design.name: design for design in CLEAN if design.images <= LARGE}
SEEDS = 30


def run(name: str, seed: int) -> Any:
    """Fly and judge one flight: the cells of its row."""
    return astuple(judged("clean", name, DESIGNS[name], Errors(), seed))


def tells(row: Row, wanted: Callable[[Any], bool]) -> bool:
    """Whether either command has such a finding."""
    return any(wanted(one) for command in COMMANDS for one in row.told(command))


def counts(rows: Sequence[Row]) -> tuple[int, ...]:
    """Flights: all, with something grave, grave or doubtful, a noted cause, an image that is needed."""
    return (
        len(rows),
        sum(tells(row, lambda one: one.severity in HARSH[:2]) for row in rows),
        sum(tells(row, lambda one: one.severity in HARSH) for row in rows),
        sum(tells(row, lambda one: one.is_cause and one.severity not in HARSH) for row in rows),
        sum(tells(row, lambda one: one.code == "image-needed") for row in rows),
    )


def page(rows: Sequence[Row]) -> str:
    """Write the page."""
    whole = counts(rows)
    lines = [
        "# Clean flights, judged by both commands",
        "",
        f"{len(rows)} flights of an independent simulator (`tests/independent`) in {len(DESIGNS)} designs,",
        "none with an error. A flight counts once, whether `photocal analyse` or `photocal check` reports",
        "the finding. Required: grave or doubtful findings in at most 2 % of the flights, a note that",
        "names a cause in at most 5 %.",
        "",
        "| design | flights | grave | grave or doubtful | a cause in a note | an image is needed |",
        "|---|---|---|---|---|---|",
        *(f"| {name} | {' | '.join(map(str, counts(of)))} |" for name, of in sorted(by_name(rows))),
        f"| **all** | {' | '.join(map(str, whole))} |",
        f"| share | | {' | '.join(f'{100 * n / max(len(rows), 1):.1f} %' for n in whole[1:])} |",
        "",
        f"Grave or doubtful findings: {said(rows)}.",
    ]
    return "\n".join(lines) + "\n"


def main() -> None:
    """Fly, judge, and write the page."""
    every = [(name, seed) for seed in range(SEEDS) for name in DESIGNS]
    found = outcomes(iter(every), len(every), run)
    OUTPUT.write_text(page([Row(*cells) for cells in found.values()]), encoding="utf-8")


if __name__ == "__main__":
    main()
