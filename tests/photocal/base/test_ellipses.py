"""Ellipses, ellipsoids and mean precision against the tank study, coverage, and constructed cases."""

from __future__ import annotations

import csv
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation
from scipy.stats import chi2

from photocal.base.ellipses import (
    azimuth_and_elevation,
    ellipses,
    ellipsoids,
    enlargement,
    hottier_factor,
    mean_precision,
    spheres,
)

TANK = Path(__file__).parents[2] / "reference" / "tank"


def table(name: str) -> list[dict[str, str]]:
    with (TANK / name).open(encoding="utf-8", newline="") as text:
        return list(csv.DictReader(text))


@pytest.mark.parametrize("row", table("ellipsoid_probability.csv"), ids=lambda row: row["probability"])
def test_probabilities_of_the_tank_study(row: dict[str, str]) -> None:
    """C = 1 stands for 19.87 %, printed as 20 %; the other C have two decimals."""
    c = enlargement(float(row["probability"]), 3) ** 2
    assert c == pytest.approx(float(row["C"]), abs=0.006)


def station(case: str) -> np.ndarray:
    names = ("XC", "YC", "ZC")
    matrix = np.zeros((1, 3, 3))
    for row in table("table01_station9_covariance.csv"):
        if row["case"] == case and row["row"] in names and row["col"] in names:
            a, b = names.index(row["row"]), names.index(row["col"])
            matrix[0, a, b] = matrix[0, b, a] = float(row["value"])
    assert (np.diagonal(matrix[0]) > 0).all()
    return matrix


def test_one_station_in_three_systems() -> None:
    """Turned by 15 degrees about Y, and permuted: the same ellipsoid, printed to three digits."""
    first, second, third = (ellipsoids(station(case), 0.95) for case in "123")
    assert second[0] == pytest.approx(first[0], rel=0.01)
    assert third[0] == pytest.approx(first[0], rel=1e-5)
    turn = np.degrees(np.arccos(np.abs(np.sum(first[1][0, 0] * second[1][0, 0]))))
    assert turn <= 15.5


@pytest.mark.parametrize("row", table("tests_summary.csv"), ids=lambda row: row["test"])
def test_mean_precision_of_the_tank_study(row: dict[str, str]) -> None:
    """Its sC is the arithmetic mean, whatever its formula says."""
    sigma = np.array([float(row[k]) for k in ("sX_m", "sY_m", "sZ_m")])
    found = mean_precision(np.diag(sigma**2)[None], np.zeros((1, 3)))
    assert found.arithmetic == pytest.approx(float(row["sC_m"]), abs=1.01e-4)
    assert found.root_mean_square >= found.arithmetic
    if row["test"] == "16":
        assert found.root_mean_square == pytest.approx(0.0151, abs=5e-5)


def test_mean_precision_of_two_points() -> None:
    """Standard deviations 1, 2, 2 and 3, 4, 5: means 17/6, and sqrt(59/6)."""
    sigma = np.array([[1.0, 2.0, 2.0], [3.0, 4.0, 5.0]])
    found = mean_precision(np.array([np.diag(s**2) for s in sigma]), np.array([[0.0, 0, 0], [3.0, 17, 1]]))
    assert found.arithmetic == pytest.approx(17 / 6)
    assert found.root_mean_square == pytest.approx((59 / 6) ** 0.5)
    assert found.arithmetic_by_axis == pytest.approx([2.0, 3.0, 3.5])
    assert found.root_mean_square_by_axis == pytest.approx([5**0.5, 10**0.5, 14.5**0.5])
    assert found.spread_by_axis == pytest.approx([2.0, 2.0, 3.0])
    assert (found.spread, found.spread_in_plane) == pytest.approx((4.0, 3.0))
    assert found.proportional == pytest.approx(17 / (17 / 6))


def test_proportional_precision_of_the_tank_study() -> None:
    """Precision of 13 m to 0.001 m: 1 part in 13 000."""
    tank = np.array([[0.0, 0.0, 0.0], [13.0, 9.5, 13.0]])
    assert mean_precision(np.array([np.eye(3) * 0.001**2] * 2), tank).proportional == pytest.approx(13_000.0)


def test_error_sphere_has_the_volume_of_the_ellipsoid() -> None:
    """Of one sigma always below the quadratic standard deviation, as the tank study says."""
    one_sigma = float(chi2.cdf(1.0, 3))
    covariance = np.array([np.diag([0.04, 0.01, 0.0025]), np.eye(3)])
    radius = spheres(ellipsoids(covariance, one_sigma)[0])
    assert radius == pytest.approx([(0.2 * 0.1 * 0.05) ** (1 / 3), 1.0])
    assert (radius < np.sqrt(np.trace(covariance, axis1=1, axis2=2))).all()


def test_hottier_factor_by_simulation() -> None:
    """Residuals of a fit of r parameters to p n values are too small by K, which fresh values show."""
    rng = np.random.default_rng(5)
    design = rng.standard_normal((24, 8))
    noise = rng.standard_normal((20_000, 24))
    left = noise - noise @ np.linalg.pinv(design).T @ design.T
    factor = hottier_factor(24, 8)
    assert factor == pytest.approx(1.5**0.5)
    assert factor * np.sqrt(np.mean(left**2)) == pytest.approx(1.0, abs=0.005)
    assert hottier_factor(8, 8) is None


@pytest.mark.parametrize("probability", [0.5, 0.95])
def test_coverage(probability: float) -> None:
    """As many samples fall inside as the probability says."""
    rng = np.random.default_rng(8)
    root = np.array([[2.0, 0, 0], [1.5, 1, 0], [-0.5, 0.7, 0.3]])
    covariance = (root @ root.T)[None]
    sample = rng.standard_normal((100_000, 3)) @ root.T
    axes, directions = ellipsoids(covariance, probability)
    inside = np.sum((sample @ directions[0].T / axes[0]) ** 2, axis=1) < 1
    assert inside.mean() == pytest.approx(probability, abs=0.006)
    axes, azimuth = ellipses(covariance, probability)
    s, c = np.sin(azimuth[0]), np.cos(azimuth[0])
    along, across = sample[:, :2] @ [s, c], sample[:, :2] @ [c, -s]
    inside = (along / axes[0, 0]) ** 2 + (across / axes[0, 1]) ** 2 < 1
    assert inside.mean() == pytest.approx(probability, abs=0.006)


@given(
    st.floats(0, np.pi - 1e-6),
    st.floats(0.01, 10),
    st.floats(1.01, 20),
)
def test_ellipse_by_construction(azimuth: float, minor: float, ratio: float) -> None:
    """Built from its axes: the larger one towards an azimuth from Y."""
    along = np.array([np.sin(azimuth), np.cos(azimuth)])
    across = np.array([along[1], -along[0]])
    major = minor * ratio
    matrix = major**2 * np.outer(along, along) + minor**2 * np.outer(across, across)
    # 1 - exp(-1/2): the ellipse of one standard deviation.
    axes, found = ellipses(matrix[None], 0.39346934)
    assert axes[0] == pytest.approx([major, minor], rel=1e-6)
    difference = (found[0] - azimuth + np.pi / 2) % np.pi - np.pi / 2
    assert abs(difference) < 1e-6


@given(st.integers(0, 2**32 - 1))
def test_ellipsoid_by_construction(seed: int) -> None:
    rng = np.random.default_rng(seed)
    axes = np.sort(rng.uniform(0.1, 5, 3))[::-1] + np.array([0.2, 0.1, 0.0])
    turn = Rotation.random(rng=rng).as_matrix()
    semi_axes, directions = ellipsoids((turn.T * axes**2 @ turn)[None], 0.95)
    assert semi_axes[0] == pytest.approx(axes * enlargement(0.95, 3), rel=1e-8)
    assert np.abs(np.sum(directions[0] * turn, axis=1)) == pytest.approx(np.ones(3), abs=1e-6)
    az, el = azimuth_and_elevation(directions[0])
    rebuilt = np.column_stack([np.cos(el) * np.sin(az), np.cos(el) * np.cos(az), np.sin(el)])
    assert rebuilt == pytest.approx(directions[0], abs=1e-12)
    assert (el >= 0).all()


def test_circle_and_held_point() -> None:
    axes, azimuth = ellipses(np.array([np.eye(3), np.zeros((3, 3))]), 0.95)
    assert azimuth.tolist() == [0.0, 0.0]
    assert axes[1].tolist() == [0.0, 0.0]
