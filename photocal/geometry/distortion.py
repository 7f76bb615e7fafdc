"""Distortion of whole sets of points: correction and projection."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from photocal.base.arrays import Floats, Integers
from photocal.geometry.camera import AFFINITY_MATRICES, MM, Camera
from photocal.geometry.lens import all_directions, all_recorded, optics


def focused(near: Camera, far: Camera, focus_m: float) -> Camera:
    """Camera focused to a distance, its radial distortion from calibrations at two others.

    returns: `near` with K1 to K4 and `focus_m` of that focus: each divided by (1 - c/s)^(2n+1) varies with
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


def affinity_matrix(camera: Camera) -> Floats:
    """Matrix F, shape (2, 2), of the affinity: x becomes (I + F) x where it acts."""
    first, second = AFFINITY_MATRICES[camera.affinity_form]
    b1, b2 = camera.values[11:13]
    return np.asarray(b1 * np.array(first, dtype=float) + b2 * np.array(second, dtype=float))


def undistorted(camera: Camera, measured: Floats) -> Floats:
    """Correct measured image coordinates to those of a perfect central projection.

    measured (n, 2): image plane coordinates in the camera's unit.
    returns (n, 2): p = -c (u, v)/w, from the principal point; NaN where the camera sees nothing, and at 90
        degrees off its axis or more.
    """
    q = np.empty((len(measured), 3))
    plane = np.ascontiguousarray(measured, dtype=float)
    all_directions(camera.values[None], optics(camera)[None], 0, camera.lens.angular, plane, q)
    q[~(q[:, 2] < 0)] = np.nan
    return np.asarray(-camera.values[0] * q[:, :2] / q[:, 2:])


def slopes_of(cameras: Sequence[Camera], camera: Integers, plane: Floats) -> Floats:
    """Slopes (u, v)/-w, shape (n, 2), of what several cameras have measured; `camera` (n,): which of them."""
    slopes = np.empty(plane.shape)
    # Sorted by camera: thousands of them would each pass through all rays.
    order = np.argsort(camera, kind="stable")
    first = np.searchsorted(camera[order], np.arange(len(cameras) + 1))
    for k, interior in enumerate(cameras):
        if first[k] < first[k + 1]:
            own = order[first[k] : first[k + 1]]
            slopes[own] = undistorted(interior, plane[own]) / interior.value("c")
    return slopes


def distorted(camera: Camera, ideal: Floats) -> Floats:
    """Image coordinates at which the camera records ideal ones, the inverse of `undistorted`.

    ideal (n, 2): p = -c (u, v)/w, from the principal point.
    returns (n, 2): image plane coordinates in the camera's unit; NaN where the lens records nothing.
    """
    q = np.column_stack([ideal / camera.values[0], np.full(len(ideal), -1.0)])
    return projected(camera, q * (camera.focus_m or 1.0))


def projected(camera: Camera, q: Floats) -> Floats:
    """Project points in camera axes to measured image coordinates.

    q (n, 3): points in camera axes (x right, y up, z backwards), m; those in front have q_z < 0.
    returns (n, 2): image plane coordinates in the camera's unit; NaN for points that the lens does not see.
    """
    plane = np.empty((len(q), 2))
    points = np.ascontiguousarray(q, dtype=float)
    all_recorded(camera.values[None], optics(camera)[None], 0, points, plane)
    return plane


def polynomial_distortion(camera: Camera, plane: Floats) -> Floats:
    """What the model adds to the projection at ideal places (n, 2), without principal point and affinity."""
    return distorted(_centred(camera), plane) - plane


def radial_profile(camera: Camera, radius: Floats) -> Floats:
    """How far beyond a radius (n,) a ray is recorded, radial terms alone, in the camera's unit.

    The ray has the tangent r/c off the axis or, in a fisheye, the angle r/c.
    """
    bare = _centred(camera).changed(**dict.fromkeys(("P1", "P2", "P3", "P4", "S1", "S2", "S3", "S4"), 0.0))
    ray, wide = radius / camera.value("c"), camera.lens.angular
    across, along = (np.sin(ray), np.cos(ray)) if wide else (ray, np.ones_like(ray))
    q = np.column_stack([across, np.zeros_like(ray), -along]) * (camera.focus_m or 1.0)
    return np.asarray(projected(bare, q)[:, 0] - radius)


def radial_profile_sigma(camera: Camera, radius: Floats) -> Floats:
    """Standard deviation of the radial profile of an adjusted camera, shape (n,), by differences."""
    names = [name for name in camera.free if name.startswith("K") and camera.sigma_of(name) > 0]
    # By the steps of one sigma each: what they move, correlated as they are.
    moved = np.zeros((len(radius), len(names)))
    for k, n in enumerate(names):
        ends = (camera.changed(**{n: camera.value(n) + side * camera.sigma_of(n)}) for side in (1, -1))
        more, less = (radial_profile(end, radius) for end in ends)
        moved[:, k] = (more - less) / 2
    variance = np.einsum("ni,ij,nj->n", moved, camera.correlation_of(names), moved)
    return np.asarray(np.sqrt(np.maximum(variance, 0.0)))


def _centred(camera: Camera) -> Camera:
    """The same lens without principal point and affinity; Brown's polynomial as it distorts ideal places."""
    bare = camera.changed(x0=0.0, y0=0.0, B1=0.0, B2=0.0)
    return bare if camera.lens.relative else replace(bare, model="brown-ideal")
