from __future__ import annotations

import re

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from matplotlib.patches import Rectangle
from matplotlib.quiver import QuiverKey
from matplotlib.text import Text

from photocal.analysis.accuracy.discrepancies import Discrepancies
from photocal.analysis.accuracy.maps import (
    check_figures,
    heights_by_point,
    histograms,
    residual_map,
    round_down,
)
from photocal.findings.texts import catalogue

D = np.random.default_rng(6).normal(0.0, 0.3, (10, 3))
POSITIONS = np.random.default_rng(7).uniform(0.0, 900.0, (10, 3)) + 1e5
EN = catalogue("en")
NAMES = tuple(f"P{i}" for i in range(10))


def test_map_is_labelled_with_units_and_scale() -> None:
    figure = residual_map(Discrepancies(NAMES, D, POSITIONS), EN)
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
    assert residual_map(Discrepancies(NAMES, D), EN) is None
    only_heights = D * np.array([np.nan, np.nan, 1.0])
    assert residual_map(Discrepancies(NAMES, only_heights, POSITIONS), EN) is None


def test_map_of_one_point_and_of_no_error() -> None:
    assert residual_map(Discrepancies(("A",), D[:1], POSITIONS[:1]), EN) is not None
    assert residual_map(Discrepancies(NAMES, 0.0 * D, POSITIONS), EN) is not None


def test_histograms_count_every_point() -> None:
    figure = histograms(Discrepancies(NAMES, D), EN)
    assert [axes.get_xlabel() for axes in figure.axes] == ["dE (m)", "dN (m)", "dh (m)"]
    for axes in figure.axes:
        assert sum(patch.get_height() for patch in axes.patches) == 10  # type: ignore[attr-defined]
    assert len(histograms(Discrepancies(NAMES, D * np.array([np.nan, np.nan, 1.0])), EN).axes) == 1


@given(st.floats(1e-6, 1e6))
def test_round_numbers_of_the_scale_bar(value: float) -> None:
    found = round_down(value)
    assert 0.39 * value <= found <= value * (1 + 1e-9)


def test_heights_point_by_point() -> None:
    figure = heights_by_point(Discrepancies(NAMES, D), EN)
    assert figure is not None
    (axes,) = figure.axes
    heights = [bar.get_height() for bar in axes.patches if isinstance(bar, Rectangle)]
    assert heights == pytest.approx(D[:, 2].tolist())
    assert [label.get_text() for label in axes.get_xticklabels()] == list(NAMES)
    assert f"{sum(D[:, 2] > 0)} of {len(D)} higher" in axes.get_title(loc="left")
    assert heights_by_point(Discrepancies(NAMES, D * np.array([1.0, 1.0, np.nan])), EN) is None


def test_figures_speak_the_language_of_the_reader() -> None:
    given = Discrepancies(NAMES, np.round(D, 3), POSITIONS)
    drawn = [
        figure for figure in check_figures(given, 0.25, catalogue("pt-BR")).values() if figure is not None
    ]
    for figure in drawn:
        figure.canvas.draw()
    said = "\n".join(text.get_text() for figure in drawn for text in figure.findobj(Text))
    assert len(drawn) == 4
    for word in ("produto menos referência", "vetores ampliados", "média", "REQM", "pontos de verificação"):
        assert word in said
    # A comma stands before decimals, and none of the English words is left.
    assert not re.search(r"\d\.\d", said)
    assert not re.search(r"\b(of|mean|check|times|product)\b", said)
