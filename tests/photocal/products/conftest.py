"""The published tables of the tank, and points made from them."""

from __future__ import annotations

import csv
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

DATA = Path(__file__).parent / "data"
Floats = NDArray[np.float64]

# The variance of a point that the published standard deviations and variance factors imply.
TANK_VARIANCE = 2.0e-4
TANK_HEIGHT = 9.5


def rows_of(name: str) -> list[dict[str, str]]:
    with (DATA / name).open(encoding="utf-8", newline="") as file:
        return list(csv.DictReader(file))


def signed(lengths: Floats, angle: Floats) -> Floats:
    """Give the printed residuals, whose signs are lost, signs that residuals of a circle can have.

    Those of a fit are orthogonal to 1, cos and sin of the direction: of 150 000 draws the nearest is taken.
    """
    random = np.random.default_rng(1994)
    signs = random.choice([-1.0, 1.0], size=(150_000, len(lengths)))
    design = np.column_stack([np.ones_like(angle), np.cos(angle), np.sin(angle)])
    miss = np.linalg.norm((signs * lengths) @ design, axis=1)
    return np.asarray(signs[int(np.argmin(miss))] * lengths)


@pytest.fixture(scope="session")
def tank_table() -> str:
    """Table of the five published rings: printed centres, radii and residuals."""
    residuals = rows_of("tank_residuals.csv")
    lines = ["section,point,X,Y,Z"]
    for ring in rows_of("tank_circles.csv"):
        name = ring["section"]
        measured = [(int(r["generatrix"]), r[f"s{name}_m"]) for r in residuals if r[f"s{name}_m"]]
        angle = np.array([2 * np.pi * (number - 1) / 24 for number, _ in measured])
        radial = signed(np.array([float(text) for _, text in measured]), angle)
        # The printed radius is rounded; its area has more digits.
        radius = np.sqrt(float(ring["area_m2"]) / 3.1415926) + radial
        x = float(ring["xc_m"]) + radius * np.cos(angle)
        y = float(ring["yc_m"]) + radius * np.sin(angle)
        z = TANK_HEIGHT * (int(name) - 1) / 4
        lines += [
            f"{name},{number}{name},{a:.9f},{b:.9f},{z}"
            for (number, _), a, b in zip(measured, x, y, strict=True)
        ]
    return "\n".join(lines) + "\n"
