"""c of the quick calibration where positions are worse, together, than each of them says."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from photocal.adjustment.adjust import adjust
from photocal.adjustment.solution import Solution
from photocal.findings.texts import catalogue
from photocal.geometry.camera import PARAMETERS
from photocal.measurement.released_c import told_by_rays, with_released_c
from photocal.run.debrief.pictures import ALSO
from photocal.run.debrief.verdict import measured_text
from tests.evidence.quick_c import adjusted as flown_blindly
from tests.photocal.networks import convergent, lens, observe

STATED_M, FLIGHTS = 0.002, 20
CAMERA = lens(estimate=("c",))


def adjusted(seed: int, error_m: float) -> tuple[Solution, Solution]:
    """A block with positions that are off by so much more than stated, with these as stated and loose."""
    rng = np.random.default_rng(seed)
    sigma = np.repeat([np.inf, STATED_M], 3)
    scene = convergent((CAMERA,), images=12, points=60, seed=seed)
    network = observe(scene, rng, exposure_sigma=sigma, point_sigma=np.inf)
    values = network.exposures.values.copy()
    values[:, 3:] += error_m * rng.normal(size=(12, 3))
    exposures = replace(network.exposures, values=values)
    loosely = replace(exposures, sigma=10.0 * exposures.sigma)
    return adjust(replace(network, exposures=exposures)), adjust(replace(network, exposures=loosely))


def rms_of_c(solutions: list[Solution | None]) -> float:
    """Root mean square of the errors of c in their standard deviations."""
    z = [(s.cameras[0, 0] - CAMERA.values[0]) / np.sqrt(s.camera_covariance[0, 0, 0]) for s in solutions if s]
    assert len(z) == FLIGHTS
    return float(np.sqrt(np.mean(np.square(z))))


def test_positions_that_pull_c_do_not_tell_it() -> None:
    pairs = [adjusted(seed, 10.0 * STATED_M) for seed in range(FLIGHTS)]
    assert rms_of_c([stated for stated, _ in pairs]) > 1.8
    # 99.9 % of a chi-square of 20.
    assert rms_of_c([told_by_rays(*pair) for pair in pairs]) < 1.51


def test_positions_as_they_say_tell_it() -> None:
    pairs = [adjusted(seed, 0.0) for seed in range(FLIGHTS)]
    assert sum(told_by_rays(*pair) is pair[0] for pair in pairs) >= FLIGHTS - 1
    assert told_by_rays(pairs[0][0], None) is pairs[0][0]
    assert told_by_rays(None, None) is None


@pytest.mark.slow
def test_a_shutter_that_rolls_is_found_with_c_and_gusts_take_their_part() -> None:
    """Of a readout of 30 ms that nobody has stated; without it c is off by 40 of its standard deviations."""
    made, c = flown_blindly(1, 1.0, 0.03)
    readout, before = PARAMETERS.index("readout"), with_released_c(made, 1.0, ())
    told = told_by_rays(with_released_c(made, 1.0, ALSO), with_released_c(made, 10.0, ALSO))
    assert before is not None
    assert told is not None
    assert abs(before.cameras[0, 0] - c) > 20.0 * np.sqrt(before.camera_covariance[0, 0, 0])
    assert abs(told.cameras[0, 0] - c) < 4.0 * np.sqrt(told.camera_covariance[0, 0, 0])
    assert told.cameras[0, readout] == pytest.approx(
        0.03, abs=4.0 * told.camera_covariance[0, readout, readout] ** 0.5
    )
    # Of nothing that gusts move, c would seem a third better known.
    assert told.camera_covariance[0, 0, 0] > 1.5 * before.camera_covariance[0, 0, 0]


@pytest.mark.slow
def test_beside_a_lens_that_a_certificate_states_the_principal_point_is_released_too() -> None:
    made, _ = flown_blindly(1, 1.0, 0.0)
    network = made.assembly.network
    held = tuple(replace(camera, estimated=np.zeros_like(camera.estimated)) for camera in network.cameras)
    stated = replace(made, assembly=replace(made.assembly, network=replace(network, cameras=held)))
    alone, beside = with_released_c(stated), with_released_c(stated, 1.0, ALSO)
    assert alone is not None
    assert beside is not None
    released = [np.flatnonzero(one.camera_covariance[0].diagonal()).tolist() for one in (alone, beside)]
    assert released == [[0], [0, 1, 2]]
    assert beside.camera_covariance[0, 0, 0] > alone.camera_covariance[0, 0, 0]


@pytest.mark.parametrize(("language", "said"), [("en", "c 839.1 ± 3.9 px"), ("pt-BR", "c 839,1 ± 3,9 px")])
def test_c_is_said_with_the_decimals_of_its_standard_deviation(language: str, said: str) -> None:
    figures = {"camera": "m4e", "unit": "px", "c": 839.136, "sigma": 3.94}
    (line,) = measured_text([("debrief.camera", figures)], catalogue(language))
    assert line.endswith(said)
