"""Figures for the report section: residual vectors on a map, histograms of the components."""

from __future__ import annotations

import math
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
_MAP_INCHES = (7.0, 6.0)
_HISTOGRAM_INCHES = (7.0, 2.6)


def round_down(value: float) -> float:
    """Give the largest 1, 2 or 5 times a power of ten that a value reaches."""
    power = 10.0 ** math.floor(math.log10(value))
    return max(step * power for step in (1.0, 2.0, 5.0) if step * power <= value * (1.0 + 1e-12))


def residual_map(discrepancies: Discrepancies) -> Figure | None:
    """Draw the planimetric discrepancies as vectors, the heights as bars, at their points.

    Returns
    -------
    matplotlib.figure.Figure or None
        None without positions or without planimetric discrepancies. North is up, both axes have one
        scale, the vectors another one that is drawn beside the map.
    """
    from matplotlib.figure import Figure

    if discrepancies.positions_m is None:
        return None
    table = np.column_stack((discrepancies.positions_m[:, :2], discrepancies.d_m))
    known: Flags = np.all(np.isfinite(table[:, :4]), axis=1)
    if not known.any():
        return None
    names = [name for name, has in zip(discrepancies.points, known.tolist(), strict=True) if has]
    table = table[known]
    figure = Figure(figsize=_MAP_INCHES, layout="constrained")
    axes = figure.add_subplot()
    extent = max(float(np.ptp(table[:, 0])), float(np.ptp(table[:, 1])), 1.0)
    longest = float(np.max(np.hypot(table[:, 2], table[:, 3]))) or 1.0
    enlarge = _LONGEST * extent / longest
    quiver = axes.quiver(
        *table[:, :4].T,
        color="#1f4e9c",
        zorder=3,
        angles="xy",
        scale_units="xy",
        scale=1.0 / enlarge,
        width=0.004,
    )
    axes.plot(table[:, 0], table[:, 1], "k.", markersize=4)
    for name, row in zip(names, table, strict=True):
        height = "" if math.isnan(row[4]) else f"\n{row[4]:+.2f}"
        axes.annotate(
            f"{name}{height}", row[:2], xytext=(3, -3), textcoords="offset points", fontsize=6, va="top"
        )
    unit = round_down(longest)
    axes.quiverkey(quiver, 0.9, 1.03, unit, f"{unit:g} m", labelpos="E", coordinates="axes")
    axes.set_aspect("equal", adjustable="datalim")
    axes.margins(0.18)
    axes.ticklabel_format(style="plain", useOffset=False)
    axes.set_xlabel("E (m)")
    axes.set_ylabel("N (m)")
    numbers = ", numbers: dh (m)" if np.isfinite(table[:, 4]).any() else ""
    axes.set_title(
        f"Discrepancies, {SIGN}\nvectors {enlarge:.3g} times enlarged{numbers}",
        fontsize=9,
        loc="left",
    )
    axes.tick_params(labelsize=7)
    axes.grid(visible=True, linewidth=0.3)
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
    edges = np.histogram_bin_edges(values, bins="sturges")
    axes.hist(values, bins=edges.tolist(), color="#9db8d9", edgecolor="black", linewidth=0.5)
    figures = moments(values)
    axes.axvline(0.0, color="black", linewidth=0.8)
    axes.axvline(figures.mean_m, color="#b02a2a", linewidth=1.2, linestyle="--")
    if figures.n > 1 and figures.std_m > 0.0:
        x = np.linspace(edges[0], edges[-1], 200)
        density = np.exp(-0.5 * ((x - figures.mean_m) / figures.std_m) ** 2)
        peak = figures.n * (edges[1] - edges[0]) / (figures.std_m * math.sqrt(2.0 * math.pi))
        axes.plot(x, peak * density, color="#b02a2a", linewidth=1.0)
    axes.set_xlabel(f"d{name} (m)")
    axes.set_title(f"n {figures.n}, mean {figures.mean_m:+.3f}, RMSE {figures.rmse_m:.3f}", fontsize=7)
    axes.tick_params(labelsize=7)


def write_figures(discrepancies: Discrepancies, folder: Path) -> tuple[Path, ...]:
    """Write the figures of the report section.

    Raises
    ------
    OutputError
        When the folder cannot be written.
    """
    drawn = {"residual_map.pdf": residual_map(discrepancies), "histograms.pdf": histograms(discrepancies)}
    made = {name: figure for name, figure in drawn.items() if figure is not None}
    with output_folder(folder) as aside:
        for name, figure in made.items():
            # Without the date the same input gives the same bytes.
            figure.savefig(aside / name, metadata={"CreationDate": None})
    return tuple(folder / name for name in made)
