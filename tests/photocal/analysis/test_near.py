"""Minima near a known one against adjustments anew, and what an analysis costs."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest

from photocal.adjustment import solver
from photocal.adjustment.adjust import adjust
from photocal.adjustment.adjusted import AdjustedNetwork, fit, left_without, lowest, without_images
from photocal.adjustment.factored import Factored, factored
from photocal.adjustment.kernels.residuals import evaluate
from photocal.adjustment.near import Removals
from photocal.adjustment.network import Network, Relations
from photocal.adjustment.normal import values_of
from photocal.adjustment.readout import with_moving_images
from photocal.adjustment.removed import groups_of, standard_error, state_without
from photocal.adjustment.score import score
from photocal.adjustment.solver import Near
from photocal.analysis import left_out as of_parameters
from photocal.analysis.left_out import Checks, without_parameter
from photocal.analysis.outcome import analyse_network
from photocal.geometry.camera import PARAMETERS
from photocal.hypotheses.fields import ray_fields
from tests.photocal import flights
from tests.photocal.analysis.aerial import Flight, fly


@pytest.fixture(scope="module")
def flown() -> AdjustedNetwork:
    return fit(fly(Flight(50, 12_000), 3).network)


def test_images_taken_out_of_the_minimum_are_images_never_flown(flown: AdjustedNetwork) -> None:
    """Camera parameters to 1e-3 of their standard deviations, for single images and for groups."""
    sigma = np.sqrt(np.diag(flown.solution.camera_covariance[0]))
    removals = Removals(flown.factored)
    for group in ([0], [31], [7, 8, 9, 10, 11]):
        out = np.isin(np.arange(50), group)
        nearby = removals.without(out, 1e-8)
        assert nearby is not None
        anew = lowest(*without_images(flown.network, flown.state, out)).state.cameras[0]
        moved = anew - flown.state.cameras[0]
        assert np.abs(moved).max() > 0.0
        assert (np.abs(nearby.state.cameras[0] - anew) <= 1e-3 * sigma).all()
        assert nearby.left < 1e-8


def bare() -> Network:
    """A free network with a scale bar."""
    network = fly(Flight(30, 6_000, gnss=False, control=False), 3).network
    # Whoever is left out, both ends are seen.
    first, second = np.argsort(np.bincount(network.rays.point))[-2:]
    apart = np.linalg.norm(network.points.values[[second]] - network.points.values[[first]], axis=1)
    ends = np.array([first]), np.array([second])
    bar = Relations(np.zeros(1, dtype=np.int64), *ends, apart, np.full(1, 0.01))
    return replace(network, relations=bar)


def varied() -> Network:
    """Two cameras, one of which differs from image to image; an image without rays, but with a pose."""
    network = fly(Flight(30, 6_000), 3).network
    (own,) = network.cameras
    own = replace(own, deviation_sigma=np.where(np.arange(len(PARAMETERS)) == 1, 0.5, 0.0))
    kept = network.rays.image != 9
    rays = replace(network.rays, **{name: column[kept] for name, column in vars(network.rays).items()})
    camera = np.arange(30) % 2
    other = replace(own, id="other", deviation_sigma=np.zeros(len(PARAMETERS)))
    sigma = network.exposures.sigma.copy()
    sigma[9] = 0.01
    exposures = replace(network.exposures, camera=camera, sigma=sigma)
    return replace(network, cameras=(own, other), exposures=exposures, rays=rays)


@pytest.mark.parametrize("made", [bare, varied])
@pytest.mark.parametrize("group", [[4], [9, 10, 11], [19, 20, 21, 22]])
def test_images_are_taken_out_of_networks_of_any_kind(made: Callable[[], Network], group: list[int]) -> None:
    network = made()
    whole = fit(network)
    out = np.isin(np.arange(30), group)
    nearby = Removals(whole.factored).without(out, 1e-8)
    assert nearby is not None
    anew = lowest(*without_images(network, whole.state, out)).state.cameras
    sigma = np.sqrt(np.diagonal(whole.solution.camera_covariance, axis1=1, axis2=2))
    assert (np.abs(nearby.state.cameras - anew) <= 1e-3 * sigma).all()


@pytest.mark.parametrize(("case", "seed", "vibration_deg"), [("positions", 2, 0.03), ("attitudes", 3, 0.1)])
def test_images_that_vibrate_are_left_out_as_well_as_a_standard_error_needs(
    case: flights.Case, seed: int, vibration_deg: float, monkeypatch: pytest.MonkeyPatch
) -> None:
    """With one step by each of two factors, where that may not be the minimum yet.

    A standard error of m removals is good to 1 / sqrt(2 (m - 1)).
    """
    motion = {"readout_s": 0.03, "sigma_px": 0.3, "vibration_deg": vibration_deg}
    _, network = flights.case(case, seed, images=20, points=300, **motion)
    network, solution, _ = with_moving_images(network, adjust(network))
    whole = fit(network, solution.state)
    removals, groups = Removals(whole.factored), groups_of(whole)
    with monkeypatch.context() as hurried:
        hurried.setattr(solver, "CHORDS", 1)
        steps = np.array([state_without(removals, out).cameras[0] for out in groups])
    anew = np.array([lowest(*without_images(network, whole.state, out)).state.cameras[0] for out in groups])
    free = network.cameras[0].estimated
    ratio = standard_error(steps)[free] / standard_error(anew)[free]
    assert (np.abs(ratio - 1.0) < 1.0 / np.sqrt(2.0 * (len(groups) - 1))).all()


def uncorrected() -> Network:
    """A flight whose camera is adjusted without K3."""
    network = fly(Flight(30, 6_000), 3).network
    (own,) = network.cameras
    estimated, values = own.estimated.copy(), own.values.copy()
    estimated[PARAMETERS.index("K3")], values[PARAMETERS.index("K3")] = False, 0.0
    return replace(network, cameras=(replace(own, estimated=estimated, values=values),))


@pytest.mark.parametrize("made", [uncorrected, bare, varied])
@pytest.mark.parametrize("group", [[4], [19, 20, 21, 22]])
def test_a_field_without_images_is_that_of_images_never_flown(
    made: Callable[[], Network], group: list[int]
) -> None:
    """Amounts of what the camera lacks, to a twentieth of their standard deviations.

    One is linear at the minimum of the whole, the other at that of the rest; what is made of them, a standard
    error of m removals, is good to 1 / sqrt(2 (m - 1)), a fifth.
    """
    network = made()
    whole = fit(network)
    out = np.isin(np.arange(30), group)
    fields = np.array([one.displacement for one in ray_fields(whole)])
    rest = Removals(whole.factored).scored(out, fields, 1e-6)
    assert rest is not None
    smaller, start = without_images(network, whole.state, out)
    state = lowest(smaller, start).state
    at = factored(smaller, state)
    kept = left_without(network, out)[1]
    residuals = np.empty(smaller.rays.plane.shape)
    evaluate(at.problem.design, values_of(at.problem, state), residuals, np.empty(len(residuals)))
    anew = score(at, residuals, fields[:, kept])
    some = anew.share > 1e-4
    assert some.any()
    sigma = np.diag(anew.information)[some] ** -0.5
    amount, there = (one.slope[some] / np.diag(one.information)[some] for one in (rest, anew))
    assert np.diag(rest.information)[some] ** -0.5 == pytest.approx(sigma, rel=0.05)
    assert (np.abs(amount - there) <= 0.05 * sigma).all()


@pytest.mark.parametrize("name", ["K1", "K3", "P1"])
def test_a_parameter_at_zero_is_a_parameter_never_estimated(flown: AdjustedNetwork, name: str) -> None:
    at, own = PARAMETERS.index(name), flown.network.cameras[0]
    nearby = without_parameter(flown, 0, at)
    estimated, values = own.estimated.copy(), own.values.copy()
    estimated[at], values[at] = False, 0.0
    held = replace(flown.network, cameras=(replace(own, estimated=estimated, values=values),))
    start = flown.state.cameras.copy()
    start[0, at] = 0.0
    anew = lowest(held, replace(flown.state, cameras=start))
    sigma = np.sqrt(np.diag(flown.solution.camera_covariance[0]))
    # A hundredth of a standard deviation is promised; a thousandth would take a third more steps.
    assert (np.abs(nearby.state.cameras[0] - anew.state.cameras[0]) <= 1e-2 * sigma).all()
    assert nearby.chi_squared == pytest.approx(anew.chi_squared, abs=1e-4)


def test_an_analysis_is_that_of_the_long_way(flown: AdjustedNetwork, monkeypatch: pytest.MonkeyPatch) -> None:
    """Findings, jackknife and significance, when each image and parameter left out is adjusted anew."""
    checks = Checks(np.zeros(0, dtype=np.int64), np.zeros((0, 3)))

    def refused(at: Factored, *_: object) -> Near:
        return Near(at.state, np.inf, np.inf, reached=False)

    short = analyse_network(flown.network, checks, 0.1, 0.8, start=flown.state)
    # Nothing is left that another lens could explain: none is adjusted.
    assert list(short.lens_models.values()) == [()]
    monkeypatch.setattr(of_parameters, "with_held", refused)
    long = analyse_network(flown.network, checks, 0.1, 0.8)
    assert [(one.code, one.subject) for one in short.findings] == [
        (one.code, one.subject) for one in long.findings
    ]
    sigma = np.sqrt(np.diag(flown.solution.camera_covariance[0]))
    for one, other in zip(
        (short.search.jackknife_first, short.search.jackknife_last),
        (long.search.jackknife_first, long.search.jackknife_last),
        strict=True,
    ):
        assert (np.abs(one.cameras - other.cameras) <= 1e-3 * sigma).all()
        assert (np.abs(one.standard_error - other.standard_error) <= 1e-3 * sigma).all()
    (quick,), (slow,) = short.cameras.values(), long.cameras.values()
    assert quick is not None
    assert slow is not None
    assert [test.statistic for test in quick.significance] == pytest.approx(
        [test.statistic for test in slow.significance], rel=1e-6
    )
    for near, anew in zip(quick.left_out, slow.left_out, strict=True):
        assert near.parameter == anew.parameter
        assert abs(near.c - anew.c) <= 1e-2 * sigma[0]
        assert near.chi_squared == pytest.approx(anew.chi_squared, abs=1e-4)


def test_analysis_grows_with_the_block() -> None:
    """Processor time of an analysis over that of the adjustment, at 60 and at 240 images."""
    ratios = []
    for images in (60, 240):
        network = fly(Flight(images, 60 * images), 4).network
        fit(network)
        began = time.process_time()
        fit(network)
        own = time.process_time() - began
        analyse_network(network, Checks(np.zeros(0, dtype=np.int64), np.zeros((0, 3))), 0.1, 0.8)
        ratios.append((time.process_time() - began - own) / own)
    assert ratios[1] < 1.5 * ratios[0]
