"""Direct, integrated and indirect georeferencing of flights with known truth."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from scipy import stats

from photocal.analysis.georeferencing.comparison import differences
from photocal.analysis.georeferencing.methods import METHODS, Method, of_method
from photocal.analysis.georeferencing.prepared import checkable, in_local_frame, with_attitude_angles
from photocal.base.errors import IllPosedError
from photocal.block.folder import read_block
from tests.photocal.analysis.georeferencing.flights import Plan, fly
from tests.simulated import PLANS, simulate

SEEDS = 6
SMALL = Plan(tie=50)


def distances(
    folder: Path, plan: Plan, seeds: int, methods: tuple[Method, ...] = METHODS
) -> dict[str, object]:
    """d' C^-1 d at the check points, shape (seeds, points), for each method."""
    found: dict[str, list[object]] = {method: [] for method in methods}
    for seed in range(seeds):
        block = read_block(fly(folder / f"flight{seed}", np.random.default_rng(seed), plan=plan))
        for method in methods:
            check = differences(block, of_method(block, method), "check")
            assert len(check.names) == 20
            found[method].append(check.distance)
    return {method: np.array(rows) for method, rows in found.items()}


def test_errors_agree_with_predicted_covariance(tmp_path: Path) -> None:
    """Seeds are independent, points are not: the sum over seeds of one point is chi-squared."""
    for method, rows in distances(tmp_path, SMALL, SEEDS).items():
        table = np.asarray(rows, dtype=float)
        p = stats.chi2(3 * SEEDS).sf(table.sum(axis=0))
        assert p.min() > 1e-3 / 20, method
        assert p.max() < 1 - 1e-3 / 20, method
        assert 0.75 < table.mean() / 3 < 1.3, method


def test_direct_covariance_knows_camera_and_mounting(tmp_path: Path) -> None:
    """Errors that all exposures share make all points wrong together; the prediction contains them."""
    plan = Plan(
        tie=0,
        estimate=("c", "x0", "y0"),
        camera_sigma={"c": 0.01, "x0": 0.004, "y0": 0.004},
    )
    rows = np.asarray(distances(tmp_path, plan, 12, ("direct",))["direct"], dtype=float)
    # Twelve independent draws of the common errors: one point is chi-squared, all points move together.
    p = stats.chi2(36).sf(rows.sum(axis=0))
    assert p.min() > 1e-3 / 20
    assert p.max() < 1 - 1e-3 / 20


def test_common_errors_enlarge_the_direct_prediction(tmp_path: Path) -> None:
    sigmas = {}
    for name, mounting in (("held", ""), ("weighted", "lever_arm_sigma_m = 0.2\nboresight_sigma_deg = 0.1")):
        plan = Plan(tie=0, mounting=mounting)
        block = read_block(fly(tmp_path / name, np.random.default_rng(1), plan=plan))
        sigmas[name] = differences(block, of_method(block, "direct"), "check").product_sigma
    # A vertical lever arm known to 0.2 m leaves the heights at least as uncertain.
    assert np.all(sigmas["weighted"] > sigmas["held"])
    assert sigmas["weighted"][:, 2].min() > 0.15


def test_control_is_fitted_by_adjustments_only(tmp_path: Path) -> None:
    block = read_block(fly(tmp_path / "flight", np.random.default_rng(2), plan=SMALL))
    direct, indirect = of_method(block, "direct"), of_method(block, "indirect")
    assert not direct.fitted.any()
    assert indirect.fitted.sum() == 9
    control = differences(block, indirect, "control")
    assert np.sqrt(np.nanmean(control.w**2)) == pytest.approx(1.0, abs=0.35)
    assert control.names == tuple(f"p{k}" for k in range(9))


def test_images_without_noise_are_met(tmp_path: Path) -> None:
    plan = Plan(
        tie=50,
        pixel_sigma=1e-4,
        position_sigma_m=1e-5,
        attitude_sigma_deg=1e-6,
        control_sigma_m=1e-5,
        check_sigma_m=1e-6,
    )
    block = read_block(fly(tmp_path / "flight", np.random.default_rng(2), plan=plan))
    for method in METHODS:
        found = of_method(block, method)
        assert np.abs(differences(block, found, "check").d).max() < 1e-4, method
        assert found.images.rms.max() < 1e-3, method


def test_rays_that_meet_nowhere_are_refused(tmp_path: Path) -> None:
    """Events 18 s off: each exposure is placed where another one was."""
    wrong = {"level": "block", "faults": ["event_time_base"], "observing": {"ties": 20}}
    site = simulate(tmp_path / "flight", PLANS / "small.toml", **wrong)
    block = with_attitude_angles(checkable(in_local_frame(read_block(site / "block"))))
    with pytest.raises(IllPosedError, match=r"rays .* that meet"):
        of_method(block, "direct")
