"""A rolling shutter in simulated flights: found, told from a global one, and what it moves is told."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from photocal.adjustment.adjust import adjust
from photocal.adjustment.normal import diagonal_addresses, normal_equations, other_equations, prepare
from photocal.adjustment.readout import (
    Readout,
    _unless_stagnant,
    adjust_moving_images,
    rolls_whatever_the_lens,
    with_moving_images,
    with_readouts,
)
from photocal.adjustment.solution import Solution
from photocal.adjustment.solver import Iteration, gradient, moved_along
from photocal.base.errors import NotConvergedError
from photocal.geometry.camera import PARAMETERS
from tests.photocal import flights

SMALL = {"images": 20, "points": 300}


def found(case: flights.Case, readout_s: float, seed: int) -> tuple[dict[str, float], Solution, Readout]:
    truth, network = flights.case(case, seed, readout_s=readout_s, **SMALL)
    network, solution, (readout,) = with_moving_images(network, adjust(network))
    # Gusts have room for what the readout may be wrong by.
    room = readout.estimated * np.hypot(readout.value, 3 * readout.sigma)
    assert network.cameras[0].value("readout") == pytest.approx(room, rel=0.02)
    return flights.standardised(truth, network, solution), solution, readout


@pytest.mark.parametrize("case", ["attitudes", "positions", "pictures"])
def test_readout_and_camera_are_found(case: flights.Case) -> None:
    """Within 3.3 standard deviations: 1 of 1000 for each."""
    errors, solution, readout = found(case, 0.03, 3)
    assert readout.estimated
    assert readout.p_value < 1e-6
    assert "readout" in errors
    assert max(abs(error) for error in errors.values()) < 3.3, errors
    assert 0.9 < solution.variance_factor < 1.1


@pytest.mark.parametrize("case", ["attitudes", "positions", "pictures"])
def test_global_shutter_stays_one(case: flights.Case) -> None:
    p_values = []
    for seed in (11, 12, 13):
        errors, _, readout = found(case, 0.0, seed)
        assert not readout.estimated
        assert "readout" not in errors
        p_values.append(readout.p_value)
    assert max(p_values) > 0.05


def test_lines_may_be_read_from_below() -> None:
    truth, network = flights.case("attitudes", 5, readout_s=-0.03, **SMALL)
    network, _, (readout,) = with_moving_images(network, adjust(network))
    assert network.cameras[0].readout_direction == "bottom-to-top"
    assert readout.value == pytest.approx(-truth.readout_s, abs=3 * readout.sigma)


def test_effect_is_the_way_the_points_move() -> None:
    """Lines lie evenly between -1/2 and 1/2 of the readout: 1/sqrt(12) of it, root mean square."""
    _, _, readout = found("positions", 0.03, 3)
    assert readout.way == pytest.approx(8 * 0.03, abs=3 * 8 * readout.sigma)
    in_image = readout.way * flights.C / flights.HEIGHT_M / np.sqrt(12)
    assert readout.effect == pytest.approx(in_image, rel=0.25)


def test_not_estimated_it_spoils_the_camera() -> None:
    truth, network = flights.case("attitudes", 3, readout_s=0.03, **SMALL)
    solution = adjust(network)
    worst = max(abs(error) for error in flights.standardised(truth, network, solution).values())
    assert solution.variance_factor > 2.0
    assert worst > 4.0


def test_given_readout_is_taken() -> None:
    truth, network = flights.case("attitudes", 4, readout_s=0.03, **SMALL)
    values = network.cameras[0].values.copy()
    values[PARAMETERS.index("readout")] = 0.03
    network = replace(network, cameras=(replace(network.cameras[0], values=values, shutter="rolling"),))
    solution = adjust(network)
    errors = flights.standardised(truth, network, solution)
    assert "readout" not in errors
    assert max(abs(error) for error in errors.values()) < 3.3
    assert 0.9 < solution.variance_factor < 1.1


def test_vibration_within_the_readout_is_held() -> None:
    """Lines displaced by 0.6 px from a steady movement bias the camera where images may not shake."""
    motion = {"readout_s": 0.03, "sigma_px": 0.1, "vibration_deg": 0.01}
    truth, network = flights.case("attitudes", 1, **motion, **SMALL)  # type: ignore[arg-type]
    network, solution, _ = with_moving_images(network, adjust(network))
    errors = flights.standardised(truth, network, solution)
    assert max(abs(error) for error in errors.values()) < 3.3, errors
    assert 0.9 < solution.variance_factor < 1.1
    # Its lines lie as far from a steady movement as 20 to 60 Hz of 0.01 degrees, less what is linear.
    assert 0.2 < network.cameras[0].shaken / (np.radians(0.01) * flights.C) < 1.0
    steady = replace(network, cameras=(replace(network.cameras[0], shake=()),))
    solution = adjust(steady)
    assert solution.variance_factor > 2.0
    assert max(abs(error) for error in flights.standardised(truth, steady, solution).values()) > 4.0


@pytest.mark.parametrize(("case", "seed", "vibration_deg"), [("positions", 2, 0.03), ("attitudes", 3, 0.1)])
def test_gusts_have_the_room_of_the_readout_beside_vibration(
    case: flights.Case, seed: int, vibration_deg: float
) -> None:
    """From before vibration was found they had 1.65 and 0.75 times that in these flights."""
    motion = {"readout_s": 0.03, "sigma_px": 0.3, "vibration_deg": vibration_deg}
    _, network = flights.case(case, seed, **motion, **SMALL)  # type: ignore[arg-type]
    network, _, (readout,) = with_moving_images(network, adjust(network))
    assert network.cameras[0].shake
    room = np.hypot(readout.value, 3 * readout.sigma)
    assert network.cameras[0].value("readout") == pytest.approx(room, rel=0.02)


def test_who_asks_for_the_same_adjustment_gets_it_and_who_changes_anything_another() -> None:
    _, network = flights.case("attitudes", 8, readout_s=0.03, **SMALL)
    first, alike = adjust_moving_images(network), adjust_moving_images(replace(network))
    assert alike[1] is first[1]
    apart = with_moving_images(network, adjust(network))
    assert np.array_equal(first[1].cameras, apart[1].cameras)
    moved = replace(network.rays, plane=network.rays.plane + 0.1)
    other = adjust_moving_images(replace(network, rays=moved))
    assert np.abs(other[1].cameras - first[1].cameras).max() > 0.05


def test_slopes_where_images_shake_are_those_of_differences() -> None:
    """Also where the line of a ray is found in steps: along what is weak a small error is a long way."""
    motion = {"readout_s": 0.03, "sigma_px": 1.0, "vibration_deg": 0.03}
    _, network = flights.case("attitudes", 1, **motion, **SMALL)  # type: ignore[arg-type]
    network, solution, _ = with_moving_images(network, adjust(network))
    assert network.cameras[0].shake
    problem, state = prepare(network), solution.state
    size = np.sqrt(normal_equations(problem, state).matrix[diagonal_addresses(problem)])
    still = np.zeros_like(state.points)

    def slope(step: np.ndarray) -> tuple[float, np.ndarray]:
        there = moved_along(problem, state, step, still)
        return gradient(problem, there, list(other_equations(problem, there).values()))[:2]

    # Of v'Pv by each unknown in its standard deviations, by a hundredth of them to either side.
    given = 2 * slope(np.zeros_like(size))[1] / size
    steps = np.diag(0.01 / size)
    numeric = [(slope(step)[0] - slope(-step)[0]) / 0.02 for step in steps]
    assert np.abs(given - numeric).max() < 3e-5


def test_steady_images_do_not_shake() -> None:
    for seed in (21, 22, 23):
        _, network = flights.case("attitudes", seed, readout_s=0.03, **SMALL)
        network, _, _ = with_moving_images(network, adjust(network))
        assert not network.cameras[0].shake


@pytest.mark.parametrize(("readout_s", "rolls"), [(0.0, False), (0.03, True)])
def test_a_wrong_lens_that_is_held_feigns_no_readout(readout_s: float, rolls: bool) -> None:
    """c 3 % and the principal point 60 px off, held: much like a readout of 6 ms, but for who frees both."""
    _, network = flights.case("attitudes", 6, readout_s=readout_s, **SMALL)
    own = network.cameras[0]
    guess = own.changed(c=1.03 * flights.C, x0=72.0, y0=51.0)
    held = replace(guess, estimated=own.estimated & ~np.isin(PARAMETERS, ("c", "x0", "y0")))
    network = replace(network, cameras=(held,))
    solution = adjust(network)
    (readout,) = with_readouts(network, solution)[2]
    assert readout.p_value < 1e-3
    assert rolls_whatever_the_lens(network, solution) == rolls


def test_a_readout_that_the_network_does_not_bear_leaves_it_as_it_was() -> None:
    """Images that hover: whatever the readout is, no ray tells."""
    _, network = flights.case("attitudes", 7, readout_s=0.0, **SMALL)
    still = np.zeros_like(network.exposures.motion)
    network = replace(network, exposures=replace(network.exposures, motion=still, motion_sigma=still))
    solution = adjust(network)
    after, found, readouts = with_readouts(network, solution)
    assert after is network
    assert found is solution
    assert readouts == ()


def test_a_trial_that_stagnates_leaves_the_network_as_it_was(monkeypatch: pytest.MonkeyPatch) -> None:
    _, network = flights.case("attitudes", 3, readout_s=0.03, **SMALL)
    solution = adjust(network)
    assert with_readouts(network, solution)[0] is not network
    # Each step of this trial would have to gain, and to shorten the next, by more than any does.
    for name, value in (("_STAGNANT", 1), ("_LITTLE", np.inf), ("_SHORTER", np.inf), ("_MUCH_LEFT", 0.0)):
        monkeypatch.setattr(f"photocal.adjustment.readout.{name}", value)
    after, found, readouts = with_readouts(network, solution)
    assert after is network
    assert found is solution
    assert readouts == ()


def steps(gains: list[float], shrinking: float) -> list[Iteration]:
    """Iterations that gain so much of v'Pv each, with squared steps that shrink by a factor."""
    chi_squared = 15000.0 - np.cumsum(gains)
    return [Iteration(k + 1, float(v), shrinking**k, 0.0) for k, v in enumerate(chi_squared)]


def test_steady_steps_that_gain_nothing_stagnate() -> None:
    """Not so those that still gain, that end soon, or that another adjustment has made.

    Nor those of a trial that has explained much already: they may lead to where the valley falls.
    """
    trial, explaining = _unless_stagnant(None, 15001.0), _unless_stagnant(None, 25000.0)
    for kept in (steps([1.0] * 60, 0.9), steps([0.1] * 30, 0.1), steps([0.1] * 15, 0.9)):
        for iteration in kept:
            trial(iteration)
    for iteration in steps([0.1] * 60, 0.9):
        explaining(iteration)
    *before, twentieth = steps([0.1] * 20, 0.9)
    for iteration in before:
        trial(iteration)
    with pytest.raises(NotConvergedError, match="20 iterations"):
        trial(twentieth)


def test_what_its_own_estimate_contradicts_is_no_readout(monkeypatch: pytest.MonkeyPatch) -> None:
    """Few images may be tested wrongly; freed, a global shutter says that it is one."""
    truth, network = flights.case("positions", 11, readout_s=0.0, **SMALL)
    solution = adjust(network)

    def misled(*arguments: object) -> dict[int, Readout]:
        return {0: Readout(truth.camera.id, 0.05, 0.001, 1e-9, False, 1.0, 0.4)}

    monkeypatch.setattr("photocal.adjustment.readout._tested", misled)
    kept, same, (readout,) = with_readouts(network, solution)
    assert kept is network
    assert same is solution
    assert not readout.estimated
