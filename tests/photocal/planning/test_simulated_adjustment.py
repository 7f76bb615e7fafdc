"""The simulated adjustment of a planned flight: geometry, scaling, Monte Carlo, words."""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from scipy import stats

from photocal.adjustment.adjust import adjust
from photocal.planning.area import area_from_corners
from photocal.planning.flight import (
    FlightRequest,
    Layout,
    PlannedFlight,
    plan_flight,
    planned_camera,
    suggest_layout,
)
from photocal.planning.options import PrecisionOptions
from photocal.planning.simulated_adjustment import planned_network, simulate
from tests.photocal.conftest import Answer

CORNERS = [(-22.1200, -51.4100), (-22.1200, -51.4085), (-22.1212, -51.4085), (-22.1212, -51.4100)]
POSITIONS = "0.03,0.05"


def planned(
    forward: float = 0.7, side: float = 0.6, second: float | None = None
) -> tuple[PlannedFlight, Layout]:
    request = FlightRequest(
        planned_camera(8.8, 2.41, (5472, 3648)), 100.0, forward, side, second_height_m=second
    )
    flight = plan_flight(area_from_corners(CORNERS, "here"), request)
    return flight, suggest_layout(flight.corners_m, 5, 8, 10.0)


def test_ground_is_seen_as_often_as_the_overlaps_say() -> None:
    network, check = planned_network(*planned(0.8, 0.6), PrecisionOptions())
    rays = np.bincount(network.rays.point)[check]
    # 1 / (1 - 0.8) photos along times 1 / (1 - 0.6) strips across.
    assert rays.mean() == pytest.approx(5 * 2.5, rel=0.25)


def test_precision_scales_with_the_observations() -> None:
    flight, layout = planned()
    once = simulate(flight, layout, PrecisionOptions(image_sigma_px=0.5, control_sigma_m="0.02,0.03"))
    twice = simulate(flight, layout, PrecisionOptions(image_sigma_px=1.0, control_sigma_m="0.04,0.06"))
    np.testing.assert_allclose(twice.mean_m, 2 * np.array(once.mean_m), rtol=1e-6)


def test_monte_carlo_of_the_planned_flight() -> None:
    """Observations with errors, adjusted: the check points scatter as the plan says."""
    network, check = planned_network(*planned(), PrecisionOptions())
    rng = np.random.default_rng(7)
    truth = network.points.values
    covariance = adjust(network).point_covariance[check]
    distance = []
    for _ in range(12):
        sigma = np.where(
            network.points.weight[:, range(3), range(3)] > 0,
            1 / np.sqrt(np.maximum(network.points.weight[:, range(3), range(3)], 1e-12)),
            0.0,
        )
        noisy = replace(
            network,
            rays=replace(
                network.rays,
                plane=network.rays.plane
                + rng.normal(0.0, 1.0, network.rays.plane.shape) * network.rays.sigma,
            ),
            points=replace(network.points, values=truth + rng.normal(0.0, 1.0, truth.shape) * sigma),
        )
        d = adjust(noisy).points[check] - truth[check]
        distance.append(np.einsum("na,nab,nb->n", d, np.linalg.inv(covariance), d))
    total = np.sum(distance, axis=0)
    p = stats.chi2(3 * len(distance)).sf(total)
    assert p.min() > 1e-3 / len(check)
    assert p.max() < 1 - 1e-3 / len(check)


def test_positions_and_heights_decide_what_can_be_calibrated() -> None:
    one, two = planned(), planned(second=140.0)
    calibration = PrecisionOptions(calibrate=True)
    assert "do not separate" in simulate(*one, calibration).reason
    # Vertical photos over flat ground: a second height alone does not help, each photo has its own Z.
    assert "do not separate" in simulate(*two, calibration).reason
    with_positions = simulate(*two, replace(calibration, gnss_sigma_m=POSITIONS))
    assert with_positions.reason == ""
    assert with_positions.camera_px["c"] < 2
    one_height = simulate(*one, replace(calibration, gnss_sigma_m=POSITIONS))
    assert one_height.camera_px["c"] > with_positions.camera_px["c"]


def test_positions_help() -> None:
    flight, layout = planned()
    without, with_positions = (
        simulate(flight, layout, PrecisionOptions(gnss_sigma_m=g)) for g in (None, POSITIONS)
    )
    assert np.all(np.array(with_positions.mean_m) < without.mean_m)
    assert (without.method, with_positions.method) == ("indirect", "integrated")


def test_command(photocal: Callable[..., Answer], tmp_path: Path) -> None:
    area = tmp_path / "area.csv"
    area.write_text("lat_deg,lon_deg\n" + "".join(f"{a},{o}\n" for a, o in CORNERS), encoding="utf-8")
    camera = ("--focal-mm", "8.8", "--pixel-um", "2.41", "--image-px", "5472x3648", "--height", "100")
    layout = ("--control", "5", "--check", "8", "--forward", "0.7", "--side", "0.6")
    said = photocal(
        "plan", area, "-o", tmp_path / "out", *camera, *layout, "--gnss-sigma-m", "0.03,0.05", "--json"
    )
    assert said.code == 0, said.err
    simulated = json.loads(said.out)["simulated"]
    assert simulated["method"] == "integrated"
    assert 0 < simulated["sigma_m"]["x"] < simulated["sigma_m"]["z"] < 0.1
    assert json.loads((tmp_path / "out" / "plan.json").read_text())["simulated"] == simulated
    without = photocal("plan", area, "-o", tmp_path / "o", *camera, *layout, "--no-simulation", "--json")
    assert "simulated" not in json.loads(without.out)
    wrong = photocal("plan", area, "-o", tmp_path / "o", *camera, *layout, "--gnss-sigma-m", "good")
    assert wrong.code == 5
    assert "write 0.02,0.03" in wrong.err
