"""The step `contours`: lines of equal height of a terrain model, as a file for CAD or GIS."""

import datetime as dt
import math
import tempfile
import warnings
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import contourpy
import numpy as np

from photocal.base.arrays import Floats
from photocal.base.errors import ConfigurationError, InputMalformedError, OutputError
from photocal.base.files import output_file, refusals
from photocal.base.geopackage import changed_utc
from photocal.base.operating_system import replace
from photocal.findings.texts import Catalogue, catalogue
from photocal.geometry.frames import system_of
from photocal.products.options import ContourOptions
from photocal.products.raster import describe, system_wkt, terrain_source
from photocal.products.terrain import HEIGHT_KINDS, Terrain, grid_of_points, read_terrain_points

# By the ending of the file: the driver of GDAL.
DRIVERS = {".gpkg": "GPKG", ".shp": "ESRI Shapefile", ".dxf": "DXF"}


# A line of equal height: the number of its level (height / interval), and its vertices (n, 2), m; the first
# one again at the end of a closed line.
Contour = tuple[int, Floats]


@dataclass(frozen=True, kw_only=True)
class Contours:
    """Contours that were written.

    crs, height_kind: of the terrain model; crs is empty where it names none.
    """

    path: Path
    interval_m: float
    index: int
    lines: list[Contour]
    crs: str
    height_kind: str

    def figures(self) -> dict[str, Any]:
        """Give its figures as a JSON value."""
        numbers = [number for number, _ in self.lines]
        steps = [np.diff(xy, axis=0) for _, xy in self.lines]
        return {
            "schema": "photocal.contours/1",
            "output": str(self.path),
            "interval_m": self.interval_m,
            "lines": len(numbers),
            "index_lines": sum(number % self.index == 0 for number in numbers),
            "lowest_m": min(numbers) * self.interval_m,
            "highest_m": max(numbers) * self.interval_m,
            "length_m": float(sum(np.hypot(step[:, 0], step[:, 1]).sum() for step in steps)),
            "height_kind": self.height_kind,
            "crs": str(system_of(self.crs).name) if self.crs else None,
        }

    def __repr__(self) -> str:
        """Say it for people."""
        return self.text(catalogue("en"))

    def text(self, say: Catalogue) -> str:
        """Give it as a text in a language."""
        made = self.figures()
        ends = {"lowest": float(made["lowest_m"]), "highest": float(made["highest_m"])}
        counts = {"lines": made["lines"], "index": made["index_lines"]}
        system = made["crs"] or say("product.no_system")
        text = say.told(
            "product.contours",
            file=self.path,
            **counts,
            **ends,
            interval=float(self.interval_m),
            heights=say.stored(self.height_kind),
            system=system,
        )
        if self.path.suffix.lower() == ".dxf" and self.crs:
            text += "\n" + say("product.beside", file=self.path.with_suffix(".prj").name)
        return text


def contours(dtm: str | Path, output: str | Path, options: ContourOptions) -> Contours:
    """Write the contours of a terrain model.

    Parameters
    ----------
    dtm
        Raster that GDAL reads, or a CSV of points (X, Y, Z, optional line), m.
    output
        File to write: .dxf, .shp or .gpkg.
    options
        Interval and heights; cells of a CSV.

    Returns
    -------
    Contours
        The lines, and their figures.

    Raises
    ------
    ConfigurationError
        For another ending, missing settings, or an interval that no contour fits.
    InputNotFoundError, InputMalformedError
        For a terrain model that cannot be read.
    OutputError
        When the file cannot be written.

    Examples
    --------
    >>> import photocal
    >>> options = photocal.ContourOptions(interval=0.5, heights="local")
    >>> made = photocal.contours("orthophoto/dtm.tif", "contours.gpkg", options)
    >>> made.figures()["interval_m"]
    0.5
    """
    dtm, output = Path(dtm), Path(output)
    if output.suffix.lower() not in DRIVERS:
        raise ConfigurationError(f"{output} has no known extension", f"use {', '.join(DRIVERS)}")
    terrain = _terrain(dtm, options)
    lines = contour_lines(terrain, options.interval)
    if not lines:
        low, high = np.nanmin(terrain.heights), np.nanmax(terrain.heights)
        raise ConfigurationError(
            f"no contour every {options.interval:g} m lies between {low:.3f} and {high:.3f} m",
            "choose a smaller interval",
        )
    made = Contours(
        path=output, interval_m=options.interval, index=options.index, lines=lines,
        crs=terrain.crs, height_kind=terrain.height_kind,
    )  # fmt: skip
    _write(made, changed_utc(dtm))
    return made


def contour_lines(terrain: Terrain, interval: float) -> list[Contour]:
    """Follow the heights that are multiples of the interval, linearly between the centres of the cells.

    raises ConfigurationError: for an interval that gives too many levels.
    """
    low, high = float(np.nanmin(terrain.heights)), float(np.nanmax(terrain.heights))
    first, last = math.ceil(low / interval), math.floor(high / interval)
    # More lines are a mistaken interval.
    most_levels = 10_000
    if last - first >= most_levels:
        raise ConfigurationError(f"{interval:g} m make {last - first} levels", "choose a larger interval")
    generator = contourpy.contour_generator(
        z=np.ma.masked_invalid(terrain.heights), line_type=contourpy.LineType.Separate, corner_mask=True
    )
    a, b, c, d, e, f = terrain.transform
    axes, corner = np.array([[a, d], [b, e]]), np.array([c, f])
    lines = []
    for number in range(first, last + 1):
        for cells in generator.lines(number * interval):
            xy = (np.asarray(cells) + 0.5) @ axes + corner
            # Round a cell at the very height of a level nothing is left.
            if np.ptp(xy, axis=0).any():
                lines.append((number, xy))
    return lines


def _terrain(dtm: Path, options: ContourOptions) -> Terrain:
    """Heights of a raster, or of points on a raster of its own."""
    if options.heights is not None and options.heights not in HEIGHT_KINDS:
        raise ConfigurationError(
            f"--heights {options.heights} is not known", f"use {', '.join(HEIGHT_KINDS)}"
        )
    wished = "" if options.crs is None else system_wkt(options.crs)
    if dtm.suffix.lower() == ".csv":
        if options.cell is None or options.heights is None:
            raise ConfigurationError(f"{dtm} is a table of points", "give --cell and --heights with it")
        return grid_of_points(*read_terrain_points(dtm), options.cell, wished, options.heights)[0]
    if options.cell is not None:
        raise ConfigurationError("--cell is for a CSV of terrain points", "leave it out")
    raster = describe(dtm)
    if wished and raster.crs:
        raise ConfigurationError("--crs is for a terrain model that names none", "leave it out", where=dtm)
    found = terrain_source(raster, raster.stated_heights(options.heights))(raster.bounds)
    if not np.isfinite(found.heights).any():
        raise InputMalformedError("has no heights", "is it the right raster?", where=dtm)
    return Terrain(found.heights, found.transform, found.crs or wished, found.height_kind)


def _write(made: Contours, changed: str) -> None:
    """Write all parts of the file aside, then give them their names, the file itself last."""
    path = made.path
    with output_file(path) as whole, refusals(path), tempfile.TemporaryDirectory(dir=path.parent) as folder:
        aside = Path(folder) / path.name
        _write_lines(made, aside, changed)
        if path.suffix.lower() == ".dxf" and made.crs:
            aside.with_suffix(".prj").write_text(system_of(made.crs).to_wkt("WKT1_ESRI"), encoding="utf-8")
        for part in sorted(Path(folder).iterdir()):
            replace(part, whole if part == aside else path.parent / part.name)


def _write_lines(made: Contours, path: Path, changed: str) -> None:
    """Hand the lines to GDAL; the same lines at the same time give the same file."""
    import pyogrio  # type: ignore[import-untyped]

    number = np.array([number for number, _ in made.lines])
    is_index = number % made.index == 0
    drawing = path.suffix.lower() == ".dxf"
    fields: dict[str, Any] = {
        "height": number * made.interval_m,
        "index": is_index.astype(np.int32),
        "kind": np.full(len(number), made.height_kind, dtype=object),
    }
    options: dict[str, Any] = {"layer": "contours", "crs": made.crs or None}
    if drawing:
        # The height is that of the line itself; $INSUNITS says metres.
        fields = {"Layer": np.where(is_index, "CONTOUR_INDEX", "CONTOUR").astype(object)}
        options = {"dataset_options": {"INSUNITS": "METERS"}}
    elif path.suffix.lower() == ".shp":
        day = dt.datetime.fromisoformat(changed).strftime("%Y-%m-%d")
        options |= {"encoding": "UTF-8", "layer_options": {"DBF_DATE_LAST_UPDATE": day}}
    try:
        pyogrio.set_gdal_config_options({"OGR_CURRENT_DATE": changed})
        with warnings.catch_warnings():
            # A local frame has no reference system, and a drawing cannot name one.
            warnings.filterwarnings("ignore", "'crs' was not provided", UserWarning)
            pyogrio.raw.write(
                path,
                np.array([_wkb(line, made.interval_m) for line in made.lines], dtype=object),
                list(fields.values()),
                np.array(list(fields), dtype=object),
                driver=DRIVERS[path.suffix.lower()],
                geometry_type="LineString Z",
                **options,
            )
    except (pyogrio.errors.DataSourceError, pyogrio.errors.DataLayerError) as failure:
        reason = str(failure).splitlines()[0]
        raise OutputError(
            f"cannot be written ({reason})", "check that the disk has free space", where=made.path
        ) from failure
    finally:
        pyogrio.set_gdal_config_options({"OGR_CURRENT_DATE": None})


def _wkb(line: Contour, interval: float) -> bytes:
    """Give a line with its height as well-known binary (ISO, little endian)."""
    number, xy = line
    xyz = np.column_stack([xy, np.full(len(xy), number * interval)])
    return b"\x01" + np.array([1002, len(xyz)], "<u4").tobytes() + xyz.astype("<f8").tobytes()
