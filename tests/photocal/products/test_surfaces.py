"""Fitted surfaces against a second minimiser, exact geometry and simulation."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray
from scipy.optimize import least_squares

from photocal.base.errors import IllPosedError, InputMalformedError
from photocal.products.surfaces import fit_circle, fit_cylinder

Floats = NDArray[np.float64]


def covariances(random: np.random.Generator, count: int, size: int, scale: float) -> Floats:
    """Full, different covariances of points."""
    root = random.normal(size=(count, size, size)) * scale
    return np.asarray(root @ np.swapaxes(root, 1, 2) + np.eye(size) * (0.3 * scale) ** 2)


def whitened(difference: Floats, covariance: Floats) -> Floats:
    root = np.linalg.cholesky(covariance)
    return np.asarray(np.linalg.solve(root, difference[..., None]))[..., 0].ravel()


def gram(jacobian: Any) -> Floats:
    return np.asarray(jacobian.T @ jacobian)


def test_circle_equals_a_least_squares_over_circle_and_feet() -> None:
    random = np.random.default_rng(1)
    angle = random.uniform(0, 4.5, 15)
    covariance = covariances(random, 15, 2, 0.02)
    exact = np.column_stack([3 + 2 * np.cos(angle), -7 + 2 * np.sin(angle)])
    points = exact + np.einsum("nij,nj->ni", np.linalg.cholesky(covariance), random.normal(size=(15, 2)))
    found = fit_circle(points, covariance)

    # The same minimum with a foot on the circle for every point as an unknown of its own.
    def misses(unknowns: Floats) -> Floats:
        x, y, r, feet = unknowns[0], unknowns[1], unknowns[2], unknowns[3:]
        on_circle = np.column_stack([x + r * np.cos(feet), y + r * np.sin(feet)])
        return whitened(on_circle - points, covariance)

    peer = least_squares(misses, np.concatenate([[3, -7, 2], angle]), xtol=1e-15, ftol=1e-15, gtol=1e-15)
    assert np.append(found.center, found.radius) == pytest.approx(peer.x[:3], abs=1e-7)
    assert found.adjusted.chi_squared == pytest.approx(2 * peer.cost, rel=1e-9)
    # Their first-order covariances differ by the curvature of the circle, small against its radius.
    inverse = np.linalg.inv(gram(peer.jac))[:3, :3]
    assert found.covariance == pytest.approx(inverse, abs=0.03 * inverse.max())


def test_cylinder_equals_a_least_squares_over_axis_and_feet() -> None:
    random = np.random.default_rng(3)
    count = 24
    covariance = covariances(random, count, 3, 0.01)
    angle, along = random.uniform(0, 5, count), random.uniform(-4, 4, count)

    def on_cylinder(u: Floats, angle: Floats, along: Floats) -> Floats:
        axis = np.array([u[2], u[3], 1]) / np.sqrt(1 + u[2] ** 2 + u[3] ** 2)
        first = np.cross(axis, [0, 1, 0])
        first /= np.linalg.norm(first)
        second = np.cross(axis, first)
        round_axis = np.outer(np.cos(angle), first) + np.outer(np.sin(angle), second)
        return np.asarray(np.array([u[0], u[1], 0]) + np.outer(along, axis) + u[4] * round_axis)

    truth = np.array([1.0, 2.0, 0.05, -0.08, 3.0])
    noise = np.einsum("nij,nj->ni", np.linalg.cholesky(covariance), random.normal(size=(count, 3)))
    points = on_cylinder(truth, angle, along) + noise
    found = fit_cylinder(points, covariance)

    def misses(u: Floats) -> Floats:
        return whitened(on_cylinder(u[:5], u[5 : 5 + count], u[5 + count :]) - points, covariance)

    start = np.concatenate([truth, angle, along])
    peer = least_squares(misses, start, xtol=1e-15, ftol=1e-15, gtol=1e-15)
    axis = np.array([peer.x[2], peer.x[3], 1]) / np.sqrt(1 + peer.x[2] ** 2 + peer.x[3] ** 2)
    assert found.axis == pytest.approx(axis, abs=1e-7)
    assert found.radius == pytest.approx(peer.x[4], abs=1e-7)
    assert found.adjusted.chi_squared == pytest.approx(2 * peer.cost, rel=1e-8)
    # The peer's point of the axis lies on ours.
    gap = np.array([peer.x[0], peer.x[1], 0]) - found.point
    assert np.linalg.norm(np.cross(gap, found.axis)) < 1e-6
    sigma = np.sqrt(np.linalg.inv(gram(peer.jac))[4, 4])
    assert found.radius_sigma == pytest.approx(sigma, rel=0.02)


def test_influence_is_the_derivative_to_the_points() -> None:
    random = np.random.default_rng(4)
    angle = random.uniform(0, 6, 9)
    covariance = covariances(random, 9, 2, 0.001)
    points = np.column_stack([np.cos(angle), np.sin(angle)]) + 0.001 * random.normal(size=(9, 2))
    found = fit_circle(points, covariance)
    step = 1e-5
    for row, column in ((0, 0), (4, 1)):
        moved = points.copy()
        moved[row, column] += step
        other = fit_circle(moved, covariance)
        change = np.append(other.center - found.center, other.radius - found.radius) / step
        assert found.adjusted.influence[:, row, column] == pytest.approx(change, abs=5e-3)


def test_variance_factor_and_radius_scatter_as_predicted() -> None:
    random = np.random.default_rng(5)
    angle = np.linspace(0, 2 * np.pi, 24, endpoint=False)
    exact = 6.479 * np.column_stack([np.cos(angle), np.sin(angle)])
    covariance = np.tile(np.eye(2) * 2.02e-4, (24, 1, 1))
    runs = [
        fit_circle(exact + np.sqrt(2.02e-4) * random.normal(size=(24, 2)), covariance) for _ in range(400)
    ]
    factors = np.array([run.adjusted.variance_factor for run in runs])
    assert factors.mean() == pytest.approx(1, abs=4 * np.sqrt(2 / 21 / 400))
    radii = np.array([run.radius for run in runs])
    assert radii.std(ddof=1) == pytest.approx(np.sqrt(runs[0].covariance[2, 2]), rel=0.15)


@settings(max_examples=30)
@given(
    center=st.tuples(st.floats(-1e6, 1e6), st.floats(-1e6, 1e6)),
    radius=st.floats(0.1, 100),
    span=st.floats(1.0, 6.2),
)
def test_exact_circles_are_found(center: tuple[float, float], radius: float, span: float) -> None:
    angle = np.linspace(0, span, 11)
    points = np.array(center) + radius * np.column_stack([np.cos(angle), np.sin(angle)])
    found = fit_circle(points, np.tile(np.eye(2) * 1e-6, (11, 1, 1)))
    assert found.center == pytest.approx(center, abs=1e-6)
    assert found.radius == pytest.approx(radius, abs=1e-6)


@pytest.mark.parametrize("count", [0, 2])
def test_too_few_points_are_refused(count: int) -> None:
    with pytest.raises(IllPosedError, match="do not determine a circle"):
        fit_circle(np.eye(2)[:count], np.tile(np.eye(2), (count, 1, 1)))


def test_points_on_a_line_are_refused() -> None:
    line = np.outer(np.arange(8.0), [1.0, 2.0, 3.0])
    unit = np.tile(np.eye(3), (8, 1, 1))
    with pytest.raises(IllPosedError, match="on a line"):
        fit_circle(line[:, :2], unit[:, :2, :2])
    with pytest.raises(IllPosedError, match="cylinder"):
        fit_cylinder(line, unit)


def test_a_point_without_variance_is_named() -> None:
    points = np.array([[1.0, 0.0], [0.0, 1.0], [-1.0, 0.0], [0.0, -1.0]])
    covariance = np.tile(np.eye(2), (4, 1, 1))
    covariance[2] = 0
    with pytest.raises(InputMalformedError, match="point 3"):
        fit_circle(points, covariance)
