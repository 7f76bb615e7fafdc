"""Long study: of clean flights of any size, how many get a finding of a cause, and is c ever called biased?

Writes `docs/evidence/false_alarms.md`. Everything that is observed has the error that is stated for it, and
the camera model is the true one: whatever is found is invented. Each family of tests has a level of 0.5 %,
shared by all of its tests (Bonferroni): ten families make at most 5 %.

Run: `make evidence`, or `python -m tests.evidence.false_alarms`, in portions as
`tests.evidence.portions` says: the number of a case is the seed of its flight.
"""

from __future__ import annotations

from collections import Counter
from itertools import count as numbers
from pathlib import Path

import numpy as np

from photocal.analysis.systematic_errors.findings import findings
from photocal.analysis.systematic_errors.refit import fit
from photocal.analysis.systematic_errors.search import search
from tests.evidence.portions import outcomes
from tests.photocal.analysis.aerial import Flight, fly

BLOCKS = 300
OUTPUT = Path(__file__).parents[2] / "docs" / "evidence" / "false_alarms.md"
SIZES = ((10, 60), (60, 200), (200, 601))
# Of each hundred blocks so many have these sizes.
SHARE = (70, 26, 4)
MODELS = ("brown-ideal", "brown-observed")
CARRIED = (("GNSS", True, False), ("control", False, True), ("both", True, True), ("neither", False, False))


def drawn(seed: int) -> tuple[Flight, int, int]:
    """A flight by chance, the class of its size, and what carries its datum."""
    rng = np.random.default_rng(50_000 + seed)
    size = int(np.searchsorted(np.cumsum(SHARE), seed % 100, side="right"))
    low, high = SIZES[size]
    images = int(np.exp(rng.uniform(np.log(low), np.log(high))))
    rays = min(int(images * np.exp(rng.uniform(np.log(100), np.log(350)))), 200_000)
    carried = int(rng.integers(4))
    _, gnss, control = CARRIED[carried]
    sigma = float(np.exp(rng.uniform(np.log(0.2), np.log(1.5))))
    return Flight(images, rays, MODELS[seed % 2], sigma, gnss, control), size, carried  # type: ignore[arg-type]


def invented(seed: int) -> tuple[list[str], float]:
    """Codes of the findings of a clean flight, and the largest effect on c that they claim, in sigmas."""
    first = fit(fly(drawn(seed)[0], seed).network)
    listed = findings(search(first))
    sigma = float(np.sqrt(first.solution.camera_covariance[0, 0, 0]))
    effect = max((abs(one.size.c or 0.0) / sigma for one in listed if one.size), default=0.0)
    return [one.code for one in listed], effect


def main() -> None:
    """Fly, analyse, count, and write the page."""
    found = outcomes(((seed,) for seed in numbers()), BLOCKS, invented)
    count, hit, codes = Counter[tuple[str, str]](), Counter[tuple[str, str]](), Counter[str]()
    for (seed,), (listed, _) in found.items():
        flight, size, carried = drawn(seed)
        low, high = SIZES[size]
        for row in (
            ("model", flight.model),
            ("images", f"{low} to {high - 1}"),
            ("datum by", CARRIED[carried][0]),
            ("noise", "below 0.55 px" if flight.sigma_px < 0.55 else "0.55 px and more"),
            ("all", ""),
        ):
            count[row] += 1
            hit[row] += bool(listed)
        codes.update(set(listed))
    seeds = sorted(seed for (seed,) in found)
    worst, largest = max(effect for _, effect in found.values()), max(drawn(seed)[0].images for seed in seeds)
    lines = [
        "# False alarms of the analysis",
        "",
        f"{len(seeds)} clean flights (seeds {seeds[0]} to {seeds[-1]}) of the sizes below, 0.2 to 1.5 px of",
        "noise; c, x0, y0, K1 to K3, P1, P2 and B1 unknown. Whatever is found is invented. Each family of",
        "tests has a level of 0.5 % for all of its tests together: ten families make at most 5 %; asked",
        f"are 5 %. The largest of these flights has {largest} images.",
        "",
        "| | | blocks | with a finding |",
        "|---|---|---|---|",
        *(f"| {row[0]} | {row[1]} | {count[row]} | {hit[row]} |" for row in sorted(count)),
        "",
        "Found: " + (", ".join(f"{code} {times}" for code, times in codes.most_common()) or "nothing") + ".",
        f"Largest effect on c that a finding claims: {worst:.2f} standard deviations (asked: 1.5).",
    ]
    OUTPUT.parent.mkdir(parents=True, exist_ok=True)
    OUTPUT.write_text("\n".join(lines) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
