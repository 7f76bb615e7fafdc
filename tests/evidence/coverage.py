"""Long study: do the 95 % intervals of an adjustment hold the truth 95 times of 100?

Writes `docs/evidence/coverage.md`. 200 small blocks in which camera, orientations, points, lever arm,
boresight and time offset are all unknown; every block has other measuring errors.

Run: `make evidence`, or `python -m tests.evidence.coverage`.
"""

from __future__ import annotations

import sys
from collections import defaultdict
from dataclasses import replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from scipy import stats

from photocal.adjustment.adjust import adjust
from photocal.adjustment.mounting import COMMON
from photocal.adjustment.solution import Solution
from photocal.geometry.camera import PARAMETERS, Model
from tests.photocal import networks
from tests.photocal.networks import Scene

Floats = NDArray[np.float64]

BLOCKS = 200
MOUNTING = np.array([0.3, -0.1, -0.4, 0.01, -0.02, 0.015, 0.02, *[0.0] * 10])
SIGMA = np.array([np.inf] * 7 + [0.0] * 10)
CASES: tuple[tuple[str, Model, dict[str, float]], ...] = (
    ("brown-ideal", "brown-ideal", {}),
    ("brown-observed", "brown-observed", {}),
    ("brown-ideal, photo-variant x0 and y0", "brown-ideal", {"x0": 0.02, "y0": 0.02}),
)
OUTPUT = Path(__file__).parents[2] / "docs" / "evidence" / "coverage.md"


def block(model: Model, photo_variant: dict[str, float], seed: int) -> tuple[Scene, Solution, Floats]:
    """One block, its adjustment, and the true deviations of the images."""
    estimate = ("c", "x0", "y0", "K1", "K2", "P1", "P2")
    own = networks.lens(model=model, estimate=estimate, photo_variant=photo_variant, K3=0.0, B1=0.0, B2=0.0)
    scene, rng = networks.convergent((own,), images=9, points=18), np.random.default_rng(7000 + seed)
    deviations = np.zeros((9, len(photo_variant)))
    network = networks.observe(scene, rng, missing=0.1)
    if photo_variant:
        deviations = rng.normal(size=deviations.shape) * list(photo_variant.values())
        # x0 and y0 of brown-ideal move the whole image.
        rays = network.rays
        network = replace(network, rays=replace(rays, plane=rays.plane + deviations[rays.image]))
    return scene, adjust(networks.navigated(network, scene, rng, MOUNTING, SIGMA)), deviations


def standardised(scene: Scene, solution: Solution, deviations: Floats) -> dict[str, Floats]:
    """Errors in units of their standard deviations, by kind of unknown."""
    groups: dict[str, Floats] = {}

    def add(name: str, error: Floats, covariance: Floats) -> None:
        sigma = np.sqrt(np.diagonal(covariance, axis1=-2, axis2=-1))
        groups[name] = (error / np.where(sigma > 0, sigma, np.nan)).ravel()

    cameras = solution.cameras - scene.cameras[0].values
    for k in np.flatnonzero(scene.cameras[0].estimated):
        add(PARAMETERS[k], cameras[:, k : k + 1], solution.camera_covariance[:, k : k + 1, k : k + 1])
    turn = solution.exposures - scene.exposures
    turn[:, :3] = (turn[:, :3] + np.pi) % (2 * np.pi) - np.pi
    add("angles of the images", turn[:, :3], solution.exposure_covariance[:, :3, :3])
    add("projection centres", turn[:, 3:], solution.exposure_covariance[:, 3:, 3:])
    add("object points", solution.points - scene.points, solution.point_covariance)
    common = solution.state.common - MOUNTING
    for n, name in enumerate(COMMON):
        add(name, common[n : n + 1], solution.common_covariance[n : n + 1, n : n + 1])
    if deviations.size:
        own = solution.photo_variant
        error = own.deviations - deviations.ravel()
        groups["deviations of the images"] = error / own.deviation_sigma
    return groups


def table(title: str, model: Model, photo_variant: dict[str, float]) -> list[str]:
    """Coverage of one case."""
    found: dict[str, list[Floats]] = defaultdict(list)
    sums = []
    for seed in range(BLOCKS):
        scene, solution, deviations = block(model, photo_variant, seed)
        for name, errors in standardised(scene, solution, deviations).items():
            found[name].append(errors)
        sums.append(solution.chi_squared / solution.degrees_of_freedom)
        sys.stderr.write(f"\r{title}: block {seed + 1} of {BLOCKS} ")
    limit = stats.norm.isf(0.025)
    lines = [
        f"## {title}",
        "",
        f"v'Pv over its degrees of freedom: mean {np.mean(sums):.4f} (expected 1).",
        "",
        "| unknowns | within 95 %, of all | sampling error of single unknowns |",
        "|---|---|---|",
    ]
    share = []
    for name, parts in found.items():
        hits = np.abs(np.concatenate(parts)) < limit
        share.append((hits.sum(), len(hits)))
        spread = 100 * np.sqrt(0.95 * 0.05 / BLOCKS)
        lines.append(f"| {name} | {100 * hits.mean():.1f} % of {len(hits)} | {spread:.1f} % |")
    held, count = np.sum(share, axis=0)
    lines += [f"| all | {100 * held / count:.1f} % | |", ""]
    return lines


def main() -> None:
    """Run the study and write its page."""
    lines = [
        "# Coverage of the 95 % intervals",
        "",
        f"{BLOCKS} blocks of 9 images and 18 points for each case: camera, orientations, points (observed to",
        "3 mm), lever arm, boresight and time offset all unknown. Errors within one block are correlated:",
        "single lines scatter by about their sampling error.",
        "",
    ]
    for case in CASES:
        lines += table(*case)
    OUTPUT.parent.mkdir(parents=True, exist_ok=True)
    OUTPUT.write_text("\n".join(lines), encoding="utf-8")
    sys.stderr.write(f"\nwritten to {OUTPUT}\n")


if __name__ == "__main__":
    main()
