"""Planning figures that studies printed, and what follows from them."""

from __future__ import annotations

import math

import numpy as np
import pytest

from photocal.base.errors import ConfigurationError
from photocal.geometry.camera import pixel_to_plane
from photocal.geometry.smear import smear_px
from photocal.planning.flight import (
    air_base,
    corner_precision,
    expected_altimetric_accuracy,
    exposure_interval,
    flying_height,
    footprint,
    ground_sample_distance,
    normal_case_height_sigma,
    parallax_sigma,
    planned_camera,
    stereo_precision,
)
from photocal.planning.plan import error_budget

ELPH = planned_camera(4.38, 1.3368, (4608, 3456))
IXUS = planned_camera(4.382, 1.54, (4000, 3000))
PHANTOM = planned_camera(8.8, 2.41, (5472, 3648))


def test_canon_elph_scale_and_height() -> None:
    height = flying_height(0.08, ELPH)
    assert height == pytest.approx(262.12, abs=0.005)
    denominator = height / (ELPH.value("c") * 1e-3)
    assert denominator == pytest.approx(59844.40, abs=0.005)
    # The long side of the sensor as printed, 6.17219 mm; the study prints 73.2 m instead.
    assert air_base(0.80, 6.17219e-3 * denominator) == pytest.approx(73.87, abs=0.005)


def test_canon_elph_planning_figures_to_a_millimetre() -> None:
    """Equations 34-39 with the printed base of 73.2 m; the last digits are truncated in print."""
    x, y = pixel_to_plane(ELPH.size_px, ELPH.pitch, np.array([4377.0, 3283.0])).tolist()
    assert (x, y) == pytest.approx((2.771, -2.079), abs=1e-3)
    sigma = ELPH.pitch[0] / 2.0
    assert sigma == pytest.approx(0.0006684, abs=5e-8)
    assert parallax_sigma(sigma) == pytest.approx(0.000945, abs=5e-7)
    height = flying_height(0.08, ELPH)
    found = stereo_precision(height, 73.2, ELPH.value("c"), (x, y), sigma)
    assert found["x"] == pytest.approx(0.134, abs=1e-3)
    assert found["y"] == pytest.approx(0.104, abs=1e-3)
    assert found["z"] == pytest.approx(0.202, abs=1e-3)
    assert found["plane"] == pytest.approx(0.170, abs=1e-3)
    # With four digits, recomputed independently.
    assert found == pytest.approx({"x": 0.1343, "y": 0.1042, "z": 0.2026, "plane": 0.1699}, abs=5.1e-5)
    corner = corner_precision(ELPH, height, 73.2, 0.5)
    assert corner["plane"] == pytest.approx(found["plane"], abs=1e-4)


def test_canon_elph_error_budget() -> None:
    plane = list(error_budget(0.17).values())
    height = list(error_budget(0.34).values())
    # Printed 0.056, 0.018 and 0.11, 0.036 m: truncated thirds (the second from the truncated first).
    assert plane == pytest.approx([0.17, 0.056, 0.018], abs=1e-3)
    assert height == pytest.approx([0.34, 0.11, 0.036], abs=4e-3)
    assert math.hypot(*error_budget(1.0).values()) == pytest.approx(math.sqrt(1 + 1 / 9 + 1 / 81))


def test_ixus220_height_resolution_and_footprint() -> None:
    nominal = planned_camera(5.1, 1.54, (4000, 3000))
    assert flying_height(0.20, nominal) == pytest.approx(662.3, abs=0.05)
    assert flying_height(0.20, IXUS) == pytest.approx(569.09, abs=0.005)
    assert ground_sample_distance(711.0, IXUS) == pytest.approx(0.249872, abs=5e-7)
    assert ground_sample_distance(716.0, IXUS) == pytest.approx(0.251629, abs=5e-7)
    assert ground_sample_distance(680.0, IXUS) == pytest.approx(0.23898, abs=5e-6)
    width, height = footprint(0.25, IXUS)
    assert (width, height) == pytest.approx((1000.0, 750.0))
    assert width * height / 1e4 == pytest.approx(75.0)
    assert air_base(0.70, height) == pytest.approx(225.0)
    assert air_base(0.70, width) == pytest.approx(300.0)


def test_ixus220_expected_height_sigma_is_not_the_printed_ten_centimetres() -> None:
    assert normal_case_height_sigma(711.0, 225.0, 4.382, 1.54e-3) == pytest.approx(0.7896, abs=5e-5)
    assert normal_case_height_sigma(711.0, 300.0, 4.382, 1.54e-3) == pytest.approx(0.5922, abs=5e-5)


def test_phantom4pro_resolution_and_altimetric_accuracy() -> None:
    assert ground_sample_distance(100.0, PHANTOM) * 100 == pytest.approx(2.7386, abs=5e-5)
    assert expected_altimetric_accuracy(100.0, 158.4, 8.8e-3, 0.0241e-3) * 100 == pytest.approx(
        24.45086, abs=5e-6
    )
    assert expected_altimetric_accuracy(100.0, 0.3 * 3648 * 0.0317, 8.8e-3, 2.41e-6) * 100 == pytest.approx(
        11.164, abs=5e-4
    )


@pytest.mark.parametrize("overlap", [1.0, 1.2, -0.1, 80.0, math.nan])
def test_overlaps_that_cannot_be_flown(overlap: float) -> None:
    with pytest.raises(ConfigurationError, match="overlap"):
        air_base(overlap, 100.0)


def test_exposure_interval_follows_the_ground_speed() -> None:
    assert exposure_interval(30.0, 10.0) == pytest.approx(3.0)
    # 0.055 m/s of Doppler noise changes the distance of photos by half a percent at 10 m/s.
    assert exposure_interval(30.0, 10.055) == pytest.approx(3.0, rel=6e-3)
    with pytest.raises(ConfigurationError, match="speed"):
        exposure_interval(30.0, 0.0)
    assert smear_px(0.01, 10.0, 0.0274) == pytest.approx(3.65, abs=0.01)


def test_frames_and_budgets_that_cannot_be() -> None:
    with pytest.raises(ConfigurationError, match="positive"):
        planned_camera(0.0, 1.0, (100, 100))
    with pytest.raises(ConfigurationError, match="standard error"):
        error_budget(-1.0)
