"""Pictures of the check points: differences on a map, and how they are distributed."""

from __future__ import annotations

import math

import numpy as np

from drivers.arrays import Floats
from photocal.findings.catalogue import Catalogue
from photocal.findings.digits import fixed
from photocal.report.figures import INK, SHADE, WIDTH, drawing, localised

# Longest vector as a share of the larger side of the map.
LONGEST = 0.12
# Names of more points than this would hide the vectors.
NAMED = 60


def difference_map(names: tuple[str, ...], place: Floats, d: Floats, say: Catalogue) -> str:
    """Draw the differences in plane as vectors at their points, those in height beside the names."""
    extent = max(float(np.ptp(place[:, 0])), float(np.ptp(place[:, 1])), 1e-9)
    longest = float(np.hypot(d[:, 0], d[:, 1]).max()) or 1.0
    enlarged = LONGEST * extent / longest
    with drawing(WIDTH, 4.4) as (figure, out):
        ax = figure.add_axes((0.135, 0.1, 0.845, 0.84))
        arrows = ax.quiver(
            place[:, 0],
            place[:, 1],
            d[:, 0],
            d[:, 1],
            angles="xy",
            scale_units="xy",
            scale=1.0 / enlarged,
            width=0.003,
            color=INK,
        )
        ax.plot(place[:, 0], place[:, 1], ".", color=INK, markersize=3)
        if len(names) <= NAMED:
            for name, (x, y), dz in zip(names, place[:, :2].tolist(), d[:, 2].tolist(), strict=True):
                text = f"{name}\n{'+' if dz > 0 else ''}{fixed(1e3 * dz, 0, say.mark)}"
                ax.annotate(
                    text, (x, y), xytext=(3, -3), textcoords="offset points", fontsize=6, va="top", color=INK
                )
        unit = _round_down(longest)
        label = f"{fixed(1e3 * unit, max(0, -math.floor(math.log10(1e3 * unit))), say.mark)} mm"
        ax.quiverkey(arrows, 0.88, 1.03, unit, label, labelpos="E", coordinates="axes")
        ax.set_aspect("equal", adjustable="datalim")
        ax.margins(0.15)
        ax.set_xlabel("X [m]")
        ax.set_ylabel("Y [m]")
        ax.grid(color="#e4e7ea", linewidth=0.5)
        ax.set_axisbelow(True)
        localised(ax, say.mark)
        return out()


def difference_histograms(d: Floats, say: Catalogue) -> str:
    """Draw a histogram of each component with its mean and the normal curve of its moments."""
    with drawing(WIDTH, 2.1) as (figure, out):
        for k, axis in enumerate("XYZ"):
            ax = figure.add_axes((0.07 + 0.32 * k, 0.22, 0.26, 0.66))
            values = 1e3 * d[:, k]
            edges = np.histogram_bin_edges(values, bins="sturges")
            ax.hist(values, bins=edges.tolist(), color=SHADE, edgecolor=INK, linewidth=0.5)
            mean, spread = float(values.mean()), float(values.std(ddof=1))
            ax.axvline(0.0, color=INK, linewidth=0.6)
            ax.axvline(mean, color=INK, linewidth=1.0, linestyle=(0, (4, 3)))
            if spread > 0.0:
                x = np.linspace(edges[0], edges[-1], 121)
                peak = len(values) * (edges[1] - edges[0]) / (spread * math.sqrt(2.0 * math.pi))
                ax.plot(x, peak * np.exp(-0.5 * ((x - mean) / spread) ** 2), color=INK, linewidth=0.9)
            ax.set_xlabel(f"Δ{axis} [mm]")
            if k == 0:
                ax.set_ylabel(say("figure.checks.count"))
            ax.spines["right"].set_visible(False)
            localised(ax, say.mark)
        return out()


def _round_down(value: float) -> float:
    """Largest 1, 2 or 5 times a power of ten that is not larger."""
    power = 10.0 ** math.floor(math.log10(value))
    return max(step * power for step in (1.0, 2.0, 5.0) if step * power <= value * (1.0 + 1e-12))
