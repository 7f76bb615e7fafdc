"""The field test of a rover after ISO 17123-8, against sums made by hand."""

from __future__ import annotations

import json
import math
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from photocal.analysis.accuracy.rover_test import SETS, Sets, read_sets, rover_test
from tests.photocal.conftest import Answer

DISTANCE, HEIGHT = 12.0, 0.25


def simulated(seed: int, sigma: tuple[float, float], series: int = 3) -> Sets:
    """Sets of a rover with these standard deviations in each plane coordinate and height."""
    random = np.random.default_rng(seed)
    true = np.array([[100.0, 200.0, 50.0], [100.0 + DISTANCE, 200.0, 50.0 + HEIGHT]])
    noise = random.normal(0.0, 1.0, (series * SETS, 2, 3)) * [sigma[0], sigma[0], sigma[1]]
    names = [(str(i + 1), str(j + 1)) for i in range(series) for j in range(SETS)]
    return tuple(names), true + noise


def write(path: Path, sets: Sets) -> Path:
    lines = ["series,set,point,E,N,h"]
    for (series, name), pair in zip(sets[0], sets[1].tolist(), strict=True):
        lines += [f"{series},{name},{k + 1},{','.join(map(repr, xyz))}" for k, xyz in enumerate(pair)]
    path.write_text("\n".join(lines) + "\n", encoding="utf-8")
    return path


def test_standard_deviations_by_hand() -> None:
    """Sum of squared residuals about the mean of each point over (15 - 1) 2 = 28, term by term."""
    sets = simulated(3, (0.008, 0.012))
    sums = [0.0, 0.0, 0.0]
    for point in (0, 1):
        for axis in (0, 1, 2):
            values = [float(pair[point][axis]) for pair in sets[1]]
            mean = sum(values) / 15
            sums[axis] += sum((v - mean) ** 2 for v in values)
    e, n, h = (math.sqrt(total / 28) for total in sums)
    test = rover_test(sets, DISTANCE, HEIGHT, 0.015, 0.015)
    assert test["full"]
    assert (test["s_e_m"], test["s_n_m"], test["s_h_m"]) == pytest.approx((e, n, h), rel=1e-9)
    assert test["s_xy_m"] == pytest.approx(math.sqrt(e * e + n * n), rel=1e-9)


def test_bounds_are_those_of_tables() -> None:
    """Chi-squared 0.95: 74.468 of 56 and 41.337 of 28; F 0.975: 1.700 of 56, 56 and 2.130 of 28, 28."""
    test = rover_test(simulated(4, (0.007, 0.012)), DISTANCE, HEIGHT, 0.010, 0.012, (0.010, 0.012))
    plane, height, plane_before, height_before = test["tests"]
    assert plane["most_m"] == pytest.approx(0.010 * math.sqrt(74.468 / 56), rel=1e-5)
    assert height["most_m"] == pytest.approx(0.012 * math.sqrt(41.337 / 28), rel=1e-5)
    assert (plane_before["most_m"] / 0.010) ** 2 == pytest.approx(1.70, abs=0.005)
    assert (plane_before["least_m"] / 0.010) ** 2 == pytest.approx(0.59, abs=0.005)
    assert (height_before["most_m"] / 0.012) ** 2 == pytest.approx(2.13, abs=0.005)


def test_a_rover_as_good_as_stated_passes_as_often_as_it_should() -> None:
    """Stated in the plane is for both coordinates together: 0.010 for 0.0071 in each."""
    passed = 0
    for seed in range(300):
        sets = simulated(seed, (0.010 / math.sqrt(2), 0.015))
        tests = rover_test(sets, DISTANCE, HEIGHT, 0.010, 0.015)["tests"]
        passed += all(test["passed"] for test in tests)
    # Two tests at 95 %: 90 % of 300, 4 standard deviations of the count.
    assert abs(passed - 0.9025 * 300) < 4 * math.sqrt(300 * 0.9025 * 0.0975)
    worse = rover_test(simulated(1, (0.030, 0.015)), DISTANCE, HEIGHT, 0.010, 0.015)
    assert not worse["passed"]


def test_the_simplified_test_names_the_gross_set() -> None:
    sets = simulated(5, (0.003, 0.004), series=1)
    sets[1][2, 1, 2] += 0.08
    test = rover_test(sets, DISTANCE, HEIGHT, 0.010, 0.015)
    assert not test["full"]
    assert test["tests"] == []
    assert [one["set"] for one in test["deviations"] if not one["within"]] == ["3"]
    # 2.5 times the standard deviation of a difference of two points.
    assert test["limit_height_m"] == pytest.approx(2.5 * math.sqrt(2) * 0.015)


def test_the_command_and_its_sheet(photocal: Callable[..., Answer], tmp_path: Path) -> None:
    path = write(tmp_path / "sets.csv", simulated(3, (0.006, 0.010)))
    given = ("--distance", DISTANCE, "--height-difference", HEIGHT, "--sigma", "0.010,0.015")
    said = photocal("rover-test", path, *given, "--json")
    assert said.code == 0, said.err
    assert json.loads(said.out)["passed"] is True
    assert "the rover passes" in photocal("rover-test", path, *given).out
    sheet = photocal("forms", "-o", tmp_path / "rover.pdf", "--kinds", "rover", "--language", "pt-BR")
    assert "ISO 17123-8" in sheet.out
    assert (tmp_path / "rover.pdf").read_bytes().startswith(b"%PDF")


def test_what_is_no_test(photocal: Callable[..., Answer], tmp_path: Path) -> None:
    path = write(tmp_path / "sets.csv", simulated(3, (0.006, 0.010), series=2))
    given = ("--distance", DISTANCE, "--height-difference", HEIGHT, "--sigma", "0.010,0.015")
    assert "5, 5 by series" in photocal("rover-test", path, *given).err
    lines = path.read_text(encoding="utf-8").splitlines()
    path.write_text("\n".join(lines[:-1]) + "\n", encoding="utf-8")
    assert "lacks point 2" in photocal("rover-test", path, *given).err
    assert read_sets(write(path, simulated(3, (0.006, 0.010))))[1].shape == (15, 2, 3)
