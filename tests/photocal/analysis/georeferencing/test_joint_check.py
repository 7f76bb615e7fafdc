"""Check points judged together, by the covariance that they have in common."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from scipy import stats

from photocal.analysis.georeferencing.comparison import differences, joint_test
from photocal.analysis.georeferencing.methods import of_method
from photocal.analysis.georeferencing.prepared import with_attitude_angles
from photocal.block.folder import read_block
from tests.photocal.analysis.georeferencing.flights import Plan, fly


def test_a_common_error_is_no_bias_of_independent_points() -> None:
    """Against the closed form: a variance s^2 that is common and t^2 that is not."""
    n, common, own = 12, 0.04, 0.01
    covariance = np.kron(np.full((n, n), common**2), np.eye(3)) + own**2 * np.eye(3 * n)
    d = np.full((n, 3), 0.05) + 0.01 * np.random.default_rng(1).standard_normal((n, 3))
    found = joint_test(d, covariance)
    of_mean = common**2 + own**2 / n
    np.testing.assert_allclose(found.mean_sigma, np.sqrt(of_mean), rtol=1e-12)
    expected = float(np.sum(d.mean(axis=0) ** 2) / of_mean)
    assert found.mean_p_value == pytest.approx(float(stats.chi2.sf(expected, 3)), rel=1e-9)
    # The means and what is left of them, each with its own variance.
    rest = float(np.sum((d - d.mean(axis=0)) ** 2)) / own**2
    assert found.chi_squared == pytest.approx(expected + rest, rel=1e-9)
    assert found.degrees_of_freedom == 36


def test_a_block_says_both(tmp_path: Path) -> None:
    folder = fly(tmp_path / "flight", np.random.default_rng(3), plan=Plan(tie=40))
    block = with_attitude_angles(read_block(folder))
    found = of_method(block, "integrated")
    check = differences(block, found, "check")
    assert check.joint is not None
    assert check.joint.degrees_of_freedom == check.d.size
    np.testing.assert_allclose(check.joint.mean, check.d.mean(axis=0))
    assert found.joint is not None
    mine = np.flatnonzero(~found.fitted)
    blocks = found.joint.reshape(len(mine), 3, len(mine), 3)
    alone = np.array([blocks[k, :, k] for k in range(len(mine))])
    np.testing.assert_allclose(alone, found.covariance[mine], rtol=1e-6, atol=1e-12)
    assert check.joint.p_value > 1e-3
    assert differences(block, found, "control").joint is None
