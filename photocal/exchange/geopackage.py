"""Exposures, footprints, points and image residuals as a GeoPackage (OGC 12-128r15).

With the origin of the local frame the coordinates are longitude, latitude (deg, WGS 84) and ellipsoidal
height (m); without it they are the local ones (m) in an undefined Cartesian system. Image residuals stand in
a table without geometry: column and row (px, centre of the upper-left pixel (0, 0)), residuals computed minus
measured.
"""

from __future__ import annotations

import sqlite3
import struct
from collections.abc import Sequence
from contextlib import closing
from pathlib import Path
from typing import Any

import numpy as np

from photocal.exchange.geographic import ToGeographic, features
from photocal.exchange.reconstruction import Reconstruction

# "GPKG" and version 1.2, as the standard wants them in the header of the database.
_APPLICATION_ID = 0x47504B47
_VERSION = 10200
_LOCAL, _WGS84 = -1, 4326
_POINT_Z, _POLYGON = 1001, 3

_SCHEMA = """
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
  CONSTRAINT fk_gc_tn FOREIGN KEY (table_name) REFERENCES gpkg_contents(table_name),
  CONSTRAINT fk_gc_srs FOREIGN KEY (srs_id) REFERENCES gpkg_spatial_ref_sys(srs_id));
CREATE TABLE exposures (
  fid INTEGER PRIMARY KEY AUTOINCREMENT NOT NULL, geom POINT, name TEXT, camera TEXT, omega_deg DOUBLE,
  phi_deg DOUBLE, kappa_deg DOUBLE, sX_m DOUBLE, sY_m DOUBLE, sZ_m DOUBLE);
CREATE TABLE footprints (
  fid INTEGER PRIMARY KEY AUTOINCREMENT NOT NULL, geom POLYGON, name TEXT, plane_z_m DOUBLE);
CREATE TABLE points (
  fid INTEGER PRIMARY KEY AUTOINCREMENT NOT NULL, geom POINT, name TEXT, kind TEXT, rays INTEGER,
  sX_m DOUBLE, sY_m DOUBLE, sZ_m DOUBLE, residual_rms_px DOUBLE);
CREATE TABLE image_residuals (
  fid INTEGER PRIMARY KEY AUTOINCREMENT NOT NULL, image TEXT, point TEXT, column_px DOUBLE, row_px DOUBLE,
  vx_px DOUBLE, vy_px DOUBLE);
"""
_SYSTEMS = (
    ("Undefined Cartesian SRS", -1, "NONE", -1, "undefined"),
    ("Undefined geographic SRS", 0, "NONE", 0, "undefined"),
)
_COLUMNS = {
    "exposures": ("name", "camera", "omega_deg", "phi_deg", "kappa_deg", "sX_m", "sY_m", "sZ_m"),
    "footprints": ("name", "plane_z_m"),
    "points": ("name", "kind", "rays", "sX_m", "sY_m", "sZ_m", "residual_rms_px"),
}
_KINDS = {"exposure": "exposures", "footprint": "footprints"}
_INSERT = {
    "exposures": "INSERT INTO exposures VALUES (NULL, ?, ?, ?, ?, ?, ?, ?, ?, ?)",
    "footprints": "INSERT INTO footprints VALUES (NULL, ?, ?, ?)",
    "points": "INSERT INTO points VALUES (NULL, ?, ?, ?, ?, ?, ?, ?, ?)",
}


def write_geopackage(
    path: Path, given: Reconstruction, to_geographic: ToGeographic | None, changed_utc: str
) -> None:
    """Write a GeoPackage.

    Parameters
    ----------
    path : Path
    given : Reconstruction
    to_geographic : callable or None
        From `geographic.topocentric`; None keeps local coordinates.
    changed_utc : str
        Time to be noted as that of the last change, as `2025-01-31T12:00:00.000Z`.
    """
    system = _LOCAL if to_geographic is None else _WGS84
    turn = to_geographic or np.array
    # An empty file that waits to be renamed is not yet a database.
    path.unlink(missing_ok=True)
    with closing(sqlite3.connect(path)) as database:
        database.executescript(_SCHEMA)
        database.executescript(
            f"PRAGMA application_id = {_APPLICATION_ID}; PRAGMA user_version = {_VERSION};"
        )
        _write_systems(database)
        corners: dict[str, list[Sequence[float]]] = {name: [] for name in _COLUMNS}
        for geometry, properties in features(given, turn):
            table = _KINDS.get(properties["kind"], "points")
            ring = geometry["coordinates"][0] if geometry["type"] == "Polygon" else [geometry["coordinates"]]
            corners[table] += ring
            values = [properties.get(column) for column in _COLUMNS[table]]
            database.execute(_INSERT[table], [_geometry(geometry, system), *values])
        for table, places in corners.items():
            _register(database, table, places, system, changed_utc)
        _write_residuals(database, given, changed_utc)
        database.commit()


def _write_systems(database: sqlite3.Connection) -> None:
    from pyproj import CRS

    wgs84 = ("WGS 84", _WGS84, "EPSG", _WGS84, CRS.from_epsg(_WGS84).to_wkt("WKT1_GDAL"))
    database.executemany("INSERT INTO gpkg_spatial_ref_sys VALUES (?, ?, ?, ?, ?, NULL)", [*_SYSTEMS, wgs84])


def _register(
    database: sqlite3.Connection, table: str, places: list[Sequence[float]], system: int, changed_utc: str
) -> None:
    box: list[float | None] = [None] * 4
    if places:
        xy = np.array([place[:2] for place in places])
        box = [*xy.min(axis=0).tolist(), *xy.max(axis=0).tolist()]
    database.execute(
        "INSERT INTO gpkg_contents VALUES (?, 'features', ?, '', ?, ?, ?, ?, ?, ?)",
        [table, table, changed_utc, *box, system],
    )
    polygons = table == "footprints"
    database.execute(
        "INSERT INTO gpkg_geometry_columns VALUES (?, 'geom', ?, ?, ?, 0)",
        [table, "POLYGON" if polygons else "POINT", system, 0 if polygons else 1],
    )


def _write_residuals(database: sqlite3.Connection, given: Reconstruction, changed_utc: str) -> None:
    database.execute(
        "INSERT INTO gpkg_contents VALUES "
        "('image_residuals', 'attributes', 'image_residuals', '', ?, NULL, NULL, NULL, NULL, NULL)",
        [changed_utc],
    )
    residuals = given.residuals_px if len(given.residuals_px) else np.full(given.pixels.shape, np.nan)
    # SQLite takes NaN for NULL.
    database.executemany(
        "INSERT INTO image_residuals VALUES (NULL, ?, ?, ?, ?, ?, ?)",
        (
            (given.image_names[i], given.point_names[j], *pixel, *residual)
            for i, j, pixel, residual in zip(
                given.image.tolist(),
                given.point.tolist(),
                given.pixels.tolist(),
                residuals.tolist(),
                strict=True,
            )
        ),
    )


def _geometry(geometry: dict[str, Any], system: int) -> bytes:
    """GeoPackage binary: short header without envelope, then little-endian WKB."""
    head = struct.pack("<2sBBi", b"GP", 0, 1, system)
    if geometry["type"] == "Point":
        return head + struct.pack("<BI3d", 1, _POINT_Z, *geometry["coordinates"])
    ring = geometry["coordinates"][0]
    flat = [value for place in ring for value in place]
    return head + struct.pack(f"<BIII{len(flat)}d", 1, _POLYGON, 1, len(ring), *flat)
