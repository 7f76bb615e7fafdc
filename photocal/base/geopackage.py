"""GeoPackage files (OGC 12-128r15): the tables that each one has, layers of features, plain tables."""

import datetime as dt
import math
import sqlite3
import struct
from collections.abc import Iterable, Iterator, Sequence
from contextlib import closing, contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

import numpy as np

from photocal.base.arrays import Floats
from photocal.base.errors import OutputError

Kind = Literal["POINT", "LINESTRING", "POLYGON"]
# Coordinates of the corners, shape (n, 2) or (n, 3), and what stands in the other columns.
Value = str | bytes | int | float | None
Feature = tuple[Floats, Sequence[Value]]

# "GPKG" and version 1.2, as the standard wants them in the header of the database.
_APPLICATION_ID = 0x47504B47
_VERSION = 10200
# Of the well-known binary form; 1000 more with heights.
_NUMBERS: dict[Kind, int] = {"POINT": 1, "LINESTRING": 2, "POLYGON": 3}
_TABLES = f"""
PRAGMA application_id = {_APPLICATION_ID};
PRAGMA user_version = {_VERSION};
CREATE TABLE gpkg_spatial_ref_sys (
  srs_name TEXT NOT NULL, srs_id INTEGER NOT NULL PRIMARY KEY, organization TEXT NOT NULL,
  organization_coordsys_id INTEGER NOT NULL, definition TEXT NOT NULL, description TEXT);
CREATE TABLE gpkg_contents (
  table_name TEXT NOT NULL PRIMARY KEY, data_type TEXT NOT NULL, identifier TEXT UNIQUE,
  description TEXT DEFAULT '', last_change DATETIME NOT NULL, min_x DOUBLE, min_y DOUBLE, max_x DOUBLE,
  max_y DOUBLE, srs_id INTEGER,
  CONSTRAINT fk_gc_r_srs_id FOREIGN KEY (srs_id) REFERENCES gpkg_spatial_ref_sys(srs_id));
CREATE TABLE gpkg_geometry_columns (
  table_name TEXT NOT NULL, column_name TEXT NOT NULL, geometry_type_name TEXT NOT NULL,
  srs_id INTEGER NOT NULL, z TINYINT NOT NULL, m TINYINT NOT NULL,
  CONSTRAINT pk_geom_cols PRIMARY KEY (table_name, column_name),
  CONSTRAINT uk_gc_table_name UNIQUE (table_name),
  CONSTRAINT fk_gc_tn FOREIGN KEY (table_name) REFERENCES gpkg_contents(table_name),
  CONSTRAINT fk_gc_srs FOREIGN KEY (srs_id) REFERENCES gpkg_spatial_ref_sys(srs_id));
"""


@dataclass(frozen=True)
class ReferenceSystem:
    """A coordinate reference system as the file stores it."""

    number: int
    name: str
    organization: str
    definition: str


LOCAL = ReferenceSystem(-1, "Undefined Cartesian SRS", "NONE", "undefined")
_UNDEFINED_GEOGRAPHIC = ReferenceSystem(0, "Undefined geographic SRS", "NONE", "undefined")


@dataclass(frozen=True)
class Layer:
    """A table of features.

    has_heights: whether corners have three coordinates.
    columns: names and types (TEXT, DOUBLE, INTEGER) of the columns beside the geometry.
    """

    name: str
    kind: Kind
    has_heights: bool
    columns: dict[str, str]


def changed_utc(source: Path) -> str:
    """Time of the input, a table or a block folder, not of the clock: the same input gives the same file."""
    table = source / "points.csv" if source.is_dir() else source
    changed = dt.datetime.fromtimestamp(table.stat().st_mtime, dt.UTC)
    return f"{changed:%Y-%m-%dT%H:%M:%S}.000Z"


def wgs84() -> ReferenceSystem:
    """Give the system of longitudes and latitudes, which each file has."""
    from pyproj import CRS

    return ReferenceSystem(4326, "WGS 84", "EPSG", CRS.from_epsg(4326).to_wkt("WKT1_GDAL"))


@contextmanager
def geopackage(path: Path, system: ReferenceSystem) -> Iterator[sqlite3.Connection]:
    """Make a file and give its database to be filled; what was filled in is kept when nothing is raised.

    system: of the layers; the standard's own ones stand in each file.
    """
    # An empty file that waits to be renamed is not yet a database.
    path.unlink(missing_ok=True)
    try:
        with closing(sqlite3.connect(path)) as database:
            database.executescript(_TABLES)
            database.executemany(
                "INSERT OR IGNORE INTO gpkg_spatial_ref_sys "
                "VALUES (:name, :number, :organization, :number, :definition, NULL)",
                map(vars, (LOCAL, _UNDEFINED_GEOGRAPHIC, wgs84(), system)),
            )
            yield database
            database.commit()
    except sqlite3.OperationalError as failure:
        # A full disk, first of all; what is written aside has its name from here.
        remedy = "free disk space and try again"
        raise OutputError(f"cannot be written ({failure})", remedy, where=path) from failure


def add_layer(
    database: sqlite3.Connection,
    layer: Layer,
    system: ReferenceSystem,
    features: Iterable[Feature],
    changed_utc: str,
) -> None:
    """Add a layer with its features."""
    rows, corners = [], [np.zeros((0, 2))]
    for places, values in features:
        rows.append((_geometry(layer, system.number, places), *values))
        corners.append(places[:, :2])
    box: list[float | None] = [None] * 4
    if rows:
        xy = np.vstack(corners)
        box = [*xy.min(axis=0).tolist(), *xy.max(axis=0).tolist()]
    _add_rows(database, layer.name, {"geom": layer.kind, **layer.columns}, rows)
    database.execute(
        "INSERT INTO gpkg_contents VALUES (?, 'features', ?, '', ?, ?, ?, ?, ?, ?)",
        [layer.name, layer.name, changed_utc, *box, system.number],
    )
    database.execute(
        "INSERT INTO gpkg_geometry_columns VALUES (?, 'geom', ?, ?, ?, 0)",
        [layer.name, layer.kind, system.number, int(layer.has_heights)],
    )


def add_table(
    database: sqlite3.Connection,
    name: str,
    columns: dict[str, str],
    rows: Iterable[Sequence[Value]],
    changed_utc: str,
) -> None:
    """Add a table without geometry; parameters as those of `add_layer`."""
    _add_rows(database, name, columns, rows)
    database.execute(
        "INSERT INTO gpkg_contents VALUES (?, 'attributes', ?, '', ?, NULL, NULL, NULL, NULL, NULL)",
        [name, name, changed_utc],
    )


def _add_rows(
    database: sqlite3.Connection, name: str, columns: dict[str, str], rows: Iterable[Sequence[Value]]
) -> None:
    """Make a table and fill it; its names are those of the program, never a user's."""
    described = ", ".join(f"{column} {kind}" for column, kind in columns.items())
    database.execute(f"CREATE TABLE {name} (fid INTEGER PRIMARY KEY AUTOINCREMENT NOT NULL, {described})")
    marks = ", ".join("?" * len(columns))
    # SQLite takes NaN for NULL; it would keep an infinite number.
    known = [[None if isinstance(v, float) and not math.isfinite(v) else v for v in row] for row in rows]
    database.executemany(f"INSERT INTO {name} VALUES (NULL, {marks})", known)  # noqa: S608


def _geometry(layer: Layer, number: int, places: Floats) -> bytes:
    """GeoPackage binary: magic, version 0, flags (little-endian, no envelope), system; then WKB."""
    head = struct.pack("<2sBBi", b"GP", 0, 1, number)
    kind = _NUMBERS[layer.kind] + (1000 if layer.has_heights else 0)
    counts = {"POINT": (), "LINESTRING": (len(places),), "POLYGON": (1, len(places))}[layer.kind]
    return head + struct.pack(f"<BI{len(counts)}I", 1, kind, *counts) + places.astype("<f8").tobytes()
