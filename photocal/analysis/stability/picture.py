"""The picture of a comparison: one matrix of pairs for each method."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from drivers.arrays import Floats
from photocal.analysis.stability.comparison import Pair


def matrix_of(pairs: tuple[Pair, ...], names: tuple[str, ...], which: int) -> Floats:
    """Arrange one figure of every pair as a matrix."""
    place = {name: i for i, name in enumerate(names)}
    matrix = np.full((len(names), len(names)), np.nan)
    for pair in pairs:
        matrix[place[pair.second], place[pair.first]] = pair.figures[which].value_px
    return matrix


def draw(
    pairs: tuple[Pair, ...], names: tuple[str, ...], thresholds_px: tuple[float, ...], path: Path, ending: str
) -> None:
    """Draw the matrices of all methods, coloured by threshold.

    thresholds_px: limits between the colours, ascending, px.
    """
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.colors import BoundaryNorm, LinearSegmentedColormap
    from matplotlib.figure import Figure as Canvas

    kinds = pairs[0].figures
    columns = min(4, len(kinds))
    rows = -(-len(kinds) // columns)
    size = max(2.6, 0.42 * len(names) + 1.2)
    canvas = Canvas(figsize=(size * columns, (size + 0.3) * rows), layout="constrained")
    FigureCanvasAgg(canvas)
    largest = max(figure.value_px for pair in pairs for figure in pair.figures)
    bounds = [0.0, *thresholds_px, max(1.01 * largest, 1.01 * thresholds_px[-1])]
    norm = BoundaryNorm(bounds, 256)
    # Light colours, told apart by everyone, with black figures on them.
    colours = LinearSegmentedColormap.from_list("likeness", ["#9ecae1", "#fee391", "#fc9272"])
    for k, kind in enumerate(kinds):
        axes = canvas.add_subplot(rows, columns, k + 1)
        matrix = matrix_of(pairs, names, k)
        shown = axes.imshow(matrix, cmap=colours, norm=norm)
        for i, j in zip(*np.nonzero(np.isfinite(matrix)), strict=True):
            different = _pair(pairs, names[j], names[i]).figures[k].different
            mark = "*" if different else ""
            axes.text(j, i, f"{matrix[i, j]:.2f}{mark}", ha="center", va="center", fontsize=7)
        axes.set_xticks(range(len(names)), names, rotation=90, fontsize=7)
        axes.set_yticks(range(len(names)), names, fontsize=7)
        axes.set_title(f"{kind.method}: {kind.definition}", fontsize=8)
    bar = canvas.colorbar(shown, ax=canvas.axes, shrink=0.8, label="px")
    bar.set_ticks(bounds[:-1])
    canvas.suptitle("Difference of calibrations (* beyond the noise of both)", fontsize=9)
    canvas.savefig(path, dpi=120, format=ending)


def _pair(pairs: tuple[Pair, ...], first: str, second: str) -> Pair:
    return next(pair for pair in pairs if (pair.first, pair.second) == (first, second))
