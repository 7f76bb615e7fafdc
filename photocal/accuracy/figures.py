"""Figures for the report section: residual vectors on a map, histograms of the components."""

from __future__ import annotations

import math
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from acquire.outputs import output_folder
from drivers.arrays import Flags, Floats
from photocal.accuracy.discrepancies import COMPONENTS, SIGN, Discrepancies
from photocal.accuracy.statistics import moments

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

# Longest vector as a share of the width of the map.
_LONGEST = 0.12
# Names of more points than this would hide the vectors.
NAMED = 60
_INK = "#1f4e9c"
_MAP_INCHES = (7.0, 6.0)
_HISTOGRAM_INCHES = (7.0, 2.6)


def round_down(value: float) -> float:
    """Give the largest 1, 2 or 5 times a power of ten that a value reaches."""
    power = 10.0 ** math.floor(math.log10(value))
    return max(step * power for step in (1.0, 2.0, 5.0) if step * power <= value * (1.0 + 1e-12))


def draw_vectors(
    axes: Axes,
    names: tuple[str, ...],
    table: Floats,
    height_text: Callable[[float], str],
    length_text: Callable[[float], str],
    colour: str,
) -> float:
    """Draw discrepancies as vectors at their points, those in height as numbers; give the enlargement.

    table: (n, 5), place and discrepancy in plane, discrepancy in height, m.
    """
    extent = max(float(np.ptp(table[:, 0])), float(np.ptp(table[:, 1])), 1e-9)
    longest = float(np.max(np.hypot(table[:, 2], table[:, 3]))) or 1.0
    enlarge = _LONGEST * extent / longest
    arrows = axes.quiver(
        *table[:, :4].T,
        color=colour,
        zorder=3,
        angles="xy",
        scale_units="xy",
        scale=1.0 / enlarge,
        width=0.003,
    )
    axes.plot(table[:, 0], table[:, 1], ".", color=colour, markersize=3)
    if len(names) <= NAMED:
        for name, row in zip(names, table.tolist(), strict=True):
            text = name if math.isnan(row[4]) else f"{name}\n{height_text(row[4])}"
            axes.annotate(
                text, row[:2], xytext=(3, -3), textcoords="offset points", fontsize=6, va="top", color=colour
            )
    unit = round_down(longest)
    axes.quiverkey(arrows, 0.88, 1.03, unit, length_text(unit), labelpos="E", coordinates="axes")
    axes.set_aspect("equal", adjustable="datalim")
    axes.margins(0.15)
    axes.grid(visible=True, color="#e4e7ea", linewidth=0.5)
    axes.set_axisbelow(True)
    return enlarge


def draw_histogram(axes: Axes, values: Floats, face: str, colour: str) -> None:
    """Draw a histogram with its mean and the normal curve of its moments."""
    edges = np.histogram_bin_edges(values, bins="sturges")
    axes.hist(values, bins=edges.tolist(), color=face, edgecolor=colour, linewidth=0.5)
    mean, spread = float(values.mean()), float(values.std(ddof=1)) if len(values) > 1 else 0.0
    axes.axvline(0.0, color=colour, linewidth=0.6)
    axes.axvline(mean, color=colour, linewidth=1.0, linestyle=(0, (4, 3)))
    if spread > 0.0:
        x = np.linspace(edges[0], edges[-1], 121)
        peak = len(values) * (edges[1] - edges[0]) / (spread * math.sqrt(2.0 * math.pi))
        axes.plot(x, peak * np.exp(-0.5 * ((x - mean) / spread) ** 2), color=colour, linewidth=0.9)


def residual_map(discrepancies: Discrepancies) -> Figure | None:
    """Draw the planimetric discrepancies as vectors, the heights as numbers, at their points.

    returns: matplotlib.figure.Figure or None. None without positions or without planimetric discrepancies.
        North is up, both axes have one scale, the vectors another one that is drawn beside the map.
    """
    from matplotlib.figure import Figure

    if discrepancies.positions_m is None:
        return None
    table = np.column_stack((discrepancies.positions_m[:, :2], discrepancies.d_m))
    known: Flags = np.all(np.isfinite(table[:, :4]), axis=1)
    if not known.any():
        return None
    names = tuple(name for name, has in zip(discrepancies.points, known.tolist(), strict=True) if has)
    figure = Figure(figsize=_MAP_INCHES, layout="constrained")
    axes = figure.add_subplot()
    enlarge = draw_vectors(axes, names, table[known], "{:+.2f}".format, "{:g} m".format, _INK)
    axes.ticklabel_format(style="plain", useOffset=False)
    axes.set_xlabel("E (m)")
    axes.set_ylabel("N (m)")
    numbers = ", numbers: dh (m)" if np.isfinite(table[known][:, 4]).any() else ""
    axes.set_title(
        f"Discrepancies, {SIGN}\nvectors {enlarge:.3g} times enlarged{numbers}", fontsize=9, loc="left"
    )
    axes.tick_params(labelsize=7)
    return figure


def histograms(discrepancies: Discrepancies) -> Figure:
    """Draw a histogram of each component with its mean and the normal curve of its moments."""
    from matplotlib.figure import Figure

    known = [(name, discrepancies.component(name)[1]) for name in COMPONENTS]
    known = [(name, values) for name, values in known if len(values)]
    figure = Figure(figsize=_HISTOGRAM_INCHES, layout="constrained")
    for column, (name, values) in enumerate(known, start=1):
        axes = figure.add_subplot(1, len(known), column)
        _histogram(axes, name, values)
        if column == 1:
            axes.set_ylabel("check points")
    return figure


def _histogram(axes: Axes, name: str, values: Floats) -> None:
    draw_histogram(axes, values, "#9db8d9", _INK)
    figures = moments(values)
    axes.set_xlabel(f"d{name} (m)")
    axes.set_title(f"n {figures.n}, mean {figures.mean_m:+.3f}, RMSE {figures.rmse_m:.3f}", fontsize=7)
    axes.tick_params(labelsize=7)


def write_figures(discrepancies: Discrepancies, folder: Path) -> tuple[Path, ...]:
    """Write the figures of the report section; raises OutputError when the folder cannot be written."""
    drawn = {"residual_map.pdf": residual_map(discrepancies), "histograms.pdf": histograms(discrepancies)}
    made = {name: figure for name, figure in drawn.items() if figure is not None}
    with output_folder(folder) as aside:
        for name, figure in made.items():
            # Without the date the same input gives the same bytes.
            figure.savefig(aside / name, metadata={"CreationDate": None})
    return tuple(folder / name for name in made)
