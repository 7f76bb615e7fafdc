from __future__ import annotations

import math
import sqlite3
import struct
from contextlib import closing
from pathlib import Path

import numpy as np
import pytest
from pyproj import CRS
from typer.testing import CliRunner

from photocal.analysis.accuracy.discrepancies import Discrepancies
from photocal.analysis.accuracy.maps import reference_system, write_geopackage
from photocal.base.errors import ConfigurationError
from photocal.commands.cli import app

STAMP = "2025-01-31T12:00:00.000Z"
NAMES = tuple(f"P{i}" for i in range(5))
POSITIONS = np.array([[457_000.0 + 100 * i, 7_553_000.0 + 40 * (i % 3), 400.0] for i in range(5)])
D = np.array([[0.1, 0.2, 0.3], [-0.1, 0.0, 0.1], [0.3, -0.4, np.nan], [np.nan, np.nan, 0.2], [0.0, 0.0, 0.0]])
CHECK = Discrepancies(NAMES, D, POSITIONS)
CONTROL = Discrepancies(("C1",), np.array([[0.01, 0.02, 0.0]]), POSITIONS[:1] + 5.0)


def geometry(blob: bytes) -> tuple[int, int, tuple[float, ...]]:
    """Coordinate system, WKB type and coordinates, decoded by the letter of OGC 12-128, clause 2.1.3."""
    assert blob[:2] == b"GP"
    version, flags = blob[2], blob[3]
    assert version == 0
    assert flags == 0b00000001
    (number,) = struct.unpack("<i", blob[4:8])
    order, kind = struct.unpack("<BI", blob[8:13])
    assert order == 1
    body = blob[13:] if kind == 1 else blob[17:]
    return number, kind, struct.unpack(f"<{len(body) // 8}d", body)


def test_points_and_vectors_are_where_they_belong(tmp_path: Path) -> None:
    path = tmp_path / "check.gpkg"
    groups = (("check", CHECK), ("control", CONTROL))
    assert write_geopackage(path, groups, reference_system("EPSG:31982"), STAMP) == 6
    with closing(sqlite3.connect(path)) as database:
        points = database.execute(
            "SELECT geom, point, role, h_m, dh_m FROM ground_points ORDER BY fid"
        ).fetchall()
        vectors = database.execute(
            "SELECT geom, point, dE_m, dN_m, plane_m, enlarged FROM residual_vectors ORDER BY fid"
        ).fetchall()
    assert [row[1:3] for row in points] == [*((name, "check") for name in NAMES), ("C1", "control")]
    assert points[2][4] is None
    for row, place in zip(points, POSITIONS, strict=False):
        assert geometry(row[0]) == (31982, 1, (place[0], place[1]))
        assert row[3] == 400.0
    # P3 has no planimetric discrepancy and therefore no vector.
    assert [row[1] for row in vectors] == ["P0", "P1", "P2", "P4", "C1"]
    for blob, _, d_east, d_north, plane, enlarged in vectors:
        number, kind, (x1, y1, x2, y2) = geometry(blob)
        assert (number, kind) == (31982, 2)
        assert (x2 - x1, y2 - y1) == pytest.approx((enlarged * d_east, enlarged * d_north), abs=1e-8)
        assert plane == pytest.approx(math.hypot(d_east, d_north))


def test_prescribed_tables_of_the_standard(tmp_path: Path) -> None:
    path = tmp_path / "check.gpkg"
    write_geopackage(path, (("check", CHECK),), reference_system("EPSG:31982"), STAMP)
    with closing(sqlite3.connect(path)) as database:
        assert database.execute("PRAGMA application_id").fetchone() == (int.from_bytes(b"GPKG", "big"),)
        assert database.execute("PRAGMA user_version").fetchone() == (10200,)
        assert database.execute("PRAGMA integrity_check").fetchone() == ("ok",)
        assert database.execute("PRAGMA foreign_key_check").fetchall() == []
        systems = dict(database.execute("SELECT srs_id, definition FROM gpkg_spatial_ref_sys").fetchall())
        assert systems.keys() == {-1, 0, 4326, 31982}
        assert systems[-1] == systems[0] == "undefined"
        assert CRS.from_wkt(systems[31982]).to_epsg() == 31982
        contents = database.execute(
            "SELECT table_name, data_type, last_change, min_x, max_x, srs_id FROM gpkg_contents ORDER BY 1"
        ).fetchall()
        assert contents[0] == ("ground_points", "features", STAMP, 457_000.0, 457_400.0, 31982)
        columns = database.execute("SELECT * FROM gpkg_geometry_columns ORDER BY 1").fetchall()
        assert columns == [
            ("ground_points", "geom", "POINT", 31982, 0, 0),
            ("residual_vectors", "geom", "LINESTRING", 31982, 0, 0),
        ]


def test_a_local_system_is_undefined_cartesian(tmp_path: Path) -> None:
    path = tmp_path / "local.gpkg"
    write_geopackage(path, (("check", CHECK),), reference_system(None), STAMP)
    with closing(sqlite3.connect(path)) as database:
        assert database.execute("SELECT DISTINCT srs_id FROM gpkg_contents").fetchall() == [(-1,)]


def test_a_system_without_number_gets_one_of_its_own() -> None:
    own = reference_system("+proj=tmerc +lat_0=-23 +lon_0=-51.5 +k=1 +x_0=0 +y_0=0 +ellps=GRS80 +units=m")
    assert own.number == 100_000
    assert own.organization == "NONE"


@pytest.mark.parametrize("crs", ["EPSG:4326", "EPSG:2263", "EPSG:0", "nonsense", "EPSG:4978"])
def test_systems_without_metres_on_a_plane_are_refused(crs: str) -> None:
    with pytest.raises(ConfigurationError) as failure:
        reference_system(crs)
    assert "\n" not in str(failure.value)


def test_points_without_positions_make_no_map(tmp_path: Path) -> None:
    path = tmp_path / "none.gpkg"
    with pytest.raises(ConfigurationError, match="positions"):
        write_geopackage(path, (("check", Discrepancies(NAMES, D)),), reference_system(None), STAMP)
    assert not path.exists()


def test_command_writes_the_same_file_again(tmp_path: Path) -> None:
    table = tmp_path / "check.csv"
    table.write_text("point,E,N,dE,dN\nA,0,0,0.1,0.2\nB,100,50,0.0,-0.1\n", encoding="utf-8")
    for name in ("one.gpkg", "two.gpkg"):
        arguments = ["check", "--discrepancies", str(table), "--geopackage", str(tmp_path / name)]
        result = CliRunner().invoke(app, [*arguments, "--crs", "EPSG:31982"])
        assert result.exit_code == 0, result.output
    assert (tmp_path / "one.gpkg").read_bytes() == (tmp_path / "two.gpkg").read_bytes()
