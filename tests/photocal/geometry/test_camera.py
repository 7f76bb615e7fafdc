"""Pixels and the image plane, by hand; cameras by name."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from photocal.base.errors import ConfigurationError
from photocal.geometry.camera import PARAMETERS, camera, pixel_to_plane, plane_to_pixel


def test_middle_of_an_even_image_lies_between_four_pixels() -> None:
    # 4 x 2 pixels of 10 um: the middle is at column 1.5, row 0.5.
    assert pixel_to_plane((4, 2), (0.01, 0.01), np.array([[1.5, 0.5]])) == pytest.approx(0, abs=1e-15)


def test_upper_left_pixel_by_hand() -> None:
    # Its centre is half a pixel inside the edge: x = -1.5 px, y = +0.5 px.
    plane = pixel_to_plane((4, 2), (0.01, 0.02), np.array([[0.0, 0.0]]))
    assert plane == pytest.approx(np.array([[-0.015, 0.01]]))


def test_rows_count_downwards_and_y_upwards() -> None:
    plane = pixel_to_plane((3060, 2036), (0.009, 0.009), np.array([[3059.0, 2035.0]]))
    assert plane == pytest.approx(np.array([[1529.5 * 0.009, -1017.5 * 0.009]]))


def test_edges_of_the_sensor_are_half_a_pixel_outside() -> None:
    edges = np.array([[-0.5, -0.5], [3059.5, 2035.5]])
    plane = pixel_to_plane((3060, 2036), (27.6 / 3060, 18.4 / 2036), edges)
    assert plane == pytest.approx(np.array([[-13.8, 9.2], [13.8, -9.2]]))


@given(
    st.tuples(st.integers(1, 20000), st.integers(1, 20000)),
    st.tuples(st.floats(1e-4, 1), st.floats(1e-4, 1)),
    st.tuples(st.floats(-1e5, 1e5), st.floats(-1e5, 1e5)),
)
def test_there_and_back(
    size: tuple[int, int], pitch: tuple[float, float], pixel: tuple[float, float]
) -> None:
    there = pixel_to_plane(size, pitch, np.array([pixel]))
    assert plane_to_pixel(size, pitch, there) == pytest.approx(np.array([pixel]), abs=1e-9)


def test_parameters_not_named_are_zero_and_held() -> None:
    made = camera("a", "brown-ideal", "px", (10, 10), (1, 1), {"c": 12.0, "P2": 0.5}, estimate=("c",))
    assert made.value("c") == 12.0
    assert made.value("P2") == 0.5
    assert np.count_nonzero(made.values) == 2
    assert [n for n, e in zip(PARAMETERS, made.estimated, strict=True) if e] == ["c"]
    assert np.isinf(made.prior_sigma).all()


def test_an_unknown_parameter_is_refused() -> None:
    with pytest.raises(ConfigurationError, match="'f' is not a camera parameter; use c, x0"):
        camera("a", "brown-ideal", "px", (10, 10), (1, 1), {"f": 12.0})
