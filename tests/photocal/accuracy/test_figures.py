from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from matplotlib.patches import Rectangle
from matplotlib.quiver import QuiverKey

from photocal.accuracy.discrepancies import Discrepancies
from photocal.accuracy.maps import heights_by_point, histograms, residual_map, round_down

D = np.random.default_rng(6).normal(0.0, 0.3, (10, 3))
POSITIONS = np.random.default_rng(7).uniform(0.0, 900.0, (10, 3)) + 1e5
NAMES = tuple(f"P{i}" for i in range(10))


def test_map_is_labelled_with_units_and_scale() -> None:
    figure = residual_map(Discrepancies(NAMES, D, POSITIONS))
    assert figure is not None
    axes = figure.axes[0]
    assert (axes.get_xlabel(), axes.get_ylabel()) == ("E (m)", "N (m)")
    assert axes.get_aspect() == 1.0
    assert "product minus reference" in axes.get_title(loc="left")
    assert "times enlarged" in axes.get_title(loc="left")
    assert axes.collections[0].get_offsets() == pytest.approx(POSITIONS[:, :2])
    keys = [artist for artist in axes.get_children() if isinstance(artist, QuiverKey)]
    assert [key.text.get_text().endswith(" m") for key in keys] == [True]


def test_no_map_without_positions_or_plane() -> None:
    assert residual_map(Discrepancies(NAMES, D)) is None
    only_heights = D * np.array([np.nan, np.nan, 1.0])
    assert residual_map(Discrepancies(NAMES, only_heights, POSITIONS)) is None


def test_map_of_one_point_and_of_no_error() -> None:
    assert residual_map(Discrepancies(("A",), D[:1], POSITIONS[:1])) is not None
    assert residual_map(Discrepancies(NAMES, 0.0 * D, POSITIONS)) is not None


def test_histograms_count_every_point() -> None:
    figure = histograms(Discrepancies(NAMES, D))
    assert [axes.get_xlabel() for axes in figure.axes] == ["dE (m)", "dN (m)", "dh (m)"]
    for axes in figure.axes:
        assert sum(patch.get_height() for patch in axes.patches) == 10  # type: ignore[attr-defined]
    assert len(histograms(Discrepancies(NAMES, D * np.array([np.nan, np.nan, 1.0]))).axes) == 1


@given(st.floats(1e-6, 1e6))
def test_round_numbers_of_the_scale_bar(value: float) -> None:
    found = round_down(value)
    assert 0.39 * value <= found <= value * (1 + 1e-9)


def test_heights_point_by_point() -> None:
    figure = heights_by_point(Discrepancies(NAMES, D))
    assert figure is not None
    (axes,) = figure.axes
    heights = [bar.get_height() for bar in axes.patches if isinstance(bar, Rectangle)]
    assert heights == pytest.approx(D[:, 2].tolist())
    assert [label.get_text() for label in axes.get_xticklabels()] == list(NAMES)
    assert f"{sum(D[:, 2] > 0)} of {len(D)} higher" in axes.get_title(loc="left")
    assert heights_by_point(Discrepancies(NAMES, D * np.array([1.0, 1.0, np.nan]))) is None
