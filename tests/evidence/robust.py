"""Long study: do the sandwich and the a posteriori scale cover where the noise is not what was stated?

Writes `docs/evidence/robust.md`. Flights with a known camera: clean; with noise that differs from image to
image; and with smooth errors of each image of its own, so that its rays are not independent.

Run: `make evidence`, or `python -m tests.evidence.robust [FLIGHTS]`.
"""

from __future__ import annotations

import sys
from collections.abc import Callable
from pathlib import Path

import numpy as np

from photocal.adjustment.adjusted import fit
from photocal.adjustment.network import Network
from photocal.analysis.robust import apart, sandwich
from tests.photocal.analysis.aerial import Flight, correlated, fly, scattered

FLIGHTS = 60
IMAGES = (24, 60)
SIGMA_PX = 0.5
TWO_SIDED = 1.96
OUTPUT = Path(__file__).parents[2] / "docs" / "evidence" / "robust.md"
NOISE: dict[str, Callable[[Network, float, np.random.Generator], Network]] = {
    "as stated": lambda network, _size, _rng: network,
    "different from image to image": scattered,
    "smooth in each image": correlated,
}


def errors(noise: str, images: int, seed: int) -> np.ndarray:
    """True errors of the camera over the scaled formal and the robust sigma, and whether those are apart."""
    flown = fly(Flight(images, 60 * images, sigma_px=SIGMA_PX), seed)
    found = fit(NOISE[noise](flown.network, SIGMA_PX, np.random.default_rng(7_000 + seed)))
    own = found.network.cameras[0].estimated
    error = (found.state.cameras[0] - flown.lens.values)[own]
    formal = np.sqrt(
        np.diag(found.solution.camera_covariance[0])[own] * max(found.solution.variance_factor, 1.0)
    )
    robust = sandwich(found)[0][own]
    return np.array(
        [error / formal, error / robust, [apart(*pair) for pair in zip(formal, robust, strict=True)]]
    )


def main(flights: int = FLIGHTS) -> None:
    """Fly, adjust, count, and write the page."""
    rows = []
    for images in IMAGES:
        for noise in NOISE:
            told = np.array([errors(noise, images, seed) for seed in range(flights)])
            formal, robust = (np.mean(np.abs(told[:, k]) < TWO_SIDED) for k in (0, 1))
            c = [np.mean(np.abs(told[:, k, 0]) < TWO_SIDED) for k in (0, 1)]
            shown = np.mean(told[:, 2])
            cells = (images, noise, *(f"{100 * v:.1f}" for v in (formal, robust, *c, shown)))
            rows.append("| " + " | ".join(map(str, cells)) + " |")
            sys.stderr.write(rows[-1] + "\n")
    lines = [
        "# Second opinions on standard deviations",
        "",
        f"{flights} flights each, c, x0, y0, K1 to K3, P1, P2 and B1 unknown, {SIGMA_PX} px stated. In the",
        "second kind of noise the sigma differs from image to image (log-normal, median as stated, sigma",
        "of the logarithm 0.7). In the third kind each image has a smooth field of its own (six terms of",
        "up to the third power, as large at the edge). Coverage of 95 % intervals, of all parameters",
        "together and of c alone: by standard deviations scaled by the a posteriori factor, and by the",
        "sandwich estimator (residuals of an image taken together). Shown: parameters for which the two",
        "differ by more than a third.",
        "",
        "| images | noise | scaled, % | sandwich, % | c scaled, % | c sandwich, % | shown, % |",
        "|---|---|---|---|---|---|---|",
        *rows,
    ]
    OUTPUT.parent.mkdir(parents=True, exist_ok=True)
    OUTPUT.write_text("\n".join(lines) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main(*map(int, sys.argv[1:]))
