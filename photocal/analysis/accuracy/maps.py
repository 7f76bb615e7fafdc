"""Check points in pictures and on the map: residual vectors, histograms, and a GeoPackage for QGIS."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from photocal.analysis.accuracy.discrepancies import COMPONENTS, Discrepancies
from photocal.analysis.accuracy.statistics import moments, within_gsd
from photocal.base.arrays import Flags, Floats
from photocal.base.errors import ConfigurationError
from photocal.base.files import output_file
from photocal.base.geopackage import LOCAL, Layer, ReferenceSystem, add_layer, geopackage
from photocal.findings.digits import MINUS
from photocal.findings.texts import Catalogue

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.axes._secondary_axes import SecondaryAxis
    from matplotlib.figure import Figure


# Longest vector as a share of the width of the map, and of the extent of the points.
_LONGEST = 0.12
# Names of more points than this would hide the vectors.
_NAMED = 60
_INK = "#1f4e9c"
# Axes are placed by hand: to have their places searched takes as long as to draw them.
_MAP_INCHES = (7.0, 6.0)
_HISTOGRAM_INCHES = (7.0, 2.6)


_NAMES = {"point": "TEXT", "role": "TEXT"}
_PLANE = {"dE_m": "DOUBLE", "dN_m": "DOUBLE"}
_POINTS = Layer(
    "ground_points",
    "POINT",
    has_heights=False,
    columns={**_NAMES, "h_m": "DOUBLE", **_PLANE, "dh_m": "DOUBLE", "plane_m": "DOUBLE"},
)
_VECTORS = Layer(
    "residual_vectors",
    "LINESTRING",
    has_heights=False,
    columns={**_NAMES, **_PLANE, "plane_m": "DOUBLE", "enlarged": "DOUBLE"},
)


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
    if len(names) <= _NAMED:
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


def localised(ax: Axes | SecondaryAxis, mark: str) -> None:
    """Write the numbers of both axes with the decimal mark of the language."""
    from matplotlib.ticker import ScalarFormatter

    class Localised(ScalarFormatter):
        def __call__(self, value: float, pos: int | None = None) -> str:
            return str(super().__call__(value, pos)).replace("-", MINUS).replace(".", mark)

    for axis in (ax.xaxis, ax.yaxis):
        plain = Localised(useOffset=False, useMathText=False)
        plain.set_scientific(False)
        axis.set_major_formatter(plain)


def residual_map(discrepancies: Discrepancies, say: Catalogue) -> Figure | None:
    """Draw the planimetric discrepancies as vectors, the heights as numbers, at their points.

    returns: matplotlib.figure.Figure or None. None without positions or without planimetric discrepancies.
        North is up, both axes have one scale, the vectors another one that is drawn beside the map.
    """
    if discrepancies.positions_m is None:
        return None
    table = np.column_stack((discrepancies.positions_m[:, :2], discrepancies.d_m))
    known: Flags = np.all(np.isfinite(table[:, :4]), axis=1)
    if not known.any():
        return None
    names = tuple(name for name, has in zip(discrepancies.points, known.tolist(), strict=True) if has)
    figure, axes = _figure(_MAP_INCHES, (0.12, 0.08, 0.85, 0.84), "E (m)", "N (m)")
    enlarge = draw_vectors(axes, names, table[known], _signed(say, 2), _length(say), _INK)
    localised(axes, say.mark)
    heights = np.isfinite(table[known][:, 4]).any()
    title = say("discrepancies.vectors", factor=say.significant(enlarge, 3))
    title += say("discrepancies.heights_beside") if heights else ""
    axes.set_title(f"{say('discrepancies.title')}\n{title}", fontsize=9, loc="left")
    return figure


def _signed(say: Catalogue, decimals: int) -> Callable[[float], str]:
    """Numbers of the language, positive ones with their sign too."""
    return lambda value: ("+" if value >= 0.0 else "") + say.fixed(value, decimals)


def _length(say: Catalogue) -> Callable[[float], str]:
    return lambda value: f"{say.as_given(value)} m"


def _figure(
    inches: tuple[float, float], place: tuple[float, float, float, float], across: str, up: str
) -> tuple[Figure, Axes]:
    """Begin a figure with one pair of axes, whose labels have their units."""
    from matplotlib.figure import Figure

    figure = Figure(figsize=inches)
    axes = figure.add_axes(place)
    axes.set_xlabel(across)
    axes.set_ylabel(up)
    axes.tick_params(labelsize=7)
    return figure, axes


def histograms(discrepancies: Discrepancies, say: Catalogue) -> Figure:
    """Draw a histogram of each component with its mean and the normal curve of its moments."""
    from matplotlib.figure import Figure

    known = [(name, discrepancies.component(name)[1]) for name in COMPONENTS]
    known = [(name, values) for name, values in known if len(values)]
    figure = Figure(figsize=_HISTOGRAM_INCHES)
    wide = 0.93 / max(len(known), 1)
    for column, (name, values) in enumerate(known):
        axes = figure.add_axes((0.07 + wide * column, 0.17, wide - 0.05, 0.73))
        draw_histogram(axes, values, "#9db8d9", _INK)
        sample = moments(values)
        axes.set_xlabel(f"d{name} (m)")
        mean, rmse = _signed(say, 3)(sample.mean_m), say.fixed(sample.rmse_m, 3)
        axes.set_title(say("discrepancies.moments", n=sample.n, mean=mean, rmse=rmse), fontsize=7)
        axes.tick_params(labelsize=7)
        localised(axes, say.mark)
        if column == 0:
            axes.set_ylabel(say("discrepancies.count"))
    return figure


def heights_by_point(discrepancies: Discrepancies, say: Catalogue) -> Figure | None:
    """Draw the discrepancies in height by point, with their mean, as figure 6 of Alves Junior et al. 2015.

    None without heights, and for more points than can be named.
    """
    names, values = discrepancies.component("h")
    if not 0 < len(values) <= _NAMED:
        return None
    inches = (max(4.0, 0.22 * len(values) + 1.2), 3.0)
    figure, axes = _figure(inches, (0.13, 0.2, 0.85, 0.69), "", "dh (m)")
    axes.bar(np.arange(len(values)), values, color="#9db8d9", edgecolor=_INK, linewidth=0.5)
    axes.axhline(0.0, color=_INK, linewidth=0.6)
    axes.axhline(float(values.mean()), color=_INK, linewidth=1.0, linestyle=(0, (4, 3)))
    localised(axes, say.mark)
    axes.set_xticks(np.arange(len(values)), names, rotation=90, fontsize=6)
    higher, mean = int(np.sum(values > 0.0)), _signed(say, 3)(float(values.mean()))
    title = say("discrepancies.heights", higher=higher, n=len(values), mean=mean)
    axes.set_title(title, fontsize=8, loc="left")
    return figure


def gsd_circles(discrepancies: Discrepancies, gsd_m: float | None, say: Catalogue) -> Figure | None:
    """Draw planimetric discrepancies about one origin, in circles of one and two ground sampling distances.

    As figure 4 of Alves Junior et al. 2015; None without a ground sampling distance or such discrepancies.
    """
    names, plane = discrepancies.planimetric()
    if gsd_m is None or not names:
        return None
    length, angle = np.hypot(*plane.T), np.linspace(0.0, 2.0 * math.pi, 181)
    figure, axes = _figure((4.5, 4.5), (0.16, 0.11, 0.81, 0.83), "dE (m)", "dN (m)")
    axes.plot(plane[:, 0], plane[:, 1], "+", color=_INK)
    for k, (count, colour) in enumerate(
        zip(within_gsd(length, gsd_m), ("#1f4e9c", "#b3261e"), strict=True), 1
    ):
        size = say.significant(k * gsd_m, 3)
        text = say("discrepancies.within", k=k, size=size, count=count, n=len(names))
        axes.plot(
            k * gsd_m * np.cos(angle), k * gsd_m * np.sin(angle), color=colour, linewidth=0.9, label=text
        )
    axes.set_aspect("equal", adjustable="datalim")
    axes.legend(fontsize=7, loc="upper right")
    localised(axes, say.mark)
    axes.set_title(say("discrepancies.title"), fontsize=9, loc="left")
    return figure


def save_figures(folder: Path, drawn: Mapping[str, Figure | None]) -> tuple[str, ...]:
    """Write the figures that could be drawn, and give their names."""
    figures = {name: figure for name, figure in drawn.items() if figure is not None}
    for name, figure in figures.items():
        # Without the date the same input gives the same bytes.
        figure.savefig(folder / name, metadata={"CreationDate": None})
    return tuple(figures)


def check_figures(
    discrepancies: Discrepancies, gsd_m: float | None, say: Catalogue, prefix: str = ""
) -> dict[str, Figure | None]:
    """Draw the figures of the report section, by the names of their files."""
    return {
        f"{prefix}residual_map.pdf": residual_map(discrepancies, say),
        f"{prefix}histograms.pdf": histograms(discrepancies, say),
        f"{prefix}heights_by_point.pdf": heights_by_point(discrepancies, say),
        f"{prefix}gsd_circles.pdf": gsd_circles(discrepancies, gsd_m, say),
    }


def reference_system(crs: str | None) -> ReferenceSystem:
    """Look up a projected coordinate system.

    crs: such as `EPSG:31982`; None for a local system that nothing else is known of.
    raises ConfigurationError: when it is unknown, or not a projected system in metres.
    """
    if crs is None:
        return LOCAL
    from pyproj import CRS
    from pyproj.exceptions import CRSError

    try:
        system = CRS.from_user_input(crs)
    except CRSError as refusal:
        raise ConfigurationError(f"{crs!r} is not a coordinate system", "give it as EPSG:31982") from refusal
    if not system.is_projected or {axis.unit_name for axis in system.axis_info[:2]} != {"metre"}:
        raise ConfigurationError(
            f"{crs} ({system.name}) is not a map projection in metres",
            "discrepancies in metres need one, such as a UTM zone",
        )
    number = system.to_epsg()
    definition = system.to_wkt("WKT1_GDAL")
    if number is None:
        # First number that no authority uses, for a coordinate system without one.
        own_system = 100_000
        return ReferenceSystem(own_system, system.name, "NONE", definition)
    return ReferenceSystem(number, system.name, "EPSG", definition)


def write_geopackage(
    path: Path, groups: tuple[tuple[str, Discrepancies], ...], system: ReferenceSystem, changed_utc: str
) -> int:
    """Write ground points and their residual vectors.

    raises ConfigurationError: when no point has a position.
    raises OutputError: when the file cannot be written.
    """
    rows = [
        (name, role, place, d, math.hypot(d[0], d[1]))
        for role, discrepancies in groups
        if discrepancies.positions_m is not None
        for name, place, d in zip(
            discrepancies.points, discrepancies.positions_m, discrepancies.d_m, strict=True
        )
        if np.isfinite(place[:2]).all()
    ]
    if not rows:
        raise ConfigurationError(
            "a map needs the positions of the points", "add the columns E and N to the table", where=path
        )
    drawn = [row for row in rows if math.isfinite(row[-1])]
    # The longest vector is a fair share of the map.
    longest = max((length for *_, length in drawn), default=0.0)
    extent = float(np.max(np.ptp(np.array([place[:2] for _, _, place, _, _ in rows]), axis=0)))
    enlarged = _LONGEST * max(extent, 1.0) / longest if longest > 0.0 else 1.0
    with output_file(path) as aside, geopackage(aside, system) as database:
        points = (
            (place[None, :2], (name, role, float(place[2]), *d.tolist(), length))
            for name, role, place, d, length in rows
        )
        add_layer(database, _POINTS, system, points, changed_utc)
        vectors = (
            (place[:2] + np.outer([0.0, enlarged], d[:2]), (name, role, *d[:2].tolist(), length, enlarged))
            for name, role, place, d, length in drawn
        )
        add_layer(database, _VECTORS, system, vectors, changed_utc)
    return len(rows)
