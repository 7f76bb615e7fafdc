"""Positions that all lie beside control, and clean flights that get no finding."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from photocal.adjustment.adjust import adjust
from photocal.adjustment.adjusted import fit
from photocal.adjustment.mounting import SHIFT as COLUMNS
from photocal.analysis.systematic_errors.findings import findings, of_datum
from photocal.analysis.systematic_errors.search import causes_in, search
from photocal.analysis.systematic_errors.shifts import position_shift
from tests.photocal.analysis.aerial import Flight, fly
from tests.photocal.analysis.findings import said, sized

FLIGHT = Flight(36, 5000, sigma_px=0.5)
SHIFT = np.array([0.0, 0.0, -0.085])


def test_positions_below_control_are_named_and_c_is_cleared_of_them() -> None:
    # c takes most of it up: it takes many images, as the block of which it was learnt has.
    flown = fly(replace(FLIGHT, images=100, rays=14_000, control_points=25), 5)
    positions = flown.network.positions
    network = replace(flown.network, positions=replace(positions, values=positions.values + SHIFT))
    found = search(causes_in(fit(network)))
    listed = findings(found)
    assert listed[0].code == "antenna-height"
    assert abs(sized(listed[0]).figure - SHIFT[2]) < 4 * (sized(listed[0]).sigma or 0.0)
    assert "the control, and agree" in said(listed[0])
    c, sigma = found.last.state.cameras[0, 0], np.sqrt(found.last.solution.camera_covariance[0, 0, 0])
    assert abs(c - flown.lens.values[0]) < 4 * sigma
    assert "sigmas-too-small" not in {one.code for one in listed}


def test_the_shift_is_what_an_adjustment_with_it_gives() -> None:
    network = fly(FLIGHT, 6).network
    first = fit(network)
    found = position_shift(first)
    assert found is not None
    sigma = network.mounting.sigma.copy()
    sigma[COLUMNS] = np.inf
    anew = adjust(replace(network, mounting=replace(network.mounting, sigma=sigma)))
    np.testing.assert_allclose(found.shift, anew.state.common[7:10], atol=0.01 * found.sigma.max())
    np.testing.assert_allclose(found.sigma, np.sqrt(np.diag(anew.common_covariance)[7:10]), rtol=1e-3)
    assert found.fall == pytest.approx(first.solution.chi_squared - anew.chi_squared, abs=0.02)
    assert found.p_value > 1e-3


def test_the_block_in_which_a_missing_k4_was_claimed_gets_no_finding() -> None:
    """49 images, 14 000 rays, 1 px, K1 to K3 estimated and true: nothing is missing and c is not biased."""
    block = Flight(49, 14_000, estimate=("c", "x0", "y0", "K1", "K2", "K3"))
    for seed in range(3):
        network = fly(block, seed).network
        own = network.cameras[0]
        # What is held has its true value.
        assert own.value("B1") == pytest.approx(2e-4)
        assert findings(search(causes_in(fit(network)))) == ()


def test_c_is_said_to_hang_on_the_height_datum_by_what_a_shift_does_to_it() -> None:
    network = fly(FLIGHT, 6).network
    first = fit(network)
    found = position_shift(first)
    assert found is not None
    lower = replace(network.positions, values=network.positions.values + np.array([0.0, 0.0, -0.01]))
    moved = fit(replace(network, positions=lower)).state.cameras[0, 0] - first.state.cameras[0, 0]
    assert moved == pytest.approx(-0.01 * found.c_by_shift[0, 2], rel=0.01)
    (told,) = of_datum(search(causes_in(first)))
    assert told.code == "c-on-positions"
    assert abs(float(told.figures["by_cm"])) == pytest.approx(abs(moved), rel=0.01)


def test_heights_without_control_are_said_to_hang_on_the_positions() -> None:
    first = fit(fly(replace(FLIGHT, control=False), 6).network)
    assert [one.code for one in of_datum(search(causes_in(first)))] == ["heights-on-positions"]


def test_a_shift_by_chance_does_not_call_c_biased() -> None:
    """Of 300 clean flights the worst: 71 mm, 3.2 standard deviations; it moves c by 5.3 of its own."""
    block = Flight(182, 23_254, sigma_px=0.845)
    first = fit(fly(block, 1250).network)
    listed = findings(search(causes_in(first)))
    assert "c-bias" not in [one.code for one in listed]


def test_a_strip_whose_positions_lie_beside_the_others_is_named_with_its_shift() -> None:
    network = fly(FLIGHT, 6).network
    positions = network.positions
    own = positions.strip == 2
    moved = replace(positions, values=positions.values + own[:, None] * np.array([0.12, 0.0, 0.0]))
    listed = [
        one for one in findings(search(causes_in(fit(replace(network, positions=moved))))) if not one.small
    ]
    (told,) = [one for one in listed if one.code == "strip-position"]
    first, last = (network.image_names[i] for i in positions.image[own][[0, -1]])
    assert told.subject == f"{first}-{last}"
    assert abs(sized(told).figure - 0.12) < 4 * (sized(told).sigma or 0.0) < 0.08
