"""Distortion of whole sets of points: correction, projection and the radial curve."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from drivers.arrays import Floats
from photocal.geometry.camera import AFFINITY_MATRICES, MM, Camera


def scale_ratio(camera: Camera, distance_m: Floats) -> Floats:
    """Image scale at the distance of focus over that at the object's: what makes distortion vary."""
    if not camera.focus_m:
        return np.ones_like(distance_m)
    c = camera.values[0] / MM
    return np.asarray((1 - c / camera.focus_m) / (1 - c / distance_m))


def focused(near: Camera, far: Camera, focus_m: float) -> Camera:
    """Camera focused to a distance, its radial distortion from calibrations at two others.

    Returns
    -------
    Camera
        `near` with K1 to K4 and `focus_m` of that focus: each divided by (1 - c/s)^(2n+1) varies with
        the weight a = (s2 - s)/(s2 - s1) (s1 - c)/(s - c) (Brown 1971; Fryer 1988).
    """
    c = near.values[0] / MM
    a = (near.focus_m - c) / (focus_m - c)
    if np.isfinite(far.focus_m):
        a *= (far.focus_m - focus_m) / (far.focus_m - near.focus_m)
    power = 2 * np.arange(1, 5) + 1
    first = near.values[3:7] / (1 - c / near.focus_m) ** power
    second = far.values[3:7] / (1 - c / far.focus_m) ** power
    values = near.values.copy()
    values[3:7] = (1 - c / focus_m) ** power * (a * first + (1 - a) * second)
    return replace(near, values=values, focus_m=focus_m)


def polynomial_distortion(camera: Camera, plane: Floats, ratio: Floats | float = 1.0) -> Floats:
    """Radial and decentering distortion, without the affinity."""
    k1, k2, k3, k4, p1, p2, p3, p4 = camera.values[3:11]
    x, y = plane[:, 0], plane[:, 1]
    r2, s = x * x + y * y, camera.reference_radius**2
    radial = sum(k * ratio ** (2 * n) * (r2**n - s**n) for n, k in enumerate((k1, k2, k3, k4), start=1))
    swell = ratio * (1 + p3 * r2 + p4 * r2 * r2)
    dx = x * radial + (p1 * (r2 + 2 * x * x) + 2 * p2 * x * y) * swell
    dy = y * radial + (p2 * (r2 + 2 * y * y) + 2 * p1 * x * y) * swell
    return np.column_stack([dx, dy])


def affinity_matrix(camera: Camera) -> Floats:
    """Matrix F, shape (2, 2), of the affinity: x becomes (I + F) x where it acts."""
    first, second = AFFINITY_MATRICES[camera.affinity_form]
    b1, b2 = camera.values[11:13]
    return np.asarray(b1 * np.array(first, dtype=float) + b2 * np.array(second, dtype=float))


def _through(matrix: Floats, plane: Floats) -> Floats:
    """Multiply every point by a matrix."""
    return np.asarray(plane @ matrix.T, dtype=np.float64)


def undistorted(camera: Camera, measured: Floats, ratio: Floats | float = 1.0) -> Floats:
    """Correct measured image coordinates to those of a perfect central projection.

    measured (n, 2): image plane coordinates in the camera's unit.
    ratio (n,): from `scale_ratio`.

    Returns
    -------
    ndarray, shape (n, 2)
        p = -c (u, v)/w, from the principal point.
    """
    xb = np.asarray(measured - camera.values[1:3], dtype=np.float64)
    affine = np.asarray(np.eye(2) + affinity_matrix(camera), dtype=np.float64)
    if camera.model == "brown-observed":
        if camera.affinity == "additive":
            return xb - polynomial_distortion(camera, xb, ratio) - xb @ (affine - np.eye(2)).T
        if camera.affinity == "before":
            bent = _through(affine, xb)
            return np.asarray(bent - polynomial_distortion(camera, bent, ratio))
        return (xb - polynomial_distortion(camera, xb, ratio)) @ affine.T
    if camera.affinity == "before":
        xb = _through(affine, xb)
    elif camera.affinity == "after":
        xb = _through(np.asarray(np.linalg.inv(affine), dtype=np.float64), xb)
    extra = affine - np.eye(2) if camera.affinity == "additive" else np.zeros((2, 2))
    return _solve(lambda p: p + polynomial_distortion(camera, p, ratio) + p @ extra.T, xb)


def distorted(camera: Camera, ideal: Floats, ratio: Floats | float = 1.0) -> Floats:
    """Image coordinates at which the camera records ideal ones, the inverse of `undistorted`.

    ideal (n, 2): p = -c (u, v)/w, from the principal point.
    ratio (n,): from `scale_ratio`.

    Returns
    -------
    ndarray, shape (n, 2)
        Image plane coordinates in the camera's unit; NaN where the polynomial folds and no solution is
        found.
    """
    principal = camera.values[1:3]
    if camera.model == "brown-observed":
        return _solve(lambda x: undistorted(camera, x + principal, ratio), ideal) + principal
    affine = np.asarray(np.eye(2) + affinity_matrix(camera), dtype=np.float64)
    xb = np.asarray(ideal + polynomial_distortion(camera, ideal, ratio), dtype=np.float64)
    if camera.affinity == "additive":
        xb = xb + ideal @ (affine - np.eye(2)).T
    elif camera.affinity == "after":
        xb = _through(affine, xb)
    else:
        xb = _through(np.asarray(np.linalg.inv(affine), dtype=np.float64), xb)
    return xb + principal


def projected(camera: Camera, q: Floats) -> Floats:
    """Project points in camera axes to measured image coordinates.

    q (n, 3): points in camera axes (x right, y up, z backwards), m; visible ones have q_z < 0.

    Returns
    -------
    ndarray, shape (n, 2)
        Image plane coordinates in the camera's unit; NaN for points that are not in front.
    """
    with np.errstate(divide="ignore", invalid="ignore"):
        ideal = -camera.values[0] * q[:, :2] / q[:, 2:]
    ideal[q[:, 2] >= 0] = np.nan
    return distorted(camera, ideal, scale_ratio(camera, -q[:, 2]))


def radial_profile(camera: Camera, radius: Floats) -> Floats:
    """Radial distortion over the radius, shape (n,), in the camera's unit: r rad(r)."""
    along_x = np.column_stack([radius, np.zeros_like(radius)])
    radial_only = camera.values.copy()
    radial_only[7:11] = 0.0
    return polynomial_distortion(camera.with_values(radial_only), along_x)[:, 0]


def _solve(function: Callable[[Floats], Floats], target: Floats, tolerance: float = 1e-13) -> Floats:
    """Solve function(x) = target point by point with Newton's method."""
    scale = max(float(np.nanmax(np.abs(target), initial=1e-9)), 1e-9)
    step = 1e-6 * scale
    x = target.copy()
    for _ in range(50):
        value = function(x)
        columns = [(function(x + step * axis) - function(x - step * axis)) / (2 * step) for axis in np.eye(2)]
        a, c = columns[0].T
        b, d = columns[1].T
        miss = target - value
        determinant = a * d - b * c
        with np.errstate(divide="ignore", invalid="ignore"):
            change = np.column_stack(
                [
                    (d * miss[:, 0] - b * miss[:, 1]) / determinant,
                    (a * miss[:, 1] - c * miss[:, 0]) / determinant,
                ]
            )
        x = x + change
        if not np.any(np.abs(change) > tolerance * scale):
            break
    lost = ~(np.abs(function(x) - target).max(axis=1, initial=0) <= 1e-9 * scale)
    x[lost] = np.nan
    return x
