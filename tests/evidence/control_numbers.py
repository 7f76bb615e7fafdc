"""Study: errors at check points against the number of control points, predicted and seen.

Writes `docs/evidence/control-numbers.md`. Simulated flights at two heights whose observations have random
errors of the stated size; `control_numbers` judges each with 0, 1, 3, 5 and all but one of its points.

Run: `make evidence`, or `python -m tests.evidence.control_numbers [FLIGHTS]`.
"""

from __future__ import annotations

import sys
import tempfile
from pathlib import Path

import numpy as np

from photocal.analysis.georeferencing.experiment import control_numbers
from photocal.block.folder import read_block
from tests.photocal.analysis.georeferencing.flights import Errors, Plan, fly

OUTPUT = Path(__file__).parents[2] / "docs" / "evidence" / "control-numbers.md"
PLAN = Plan(tie=40, control=5, check=7, estimate=("c", "x0", "y0", "K1", "K2"))


def main(flights: int = 12) -> None:
    """Fly, count and write the page."""
    errors: dict[str, list[tuple[int, float]]] = {}
    rmse: dict[str, list[tuple[float, float]]] = {}
    for seed in range(flights):
        with tempfile.TemporaryDirectory() as scratch:
            fly(Path(scratch) / "block", np.random.default_rng(seed), Errors(), PLAN)
            numbers = control_numbers(read_block(Path(scratch) / "block"), seed=seed)[1]["numbers"]
        for row in numbers:
            name = str(row["control"])
            errors.setdefault(name, []).append((3 * row["errors"], row["within_95_percent"]))
            seen, predicted = (
                float(np.linalg.norm(list(row[k].values()))) for k in ("rmse_m", "predicted_m")
            )
            rmse.setdefault(name, []).append((seen, predicted))
    total = [pair for rows in errors.values() for pair in rows]
    lines = [
        "# Number of control points",
        "",
        f"Made by `python -m tests.evidence.control_numbers`: {flights} simulated flights with",
        f"{PLAN.control + PLAN.check} surveyed points each, and several choices of control points for each",
        f"number. Of {sum(n for n, _ in total)} errors **{100 * _share(total):.1f} %** lie within their",
        "predicted 95 % interval.",
        "",
        "| control points | errors | within 95 % | RMSE seen, mm (3-D) | predicted, mm |",
        "|---|---|---|---|---|",
    ]
    for name, rows in errors.items():
        seen, predicted = (1e3 * float(np.sqrt(np.mean(np.square(v)))) for v in zip(*rmse[name], strict=True))
        count, share = sum(n for n, _ in rows), 100 * _share(rows)
        lines.append(f"| {name} | {count} | {share:.1f} % | {seen:.1f} | {predicted:.1f} |")
    OUTPUT.write_text("\n".join(lines) + "\n", encoding="utf-8")


def _share(rows: list[tuple[int, float]]) -> float:
    return sum(n * share for n, share in rows) / sum(n for n, _ in rows)


if __name__ == "__main__":
    main(*(int(one) for one in sys.argv[1:]))
