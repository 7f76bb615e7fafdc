"""Files and words about a flown block: tables, a map for QGIS, a picture, and what to tell a person."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from photocal.base.arrays import Floats
from photocal.base.files import output_folder, output_picture, write_json, write_rows
from photocal.base.geopackage import Feature, Layer, ReferenceSystem, add_layer, geopackage
from photocal.findings.document import Paragraph, Section, TablePart, columns, text
from photocal.findings.texts import Catalogue
from photocal.planning.flown import FlownBlock, gaps

_NUMBERS = ("height_m", "gsd_m", "tilt_deg", "forward_overlap", "smear_px", "speed_m_s")
_IMAGES = Layer(
    "images",
    "POINT",
    has_heights=False,
    columns={"name": "TEXT", "strip": "INTEGER", **dict.fromkeys(_NUMBERS, "DOUBLE")},
)
_RAYS = Layer("rays", "POLYGON", has_heights=False, columns={"images": "INTEGER"})
_GAPS = Layer("gaps", "POINT", has_heights=False, columns={"area_m2": "DOUBLE"})
# Unit, factor and decimals of the figures that are shown, in their order.
_SHOWN: dict[str, tuple[str, float, int]] = {
    "height_m": ("m", 1.0, 1), "gsd_m": ("cm", 100.0, 2), "tilt_deg": ("°", 1.0, 1),
    "forward_overlap": ("%", 100.0, 1), "side_overlap": ("%", 100.0, 1), "rays": ("", 1.0, 0),
    "smear_px": ("px", 1.0, 2), "exposure_ms": ("ms", 1.0, 3), "iso": ("", 1.0, 0),
}  # fmt: skip
# Planned figures that may be compared with the flown ones of the same names.
_PLANNED = ("height_m", "gsd_m")


def flown_text(figures: Mapping[str, Any], say: Catalogue) -> str:
    """Write a flown block for people."""
    spread = {key: tuple(figures[key].values()) for key in _SHOWN if figures.get(key)}
    listed = figures["gaps"]
    counts = {**figures, "gaps": len(listed)}
    section = flown_section("", spread, figures.get("planned", {}), counts, say)
    bare = [row for row in figures.get("control_by_strip", ()) if not row["control_points"]]
    some = any(row["control_points"] for row in figures.get("control_by_strip", ()))
    lines = []
    if bare and some and not figures.get("held_by_positions"):
        named = ", ".join(
            say("flown.strip", strip=row["strip"], first=row["first"], n=row["images"]) for row in bare
        )
        lines.append(say("flown.bare", strips=named))
    positions = figures.get("positions")
    if positions is not None:
        both = zip(positions["mean_m"], positions["std_m"], strict=True)
        axes = say("join.figures").join(f"{mean:+.3f} +- {std:.3f}" for mean, std in both)
        lines.append(say("flown.positions", axes=axes.replace(".", say.mark)))
    joint = say("join.figures")
    holes = (
        f"{say.row([g['east_m'], g['north_m']], '.1f', joint)}: {g['area_m2']:.0f} m2" for g in listed[:10]
    )
    return text([replace(section, pieces=(*section.pieces, Paragraph("\n".join([*lines, *holes]))))])


def flown_section(
    title: str,
    spread: Mapping[str, Sequence[float | None]],
    planned: Mapping[str, float | None],
    counts: Mapping[str, Any],
    say: Catalogue,
) -> Section:
    """Set what was flown beside what was planned.

    spread: least, median and most of each figure that is known, SI.
    counts: of images, strips, tilted and blurred images, and gaps.
    """
    rows = []
    for key, (unit, factor, decimals) in _SHOWN.items():
        values = (*spread.get(key, (None,) * 3), planned.get(key))
        printed = ("–" if value is None else say.fixed(factor * value, decimals) for value in values)
        rows.append((say(f"flown.{key}"), unit, *printed))
    heads = columns(say, "flown", "quantity<", "unit<", "least", "median", "most", "planned")
    # Without exposure times and speeds nothing is known of blur: no image is then said to be free of it.
    notes = ["note", *(["blurred"] if "smear_px" in spread else []), "meaning"]
    note = " ".join(say(f"flown.{key}", **counts) for key in notes)
    return Section(title, (TablePart(say("flown.table"), heads, tuple(rows), note),))


def against_plan(figures: dict[str, Any], plan: Mapping[str, Any]) -> dict[str, Any]:
    """Add what `photocal plan` wrote to the figures of a flown block: of the level flown nearest."""
    height = figures["height_m"]["median"]
    level = min(plan["levels"], key=lambda entry: abs(entry["height_m"] - height))
    return figures | {"planned": {name: level[name] for name in _PLANNED if name in level}}


def write_flown(
    folder: Path,
    block: FlownBlock,
    stations: Floats,
    speed_m_s: Floats,
    figures: Mapping[str, Any],
    to_given: Callable[[Floats], Floats],
    system: ReferenceSystem,
    changed_utc: str,
) -> None:
    """Write figures, a table of the images and a map.

    raises OutputError: when the folder cannot be written.
    """
    tilt_deg = np.degrees(block.tilt_rad)
    columns = (block.height_m, block.gsd_m, tilt_deg, block.forward, block.smear_px, speed_m_s)
    numbers = np.column_stack(columns).tolist()
    named = zip(block.names, (block.strip + 1).tolist(), numbers, strict=True)
    rows = [(name, strip, *values) for name, strip, values in named]
    with output_folder(folder) as aside:
        write_json(aside / "flown.json", figures)
        cells = (
            [name, strip, *("" if v != v else f"{v:.6g}" for v in values)] for name, strip, *values in rows
        )
        write_rows(aside / "flown.csv", list(_IMAGES.columns), cells)
        with geopackage(aside / "flown.gpkg", system) as database:
            places = to_given(stations)[:, :2]
            images = zip(places[:, None], rows, strict=True)
            add_layer(database, _RAYS, system, _cells(block, to_given), changed_utc)
            add_layer(database, _IMAGES, system, images, changed_utc)
            holes = [
                (to_given(np.array([[east, north, 0.0]]))[:, :2], [cells * block.ground.cell_m**2])
                for east, north, cells in gaps(block)
            ]
            add_layer(database, _GAPS, system, holes, changed_utc)


def _cells(block: FlownBlock, to_given: Callable[[Floats], Floats]) -> list[Feature]:
    """Squares of the map below the flight with the least number of images in each."""
    # Cells of the map, as many of the raster on a side.
    merged_cells = 3
    ground, k = block.ground, merged_cells
    rows = len(ground.places) // ground.columns // k
    columns = ground.columns // k
    shape = (rows * k, columns * k)

    def merged(values: Any) -> Any:
        """Values of the cells of the ground that each cell of the map covers, along the last axis."""
        grid = values.reshape(-1, ground.columns)[: shape[0], : shape[1]]
        return grid.reshape(rows, k, columns, k).swapaxes(1, 2).reshape(rows, columns, k * k)

    inside = merged(block.inside).all(axis=2)
    least = merged(block.rays).min(axis=2)
    first = ground.places[0] - [ground.cell_m / 2.0, ground.cell_m / 2.0, 0.0]
    side = k * ground.cell_m
    square = np.array([[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0], [0, 0, 0]]) * side
    return [
        (to_given(first + side * np.array([column, row, 0.0]) + square)[:, :2], [int(least[row, column])])
        for row, column in zip(*np.nonzero(inside), strict=True)
    ]


def draw_flown(block: FlownBlock, stations: Floats, path: Path) -> None:
    """Draw how many images show each place, with the stations and the gaps."""
    ground = block.ground
    shape = (-1, ground.columns)
    rays = np.where(block.rays > 0, block.rays, np.nan).reshape(shape)
    half = ground.cell_m / 2.0
    (west, south), (east, north) = ground.places[0, :2] - half, ground.places[-1, :2] + half
    extent = (west, east, south, north)
    with output_picture(path, (6.7, 6.0)) as figure:
        axes = figure.add_subplot()
        shown = axes.imshow(rays, origin="lower", extent=extent, cmap="viridis")
        axes.contour(block.inside.reshape(shape), [0.5], colors="black", linewidths=0.8, extent=extent)
        for strip in np.unique(block.strip):
            axes.plot(*stations[block.strip == strip, :2].T, ".-", color="white", markersize=3, linewidth=0.6)
        for x, y, _ in gaps(block):
            axes.plot([x], [y], "x", color="red", markersize=8)
        axes.set(xlabel="m", ylabel="m")
        figure.colorbar(shown, ax=axes, shrink=0.8, label="overlap, images")
