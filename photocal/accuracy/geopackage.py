"""Check points and their residual vectors as a GeoPackage (OGC 12-128r15) for QGIS.

A GeoPackage is an SQLite database with a few prescribed tables and geometries as WKB behind a short
header. Points and two-point lines need so little of it that the sqlite3 of Python suffices and the
whole of GDAL does not have to come along.
"""

from __future__ import annotations

import math
import sqlite3
import struct
from contextlib import closing
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from acquire.outputs import output_file
from drivers.errors import ConfigurationError
from photocal.accuracy.discrepancies import Discrepancies
from photocal.accuracy.statistics import FloatArray

# "GPKG" and version 1.2, as the standard wants them in the header of the database.
_APPLICATION_ID = 0x47504B47
_VERSION = 10200

_UNDEFINED_CARTESIAN = -1
# First number that no authority uses, for a coordinate system without one.
_OWN_SYSTEM = 100_000

# Longest drawn vector as a share of the extent of the points.
_LONGEST = 0.12

_TABLES = """
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
CREATE TABLE ground_points (
  fid INTEGER PRIMARY KEY AUTOINCREMENT NOT NULL, geom POINT, point TEXT, role TEXT,
  h_m DOUBLE, dE_m DOUBLE, dN_m DOUBLE, dh_m DOUBLE, plane_m DOUBLE);
CREATE TABLE residual_vectors (
  fid INTEGER PRIMARY KEY AUTOINCREMENT NOT NULL, geom LINESTRING, point TEXT, role TEXT,
  dE_m DOUBLE, dN_m DOUBLE, plane_m DOUBLE, enlarged DOUBLE);
"""
_ADD_POINT = """
INSERT INTO ground_points (geom, point, role, h_m, dE_m, dN_m, dh_m, plane_m) VALUES (?, ?, ?, ?, ?, ?, ?, ?)
"""
_ADD_VECTOR = """
INSERT INTO residual_vectors (geom, point, role, dE_m, dN_m, plane_m, enlarged) VALUES (?, ?, ?, ?, ?, ?, ?)
"""


@dataclass(frozen=True)
class ReferenceSystem:
    """A projected coordinate system as the GeoPackage stores it."""

    number: int
    name: str
    organization: str
    definition: str


def reference_system(crs: str | None) -> ReferenceSystem:
    """Look up a projected coordinate system.

    Parameters
    ----------
    crs : str or None
        Such as `EPSG:31982`; None for a local system that nothing else is known of.

    Returns
    -------
    ReferenceSystem
        For `write_geopackage`.

    Raises
    ------
    ConfigurationError
        When it is unknown, or not a projected system in metres.
    """
    if crs is None:
        return ReferenceSystem(_UNDEFINED_CARTESIAN, "Undefined Cartesian SRS", "NONE", "undefined")
    from pyproj import CRS
    from pyproj.exceptions import CRSError

    try:
        system = CRS.from_user_input(crs)
    except CRSError as refusal:
        raise ConfigurationError(
            f"{crs!r} is not a coordinate system", remedy="give it as EPSG:31982"
        ) from refusal
    if not system.is_projected or {axis.unit_name for axis in system.axis_info[:2]} != {"metre"}:
        raise ConfigurationError(
            f"{crs} ({system.name}) is not a map projection in metres",
            remedy="discrepancies in metres need one, such as a UTM zone",
        )
    number = system.to_epsg()
    definition = system.to_wkt("WKT1_GDAL")
    if number is None:
        return ReferenceSystem(_OWN_SYSTEM, system.name, "NONE", definition)
    return ReferenceSystem(number, system.name, "EPSG", definition)


def write_geopackage(
    path: Path, groups: tuple[tuple[str, Discrepancies], ...], system: ReferenceSystem, changed_utc: str
) -> int:
    """Write ground points and their residual vectors.

    Parameters
    ----------
    path : Path
        The file; replaced as a whole.
    groups : tuple of tuple
        Role (such as `check` or `control`) and discrepancies with positions, each.
    system : ReferenceSystem
        Coordinate system of the positions.
    changed_utc : str
        Time to be noted as that of the last change, as `2025-01-31T12:00:00.000Z`.

    Returns
    -------
    int
        Number of points written; those without position are left out.

    Raises
    ------
    ConfigurationError
        When no point has a position.
    OutputError
        When the file cannot be written.
    """
    rows = [row for role, discrepancies in groups for row in _rows(role, discrepancies)]
    if not rows:
        raise ConfigurationError(
            "a map needs the positions of the points",
            where=path,
            remedy="add the columns E and N to the table",
        )
    enlarged = _enlargement(np.array([row[2:] for row in rows]))
    with output_file(path) as aside, closing(sqlite3.connect(aside)) as database:
        database.executescript(_TABLES)
        database.executescript(
            f"PRAGMA application_id = {_APPLICATION_ID}; PRAGMA user_version = {_VERSION};"
        )
        _systems(database, system)
        for name, kind in (("ground_points", "POINT"), ("residual_vectors", "LINESTRING")):
            _register(database, name, kind, system.number, changed_utc)
        for row in rows:
            _add(database, row, system.number, enlarged)
        _extents(database, np.array([row[2:7] for row in rows]), enlarged)
        database.commit()
    return len(rows)


_Row = tuple[str, str, float, float, float, float, float, float]


def _rows(role: str, discrepancies: Discrepancies) -> list[_Row]:
    if discrepancies.positions_m is None:
        return []
    return [
        (role, name, *place, *d)
        for name, place, d in zip(
            discrepancies.points, discrepancies.positions_m.tolist(), discrepancies.d_m.tolist(), strict=True
        )
        if math.isfinite(place[0]) and math.isfinite(place[1])
    ]


def _enlargement(table: FloatArray) -> float:
    """Factor that makes the longest vector a fair share of the map."""
    known = np.isfinite(table[:, 3:5]).all(axis=1)
    longest = float(np.max(np.hypot(table[known, 3], table[known, 4]), initial=0.0))
    extent = float(np.max(np.ptp(table[:, :2], axis=0)))
    return _LONGEST * max(extent, 1.0) / longest if longest > 0.0 else 1.0


def _systems(database: sqlite3.Connection, system: ReferenceSystem) -> None:
    from pyproj import CRS

    needed = (
        (ReferenceSystem(_UNDEFINED_CARTESIAN, "Undefined Cartesian SRS", "NONE", "undefined"), -1),
        (ReferenceSystem(0, "Undefined geographic SRS", "NONE", "undefined"), 0),
        (ReferenceSystem(4326, "WGS 84", "EPSG", CRS.from_epsg(4326).to_wkt("WKT1_GDAL")), 4326),
        (system, system.number),
    )
    database.executemany(
        "INSERT OR IGNORE INTO gpkg_spatial_ref_sys VALUES (?, ?, ?, ?, ?, NULL)",
        [
            (entry.name, entry.number, entry.organization, number, entry.definition)
            for entry, number in needed
        ],
    )


def _register(database: sqlite3.Connection, name: str, kind: str, number: int, changed: str) -> None:
    database.execute(
        "INSERT INTO gpkg_contents VALUES (?, 'features', ?, '', ?, NULL, NULL, NULL, NULL, ?)",
        (name, name, changed, number),
    )
    database.execute("INSERT INTO gpkg_geometry_columns VALUES (?, 'geom', ?, ?, 0, 0)", (name, kind, number))


def _add(database: sqlite3.Connection, row: _Row, number: int, enlarged: float) -> None:
    role, name, east, north, height, d_east, d_north, d_height = row
    plane = math.hypot(d_east, d_north)
    point = _geometry(number, struct.pack("<BIdd", 1, 1, east, north))
    figures = [_null(value) for value in (height, d_east, d_north, d_height, plane)]
    database.execute(_ADD_POINT, (point, name, role, *figures))
    if math.isfinite(plane):
        end = east + enlarged * d_east, north + enlarged * d_north
        line = _geometry(number, struct.pack("<BIIdddd", 1, 2, 2, east, north, *end))
        database.execute(_ADD_VECTOR, (line, name, role, d_east, d_north, plane, enlarged))


def _geometry(number: int, wkb: bytes) -> bytes:
    # Magic, version 0, flags: little-endian and no envelope; then the coordinate system.
    return struct.pack("<2sBBi", b"GP", 0, 1, number) + wkb


def _extents(database: sqlite3.Connection, table: FloatArray, enlarged: float) -> None:
    starts = table[:, :2]
    ends = starts + enlarged * np.nan_to_num(table[:, 3:5])
    for name, places in (("ground_points", starts), ("residual_vectors", np.vstack((starts, ends)))):
        database.execute(
            "UPDATE gpkg_contents SET min_x = ?, min_y = ?, max_x = ?, max_y = ? WHERE table_name = ?",
            (*places.min(axis=0).tolist(), *places.max(axis=0).tolist(), name),
        )


def _null(value: float) -> float | None:
    return value if math.isfinite(value) else None
