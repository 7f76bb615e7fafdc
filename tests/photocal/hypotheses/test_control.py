"""Control points that contradict each other: several, exchanged, wrong sigmas, and slips told by chance."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

import photocal
from photocal.adjustment.adjusted import fit
from photocal.base.arrays import Floats
from photocal.block.network import assemble
from photocal.hypotheses.causes import candidates
from photocal.hypotheses.control import (
    Contradiction,
    Predicted,
    WrongSigmas,
    contradiction,
    misfit,
    predicted,
    slips,
)
from tests.evidence.judging import fly
from tests.independent.faults import BASE, CLEAN
from tests.independent.flights import Design, Errors

N, SURVEY, IMAGES = 9, 0.01, 0.02


def seen(rng: np.random.Generator, wrong: dict[int, Floats], factor: float = 1.0) -> Predicted:
    """Nine points on a field, predicted by images to 2 cm and a common 10 cm, surveyed to 1 cm."""
    places = np.column_stack([rng.uniform(-100.0, 100.0, (N, 2)), rng.uniform(0.0, 5.0, N)])
    survey = rng.normal(0.0, factor * SURVEY, (N, 3))
    given = places + survey
    for k, error in wrong.items():
        given[k] += error
    computed = places + rng.normal(0.0, IMAGES, (N, 3)) + rng.normal(0.0, 0.1, 3)
    covariance = np.kron(np.full((N, N), 0.1**2), np.eye(3)) + (IMAGES**2 + SURVEY**2) * np.eye(3 * N)
    common = np.tile(np.eye(3), (N, 1))
    return Predicted(
        np.arange(N), computed - given, covariance, common, given, np.tile(SURVEY**2 * np.eye(3), (N, 1, 1))
    )


@pytest.mark.parametrize(
    ("design", "in_common"), [(BASE, 3), (next(d for d in CLEAN if d.name == "control alone"), 7)]
)
def test_what_control_contradicts_is_known_without_an_adjustment_more(
    tmp_path: Path, design: Design, in_common: int
) -> None:
    """By the factors of the block with its control as by an adjustment without it; without positions a turn
    and a scale of all points are free, too.
    """
    flown = fly(tmp_path / "block", design, Errors(control=((1, (0.0, 0.0, 0.1)),)), 1)
    given = fit(assemble(photocal.read_block(flown.folder)).network)
    fall, count = candidates(given).of_control()
    seen = predicted(given.network, given.state)
    assert seen is not None
    assert count == 3 * design.control - in_common
    assert fall == pytest.approx(misfit(seen.d, seen.covariance, seen.common, ()), rel=0.01)


def test_points_that_agree_contradict_nobody() -> None:
    assert sum(contradiction(seen(np.random.default_rng(k), {})) is not None for k in range(40)) <= 1


@pytest.mark.parametrize("count", [1, 2, 3])
def test_up_to_a_third_of_the_points_is_named(count: int) -> None:
    """Errors alike in height, which hide each other one by one."""
    named = 0
    for seed in range(10):
        rng = np.random.default_rng(100 + seed)
        rows = rng.choice(N, count, replace=False).tolist()
        found = contradiction(seen(rng, {k: np.array([0.0, 0.0, 0.3]) for k in rows}))
        # A third of all, and all alike, may be a survey that is worse as a whole.
        if count == 3 and isinstance(found, WrongSigmas):
            continue
        assert isinstance(found, Contradiction)
        assert set(found.points) == set(rows)
        assert not found.exchanged
        assert (np.abs(found.error - [0.0, 0.0, -0.3]) < 4.5 * found.sigma).all()
        named += 1
    assert named >= 8


def test_two_points_that_changed_places_are_named_as_that() -> None:
    for seed in range(10):
        rng = np.random.default_rng(200 + seed)
        whole = seen(rng, {})
        i, j = rng.choice(N, 2, replace=False).tolist()
        given = whole.given.copy()
        given[[i, j]] = given[[j, i]]
        moved = Predicted(
            whole.points, whole.d + whole.given - given, whole.covariance, whole.common, given, whole.survey
        )
        found = contradiction(moved)
        assert isinstance(found, Contradiction)
        assert found.exchanged
        assert set(found.points) == {i, j}


def test_a_survey_that_is_worse_as_a_whole_is_laid_at_no_points_door() -> None:
    """Twelve times worse than stated: of ten blocks no more than one has points that are blamed."""
    blamed = [contradiction(seen(np.random.default_rng(300 + k), {}, 12.0)) for k in range(10)]
    assert sum(isinstance(one, Contradiction) for one in blamed) <= 1


def test_a_slip_of_the_pen_is_told_where_chance_makes_none() -> None:
    """Errors of 0.15 to 1 m, standard deviations of 10 to 45 mm: a digit fits nearly all of them."""
    rng, told = np.random.default_rng(5), 0
    for _ in range(60):
        given = np.array([4132.518, 7841.236, 87.412]) + rng.uniform(0.0, 9.0, 3)
        sigma = rng.uniform(0.010, 0.045, 3)
        wanted = given.copy()
        wanted[rng.integers(3)] += rng.choice([-1.0, 1.0]) * rng.uniform(0.15, 1.0)
        told += bool(slips(given, wanted, sigma, "local"))
    assert told <= 9
    # A thousand metres too many, or the sign, are no chance.
    given, sigma = np.array([4132.518, 7841.236, 87.412]), np.full(3, 0.01)
    for meant in ([5132.521, 7841.236, 87.412], [4132.518, -7841.231, 87.412], [7841.23, 4132.52, 87.41]):
        assert slips(given, np.array(meant), sigma, "local")
