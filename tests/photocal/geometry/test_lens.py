"""The ray of every camera model: residual by definition, derivatives against numerical ones."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray

from photocal.geometry.camera import (
    AFFINITIES,
    AFFINITY_MATRICES,
    PARAMETERS,
    Affinity,
    AffinityForm,
    Camera,
    Model,
    camera,
)
from photocal.geometry.lens import Ray, optics, ray_residual, scratch
from tests.photocal import oracle

Floats = NDArray[np.float64]
BROWN: tuple[Model, ...] = ("brown-observed", "brown-ideal")
KINDS = [(m, a, f) for m in BROWN for a in AFFINITIES for f in AFFINITY_MATRICES]

# Magnitudes of strong lenses of about 20 mm; at r = 12 mm each term moves a point by up to a millimetre.
LARGEST = {
    "x0": 0.5, "y0": 0.5, "K1": 5e-4, "K2": 3e-6, "K3": 2e-8, "K4": 1e-10, "P1": 1e-3, "P2": 1e-3,
    "P3": 1e-3, "P4": 1e-5, "B1": 0.05, "B2": 0.05,
}  # fmt: skip


def _parameters() -> st.SearchStrategy[dict[str, float]]:
    terms = {name: st.floats(-size, size) for name, size in LARGEST.items()}
    return st.fixed_dictionaries({"c": st.floats(15, 25), **terms})


@st.composite
def rays(draw: st.DrawFn) -> tuple[dict[str, float], float, Floats, Floats]:
    """Parameters, R0, measured coordinates and a point in camera axes."""
    measured = np.array([draw(st.floats(-12, 12)), draw(st.floats(-9, 9))])
    depth = draw(st.floats(1, 1000))
    q = np.array([draw(st.floats(-0.6, 0.6)) * depth, draw(st.floats(-0.45, 0.45)) * depth, -depth])
    return draw(_parameters()), draw(st.sampled_from([0.0, 9.0])), measured, q


def evaluate(own: Camera, measured: Floats, q: Floats) -> tuple[Floats, Any]:
    room = scratch(0)
    (x, y), (a, b, c) = measured.tolist(), q.tolist()
    v = ray_residual(own.values[None], optics(own)[None], Ray(0, x, y, a, b, c), room)
    return np.array(v), room


def made(kind: tuple[Model, Affinity, AffinityForm], parameters: dict[str, float], r0: float) -> Camera:
    model, affinity, form = kind
    return camera(
        "a", model, "mm", (3000, 2000), (0.009, 0.009), parameters,
        reference_radius=r0, affinity=affinity, affinity_form=form,
    )  # fmt: skip


@pytest.mark.parametrize("kind", KINDS, ids="-".join)
@settings(max_examples=40)
@given(ray=rays())
def test_residual_and_derivatives(
    kind: tuple[Model, Affinity, AffinityForm], ray: tuple[dict[str, float], float, Floats, Floats]
) -> None:
    parameters, r0, measured, q = ray
    own = made(kind, parameters, r0)
    v, room = evaluate(own, measured, q)
    assert v == pytest.approx(oracle.residual(own, own.values, measured, q), abs=1e-11)
    by_camera = np.empty((2, len(PARAMETERS)))
    for n in range(len(PARAMETERS)):
        # The definition is a polynomial: a complex step differentiates it exactly.
        moved = own.values.astype(complex)
        moved[n] += 1e-30j
        by_camera[:, n] = np.array(oracle.residual(own, moved, measured, q)).imag / 1e-30
    by_q = np.empty((2, 3))
    for n in range(3):
        place = q.astype(complex)
        place[n] += 1e-30j
        by_q[:, n] = np.array(oracle.residual(own, own.values, measured, place)).imag / 1e-30
    # Near the reference radius K is multiplied by a small difference of two large powers of the radius.
    reach, rounding = max(float(np.hypot(*(measured - own.values[1:3]))), r0), np.zeros(len(PARAMETERS))
    for k in range(4):
        rounding[PARAMETERS.index(f"K{k + 1}")] = 4 * np.finfo(float).eps * reach ** (2 * k + 3)
    away = np.abs(room.by_camera[:, : len(PARAMETERS)] - by_camera)
    assert (away <= 1e-10 + 1e-10 * np.abs(by_camera) + rounding).all()
    assert room.by_q == pytest.approx(by_q, rel=1e-10, abs=1e-11)
    assert room.depth[0] == -q[2]


@pytest.mark.parametrize("kind", KINDS, ids="-".join)
@settings(max_examples=15)
@given(ray=rays(), focus_m=st.floats(0.3, 20.0), distance=st.floats(0.3, 20.0))
def test_distortion_that_varies_with_the_distance(
    kind: tuple[Model, Affinity, AffinityForm],
    ray: tuple[dict[str, float], float, Floats, Floats],
    focus_m: float,
    distance: float,
) -> None:
    parameters, r0, measured, q = ray
    own = replace(made(kind, parameters, r0), focus_m=focus_m)
    q = q * distance / -q[2]
    v, room = evaluate(own, measured, q)
    assert v == pytest.approx(oracle.residual(own, own.values, measured, q), abs=1e-10)
    for n in range(len(PARAMETERS)):
        moved = own.values.astype(complex)
        moved[n] += 1e-30j
        numerical = np.array(oracle.residual(own, moved, measured, q)).imag / 1e-30
        assert room.by_camera[:, n] == pytest.approx(numerical, rel=1e-9, abs=1e-9)
    for n in range(3):
        place = q.astype(complex)
        place[n] += 1e-30j
        numerical = np.array(oracle.residual(own, own.values, measured, place)).imag / 1e-30
        assert room.by_q[:, n] == pytest.approx(numerical, rel=1e-9, abs=1e-9)


def test_derivatives_against_differences_of_the_residual_itself() -> None:
    parameters = {"c": 20.0} | {name: size / 2 for name, size in LARGEST.items()}
    measured, q = np.array([7.0, -5.0]), np.array([3.0, -2.5, -10.0])
    for kind in KINDS:
        own = made(kind, parameters, 8.0)
        _, room = evaluate(own, measured, q)
        for n, name in enumerate(PARAMETERS):
            step = np.zeros(len(PARAMETERS))
            step[n] = 1e-4 * LARGEST.get(name, 1.0)
            up, _ = evaluate(own.with_values(own.values + step), measured, q)
            down, _ = evaluate(own.with_values(own.values - step), measured, q)
            numerical = (up - down) / (2 * step[n])
            assert room.by_camera[:, n] == pytest.approx(numerical, rel=1e-5, abs=1e-6), (kind, name)


@pytest.mark.parametrize(
    ("measured", "expected"),
    [
        # c = 20, q = (1, 2, -10): p = (2, 4). At (3, 4): r^2 = 25, radial 0.01 * 25 = 0.25,
        # d = (3 * 0.25 + 0.001 * (25 + 18), 4 * 0.25 + 2 * 0.001 * 12).
        ((3.0, 4.0), (2 + 0.75 + 0.043 - 3, 4 + 1.0 + 0.024 - 4)),
        ((0.0, 0.0), (2.0, 4.0)),
    ],
)
def test_observed_residual_by_hand(measured: tuple[float, float], expected: tuple[float, float]) -> None:
    own = camera("a", "brown-observed", "mm", (9, 9), (1, 1), {"c": 20.0, "K1": 0.01, "P1": 0.001})
    v, _ = evaluate(own, np.array(measured), np.array([1.0, 2.0, -10.0]))
    assert v == pytest.approx(expected, abs=1e-14)


def test_ideal_residual_by_hand() -> None:
    # p = (2, 4), r^2 = 20, radial 0.2: x = 0.5 + 2.4 + 0.001 * 2 * 8, y = 4.8 + 0.001 * (20 + 32).
    own = camera("a", "brown-ideal", "mm", (9, 9), (1, 1), {"c": 20.0, "x0": 0.5, "K1": 0.01, "P2": 0.001})
    v, _ = evaluate(own, np.array([0.0, 0.0]), np.array([1.0, 2.0, -10.0]))
    assert v == pytest.approx((0.5 + 2.4 + 0.016, 4.8 + 0.052), abs=1e-14)
