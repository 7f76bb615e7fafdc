"""Residuals arrive in the image plane whatever they were observed in."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from photocal.geometry.camera import camera, pixel_to_plane
from photocal.report.sensor import SensorResiduals, thinned, to_plane

CAMERA = camera("a", "brown-observed", "mm", (4000, 3000), (0.003, 0.004), {"c": 20.0})


def test_pixels_become_millimetres_and_rows_turn_up() -> None:
    pixel, shifted = np.array([[100.0, 50.0]]), np.array([[101.5, 48.0]])
    found = to_plane(CAMERA, pixel, shifted - pixel, unit="px", axes="pixel")
    place, end = (pixel_to_plane((4000, 3000), (0.003, 0.004), p) for p in (pixel, shifted))
    assert found.place == pytest.approx(place)
    assert found.residual_px * [0.003, 0.004] == pytest.approx(end - place)


def test_photo_millimetres_stay() -> None:
    found = to_plane(CAMERA, np.array([[1.5, -2.0]]), np.array([[0.003, 0.002]]), unit="mm", axes="photo")
    assert found.place == pytest.approx(np.array([[1.5, -2.0]]))
    assert found.residual_px == pytest.approx(np.array([[1.0, 0.5]]))


def test_photo_pixels_scale_to_a_camera_in_millimetres() -> None:
    found = to_plane(CAMERA, np.array([[10.0, -10.0]]), np.array([[0.5, 0.5]]), unit="px", axes="photo")
    assert found.place == pytest.approx(np.array([[0.03, -0.04]]))
    assert found.residual_px == pytest.approx(np.array([[0.5, 0.5]]))


@given(st.integers(1, 3000), st.integers(0, 100))
def test_thinning_keeps_the_mean_of_a_cell(n: int, seed: int) -> None:
    rng = np.random.default_rng(seed)
    in_px = replace(CAMERA, unit="px", pitch=(1.0, 1.0))
    place = rng.uniform([-2000, -1500], [2000, 1500], (n, 2))
    turn, shift = rng.normal(size=(2, 2)), rng.normal(size=2)
    vectors = thinned(SensorResiduals(place, place @ turn + shift), in_px, 500)
    assert len(vectors.place) <= 500
    # The mean of what is linear in the place is what it is at the mean place.
    assert vectors.residual_px == pytest.approx(vectors.place @ turn + shift)
