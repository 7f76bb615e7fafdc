"""Cameras fixed to each other: relations, their derivatives, and what comes out of simulated flights."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from photocal.adjustment import normal
from photocal.adjustment.adjust import adjust
from photocal.adjustment.adjusted import AdjustedNetwork, fit
from photocal.adjustment.layout import layout
from photocal.adjustment.normal import normal_equations, prepare
from photocal.adjustment.observations import mounting_equations
from photocal.adjustment.rig import pairs_of
from photocal.adjustment.state import State, moved_exposures, start_state
from photocal.analysis.systematic_errors.findings import of_heads
from tests.photocal import rigs


def test_derivatives_are_those_of_differences() -> None:
    _, network = rigs.flight(np.random.default_rng(1), exposures=4, points=300, missing=0.3)
    assert (network.exposures.camera[network.rig.first] > 0).any(), "an exposure without its first head"
    rays = np.searchsorted(network.rays.point, np.arange(len(network.points.values) + 1))
    where = layout(network, rays)
    state = start_state(network)

    def residual(at: State) -> np.ndarray:
        return mounting_equations(network, where, at)["rig"].residual

    given = mounting_equations(network, where, state)["rig"]
    analytic = np.zeros((len(given.residual), where.size))
    for row in range(len(given.residual)):
        span = slice(given.start[row], given.start[row + 1])
        analytic[row, given.column[span]] += given.coefficient[span]
    columns = np.flatnonzero(np.abs(analytic).any(axis=0))
    for column in columns:
        sides = []
        for sign in (1.0, -1.0):
            step = np.zeros(where.size)
            step[column] = sign * 1e-5
            sides.append(residual(moved_exposures(network, where, state, step)))
        numeric = (sides[0] - sides[1]) / 2e-5
        scale = np.abs(analytic[:, column]).max()
        assert np.abs(numeric - analytic[:, column]).max() < 1e-6 * scale, column


def test_truth_leaves_no_residual() -> None:
    flown, network = rigs.flight(np.random.default_rng(2), exposures=5, points=300, missing=0.2)
    rays = np.searchsorted(network.rays.point, np.arange(len(network.points.values) + 1))
    state = replace(
        start_state(network), rotation=flown.rotation, centre=flown.centre, common=np.concatenate(
            [network.mounting.values, flown.heads.ravel()])
    )  # fmt: skip
    found = mounting_equations(network, layout(network, rays), state)["rig"].residual
    # In stiffnesses (0.1 mm, 1"): exact from the first head; from another, arms of 10 cm turn by 10 deg/s
    # for some milliseconds that the relation leaves out.
    pairs = network.rig.first.size
    exact = network.exposures.camera[network.rig.first] == 0
    assert np.abs(found.reshape(2, pairs, 3)[:, exact]).max() < 1e-6
    assert np.abs(found).max() < 0.6


def test_sixty_exposures_of_five_heads() -> None:
    flown, network = rigs.flight(np.random.default_rng(3), missing=0.05)
    solution = adjust(network)
    errors = rigs.standardised(flown, network, solution)
    assert np.isnan(errors[0]).all()
    assert np.nanmax(np.abs(errors)) < 3.3  # 28 values
    assert abs(solution.variance_factor - 1) < 4 * np.sqrt(2 / solution.degrees_of_freedom)
    free = adjust(rigs.without_rig(network))
    # What the frame holds together is known better than without it.
    assert np.trace(solution.exposure_covariance.mean(axis=0)) < 0.8 * np.trace(
        free.exposure_covariance.mean(axis=0)
    )


def test_an_exposure_without_its_first_head_is_related_to_another() -> None:
    exposure = np.array([0, 0, 0, 1, 1, -1, 2])
    head = np.array([2, 0, 1, 2, 1, 0, 1])
    first, second = pairs_of(exposure, head, np.zeros(3, dtype=np.int64))
    assert set(zip(first.tolist(), second.tolist(), strict=True)) == {(1, 2), (1, 0), (4, 3)}


def test_pieces_whose_strips_would_fill_the_memory_are_fewer(monkeypatch: pytest.MonkeyPatch) -> None:
    """Heads that look out see points of much of the block: the same equations, of fewer pieces."""
    _, network = rigs.flight(np.random.default_rng(4), exposures=8, points=300)
    monkeypatch.setattr(normal, "RAYS_IN_PIECE", 100)
    many = prepare(network)
    monkeypatch.setattr(normal, "STRIPS", many.layout.strips.offset[-1])
    few = prepare(network)
    assert 1 < len(few.design.pieces) < len(many.design.pieces)
    state = start_state(network)
    one, other = (normal_equations(problem, state) for problem in (many, few))
    np.testing.assert_allclose(other.matrix, one.matrix, rtol=1e-9, atol=1e-12 * np.abs(one.matrix).max())
    np.testing.assert_allclose(other.gradient, one.gradient, atol=1e-9 * np.abs(one.gradient).max())


def moved_rays(seed: int, turn_rad: float) -> AdjustedNetwork:
    """A flight during which the aft head turns, adjusted as if it had not."""
    flown, network = rigs.flight(np.random.default_rng(seed), exposures=16, points=500)
    images = np.flatnonzero(network.exposures.camera == 4)[8:]
    rays = network.rays
    mine = np.isin(rays.image, images)
    # A turn about the camera's x moves what it shows along y, by c and more off the axis.
    own = flown.cameras[4]
    c, y = own.value("c"), rays.plane[mine, 1] - own.value("y0")
    plane = rays.plane.copy()
    plane[mine] += turn_rad * np.column_stack([rays.plane[mine, 0] * y / c, c + y**2 / c])
    return fit(replace(network, rays=replace(rays, plane=plane)))


def test_a_head_that_turns_in_flight_is_named() -> None:
    (found,) = of_heads(moved_rays(11, np.radians(0.05)))
    assert found.subject == "aft"
    assert abs(found.figures["turn_arcsec"] - 180) < 60
    assert of_heads(moved_rays(11, 0.0)) == []
