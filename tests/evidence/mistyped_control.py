"""Long study: one control point with a typing error, among four and among six: is it found and named?

Writes `docs/evidence/mistyped_control.md`. Flights with positions and attitudes, c, K1 and K2 estimated. Of
the mistyped coordinates one pair of digits is exchanged, one digit is wrong, X and Y are exchanged, a point
is in feet, or its height is of another kind.

Run: `make evidence`, or `python -m tests.evidence.mistyped_control [DRAWS]`.
"""

from __future__ import annotations

import sys
import tempfile
from collections import Counter
from dataclasses import replace
from pathlib import Path

import numpy as np

from photocal.analysis.georeferencing.causes import causes_of, mistyped_of, slips_of
from photocal.analysis.georeferencing.prepared import with_attitude_angles
from photocal.base.arrays import Floats
from photocal.block.folder import read_block
from photocal.block.model import Block
from photocal.block.network import assemble
from tests.photocal.analysis.georeferencing.flights import Plan, fly

DRAWS = 100
KINDS = ("digits-exchanged", "one-digit", "exchanged", "feet", "height")
OUTPUT = Path(__file__).parents[2] / "docs" / "evidence" / "mistyped_control.md"
# A slip that moves a point by less is no mistake that the block could show.
LEAST_M = 0.3
# What is added to the coordinates of the simulated flights: as long as those of a map.
EAST, NORTH = 2_400.0, 7_300.0


def mistyped(place: Floats, kind: str, rng: np.random.Generator) -> Floats:
    """Coordinates of a point with one slip."""
    wrong = place.copy()
    if kind == "exchanged":
        wrong[:2] = place[1::-1]
    elif kind == "feet":
        wrong = place / 0.3048
    elif kind == "height":
        wrong[2] += rng.choice([-1.0, 1.0]) * rng.uniform(2.0, 45.0)
    while np.abs(wrong - place).max() < LEAST_M:
        axis = int(rng.integers(3))
        text = list(f"{place[axis]:.3f}")
        digits = [i for i, mark in enumerate(text) if mark.isdigit()]
        i = int(rng.integers(len(digits) - 1))
        if kind == "digits-exchanged":
            a, b = digits[i], digits[i + 1]
            text[a], text[b] = text[b], text[a]
        else:
            text[digits[i]] = str(rng.integers(10))
        wrong[axis] = float("".join(text))
    return wrong


def moved(block: Block) -> Block:
    """The block far from its origin, where coordinates have all their digits."""
    far = np.array([EAST, NORTH, 0.0])
    images = block.images.values + np.concatenate([np.zeros(3), far])
    return replace(
        block,
        images=replace(block.images, values=images),
        points=replace(block.points, values=block.points.values + far),
        positions=replace(block.positions, values=block.positions.values + far),
    )


def drawn(control: int, seed: int) -> tuple[str, bool, bool]:
    """Kind of slip, whether the point and no other is named, and whether the slip is."""
    rng = np.random.default_rng(90_000 + 1000 * control + seed)
    plan = Plan(control=control, check=4, tie=60, estimate=("c", "K1", "K2"), camera_sigma={})
    with tempfile.TemporaryDirectory() as scratch:
        block = moved(with_attitude_angles(read_block(fly(Path(scratch) / "flight", rng, plan=plan))))
    kind = KINDS[seed % len(KINDS)]
    rows = np.flatnonzero(block.points.of_role("control"))
    row = int(rng.choice(rows))
    values = block.points.values.copy()
    values[row] = mistyped(values[row], kind, rng)
    wrong = replace(block, points=replace(block.points, values=values))
    found = mistyped_of(causes_of(wrong)[0], slips_of(wrong, assemble(wrong)))
    right = [one.point for one in found] == [block.points.names[row]]
    slips = {slip.split()[0] for slip in found[0].slips} if right else set[str]()
    # Other slips may make the same coordinates; a kind of height has no form of its own.
    return kind, right, kind in slips or (kind == "one-digit" and bool(slips)) or kind == "height"


def main(draws: int = DRAWS) -> None:
    """Fly, mistype, look, and write the page."""
    rows = []
    for control in (4, 6):
        named, told, wrong = 0, 0, Counter[str]()
        for seed in range(draws):
            kind, right, slip = drawn(control, seed)
            named += right
            told += right and slip
            wrong[kind] += not right
            sys.stderr.write(
                f"\r{control} control points: {seed + 1} of {draws}, {named} named, {told} told  "
            )
        missed = ", ".join(f"{kind} {n}" for kind, n in wrong.items() if n) or "-"
        rows.append(f"| {control} | {draws} | {named} | {95 if control == 4 else 99} | {told} | {missed} |")
        sys.stderr.write(f"\n{rows[-1]}\n")
    lines = [
        "# One mistyped control point",
        "",
        "Flights with positions and attitudes, c, K1 and K2 estimated; one control point with a typing",
        f"error: {', '.join(KINDS)}. Named: that point and no other. Identified: the kind of error, too.",
        "",
        "| control points | draws | point named | required, of 100 | error identified | missed |",
        "|---|---|---|---|---|---|",
        *rows,
    ]
    OUTPUT.parent.mkdir(parents=True, exist_ok=True)
    OUTPUT.write_text("\n".join(lines) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main(*map(int, sys.argv[1:]))
