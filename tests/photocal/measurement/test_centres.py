"""Centres of rendered targets: true to the stated sigma, to a twentieth of a pixel at 20 px and 2 % noise."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy import stats

from photocal.measurement.centres import (
    Centre,
    cross_centre,
    disc_centre,
    quadrilateral_centre,
    saddle_centre,
)
from photocal.measurement.eccentricity import circle_centre, ellipse_conic, ring_centre

from .rendering import DARK, LIGHT, perspective, render

Floats = NDArray[np.float64]
SAMPLES = 40


def _errors(
    measure: Callable[[NDArray[np.uint8], Floats, Floats], Centre | None],
    scene: Callable[[Floats, Floats], Floats],
    size: int,
) -> tuple[Floats, Floats]:
    """Errors and standardised squares of `SAMPLES` rendered targets."""
    rng = np.random.default_rng(7)
    errors, squares = [], []
    for _ in range(SAMPLES):
        matrix = perspective(rng, size)
        true = matrix[:2, 2] / matrix[2, 2]
        centre = measure(render(scene, matrix, size, rng), true + rng.uniform(-1, 1, 2), matrix)
        assert centre is not None
        error: Floats = np.array([centre.column, centre.row]) - true
        errors.append(error)
        squares.append(error @ np.linalg.solve(centre.covariance, error))
    return np.array(errors), np.array(squares)


def _hourglass(u: Floats, v: Floats) -> Floats:
    return np.where(u * v > 0, LIGHT, DARK)


def _cross(u: Floats, v: Floats) -> Floats:
    return np.where((np.abs(u) < 2) | (np.abs(v) < 2), LIGHT, DARK)


def _disc(u: Floats, v: Floats) -> Floats:
    return np.where(np.hypot(u, v) < 10, DARK, LIGHT)


def _square(u: Floats, v: Floats) -> Floats:
    inside, code = np.maximum(np.abs(u), np.abs(v)) < 12, np.maximum(np.abs(u), np.abs(v)) < 8
    return np.where(inside & ~(code & (u > 0)), DARK, LIGHT)


def _measured_disc(grey: NDArray[np.uint8], near: Floats, matrix: Floats) -> Centre | None:
    found = disc_centre(grey, (near[0], near[1]), (9.0, 8.0))
    if found is None:
        return None
    conic = ellipse_conic(np.array([found.column, found.row]), found.shape[:2], float(found.shape[2]))
    # The plane's line at infinity, seen in the picture.
    line = np.linalg.inv(matrix).T @ [0.0, 0.0, 1.0]
    place: Floats = circle_centre(conic, line)
    return Centre(
        float(place[0]), float(place[1]), found.covariance, found.contrast, found.noise, found.shape
    )


def _measured_square(grey: NDArray[np.uint8], near: Floats, matrix: Floats) -> Centre | None:
    corners = np.array([[-12, -12, 1], [12, -12, 1], [12, 12, 1], [-12, 12, 1.0]]) @ matrix.T
    rough = corners[:, :2] / corners[:, 2:] + (near - matrix[:2, 2] / matrix[2, 2]) * 0.5
    found = quadrilateral_centre(grey, rough, 3.5)
    return None if found is None else found[0]


Measure = Callable[[NDArray[np.uint8], Floats, Floats], Centre | None]
CASES: dict[str, tuple[Measure, Callable[[Floats, Floats], Floats]]] = {
    "hourglass": (lambda g, n, _: saddle_centre(g, (n[0], n[1]), 10.0), _hourglass),
    "cross": (lambda g, n, _: cross_centre(g, (n[0], n[1]), 20.0), _cross),
    "disc": (_measured_disc, _disc),
    "square": (_measured_square, _square),
}


@pytest.mark.parametrize("kind", CASES)
def test_twenty_pixels_and_two_percent_noise(kind: str) -> None:
    measure, scene = CASES[kind]
    errors, squares = _errors(measure, scene, 56)
    assert np.sqrt(np.mean(errors**2)) < 0.05
    # The standardised squares are chi-squared with two degrees of freedom each; a stated sigma may be
    # up to a quarter too large, since a weak blur is poorly separated from the noise.
    low, high = (float(stats.chi2.ppf(p, 2 * SAMPLES)) for p in (0.0005, 0.9995))
    assert low / 1.6 < squares.sum() < high


@pytest.mark.parametrize("diameter", [6.0, 10.0, 60.0])
def test_discs_from_small_to_large(diameter: float) -> None:
    rng = np.random.default_rng(3)
    size = int(diameter * 1.6) + 24
    errors = []
    for _ in range(10):
        matrix = np.eye(3)
        matrix[:2, 2] = size / 2 + rng.uniform(-0.5, 0.5, 2)
        grey = render(lambda u, v: np.where(np.hypot(u, v) < diameter / 2, DARK, LIGHT), matrix, size, rng)
        near = (float(matrix[0, 2] + 0.4), float(matrix[1, 2] - 0.3))
        found = disc_centre(grey, near, (diameter / 2, diameter / 2))
        assert found is not None
        errors.append([found.column - matrix[0, 2], found.row - matrix[1, 2]])
    assert np.sqrt(np.mean(np.square(errors))) < (0.08 if diameter < 10 else 0.05)


def test_eccentricity_of_a_tilted_circle() -> None:
    """A circle projected point by point: the conic's pole is its centre, the ellipse's centre is not."""
    rng = np.random.default_rng(5)
    matrix = perspective(rng, 60)
    matrix[2, :2] = [0.004, 0.003]
    back = np.linalg.inv(matrix)
    outer, inner = (back.T @ np.diag([1 / r**2, 1 / r**2, -1.0]) @ back for r in (15.0, 8.0))
    true = matrix[:2, 2] / matrix[2, 2]
    ellipse = np.linalg.solve(outer[:2, :2], -outer[:2, 2])
    assert np.hypot(*(ellipse - true)) > 0.2
    assert circle_centre(outer, back.T @ [0.0, 0.0, 1.0]) == pytest.approx(true, abs=1e-9)
    assert ring_centre(inner, outer) == pytest.approx(true, abs=1e-6)


@pytest.mark.parametrize("kind", ["hourglass", "cross", "disc"])
def test_plain_ground_has_no_target(kind: str) -> None:
    rng = np.random.default_rng(1)
    grey = np.asarray(np.clip(rng.normal(120, 5, (56, 56)), 0, 255), np.uint8)
    assert CASES[kind][0](grey, np.array([28.0, 28.0]), np.eye(3)) is None


def test_a_window_beyond_the_edge_gives_nothing() -> None:
    grey = np.zeros((40, 40), dtype=np.uint8)
    assert saddle_centre(grey, (3.0, 20.0), 8.0) is None
    assert saddle_centre(grey, (float("nan"), 20.0), 8.0) is None
