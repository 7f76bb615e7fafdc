"""What is estimated of a camera in the end: a given c that the rays refute is not held."""

from dataclasses import replace

import numpy as np
import pytest

from photocal.measurement.project_block import HOLDING, release
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
