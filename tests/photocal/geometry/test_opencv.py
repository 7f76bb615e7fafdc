"""brown-ideal with the affinity after the distortion is OpenCV's camera."""

from __future__ import annotations

import cv2
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from photocal.geometry.camera import camera, plane_to_pixel
from photocal.geometry.distortion import projected

WIDTH, HEIGHT = 4000, 3000


@settings(max_examples=100)
@given(
    st.floats(2500, 4500), st.floats(0.97, 1.03), st.floats(-40, 40), st.floats(-40, 40),
    st.floats(-0.3, 0.3), st.floats(-0.1, 0.1), st.floats(-0.05, 0.05),
    st.floats(-5e-3, 5e-3), st.floats(-5e-3, 5e-3),
)  # fmt: skip
def test_same_pixels_as_opencv(
    fy: float, ratio: float, x0: float, y0: float, k1: float, k2: float, k3: float, p1: float, p2: float
) -> None:
    # OpenCV's y points down and its z forward: its (x', y') is our (u, -v)/(-w). Its polynomial is in units
    # of the focal length; p2 multiplies r^2 + 2 x^2, as our P1 does, and the sign of p1 turns with y:
    # P1 = p2/c, P2 = -p1/c, Kn = kn/c^2n. fx = c (1 + B1), fy = c.
    own = camera(
        "a", "brown-ideal", "px", (WIDTH, HEIGHT), (1, 1),
        {"c": fy, "x0": x0, "y0": y0, "K1": k1 / fy**2, "K2": k2 / fy**4, "K3": k3 / fy**6,
         "P1": p2 / fy, "P2": -p1 / fy, "B1": ratio - 1},
        affinity="after",
    )  # fmt: skip
    # The middle of the image, between the middle pixels; y0 moves it up, so that the row falls.
    matrix = np.array([[fy * ratio, 0, (WIDTH - 1) / 2 + x0], [0, fy, (HEIGHT - 1) / 2 - y0], [0, 0, 1]])
    q = np.random.default_rng(2).uniform([-5, -4, -12], [5, 4, -9], (40, 3))
    peer, _ = cv2.projectPoints(
        q * [1.0, -1.0, -1.0], np.zeros(3), np.zeros(3), matrix, np.array([k1, k2, p1, p2, k3])
    )
    ours = plane_to_pixel((WIDTH, HEIGHT), (1, 1), projected(own, q))
    assert ours == pytest.approx(peer.reshape(-1, 2), abs=1e-8)
