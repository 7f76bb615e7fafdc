"""Networks of baselines: a wrong antenna height found and named, the rest as good as it claims."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from numpy.typing import NDArray

from photocal.base.errors import IllPosedError
from photocal.base.geodesy import enu_axes, geocentric, geodetic
from photocal.navigation.baseline_network import Baseline, GroundMark, adjust_baselines

Floats = NDArray[np.float64]
LAT, LON = -25.45, -49.23
AXES = enu_axes(LAT, LON)
SIGMA_ENU = np.array([0.004, 0.004, 0.008])
PAIRS = [(0, 1), (0, 2), (0, 3), (1, 2), (1, 3), (2, 3), (2, 4), (3, 4), (3, 5), (4, 5), (1, 5), (0, 4)]
COVARIANCE = AXES.T @ np.diag(SIGMA_ENU**2) @ AXES


def network(
    rng: np.random.Generator, wrong: int | None, height_m: float = 0.1
) -> tuple[list[Baseline], list[GroundMark], Floats]:
    """Six marks over two kilometres and twelve baselines, one with a wrong antenna height."""
    centre = geocentric(np.array([LAT]), np.array([LON]), np.array([900.0]))[0]
    local = rng.uniform([-1000, -1000, -40], [1000, 1000, 40], (6, 3))
    marks = centre + local @ AXES
    found = []
    for number, (a, b) in enumerate(PAIRS):
        error = rng.normal(0, 1, 3) * SIGMA_ENU
        error[2] += height_m if number == wrong else 0.0
        found.append(Baseline(f"s{number}", f"P{a}", f"P{b}", marks[b] - marks[a] + error @ AXES, COVARIANCE))
    return found, [GroundMark("P0", marks[0], np.zeros((3, 3)))], marks


def test_wrong_antenna_heights_are_found_and_the_rest_is_right() -> None:
    rng = np.random.default_rng(12)
    named, inside, total = 0, 0, 0
    for case in range(1000):
        baselines, control, marks = network(rng, case % 12)
        solution = adjust_baselines(baselines, control)
        names = [(b.name, b.component) for b in solution.blunders]
        named += (f"s{case % 12}", "height") in names[:1]
        for name, xyz, cov in zip(
            solution.names, solution.xyz_m, _blocks(solution.covariance_m2), strict=True
        ):
            if name != "P0":
                error = AXES @ (xyz - marks[int(name[1])])
                sigma = np.sqrt(np.diag(AXES @ cov @ AXES.T))
                inside += int((np.abs(error) < sigma).sum())
                total += 3
    # An error of 10 cm is far over what can be detected (3 to 6 cm here).
    assert named == 1000
    # 68.3 % is what must come out of 15 000 components that share their baselines.
    assert inside / total >= 0.68


def test_size_of_the_blunder() -> None:
    baselines, control, _ = network(np.random.default_rng(1), 5)
    blunder = adjust_baselines(baselines, control).blunders[0]
    assert (blunder.name, blunder.start, blunder.end) == ("s5", "P2", "P3")
    assert blunder.size_m == pytest.approx(0.1, abs=4 * blunder.size_sigma_m)


def test_against_dense_least_squares() -> None:
    baselines, control, _ = network(np.random.default_rng(2), None)
    solution = adjust_baselines(baselines, control)
    assert not solution.blunders
    design = np.zeros((36, 15))
    values = np.zeros(36)
    for i, b in enumerate(baselines):
        rows = slice(3 * i, 3 * i + 3)
        values[rows] = b.vector_m
        for name, sign in ((b.start, -1), (b.end, 1)):
            j = int(name[1])
            if j:
                design[rows, 3 * j - 3 : 3 * j] = sign * np.eye(3)
            else:
                values[rows] -= sign * control[0].xyz_m
    root = np.linalg.cholesky(np.linalg.inv(COVARIANCE)).T
    whiten = np.kron(np.eye(12), root)
    expected, *_ = np.linalg.lstsq(whiten @ design, whiten @ values, rcond=None)
    ours = np.concatenate([solution.xyz_m[solution.names.index(f"P{j}")] for j in range(1, 6)])
    assert np.abs(ours - expected).max() < 1e-6
    assert solution.redundancy.sum() == pytest.approx(solution.degrees_of_freedom)
    assert solution.degrees_of_freedom == 21


def test_effects_of_detectable_errors_are_those_of_an_adjustment_with_them() -> None:
    """The measurement changed by the detectable error, adjusted anew: the marks move as foretold."""
    baselines, control, _ = network(np.random.default_rng(5), None)
    solution = adjust_baselines(baselines, control)
    assert not solution.blunders
    for row, component in ((0, 0), (5, 2), (10, 1)):
        error = solution.detectable_m[row, component]
        changed = list(baselines)
        own = baselines[row]
        lat, lon, _ = geodetic(solution.xyz_m[[solution.names.index(own.start)]])
        moved = own.vector_m + error * enu_axes(float(lat[0]), float(lon[0]))[component]
        changed[row] = replace(own, vector_m=moved)
        # Sigmas ten times larger let the error pass; the result is the same.
        loose = [replace(b, covariance_m2=100 * b.covariance_m2) for b in changed]
        other = adjust_baselines(loose, control)
        assert not other.blunders
        shift = np.array(
            [
                enu_axes(*(float(v[0]) for v in geodetic(solution.xyz_m[[k]])[:2]))
                @ (other.xyz_m[other.names.index(name)] - solution.xyz_m[k])
                for k, name in enumerate(solution.names)
            ]
        )
        assert solution.effects_m[row, component] == pytest.approx(shift, abs=1e-6)
        # In units of the covariance, by the marks that are not held.
        free = slice(3, None)
        flat = (other.xyz_m - solution.xyz_m).ravel()[free]
        length = np.sqrt(flat @ np.linalg.solve(solution.covariance_m2[free, free], flat))
        assert solution.distortion[row, component] == pytest.approx(length, rel=1e-3)
    # What nothing checks may move its mark by anything.
    alone = adjust_baselines(baselines[:1], control)
    assert np.isinf(alone.effects_m).all()


def test_unconnected_and_unknown() -> None:
    baselines, control, _ = network(np.random.default_rng(3), None)
    with pytest.raises(IllPosedError, match="P4"):
        adjust_baselines(
            [b for b in baselines if "P4" not in (b.start, b.end)]
            + [Baseline("x", "P4", "P9", np.ones(3), COVARIANCE)],
            control,
        )
    with pytest.raises(IllPosedError, match="no known mark"):
        adjust_baselines(baselines, [])


def test_single_baseline_has_nothing_to_check_it() -> None:
    baselines, control, marks = network(np.random.default_rng(4), 0)
    solution = adjust_baselines(baselines[:1], control)
    assert not solution.blunders
    assert np.isinf(solution.detectable_m).all()
    assert np.linalg.norm(solution.xyz_m[1] - marks[1]) > 0.05


def _blocks(covariance: Floats) -> list[Floats]:
    return [covariance[3 * i : 3 * i + 3, 3 * i : 3 * i + 3] for i in range(len(covariance) // 3)]
