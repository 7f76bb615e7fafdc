"""Grave is what harms more than was asked for and whose cause is known."""

from __future__ import annotations

import math

import pytest

from photocal.findings.finding import Finding, Severity, Size
from photocal.findings.harm import Asked, harmful_from, on_ground, weighed, without_metres

# 100 m above ground, 10 m/s, c 10 mm: harmful from 2 cm on.
ASKED = Asked(0.02, 100.0, 10.0, 10.0)


def test_without_a_target_a_pixel_is_the_measure() -> None:
    assert harmful_from(0.02, None) == 0.02
    assert harmful_from(0.02, 0.10) == 0.05


@pytest.mark.parametrize(
    ("size", "expected"),
    [
        (Size(0.3, "m"), 0.3),
        (Size(-0.01, "deg"), math.radians(0.01) * 100.0),
        (Size(0.004, "s"), 0.04),
        (Size(1.5, "1", ground_m=0.07), 0.07),
        (Size(1.5, "1"), None),
        (None, None),
    ],
)
def test_an_error_is_carried_to_the_ground(size: Size | None, expected: float | None) -> None:
    found = on_ground(Finding("lever-arm", "grave", size=size), ASKED)
    assert found == (None if expected is None else pytest.approx(expected))


def test_what_a_change_of_c_does_at_the_distance_of_the_block() -> None:
    finding = Finding("lever-arm", "grave", figures={"change_of_c": -0.005, "moved_height_m": 0.01})
    assert on_ground(finding, ASKED) == pytest.approx(0.05)


@pytest.mark.parametrize(
    ("given", "size_m", "clauses", "expected"),
    [
        ("grave", 0.05, (), "grave"),
        ("grave", 0.05, ("same",), "doubtful"),
        ("grave", 0.01, (), "note"),
        ("grave", 0.01, ("same",), "note"),
        ("doubtful", 0.05, (), "doubtful"),
        ("doubtful", 0.01, (), "note"),
        ("note", 0.05, (), "note"),
        ("refused", 0.01, (), "refused"),
        ("consequence", 0.01, (), "consequence"),
    ],
)
def test_severity_is_that_of_the_harm(
    given: Severity, size_m: float, clauses: tuple[str, ...], expected: Severity
) -> None:
    finding = Finding("lever-arm", given, clauses=clauses, size=Size(size_m, "m"))
    assert weighed(finding, ASKED).severity == expected


def test_what_is_not_known_to_be_harmless_stays() -> None:
    finding = Finding("height-kind", "grave")
    assert weighed(finding, ASKED) == finding


def test_without_a_scale_an_effect_is_a_share_of_the_distance() -> None:
    figures = {"ground_m": 3.5, "shift_c": 0.02, "unit": "mm"}
    size = Size(0.02, "mm", c=0.02, ground_m=-3.5)
    finding = Finding("jackknife", "note", "cam", figures, ("shifts_c", "heights_hang", "only_carried"), size)
    told = without_metres(finding, ASKED)
    assert told.size is not None
    assert told.size.ground_m is None
    assert told.size.of_distance == pytest.approx(0.035)
    assert told.clauses == ("shifts_c_alone", "heights_hang_alone", "only_carried")
    assert "ground_m" not in told.figures
    # Its severity is that of the share of a pixel, which has no scale either.
    assert told.severity == finding.severity
