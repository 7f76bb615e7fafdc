"""What an error of a held c does to heights: the rule of the plan against an adjustment."""

from __future__ import annotations

import numpy as np
import pytest

import photocal
from photocal.planning.plan import height_by_c
from tests.evidence.height_from_c import CAMERA, DESIGNS, HEIGHT, WRONG, study

CORNERS = [(-51.41, -22.12), (-51.4085, -22.12), (-51.4085, -22.1212), (-51.41, -22.1212)]


def test_straight_down_it_is_what_the_plan_says_and_c_cannot_be_estimated() -> None:
    asked = photocal.FlightOptions(focal_mm=8.8, pixel_um=2.41, image_px="5472x3648", height=HEIGHT)
    plan = photocal.plan(photocal.area_from_corners(CORNERS, "field"), asked.request())
    wrong_um = WRONG * CAMERA.value("c") * 1e3
    seen = study(DESIGNS[0], 0)
    assert seen.held_m == pytest.approx(-height_by_c(plan.flight.levels[0]) * wrong_um, rel=0.01)
    assert np.isnan(seen.sigma_c)


def test_strips_that_look_aside_take_most_of_it_and_estimate_c() -> None:
    design = DESIGNS[3]
    seen = study(design, 4)
    assert abs(seen.held_m) < 0.5 * HEIGHT * WRONG
    assert 0.0 < seen.sigma_c < 2e-4
    # Four heights with this standard deviation: their root mean square lies within these at 99 %.
    assert 0.22 < seen.simulated_m / seen.predicted_m < 1.93
