"""Conversions between camera models: exact where models are the same, residual stated elsewhere."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from photocal.base.errors import InputMalformedError
from photocal.exchange.pinhole import from_pinhole, to_pinhole
from photocal.geometry.camera import Camera, Model, camera, plane_to_pixel
from photocal.geometry.conversion import converted, in_pixels, require_no_skew, unbalanced
from photocal.geometry.distortion import projected

RAYS = np.column_stack([*np.random.default_rng(5).uniform(-0.4, 0.4, (2, 200)), -np.ones(200)])
VALUES = {
    "c": 20.5,
    "x0": -0.22,
    "y0": 0.18,
    "K1": -2.75e-4,
    "K2": 2.7e-7,
    "K3": 9e-10,
    "P1": 1e-5,
    "P2": 5e-6,
}


def pixels(own: Camera) -> np.ndarray:
    return plane_to_pixel(own.size_px, own.pitch, projected(own, RAYS.copy()))


def made(model: Model, **keys: object) -> Camera:
    base = {"affinity": "after" if model == "brown-ideal" else "before"} | keys
    return camera("a", model, "mm", (3060, 2036), (0.009, 0.009), VALUES | {"B1": 1e-4, "B2": 2e-5}, **base)  # type: ignore[arg-type]


@pytest.mark.parametrize("model", ["brown-observed", "brown-ideal", "rational"])
def test_the_shutter_is_no_matter_of_the_lens(model: Model) -> None:
    still, rolls = (
        camera("a", "brown-observed", "mm", (3060, 2036), (0.009, 0.009), VALUES | {"readout": readout})
        for readout in (0.0, 0.03)
    )
    other = converted(rolls, model).camera
    assert other.value("readout") == 0.03
    assert other.changed(readout=0.0).values == pytest.approx(converted(still, model).camera.values, abs=0)


@pytest.mark.parametrize("model", ["brown-observed", "brown-ideal"])
@pytest.mark.parametrize("pitch", [(0.009, 0.009), (0.009, 0.0091)])
def test_pixels_of_a_camera_in_px_are_those_in_mm(model: Model, pitch: tuple[float, float]) -> None:
    own = replace(made(model), pitch=pitch)
    assert np.abs(pixels(in_pixels(own)) - pixels(own)).max() < 1e-9


@pytest.mark.parametrize("affinity", ["additive", "before", "after"])
@pytest.mark.parametrize("model", ["brown-observed", "brown-ideal"])
def test_balanced_and_plain_polynomial_are_the_same_camera(model: Model, affinity: str) -> None:
    own = replace(made(model, affinity=affinity), reference_radius=9.0)
    plain = unbalanced(own)
    assert plain.reference_radius == 0
    assert plain.value("c") != own.value("c")
    assert np.abs(pixels(plain) - pixels(own)).max() < 1e-9


def test_same_model_loses_nothing() -> None:
    own = made("brown-ideal")
    conversion = converted(own, "brown-ideal")
    assert conversion.largest_px == 0
    assert np.array_equal(conversion.camera.values, own.values)


@pytest.mark.parametrize("target", ["brown-observed", "brown-ideal"])
def test_stated_residual_is_the_distance_of_the_image_points(target: Model) -> None:
    source: Model = "brown-ideal" if target == "brown-observed" else "brown-observed"
    own = made(source)
    conversion = converted(own, target, "additive")
    apart = np.hypot(*(pixels(conversion.camera) - pixels(own)).T)
    assert 0 < conversion.rms_px < 0.05
    assert apart.max() <= conversion.largest_px * 1.01
    # Sign errors would show as the distortion itself: many pixels.
    assert conversion.largest_px < 0.5


def test_skew_has_no_place_in_a_pinhole() -> None:
    with pytest.raises(InputMalformedError, match="skew"):
        require_no_skew(made("brown-ideal"), "COLMAP")


small = st.floats(-1, 1, allow_nan=False)


@given(st.tuples(*[small] * 7), st.floats(0.5, 2), st.floats(0.9, 1.1))
@settings(max_examples=60)
def test_pinhole_round_trip(unit: tuple[float, ...], focal: float, aspect: float) -> None:
    c = 3000 * focal
    scale = np.array([50, 50, 0.2 / c**2, 0.2 / c**4, 0.2 / c**6, 1e-3 / c, 1e-3 / c])
    names = ("x0", "y0", "K1", "K2", "K3", "P1", "P2")
    values = dict(zip(names, np.multiply(unit, scale).tolist(), strict=True)) | {"c": c, "B1": aspect - 1}
    own = camera("a", "brown-ideal", "px", (4000, 3000), (1, 1), values, affinity="after")
    pinhole, conversion = to_pinhole(own, "OpenCV")
    assert conversion.largest_px == 0
    again = from_pinhole(pinhole, "a", "here")
    np.testing.assert_allclose(again.values, own.values, rtol=1e-9, atol=1e-12)
