"""Angles and straight lines between points: derivatives by differences, values by hand, errors of tables."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from photocal.adjustment.observations import among_three, related
from photocal.base.arrays import Floats
from photocal.base.errors import InputMalformedError
from photocal.block.folder import read_relations

POINTS = np.array(
    [[[0.4, -0.2, 1.1], [2.3, 1.9, 0.2], [1.0, 3.1, -0.7]], [[1, 2, 3], [-4, 0, 3.5], [2, 2, 0]]]
)


def vertical(points: Floats) -> Floats:
    return np.asarray(related("vertical_angle", points[:, 1] - points[:, 0])[0])


def test_values_by_hand() -> None:
    """Azimuths 0 and 90 degrees; 1 up over 1 level; 3, 4, 5 beside a line along X."""
    points = np.array([[[0.0, 0, 0], [0, 1, 0], [2, 0, 5]]])
    assert np.degrees(among_three("horizontal_angle", points)[0]) == pytest.approx(90.0)
    assert np.degrees(vertical(np.array([[[0.0, 0, 0], [0.6, 0.8, 1.0]]]))) == pytest.approx(45.0)
    beside = among_three("line", np.array([[[1.0, 0, 0], [9.0, 0, 0], [2.0, 3.0, 4.0]]]))[0]
    assert np.linalg.norm(beside) == pytest.approx(5.0)


def test_derivatives_against_differences() -> None:
    step = 1e-6
    _, by_second = related("vertical_angle", POINTS[:, 1] - POINTS[:, 0])
    _, by_end = among_three("horizontal_angle", POINTS)
    beside, of_line = among_three("line", POINTS)
    # The axes turn with the line; the square of the distance does not depend on them.
    by_square = 2.0 * np.einsum("nm,nmki->nki", beside, of_line)
    for k in range(3):
        for axis in range(3):
            low, high = POINTS.copy(), POINTS.copy()
            low[:, k, axis] -= step
            high[:, k, axis] += step

            def square(points: Floats) -> Floats:
                return np.asarray(np.sum(among_three("line", points)[0] ** 2, axis=1))

            def angle(points: Floats) -> Floats:
                return among_three("horizontal_angle", points)[0][:, 0]

            rate = (angle(high) - angle(low)) / (2 * step)
            assert by_end[:, 0, k, axis] == pytest.approx(rate, abs=1e-8)
            assert by_square[:, k, axis] == pytest.approx((square(high) - square(low)) / (2 * step), abs=1e-7)
            if k == 1:
                rate = (vertical(high) - vertical(low)) / (2 * step)
                assert by_second[:, axis] == pytest.approx(rate, abs=1e-8)


def test_tables_of_angles_and_lines(tmp_path: Path) -> None:
    names = ("A", "B", "C")
    angles = tmp_path / "horizontal_angles.csv"
    angles.write_text("at,from,to,value,sigma\nB,A,C,90,0.001\n", encoding="utf-8")
    found = read_relations(angles, "horizontal_angle", names)
    assert found.ends.tolist() == [[1, 0, 2]]
    assert found.values == pytest.approx([np.pi / 2])
    lines = tmp_path / "lines.csv"
    lines.write_text("from,to,point,sigma\nA,C,B,0.002\n", encoding="utf-8")
    assert read_relations(lines, "line", names).sigma.tolist() == [0.002]
    lines.write_text("from,to,point,sigma\nA,C,A,0.002\n", encoding="utf-8")
    with pytest.raises(InputMalformedError, match="name 3 points"):
        read_relations(lines, "line", names)
