"""Direct georeferencing of one flight with camera and mounting of another, against the truth."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy import stats

from photocal.adjustment.mounting import STRIPS
from photocal.analysis.georeferencing.comparison import differences
from photocal.analysis.georeferencing.direct import Calibration, calibrate
from photocal.analysis.georeferencing.methods import of_method
from photocal.analysis.georeferencing.prepared import with_attitude_angles
from photocal.base.errors import ConfigurationError
from photocal.block.folder import read_block
from photocal.block.model import Block
from tests.photocal.analysis.georeferencing.flights import Errors, Plan, fly

SEEDS = 8
RIG = Errors(lever_arm_m=(0.1, -0.05, -0.2), boresight_deg=(0.4, -0.3, 0.5), time_offset_s=0.008)
# One height only: principal distance and vertical lever arm are hardly told apart, nor need they be.
PLAN = Plan(
    heights_m=(90.0, 92.0),
    tie=50,
    estimate=("c", "x0", "y0", "K1", "K2", "P1", "P2"),
    mounting="lever_arm_m = [0.1, -0.05, -0.2]\nlever_arm_sigma_m = 0.3\n"
    "boresight_sigma_deg = 1.0\ntime_offset_sigma_s = 0.01",
)


def _flight(folder: Path, seed: int, plan: Plan = PLAN) -> Block:
    return with_attitude_angles(read_block(fly(folder / f"f{seed}", np.random.default_rng(seed), RIG, plan)))


def test_errors_of_another_flight_are_predicted(tmp_path: Path) -> None:
    together, apart = [], []
    for seed in range(SEEDS):
        calibration = calibrate(_flight(tmp_path, seed))
        # What the second flight states of camera and rig has no part in it.
        block = _flight(tmp_path, 100 + seed, replace(PLAN, tie=0, estimate=(), mounting=""))
        carried = calibration.on_flight(block.mounting)
        together.append(_distances(block, carried))
        alone = np.diag(np.diag(carried.covariance))
        apart.append(_distances(block, replace(carried, covariance=alone)))
    table = np.array(together)
    p = stats.chi2(3 * SEEDS).sf(table.sum(axis=0))
    assert p.min() > 1e-3 / table.shape[1]
    assert p.max() < 1 - 1e-3 / table.shape[1]
    # Without the correlations the prediction is too large: what cancels on the ground would count.
    assert np.mean(apart) < 0.9 * table.mean()


def _distances(block: Block, calibration: Calibration) -> NDArray[np.float64]:
    return differences(block, of_method(block, "direct", calibration=calibration), "check").distance


def test_another_rig_is_refused(tmp_path: Path) -> None:
    block = _flight(tmp_path, 1)
    size = len(block.cameras[0].values)
    all_of_two = STRIPS + 2 * size
    wrong = Calibration(np.zeros((2, size)), np.zeros(STRIPS), np.zeros((all_of_two, all_of_two)))
    with pytest.raises(ConfigurationError, match="2 cameras"):
        of_method(block, "direct", calibration=wrong)
