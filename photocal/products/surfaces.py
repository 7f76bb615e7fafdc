"""Circles and cylinders through measured points, with the covariance of the points."""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from photocal.base.arrays import Floats
from photocal.base.errors import IllPosedError, InputMalformedError, NotConvergedError

# Value of each point's condition (n,), its derivatives to the parameters (n, u) and to the point (n, d).
Condition = Callable[[Floats, Floats], tuple[Floats, Floats, Floats]]


@dataclass(frozen=True)
class AdjustedSurface:
    """What the adjustment found.

    state: parameters of the surface, in its own order.
    covariance (u, u): of the steps of the parameters, with the a priori variance factor 1.
    influence (u, n, d): derivative of the parameters to each coordinate of each point.
    """

    state: Floats
    covariance: Floats
    influence: Floats
    chi_squared: float
    degrees_of_freedom: int

    @property
    def variance_factor(self) -> float:
        """Variance factor a posteriori; NaN without redundancy."""
        return self.chi_squared / self.degrees_of_freedom if self.degrees_of_freedom else float("nan")


def fit(
    points: Floats,
    covariance: Floats,
    start: Floats,
    condition: Condition,
    moved: Callable[[Floats, Floats], Floats],
    what: str,
) -> AdjustedSurface:
    """Fit a surface so that every point, corrected within its covariance, lies on it.

    Helmert (1872); in the form of Pope (1972) with the misclosure reduced to the measured points.
    """
    residuals = np.zeros_like(points)
    state = start
    iterations = 100
    # A step is over when it is this small against the standard deviation of what it moves.
    negligible = 1e-7
    for _ in range(iterations):
        value, by_parameter, by_point = condition(state, points + residuals)
        count, unknowns = by_parameter.shape
        misclosure = value - np.einsum("ni,ni->n", by_point, residuals)
        variance = np.einsum("ni,nij,nj->n", by_point, covariance, by_point)
        if not (variance > 0).all():
            raise InputMalformedError(
                f"point {int(np.argmin(variance)) + 1} of the {what} has no variance across it",
                "give every point a positive standard deviation",
            )
        cofactor = _inverse(by_parameter.T @ (by_parameter / variance[:, None]), what)
        step = -cofactor @ (by_parameter.T @ (misclosure / variance))
        state = moved(state, step)
        correlate = -(misclosure + by_parameter @ step) / variance
        across = np.einsum("nij,nj->ni", covariance, by_point)
        before, residuals = residuals, across * correlate[:, None]
        settled = np.abs(step) <= negligible * np.sqrt(np.diag(cofactor))
        moved_points = np.abs(np.einsum("ni,ni->n", by_point, residuals - before))
        if settled.all() and (moved_points <= 10 * negligible * np.sqrt(variance)).all():
            influence = -np.einsum("uv,nv,ni->uni", cofactor, by_parameter / variance[:, None], by_point)
            chi_squared = float(correlate**2 @ variance)
            return AdjustedSurface(state, cofactor, influence, chi_squared, count - unknowns)
    raise NotConvergedError(
        f"the fit of the {what} did not converge within {iterations} iterations",
        "are the points on such a surface, and their sigmas in metres?",
    )


def _inverse(normal: Floats, what: str) -> Floats:
    scale = np.sqrt(np.diag(normal))
    if (scale > 0).all() and np.isfinite(normal).all():
        scaled = normal / np.outer(scale, scale)
        if np.linalg.eigvalsh(scaled)[0] > 1e-12:
            return np.asarray(np.linalg.inv(scaled) / np.outer(scale, scale))
    raise IllPosedError(
        f"the points leave a parameter of the {what} undetermined", "spread the points over it"
    )


@dataclass(frozen=True)
class Circle:
    """A circle in a plane.

    covariance (3, 3): of centre and radius, m2, a priori.
    radial (n,): distance of each measured point from the circle, outwards positive, m.
    direction (n,): of each measured point from the centre, from the first axis towards the second, radians.
    """

    center: Floats
    radius: float
    covariance: Floats
    radial: Floats
    direction: Floats
    adjusted: AdjustedSurface


@dataclass(frozen=True)
class Cylinder:
    """A circular cylinder without ends.

    point (3,): point of the axis beside the centroid of the measured points, m.
    axis (3,): unit vector; the largest of its components is positive.
    axis_covariance (3, 3): a priori; singular along the axis.
    radius_sigma: m, a priori.
    """

    point: Floats
    axis: Floats
    radius: float
    axis_covariance: Floats
    radius_sigma: float
    adjusted: AdjustedSurface


def fit_circle(points: Floats, covariance: Floats) -> Circle:
    """Fit a circle."""
    middle = _centroid(points, 3, "circle")
    local = points - middle
    fitted = fit(local, covariance, _algebraic_circle(local), _circle_condition, np.add, "circle")
    center, radius = fitted.state[:2], float(fitted.state[2])
    away = local - center
    radial = np.linalg.norm(away, axis=1) - radius
    turn = np.arctan2(away[:, 1], away[:, 0])
    return Circle(center + middle, radius, fitted.covariance, radial, turn, fitted)


def fit_cylinder(points: Floats, covariance: Floats) -> Cylinder:
    """Fit a circular cylinder."""
    middle = _centroid(points, 5, "cylinder")
    local = points - middle
    fitted = fit(local, covariance, _cylinder_start(local), _cylinder_condition, _cylinder_moved, "cylinder")
    point, axis, radius = fitted.state[:3], fitted.state[3:6], float(fitted.state[6])
    basis = _across(axis)
    covariances = fitted.covariance
    return Cylinder(
        point - (point @ axis) * axis + middle,
        np.asarray(axis * np.sign(axis[int(np.argmax(np.abs(axis)))])),
        radius,
        basis.T @ covariances[2:4, 2:4] @ basis,
        float(np.sqrt(covariances[4, 4])),
        fitted,
    )


def _centroid(points: Floats, least: int, what: str) -> Floats:
    if len(points) < least:
        raise IllPosedError(f"{len(points)} points do not determine a {what}", f"give at least {least}")
    return np.asarray(points.mean(axis=0))


def _algebraic_circle(points: Floats) -> Floats:
    """Start values: the circle of Kasa (1976), linear in its coefficients."""
    design = np.column_stack([2 * points, np.ones(len(points))])
    (x, y, c), _, rank, _ = np.linalg.lstsq(design, (points**2).sum(axis=1), rcond=1e-10)
    if rank < 3:
        raise IllPosedError("the points of the circle lie on a line", "spread them over the circle")
    return np.array([x, y, np.sqrt(c + x * x + y * y)])


def _circle_condition(state: Floats, points: Floats) -> tuple[Floats, Floats, Floats]:
    away = points - state[:2]
    distance = np.linalg.norm(away, axis=1)
    outward = away / distance[:, None]
    return distance - state[2], np.column_stack([-outward, -np.ones(len(points))]), outward


def _across(direction: Floats) -> Floats:
    """Two unit vectors, shape (2, 3), at right angles to a direction and to each other."""
    helper = np.eye(3)[int(np.argmin(np.abs(direction)))]
    first = np.cross(direction, helper)
    first /= np.linalg.norm(first)
    return np.array([first, np.cross(direction, first)])


def _radii(points: Floats, point: Floats, axis: Floats) -> tuple[Floats, Floats, Floats]:
    """Distance from an axis, unit vector away from it, and distance along it."""
    away = points - point
    along = away @ axis
    away = away - along[:, None] * axis
    distance = np.linalg.norm(away, axis=1)
    return distance, away / distance[:, None], along


def _cylinder_condition(state: Floats, points: Floats) -> tuple[Floats, Floats, Floats]:
    distance, outward, along = _radii(points, state[:3], state[3:6])
    sideways = outward @ _across(state[3:6]).T
    by_parameter = np.column_stack([-sideways, -along[:, None] * sideways, -np.ones(len(points))])
    return distance - state[6], by_parameter, outward


def _cylinder_moved(state: Floats, step: Floats) -> Floats:
    point = state[:3] + step[:2] @ _across(state[3:6])
    axis = state[3:6] + step[2:4] @ _across(state[3:6])
    axis = axis / np.linalg.norm(axis)
    # The axis' foot beside the centroid keeps position and direction apart.
    return np.concatenate([point - (point @ axis) * axis, axis, [state[6] + step[4]]])


def _cylinder_start(points: Floats) -> Floats:
    """Of the three principal directions, the one along which the points look most like a circle."""
    best, least = None, np.inf
    for axis in np.linalg.svd(points, full_matrices=True)[2]:
        basis = _across(axis)
        flat = points @ basis.T
        try:
            circle = _algebraic_circle(flat)
        except IllPosedError:
            continue
        miss = float(np.ptp(np.linalg.norm(flat - circle[:2], axis=1)) / circle[2])
        if miss < least:
            best, least = np.concatenate([circle[:2] @ basis, axis, circle[2:]]), miss
    if best is None:
        raise IllPosedError("the points do not determine a cylinder", "spread them over its surface")
    return best
