"""Calibrations of runs enter a comparison as the adjustment gave them."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from photocal.adjustment.adjust import adjust
from photocal.block.folder import read_block
from photocal.block.network import assemble
from photocal.block.process import adjust_block
from photocal.report.calibrations import calibrations_of_run
from photocal.report.run_reader import read_adjustment

DEMO = Path(__file__).resolve().parents[3] / "configs" / "demo" / "dcs460"


def test_values_and_covariance_are_those_of_the_adjustment(tmp_path: Path) -> None:
    adjust_block(DEMO, tmp_path / "run")
    (found,) = calibrations_of_run(read_adjustment(tmp_path / "run").result, "2024")
    network = assemble(read_block(DEMO)).network
    solution = adjust(network)
    assert found.id == "2024"
    np.testing.assert_allclose(found.camera.values, solution.cameras[0], rtol=1e-9)
    assert found.uncertainty is not None
    at = np.flatnonzero(network.cameras[0].estimated)
    expected = solution.camera_covariance[0][np.ix_(at, at)]
    scale = np.sqrt(np.outer(np.diag(expected), np.diag(expected)))
    np.testing.assert_allclose(found.uncertainty.covariance / scale, expected / scale, atol=1e-6)
