"""What is estimated of a camera in the end: a given c that the rays refute is not held."""

from dataclasses import replace

import numpy as np
import pytest

from photocal.adjustment.readout import left_by_movement
from photocal.measurement.release import HOLDING, MOVES, release
from photocal.measurement.tie_adjustment import adjust_ties, assembled
from tests.photocal.measurement.test_lens_choice import ESTIMATE, C, flown, lens


def test_a_c_of_other_pictures_is_not_held() -> None:
    """The tags of a larger picture than the one that was cut of it, with their usual prior sigma."""
    adjusted, block, _ = flown(lens("brown-ideal", (-0.1, 0.05)), 12)
    (own,) = block.cameras
    prior = np.full(len(own.values), np.inf)
    prior[:3] = 0.03 * C
    given = replace(own.changed(c=0.85 * C), prior_sigma=prior)
    released, chosen, findings = release(adjusted, replace(block, cameras=(given,)), HOLDING)
    assert [(one.code, one.subject, one.figures["given"]) for one in findings] == [
        ("c-refuted-by-rays", "c", pytest.approx(0.85 * C))
    ]
    sigma = np.sqrt(released.solution.camera_covariance[0, 0, 0])
    # What was refuted pulls for the last time, by its weight.
    pull = 0.15 * C * (sigma / prior[0]) ** 2
    assert released.solution.cameras[0, 0] == pytest.approx(C, abs=3.5 * sigma + pull)
    assert chosen.cameras[0].free == ESTIMATE
    assert np.isinf(chosen.cameras[0].prior_sigma[0])
    assert chosen.cameras[0].prior_sigma[1] == prior[1]


@pytest.mark.parametrize(("readout", "moves"), [(0.06, True), (0.0, False)])
def test_what_images_may_move_while_read_tells_a_rolling_shutter(readout: float, moves: bool) -> None:
    _, block, tracks = flown(lens("brown-ideal", (-0.1, 0.05)), 13, unknown=True, readout=readout)
    closed = tuple(replace(own, shutter="global") for own in block.cameras)
    still = adjust_ties(replace(block, cameras=closed), block.images.values, tracks)
    unknown = tuple(replace(own, shutter="unknown") for own in still.block.cameras)
    network = assembled(replace(still.block, cameras=unknown), still.values)[0].network
    assert (left_by_movement(network, still.solution) < MOVES) == moves
    assert left_by_movement(still.assembly.network, still.solution) == 1.0
