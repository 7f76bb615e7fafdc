"""Long study: two rules of a check, measured: what single check points explain, and what positions share.

Writes `docs/evidence/single-points.md`. The flights are those of `tests.independent`, which shares no code
with the product. What is written of the rule before is that of version a9911d99, computed beside.

Run: `python -m tests.evidence.single_points`, in portions as `tests.evidence.portions` says.
"""

from __future__ import annotations

import tempfile
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

import photocal
from photocal.adjustment.adjusted import fit
from photocal.analysis.georeferencing.comparison import Differences, differences
from photocal.analysis.georeferencing.findings import by_single_points
from photocal.analysis.georeferencing.methods import of_method
from photocal.analysis.georeferencing.prepared import checkable, in_local_frame, with_attitude_angles
from photocal.base.errors import PhotocalError
from photocal.block.network import assemble
from photocal.hypotheses.adequacy import memory_of
from tests.evidence.judging import fly
from tests.evidence.portions import Case, outcomes
from tests.independent.faults import BASE, table
from tests.independent.flights import Errors

OUTPUT = Path(__file__).parents[2] / "docs" / "evidence" / "single-points.md"
FLIGHTS = 20
CHECKED, WRONG, SIZES_M = (12, 30), (1, 2, 3, 6), (0.15, 0.40)
FAULTS = {fault.name: fault for fault in table()}
MEMORIES = {
    f"{n} images, {words}": replace(BASE, images=n, memory=rho, gnss_worse=true)
    for n in (30, 60)
    for words, rho, true in (
        ("independent errors", 0.0, 1.0),
        ("independent, stated three times too large", 0.0, 1.0 / 3.0),
        ("AR(1) 0.8", 0.8, 1.0),
        ("AR(1) 0.95", 0.95, 1.0),
        ("AR(1) 0.95, stated three times too large", 0.95, 1.0 / 3.0),
    )
}


def cases() -> Iterator[Case]:
    """List the flights: check points with mistakes of their own, blocks with errors, positions."""
    for seed in range(FLIGHTS):
        yield from (("points", n, k, s, seed) for n in CHECKED for k in WRONG for s in SIZES_M)
        yield from (("memory", name, seed) for name in MEMORIES)
    yield from (("block", n, name, seed) for n in CHECKED for name in FAULTS for seed in range(2))


def run(kind: str, *case: Any) -> list[float]:
    """Fly one case: whether there is a misfit, and whether single points are blamed, before and now."""
    if kind == "memory":
        return shared(*case)
    try:
        if kind == "points":
            check, wrong, size, seed = case
            return blamed(check, "", int(seed), int(wrong), float(size))
        check, name, seed = case
        return blamed(check, name, int(seed), 0, 0.0)
    except PhotocalError:
        return []


def blamed(check: int, name: str, seed: int, wrong: int, size: float) -> list[float]:
    """Check a flight some of whose check points are wrong by a size along one axis."""
    design, errors = (FAULTS[name].design, FAULTS[name].errors) if name else (BASE, Errors())
    with tempfile.TemporaryDirectory() as scratch:
        block = photocal.read_block(
            fly(Path(scratch) / "block", replace(design, check=check), errors, seed).folder
        )
    rng, values = np.random.default_rng(seed), block.points.values.copy()
    for row in rng.choice(np.flatnonzero(block.points.of_role("check")), wrong, replace=False):
        values[row, rng.integers(3)] += size * rng.choice([-1.0, 1.0])
    moved = replace(block, points=replace(block.points, values=values))
    whole = with_attitude_angles(checkable(in_local_frame(moved)))
    found = differences(whole, of_method(whole, "integrated"), "check")
    joint = found.joint
    misfit = joint is not None and joint.exceeds and joint.chi_squared > 1.1025 * joint.degrees_of_freedom
    return [float(misfit), float(misfit and before(found)), float(misfit and by_single_points(found))]


def before(check: Differences) -> bool:
    """The rule of a9911d99: a tenth of the points, and a mean of the others within 1.5."""
    away = [d for n, d in zip(check.names, check.distance, strict=True) if n not in check.suspected]
    few = 0 < len(check.suspected) <= max(1, len(check.names) // 10)
    return few and bool(away) and float(np.sqrt(np.nanmean(away) / 3.0)) <= 1.5


def shared(name: str, seed: int) -> list[float]:
    """Adjust a flight: whether its positions share their errors, doubted before and now, and c in sigmas."""
    with tempfile.TemporaryDirectory() as scratch:
        flown = fly(Path(scratch) / "block", MEMORIES[name], Errors(), seed)
        adjusted = fit(assemble(photocal.read_block(flown.folder)).network)
    memory, solution = memory_of(adjusted), adjusted.solution
    assert memory is not None
    rows = np.sqrt(next(g for g in solution.groups if g.name == "position").chi_squared / (3.0 * len(
        adjusted.network.positions.image)))  # fmt: skip
    doubted = memory.significant and np.sqrt(memory.inflation) * min(rows, 1.0) > 1.5
    z = (solution.cameras[0, 0] - flown.truth.lens.c) / np.sqrt(solution.camera_covariance[0, 0, 0])
    return [float(memory.significant), float(doubted), float(memory.significant and memory.exceeds), float(z)]


def page(found: dict[Case, Any]) -> str:
    """Write the page."""
    lines = [
        "# Rules of the check, tested",
        "",
        f"{len(found)} flights of an independent simulator (`tests/independent`), judged by",
        "`tests.evidence.single_points`.",
        "",
        "## Misfits caused by single check points",
        "",
        "A misfit of the check points is grave, unless single points cause it. Old rule: at most a tenth",
        "of the points, and a mean of the others within 1.5. New rule: the points that stand out by Holm's",
        "test, at most a third, when the others agree jointly, with their covariance, at 95 %.",
        "",
        "| check points | wrong | by | misfits | attributed to single points: old | new | correct |",
        "|---|---|---|---|---|---|---|",
    ]
    for n in CHECKED:
        for k in WRONG:
            for size in SIZES_M:
                rows = [v for case, v in found.items() if case[:4] == ("points", n, k, size) and v]
                lines.append(
                    f"| {n} | {k} | {size:.2f} m | {_counts(rows)} | {'all' if 3 * k <= n else 'none'} |"
                )
        rows = [v for case, v in found.items() if case[:2] == ("block", n) and v]
        lines.append(f"| {n} | none, a fault of the block | | {_counts(rows)} | none |")
    lines += [
        "",
        "## Positions that share their errors",
        "",
        "Named: the correlation r of neighbours is significant (0.1 %, with variance one over the number",
        "of products). Doubtful: what the positions have in common is larger than independent errors of",
        "the stated size would make it. This size is derived from residuals and redundancy, times the root",
        "of (1 + r) / (1 - r); the limit is 1.1. Old rule: the size of the residuals alone, which is",
        "smaller than that of the errors, with the limit 1.5.",
        "",
        "| positions | flights | named | doubtful, old rule | doubtful, new rule | c: rms error, sigmas |",
        "|---|---|---|---|---|---|",
    ]
    for name in MEMORIES:
        rows = [v for case, v in found.items() if case[:2] == ("memory", name)]
        if not rows:
            continue
        told = np.array(rows)
        counts = " | ".join(f"{int(n)}" for n in told[:, :3].sum(axis=0))
        lines.append(f"| {name} | {len(rows)} | {counts} | {np.sqrt(np.mean(told[:, 3] ** 2)):.2f} |")
    return "\n".join(lines) + "\n"


def _counts(rows: list[list[float]]) -> str:
    misfits, old, new = np.sum(rows, axis=0).astype(int).tolist() if rows else (0, 0, 0)
    return f"{misfits} of {len(rows)} | {old} | {new}"


def main() -> None:
    """Fly, and write the page."""
    every = list(cases())
    OUTPUT.write_text(page(outcomes(iter(every), len(every), run)), encoding="utf-8")


if __name__ == "__main__":
    main()
