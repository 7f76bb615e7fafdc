"""Distortion at other distances than that of the calibration (Brown 1971; Fryer 1988)."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from photocal.geometry.camera import Camera, camera
from photocal.geometry.distortion import focused, projected

NEAR = {"K1": -1.2e-4, "K2": 3e-7, "K3": -2e-10, "K4": 1e-13}


def calibrated(focus_m: float, parameters: dict[str, float]) -> Camera:
    return camera(
        "a", "brown-ideal", "mm", (3000, 2000), (0.009, 0.009), {"c": 50.0, **parameters}, focus_m=focus_m
    )


def test_the_calibrations_themselves_come_back() -> None:
    near, far = calibrated(1.0, NEAR), calibrated(8.0, {"K1": -0.9e-4, "K2": 2e-7})
    assert focused(near, far, 1.0).values == pytest.approx(near.values, rel=1e-12)
    assert focused(near, far, 8.0).values[3:7] == pytest.approx(far.values[3:7], rel=1e-12, abs=1e-25)
    infinite = replace(far, focus_m=np.inf)
    assert focused(near, infinite, 1e9).values[3:5] == pytest.approx(far.values[3:5], rel=1e-6)


def test_the_interpolation_of_magill() -> None:
    """K1 at 2 m by hand: a = (8 - 2)/(8 - 1) (1 - 0.05)/(2 - 0.05), each K1 over the cube of 1 - c/s."""
    near, far = calibrated(1.0, {"K1": -1.2e-4}), calibrated(8.0, {"K1": -0.9e-4})
    a = 6 / 7 * 0.95 / 1.95
    expected = (1 - 0.05 / 2) ** 3 * (a * -1.2e-4 / (1 - 0.05) ** 3 + (1 - a) * -0.9e-4 / (1 - 0.05 / 8) ** 3)
    assert focused(near, far, 2.0).value("K1") == pytest.approx(expected, rel=1e-12)


def test_within_the_depth_of_field() -> None:
    """At twice the focus of 2 m with c = 50 mm the scale ratio is 0.975/0.9875, K1 acts with its square."""
    own = calibrated(2.0, {"K1": -1e-4})
    g = 0.975 / 0.9875
    ideal = 50.0 * 0.4 / 4.0
    assert projected(own, np.array([[0.4, 0.0, -4.0]]))[0, 0] == pytest.approx(
        ideal - 1e-4 * g**2 * ideal**3, rel=1e-12
    )
