"""The pictures of a report as SVG: the same bytes for the same figures, readable in grey print."""

import io
import math
import re
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import TYPE_CHECKING, Any

import numpy as np

from photocal.analysis.accuracy.maps import draw_histogram, draw_vectors, localised
from photocal.base.arrays import Floats
from photocal.findings.digits import MINUS, symbol
from photocal.findings.texts import Catalogue
from photocal.geometry.camera import Camera
from photocal.report.sensor import SensorResiduals

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

# Width of the text of an A4 page, inches: figures are drawn at the size at which they are printed.
WIDTH = 6.69
INK, SHADE, RULE = "#1a1a1a", "#c9d3dd", "#8a8f94"
STYLE: Any = {
    "svg.hashsalt": "photocal",
    "svg.fonttype": "path",
    "font.family": "DejaVu Sans",
    "font.size": 8.0,
    "axes.linewidth": 0.6,
    "axes.edgecolor": INK,
    "axes.spines.top": False,
    "xtick.major.width": 0.6,
    "ytick.major.width": 0.6,
    "text.color": INK,
    "axes.labelcolor": INK,
    "lines.linewidth": 1.2,
}


def radial_curve(camera: Camera, profile: Floats, observed_to: float, say: Catalogue) -> str:
    """Draw the radial displacement over the radius with its 1-sigma band, as `radial_profile` has them."""
    millimetres = camera.unit == "mm"
    factor = 1e3 if millimetres else 1.0
    pitch = float(np.mean(camera.pitch))

    with drawing(WIDTH, 3.7) as (figure, out):
        ax = figure.add_axes((0.09, 0.37, 0.82, 0.60))
        r, d, s = profile[:, 0], profile[:, 1] * factor, profile[:, 2] * factor
        ax.axhline(0.0, color=RULE, linewidth=0.6)
        ax.fill_between(r, d - s, d + s, color=SHADE, linewidth=0, label=say("figure.radial.band"))
        inside = r <= observed_to
        ax.plot(r[inside], d[inside], color=INK, label=say("figure.radial.curve"))
        if not inside.all():
            outside = r >= (r[inside].max() if inside.any() else 0.0)
            ax.plot(
                r[outside], d[outside], color=INK, linestyle=(0, (4, 3)), label=say("figure.radial.beyond")
            )
        ax.set_xlim(0.0, float(r[-1]))
        ax.set_ylabel(say("figure.radial.y", unit="µm" if millimetres else "px"))
        ax.grid(color="#e4e7ea", linewidth=0.5)
        ax.set_axisbelow(True)
        ax.legend(frameon=False, loc="best")
        ax.spines["right"].set_visible(False)
        localised(ax, say.mark)
        if millimetres:
            px = (lambda d: d / factor / pitch, lambda d: d * factor * pitch)
            twin = ax.secondary_yaxis("right", functions=px)
            twin.set_ylabel("px")
            localised(twin, say.mark)
        # At the scale of the distortion itself the band is mostly thinner than the line: show it alone.
        below = figure.add_axes((0.09, 0.115, 0.82, 0.19), sharex=ax)
        below.fill_between(r, 0.0, s, color=SHADE, linewidth=0)
        below.plot(r, s, color=INK, linewidth=0.8)
        below.set_ylim(0.0, None)
        below.set_ylabel(say("figure.radial.sigma", unit="µm" if millimetres else "px"))
        below.set_xlabel(say("figure.radial.x", unit=camera.unit))
        below.spines["right"].set_visible(False)
        below.grid(color="#e4e7ea", linewidth=0.5)
        below.set_axisbelow(True)
        localised(below, say.mark)
        figure.align_ylabels([ax, below])
        ax.tick_params(labelbottom=False)
        return out()


def residual_map(camera: Camera, vectors: SensorResiduals, say: Catalogue) -> str:
    """Draw residual vectors on the sensor with a scale arrow; `camera`: format and unit."""
    extent = np.array(camera.size_px) * np.array(camera.pitch)
    w, h = (float(side) for side in extent)
    # A residual of typical size is drawn as a fortieth of the sensor's width.
    length = np.hypot(*vectors.residual_px.T) if len(vectors.place) else np.zeros(1)
    usual = (float(np.sqrt(np.mean(length**2))) or 1.0) * 2
    power = float(10.0 ** np.floor(np.log10(usual)))
    arrow = power * min((1.0, 2.0, 5.0, 10.0), key=lambda step: abs(step * power - usual))
    scale = 0.05 * w / arrow
    # Margins in inches: left, right, bottom, top.
    margins = (0.75, 0.25, 0.45, 0.38)
    across = min(WIDTH - margins[0] - margins[1], 5.8 * w / h)
    tall = across * h / w
    total = tall + margins[2] + margins[3]
    left = (WIDTH - across + margins[0] - margins[1]) / 2
    with drawing(WIDTH, total) as (figure, out):
        ax = figure.add_axes((left / WIDTH, margins[2] / total, across / WIDTH, tall / total))
        style: dict[str, Any] = {"angles": "xy", "scale_units": "xy", "scale": 1.0}
        style |= {"color": INK, "clip_on": False}
        if len(vectors.place):
            ax.quiver(*vectors.place.T, *(vectors.residual_px * scale).T, width=0.0013, **style)
        x0, y0 = camera.value("x0"), camera.value("y0")
        ax.plot([x0], [y0], marker="+", markersize=11, markeredgewidth=1.8, color="white", zorder=4)
        ax.plot([x0], [y0], marker="+", markersize=9, markeredgewidth=1.0, color=INK, zorder=5)
        above = h / 2 + 0.2 * w / across
        ax.quiver([-w / 2], [above], [arrow * scale], [0.0], width=0.0022, **style)
        label = f"{say.significant(arrow, 1)} px"
        if camera.unit == "mm":
            label += f" = {say.significant(arrow * float(np.mean(camera.pitch)) * 1e3, 2)} µm"
        ax.text(-w / 2 + arrow * scale * 1.15, above, label, va="center")
        ax.text(w / 2, above, f"+  {say('figure.residuals.principal_point')}", ha="right", va="center")
        ax.set_xlim(-w / 2, w / 2)
        ax.set_ylim(-h / 2, h / 2)
        ax.set_xlabel(f"x [{camera.unit}]")
        ax.set_ylabel(f"y [{camera.unit}]")
        ax.spines["top"].set_visible(True)
        localised(ax, say.mark)
        return out()


def correlation_picture(camera: Camera, say: Catalogue) -> str:
    """Draw the lower triangle of a correlation matrix as discs: area goes with |r|, open is negative."""
    names, matrix = camera.free, camera.correlation_of(camera.free).tolist()
    n = len(names)
    cell, edge, legend = 0.235, 0.32, 1.15
    width, height = n * cell + edge + legend, max(n * cell, 4 * 1.15 * cell) + 0.1
    with drawing(width, height) as (figure, out):
        ax = figure.add_axes(
            (edge / width, (height - n * cell) / height, n * cell / width, n * cell / height)
        )
        for i in range(1, n):
            for j in range(i):
                _disc(ax, j, i, matrix[i][j])
        for k in range(n):
            ax.text(k, k, symbol(names[k]), ha="center", va="center", fontweight="bold")
            ax.text(-0.8, k, symbol(names[k]), ha="right", va="center", color="#566069")
        ax.set_xlim(-0.5, n - 0.5)
        ax.set_ylim(n - 0.5, -0.5)
        ax.set_axis_off()
        for k, sample in enumerate((1.0, 0.5, -0.5, -1.0)):
            _disc(ax, n + 0.3, 1.15 * k, sample, clip=False)
            sign = MINUS if sample < 0 else "+"
            ax.text(n + 1.0, 1.15 * k, f"r = {sign}{say.fixed(abs(sample), 1)}", va="center")
        return out()


def natural_width(svg: str) -> float:
    """Give the share of the text width at which a picture is printed in the size it was drawn for."""
    match = re.search(r'<svg[^>]*\bwidth="([0-9.]+)pt"', svg)
    return min(float(match[1]) / 72.0 / WIDTH, 1.0) if match else 1.0


def _disc(ax: "Axes", x: float, y: float, r: float, *, clip: bool = True) -> None:
    from matplotlib.patches import Circle

    # Area goes with |r|; what is smaller than a hundredth is not drawn.
    if abs(r) < 0.01:
        return
    face, radius = INK if r > 0 else "white", 0.44 * float(np.sqrt(min(abs(r), 1.0)))
    ax.add_patch(Circle((x, y), radius, facecolor=face, edgecolor=INK, linewidth=0.8, clip_on=clip))


@contextmanager
def drawing(width: float, height: float) -> "Iterator[tuple[Figure, Callable[[], str]]]":
    """Open a figure of so many inches; the second value writes it as SVG."""
    import matplotlib as mpl
    from matplotlib.backends.backend_svg import FigureCanvasSVG
    from matplotlib.figure import Figure

    with mpl.rc_context(STYLE):
        figure = Figure(figsize=(width, height))
        FigureCanvasSVG(figure)

        def out() -> str:
            """Return the figure as SVG without what differs from one drawing to the next."""
            buffer = io.StringIO()
            figure.savefig(buffer, format="svg", metadata={"Date": None, "Creator": None})
            return re.sub(r"^.*?(?=<svg)", "", buffer.getvalue(), count=1, flags=re.DOTALL).rstrip()

        yield figure, out


def difference_map(names: tuple[str, ...], place: Floats, d: Floats, say: Catalogue) -> str:
    """Draw the differences in plane as vectors at their points, those in height beside the names."""

    def height(dz: float) -> str:
        """Write a height difference in mm with its sign."""
        return f"{'+' if dz > 0 else ''}{say.fixed(1e3 * dz, 0)}"

    def length(unit: float) -> str:
        """Write the length of the scale in mm."""
        return f"{say.fixed(1e3 * unit, max(0, -math.floor(math.log10(1e3 * unit))))} mm"

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
