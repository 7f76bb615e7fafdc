"""Residual ring plot: each section with the distances of its points from the fitted circle, enlarged."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from acquire.outputs import output_file
from drivers.errors import ConfigurationError
from photocal.products.sections import Tank

_INK, _RULE = "#1a1a1a", "#8a8f94"
# The largest residual is drawn as this share of the radius.
_LARGEST = 0.25


def draw_rings(tank: Tank, axes: tuple[str, str, str], path: Path) -> None:
    """Draw the rings of a tank.

    axes: names of the two horizontal axes and the vertical one.
    raises ConfigurationError: for another ending.
    raises OutputError: when it cannot be written.
    """
    if path.suffix.lower() not in (".pdf", ".svg", ".png"):
        raise ConfigurationError(f"{path} has no known ending", remedy="use .pdf, .svg or .png")
    import matplotlib as mpl
    from matplotlib.figure import Figure

    columns = min(3, len(tank.sections))
    rows = -(-len(tank.sections) // columns)
    largest = max(float(np.abs(ring.circle.radial).max()) for ring in tank.sections)
    with mpl.rc_context({"svg.hashsalt": "photocal", "svg.fonttype": "path", "font.size": 8}):
        figure = Figure(figsize=(2.6 * columns, 2.9 * rows), layout="constrained")
        for number, ring in enumerate(tank.sections):
            ax = figure.add_subplot(rows, columns, number + 1)
            circle = ring.circle
            enlarged = _LARGEST * circle.radius / largest if largest > 0 else 1.0
            turn = circle.direction
            drawn = circle.radius + enlarged * circle.radial
            around = np.linspace(0, 2 * np.pi, 361)
            ax.plot(circle.radius * np.cos(around), circle.radius * np.sin(around), color=_RULE, lw=0.8)
            order = np.append(np.argsort(turn), np.argmin(turn))
            ax.plot((drawn * np.cos(turn))[order], (drawn * np.sin(turn))[order], color=_INK, lw=0.8)
            ax.plot(drawn * np.cos(turn), drawn * np.sin(turn), ".", color=_INK, ms=3)
            for point, angle, length in zip(ring.points, turn, drawn, strict=True):
                outside = max(float(length), circle.radius) + 0.12 * circle.radius
                ax.text(outside * np.cos(angle), outside * np.sin(angle), point, ha="center", va="center",
                        fontsize=5)  # fmt: skip
            worst = 1e3 * float(np.abs(circle.radial).max())
            ax.set_title(
                f"section {ring.name}, {axes[2]} {ring.height:.3f} m\nR {circle.radius:.4f} m, "
                f"largest {worst:.1f} mm, residuals x {enlarged:.0f}",
                fontsize=7,
            )
            ax.set_aspect("equal")
            ax.set_axis_off()
        with output_file(path) as aside:
            kind = path.suffix.lower()[1:]
            stamp = {"png": None, "pdf": {"CreationDate": None}, "svg": {"Date": None}}[kind]
            figure.savefig(aside, format=kind, metadata=stamp, dpi=200)
