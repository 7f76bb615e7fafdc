"""How much control a flight needs: the adjustment with none, some and nearly all points as control.

Every other surveyed point is a check point then. For each number several choices are made, the first spread
over the block, the others at random; with all points but one, each is left out once.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from typing import Any

import numpy as np

from drivers.arrays import Floats
from drivers.errors import ConfigurationError
from photocal.block.model import Block
from photocal.georeferencing.experiment import (
    Experiment,
    Outcome,
    Pattern,
    run_experiment,
    spread_points,
)
from photocal.georeferencing.methods import Method, ground_points

SCHEMA = "photocal.control-numbers/1"
COUNTS = (0, 1, 3, 5)
CHOICES = 6
# Errors predicted with this probability: 1.96 standard deviations.
COVERED = 0.95
_TIMES = 1.959964
# More control is said to be worth while where it lowers what is predicted by more than this.
WORTH = 0.1


def control_numbers(
    block: Block, counts: Iterable[int] = COUNTS, seed: int = 0, done: Callable[[], None] = lambda: None
) -> tuple[Outcome, dict[str, Any]]:
    """Repeat the adjustment with several numbers of control points.

    raises ConfigurationError: with fewer than two surveyed points.
    """
    surveyed = ground_points(block)
    usable = surveyed[np.isfinite(block.points.sigma[surveyed]).all(axis=1)]
    if len(usable) < 2:
        raise ConfigurationError(
            f"{len(usable)} surveyed points with sigmas cannot judge each other",
            remedy="survey more points, and give sX, sY, sZ of check points, too",
        )
    observed = len(block.positions.image) or np.isfinite(block.images.sigma[:, 3:]).any()
    method: Method = "integrated" if observed else "indirect"
    patterns: list[Pattern] = []
    random = np.random.default_rng(seed)
    for count in sorted({n for n in counts if 0 <= n < len(usable) - 1}):
        chosen = [spread_points(block, usable, count)] if count else [usable[:0]]
        chosen += [random.choice(usable, count, replace=False) for _ in range(CHOICES - 1 if count else 0)]
        patterns += [(f"{count} control", np.sort(points)) for points in chosen]
    patterns += [("all but one", usable[usable != point]) for point in usable]
    outcome = run_experiment(Experiment(block, (method,), patterns=tuple(patterns)), done)
    return outcome, {
        "schema": SCHEMA,
        "method": method,
        "points": len(usable),
        "numbers": _by_number(outcome),
    }


def _by_number(outcome: Outcome) -> list[dict[str, Any]]:
    rows = []
    for count in sorted({run.control for run in outcome.runs}):
        runs = [run for run in outcome.runs if run.control == count]
        checks = [run.check for run in runs if run.check is not None and run.check.names]
        row: dict[str, Any] = {"control": count, "choices": len(runs), "failed": len(runs) - len(checks)}
        if not checks:
            rows.append(row | {"failure": runs[0].failure})
            continue
        d = np.vstack([check.d for check in checks])
        sigma = np.sqrt(np.vstack([np.diagonal(check.covariance, axis1=1, axis2=2) for check in checks]))
        rows.append(
            row
            | {
                "errors": len(d),
                "rmse_m": _rms(d),
                "predicted_m": _rms(sigma),
                "within_95_percent": float(np.mean(np.abs(d) <= _TIMES * sigma)),
            }
        )
    return rows


def _rms(values: Floats) -> dict[str, float]:
    return {axis: float(rms) for axis, rms in zip("XYZ", np.sqrt(np.mean(values**2, axis=0)), strict=True)}


def numbers_text(figures: dict[str, Any]) -> str:
    """Write them for people, and from which number on more control is hardly worth while."""
    head = f"{figures['method']} georeferencing, {figures['points']} surveyed points; at the others "
    lines = [head + "RMSE in X, Y, Z / predicted with the survey's own sigma, mm"]
    predicted = {}
    for row in figures["numbers"]:
        if "rmse_m" not in row:
            lines.append(f"  {row['control']:>3} control: not possible: {row['failure']}")
            continue
        cells = ", ".join(f"{1e3 * row['rmse_m'][a]:.0f}/{1e3 * row['predicted_m'][a]:.0f}" for a in "XYZ")
        share = f"{100 * row['within_95_percent']:.0f} % of {3 * row['errors']} errors within 95 %"
        lines.append(f"  {row['control']:>3} control, {row['choices']} choices: {cells}; {share}")
        predicted[row["control"]] = float(np.linalg.norm(list(row["predicted_m"].values())))
    if predicted:
        least = min(predicted.values())
        enough = min(count for count, value in predicted.items() if value <= (1 + WORTH) * least)
        lines.append(
            f"from {enough} control points on, more of them lower what is predicted by less than 10 %"
        )
    return "\n".join(lines)
