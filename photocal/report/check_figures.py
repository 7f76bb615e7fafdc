"""Pictures of the check points: differences on a map, and how they are distributed."""

from __future__ import annotations

import math

import numpy as np

from drivers.arrays import Floats
from photocal.accuracy.figures import draw_histogram, draw_vectors
from photocal.findings.catalogue import Catalogue
from photocal.findings.digits import fixed
from photocal.report.figures import INK, SHADE, WIDTH, drawing, localised


def difference_map(names: tuple[str, ...], place: Floats, d: Floats, say: Catalogue) -> str:
    """Draw the differences in plane as vectors at their points, those in height beside the names."""

    def height(dz: float) -> str:
        return f"{'+' if dz > 0 else ''}{fixed(1e3 * dz, 0, say.mark)}"

    def length(unit: float) -> str:
        return f"{fixed(1e3 * unit, max(0, -math.floor(math.log10(1e3 * unit))), say.mark)} mm"

    with drawing(WIDTH, 4.4) as (figure, out):
        ax = figure.add_axes((0.135, 0.1, 0.845, 0.84))
        draw_vectors(ax, names, np.column_stack((place[:, :2], d)), height, length, INK)
        ax.set_xlabel("X [m]")
        ax.set_ylabel("Y [m]")
        localised(ax, say.mark)
        return out()


def difference_histograms(d: Floats, say: Catalogue) -> str:
    """Draw a histogram of each component."""
    with drawing(WIDTH, 2.1) as (figure, out):
        for k, axis in enumerate("XYZ"):
            ax = figure.add_axes((0.07 + 0.32 * k, 0.22, 0.26, 0.66))
            draw_histogram(ax, 1e3 * d[:, k], SHADE, INK)
            ax.set_xlabel(f"Δ{axis} [mm]")
            if k == 0:
                ax.set_ylabel(say("figure.checks.count"))
            ax.spines["right"].set_visible(False)
            localised(ax, say.mark)
        return out()
