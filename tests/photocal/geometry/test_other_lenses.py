"""Lens models beside Brown's: against OpenCV, against their definition, there and back."""

from __future__ import annotations

from typing import Any

import cv2
import numpy as np
import pytest
from numpy.typing import NDArray

from photocal.geometry.camera import AFFINITY_MATRICES, PARAMETERS, Camera, Model, camera, plane_to_pixel
from photocal.geometry.distortion import distorted, projected, undistorted
from photocal.geometry.lens import Ray, optics, other_residual, scratch
from tests.photocal import oracle

Floats = NDArray[np.float64]

SIZE = (4000, 3000)
COMMON = {"c": 1500.0, "x0": 12.0, "y0": -7.0, "B1": 0.003, "B2": -0.002}
COEFFICIENTS: dict[Model, dict[str, float]] = {
    "rational": {
        "K1": 0.21, "K2": -0.12, "K3": 0.03, "K4": 0.25, "K5": -0.06, "K6": 0.015,
        "P1": 1e-3, "P2": -7e-4, "S1": 5e-4, "S2": -3e-4, "S3": 4e-4, "S4": 2e-4,
    },
    "equidistant": {"K1": -0.03, "K2": 0.01, "K3": -0.004, "K4": 0.0006},
    "pix4d-fisheye": {"K1": 0.02, "K2": -0.15, "K3": 0.01},
}  # fmt: skip


def lens(model: Model, **changed: Any) -> Camera:
    parameters = COMMON | COEFFICIENTS[model]
    return camera("a", model, "px", SIZE, (1.0, 1.0), parameters, **changed)


def rays(widest: float) -> Floats:
    """Points in camera axes up to an angle off the axis, at different distances, one on the axis."""
    rng = np.random.default_rng(4)
    angle, turn = widest * np.sqrt(rng.random(60)), rng.uniform(0, 2 * np.pi, 60)
    angle[0] = 0.0
    q = np.column_stack([np.sin(angle) * np.cos(turn), np.sin(angle) * np.sin(turn), -np.cos(angle)])
    return q * rng.uniform(1, 100, (60, 1))


@pytest.mark.parametrize("model", COEFFICIENTS)
@pytest.mark.parametrize("form", AFFINITY_MATRICES)
def test_residual_and_derivatives(model: Model, form: Any) -> None:
    own, room = lens(model, affinity_form=form), scratch(0)
    assert own.affinity == "after"
    for q in rays(0.9 if model == "rational" else 1.9)[1:]:
        a, b, c = q.tolist()
        v = other_residual(own.values[None], optics(own)[None], Ray(0, 3.0, -4.0, a, b, c), room)
        measured = np.array([3.0, -4.0])
        assert v == pytest.approx(oracle.residual(own, own.values, measured, q), abs=1e-9)
        for n, name in enumerate(PARAMETERS[:-1]):
            moved = own.values.astype(complex)
            moved[n] += 1e-30j
            exact = np.array(oracle.residual(own, moved, measured, q)).imag / 1e-30
            if name in own.lens.names:
                assert room.by_camera[:, n] == pytest.approx(exact, rel=1e-10, abs=1e-9), name
            else:
                assert not exact.any(), name
        for n in range(3):
            place = q.astype(complex)
            place[n] += 1e-30j
            exact = np.array(oracle.residual(own, own.values, measured, place)).imag / 1e-30
            assert room.by_q[:, n] == pytest.approx(exact, rel=1e-9, abs=1e-9)


@pytest.mark.parametrize("model", COEFFICIENTS)
def test_on_the_axis_derivatives_are_those_beside_it(model: Model) -> None:
    own, room, beside = lens(model), scratch(0), scratch(0)
    other_residual(own.values[None], optics(own)[None], Ray(0, 0.0, 0.0, 0.0, 0.0, -5.0), room)
    other_residual(own.values[None], optics(own)[None], Ray(0, 0.0, 0.0, 1e-7, 2e-7, -5.0), beside)
    assert room.by_q == pytest.approx(beside.by_q, abs=1e-4)
    assert room.by_camera == pytest.approx(beside.by_camera, abs=1e-4)


@pytest.mark.parametrize("model", COEFFICIENTS)
def test_there_and_back(model: Model) -> None:
    own, q = lens(model), rays(0.9 if model == "rational" else 1.3)
    plane = projected(own, q)
    ideal = -own.value("c") * q[:, :2] / q[:, 2:]
    assert undistorted(own, plane) == pytest.approx(ideal, rel=1e-10, abs=1e-8)
    assert distorted(own, ideal) == pytest.approx(plane, abs=1e-8)


def test_a_fisheye_sees_beside_itself() -> None:
    beside = projected(lens("equidistant"), np.array([[1.0, 0.2, 0.1], [0.0, -3.0, 1.0], [0.0, 0.0, 5.0]]))
    assert np.isfinite(beside).all(axis=1).tolist() == [True, True, False]
    assert np.isnan(undistorted(lens("equidistant"), beside[:2])).all()
    assert np.isnan(projected(lens("rational"), np.array([[1.0, 0.2, 0.1]]))).all()


def test_rational_and_thin_prism_are_those_of_opencv() -> None:
    own, q = lens("rational"), rays(0.8)
    v = own.value
    c, (width, height) = v("c"), SIZE
    # B1 and B2 stretch and shear after the lens; OpenCV has no shear.
    own = own.with_values(np.where(np.array(PARAMETERS) == "B2", 0.0, own.values))
    matrix = np.array(
        [[c * (1 + v("B1")), 0, v("x0") + (width - 1) / 2], [0, c, (height - 1) / 2 - v("y0")], [0, 0, 1]]
    )
    signs = {"P2": -1, "S3": -1, "S4": -1}
    names = ("K1", "K2", "P2", "P1", "K3", "K4", "K5", "K6", "S1", "S2", "S3", "S4")
    coefficients = np.array([v(name) * signs.get(name, 1) for name in names])
    seen, _ = cv2.projectPoints(q * [1, -1, -1], np.zeros(3), np.zeros(3), matrix, coefficients)
    assert plane_to_pixel(SIZE, (1, 1), projected(own, q)) == pytest.approx(seen[:, 0], abs=1e-8)


def test_equidistant_is_the_fisheye_of_opencv() -> None:
    own, q = lens("equidistant"), rays(1.4)
    v = own.value
    c, (width, height) = v("c"), SIZE
    matrix = np.array(
        [[c * (1 + v("B1")), 0, v("x0") + (width - 1) / 2], [0, c, (height - 1) / 2 - v("y0")], [0, 0, 1]]
    )
    # Its skew is that of y, which is down there.
    alpha = -v("B2") / (1 + v("B1"))
    k = np.array([v(f"K{n}") for n in range(1, 5)])
    points = (q * [1, -1, -1])[:, None]
    seen, _ = cv2.fisheye.projectPoints(points, np.zeros(3), np.zeros(3), matrix, k, alpha=alpha)
    assert plane_to_pixel(SIZE, (1, 1), projected(own, q)) == pytest.approx(seen[:, 0], abs=1e-8)


def test_pix4d_fisheye_by_hand() -> None:
    """At 45 degrees, half a right angle: C = c pi/2 times 0.5 + 0.1 / 4 - 0.2 / 8 + 0.3 / 16."""
    own = camera("a", "pix4d-fisheye", "px", SIZE, (1, 1), {"c": 1000.0, "K1": 0.1, "K2": -0.2, "K3": 0.3})
    ((x, y),) = projected(own, np.array([[2.0, 0.0, -2.0]]))
    assert (x, y) == pytest.approx((500 * np.pi * 0.51875, 0.0), abs=1e-9)
