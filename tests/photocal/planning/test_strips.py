from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray

from photocal.base.errors import ConfigurationError
from photocal.planning.area import inside, polygon_area
from photocal.planning.flight import Strip, best_azimuth, plan_strips, suggest_layout

FloatArray = NDArray[np.float64]
SQUARE = np.array([[0.0, 0.0], [400.0, 0.0], [400.0, 300.0], [0.0, 300.0]])
L_SHAPE = np.array([[0.0, 0.0], [600.0, 0.0], [600.0, 200.0], [200.0, 200.0], [200.0, 500.0], [0.0, 500.0]])

stars = st.lists(st.floats(60.0, 400.0), min_size=4, max_size=9).map(
    lambda radii: np.array(
        [
            [r * math.cos(2 * math.pi * k / len(radii)), r * math.sin(2 * math.pi * k / len(radii))]
            for k, r in enumerate(radii)
        ]
    )
)


def rays(
    strips: tuple[Strip, ...], azimuth: float, ground: FloatArray, along: float, across: float
) -> FloatArray:
    """Number of vertical photos that show each point, by the footprint of each photo."""
    centres = np.vstack([strip.exposures_m for strip in strips])
    direction = np.array([math.sin(azimuth), math.cos(azimuth)])
    normal = np.array([math.cos(azimuth), -math.sin(azimuth)])
    apart = ground[:, np.newaxis] - centres
    seen = (np.abs(apart @ direction) <= along / 2.0 + 1e-9) & (np.abs(apart @ normal) <= across / 2.0 + 1e-9)
    return np.asarray(seen.sum(axis=1))


@settings(max_examples=60)
@given(stars, st.floats(0.0, math.pi), st.floats(0.6, 0.85), st.floats(0.3, 0.8))
def test_every_point_of_the_area_is_on_as_many_photos_as_the_overlaps_promise(
    corners: FloatArray, azimuth: float, forward: float, side: float
) -> None:
    along, across = 100.0, 150.0
    strips = plan_strips(corners, azimuth, (1.0 - side) * across, (1.0 - forward) * along, along / 2.0, 100.0)
    low, high = corners.min(axis=0), corners.max(axis=0)
    grid = np.stack(np.meshgrid(*np.linspace(low, high, 25).T), axis=-1).reshape(-1, 2)
    grid = grid[inside(grid, corners)]
    promised = math.floor(1.0 / (1.0 - forward) + 1e-9)
    counts = rays(strips, azimuth, grid, along, across)
    # At least one strip shows each point, with the full number of photos that the forward overlap gives.
    assert counts.min() >= promised


@given(stars, st.floats(0.0, math.pi), st.floats(10.0, 80.0), st.floats(5.0, 60.0))
def test_strips_are_parallel_evenly_spaced_and_flown_to_and_fro(
    corners: FloatArray, azimuth: float, spacing: float, base: float
) -> None:
    strips = plan_strips(corners, azimuth, spacing, base, 20.0, 80.0)
    direction = np.array([math.sin(azimuth), math.cos(azimuth)])
    normal = np.array([math.cos(azimuth), -math.sin(azimuth)])
    lines = [float(strip.exposures_m[0] @ normal) for strip in strips]
    assert np.diff(lines) == pytest.approx(np.full(len(lines) - 1, np.diff(lines)[0]), abs=1e-6)
    assert abs(np.diff(lines)[0]) <= spacing * (1 + 1e-9)
    for number, strip in enumerate(strips):
        steps = np.diff(strip.exposures_m @ direction)
        assert steps == pytest.approx(np.full(len(steps), base * (-1) ** number), abs=1e-6)
        assert float(np.ptp(strip.exposures_m @ normal)) == pytest.approx(0.0, abs=1e-6)


def test_a_rectangle_is_flown_along_its_long_side() -> None:
    azimuth = best_azimuth(SQUARE)
    assert azimuth == pytest.approx(math.pi / 2.0)
    strips = plan_strips(SQUARE, azimuth, 100.0, 40.0, 60.0, 100.0)
    # Width 300 m at 100 m: four strips; 400 m and 60 m beyond each end at 40 m: 13 bases.
    assert len(strips) == 4
    assert [len(strip.exposures_m) for strip in strips] == [14] * 4
    assert strips[0].length_m == pytest.approx(520.0)


@given(stars, st.floats(0.0, math.pi))
def test_no_other_direction_crosses_a_narrower_area(corners: FloatArray, other: float) -> None:
    def width(azimuth: float) -> float:
        return float(np.ptp(corners @ np.array([math.cos(azimuth), -math.sin(azimuth)])))

    assert width(best_azimuth(corners)) <= width(other) + 1e-6


def test_strips_of_an_l_follow_its_arms() -> None:
    strips = plan_strips(L_SHAPE, math.pi / 2.0, 100.0, 25.0, 25.0, 100.0)
    lengths = [strip.length_m for strip in strips]
    assert max(lengths[3:]) < 300.0 or max(lengths[:3]) < 300.0
    assert max(lengths) > 600.0


def test_absurd_plans_are_refused() -> None:
    with pytest.raises(ConfigurationError, match="more than"):
        plan_strips(SQUARE, 0.0, 0.01, 0.01, 0.0, 100.0)
    with pytest.raises(ConfigurationError, match="positive"):
        plan_strips(SQUARE, 0.0, 0.0, 10.0, 0.0, 100.0)


def test_control_takes_the_corners_and_check_points_stay_away() -> None:
    control_m, check_m = suggest_layout(SQUARE, 5, 12, 10.0)
    assert control_m.shape == (5, 2)
    assert check_m.shape == (12, 2)
    for corner in SQUARE:
        assert float(np.min(np.hypot(*(control_m - corner).T))) < 30.0
    # The fifth fills the middle.
    assert np.hypot(*(control_m[4] - [200.0, 150.0])) < 20.0
    apart = np.hypot(*(check_m[:, np.newaxis] - control_m).transpose(2, 0, 1))
    assert float(apart.min()) > 30.0
    assert inside(np.vstack((control_m, check_m)), SQUARE).all()


@settings(max_examples=30)
@given(stars, st.integers(3, 12), st.integers(0, 30))
def test_points_lie_inside_and_apart(corners: FloatArray, control: int, check: int) -> None:
    control_m, check_m = suggest_layout(corners, control, check, 0.5)
    everything = np.vstack((control_m, check_m))
    assert inside(everything, corners).all()
    apart = np.hypot(*(everything[:, np.newaxis] - everything).transpose(2, 0, 1))
    np.fill_diagonal(apart, np.inf)
    # Farthest-point sampling cannot pack tighter than the grid it chooses from.
    assert float(apart.min()) >= math.sqrt(abs(polygon_area(corners))) / 60.0 - 1e-9


def test_layouts_that_orient_nothing_or_have_no_room() -> None:
    with pytest.raises(ConfigurationError, match="too few to orient"):
        suggest_layout(SQUARE, 2, 10, 5.0)
    with pytest.raises(ConfigurationError, match="no room"):
        suggest_layout(SQUARE, 5, 10, 160.0)
