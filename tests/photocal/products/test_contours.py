"""Contours of a cone are circles: written as GPKG, SHP and DXF, read back by readers of the test's own."""

from __future__ import annotations

import json
import sqlite3
import struct
from contextlib import closing
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray
from pyproj import CRS
from typer.testing import CliRunner

from photocal.base.errors import PhotocalError
from photocal.commands.cli import app
from photocal.products.contours import contour_lines
from photocal.products.raster import system_wkt, write_terrain
from photocal.products.terrain import Terrain

Floats = NDArray[np.float64]
TOP, EAST, NORTH, CELL = 130.25, 500_050.0, 7_000_050.0, 0.5
SYSTEM = "EPSG:31982"
# A chord of a cell lies inside of the circle by so much at most: cell^2 / (8 r), and of a float32 height.
SAGITTA = CELL**2 / 8
ROUNDING = 1e-5


@dataclass(frozen=True)
class Line:
    height: float
    is_index: bool
    xyz: Floats


def cone(crs: str = SYSTEM, kind: str = "orthometric") -> Terrain:
    """Heights 1 m lower for each metre from the middle; none in a corner."""
    x = np.arange(200) * CELL + CELL / 2 + EAST - 50
    y = -np.arange(200) * CELL - CELL / 2 + NORTH + 50
    radius = np.hypot(x - EAST, (y - NORTH)[:, None])
    heights = np.where((x > EAST + 40) & ((y - NORTH)[:, None] > 40), np.nan, TOP - radius)
    transform = (CELL, 0.0, EAST - 50, 0.0, -CELL, NORTH + 50)
    return Terrain(heights, transform, system_wkt(crs) if crs else "", kind)


def read_gpkg(path: Path) -> list[Line]:
    with closing(sqlite3.connect(path)) as base:
        columns = base.execute("SELECT geom, height, [index], kind FROM contours ORDER BY fid").fetchall()
        (system,) = base.execute("SELECT DISTINCT srs_id FROM gpkg_geometry_columns").fetchone()
        assert base.execute("PRAGMA integrity_check").fetchone() == ("ok",)
    assert system == 31982
    assert {row[3] for row in columns} == {"orthometric"}
    lines = []
    for blob, height, index, _ in columns:
        # OGC 12-128: magic, version, flags with the size of the envelope, system; then the line.
        assert blob[:2] == b"GP"
        head = 8 + {0: 0, 1: 32, 2: 48, 3: 48, 4: 64}[(blob[3] >> 1) & 7]
        order, kind, count = struct.unpack_from("<BII", blob, head)
        assert (order, kind) in ((1, 1002), (1, 0x80000002))
        xyz = np.frombuffer(blob, "<f8", 3 * count, head + 9).reshape(-1, 3)
        lines.append(Line(height, index == 1, xyz))
    return lines


def read_shp(path: Path) -> list[Line]:
    """The shapes by Esri's description of 1998, the table by dBASE III's."""
    raw, lines, at = path.read_bytes(), [], 100
    assert struct.unpack_from(">i", raw)[0] == 9994
    assert 2 * struct.unpack_from(">i", raw, 24)[0] == len(raw)
    shapes = []
    while at < len(raw):
        length = 2 * struct.unpack_from(">i", raw, at + 4)[0]
        kind, parts, points = struct.unpack_from("<i32xii", raw, at + 8)
        assert (kind, parts) == (13, 1)
        start = at + 8 + 44 + 4
        xy = np.frombuffer(raw, "<f8", 2 * points, start).reshape(-1, 2)
        z = np.frombuffer(raw, "<f8", points, start + 16 * points + 16)
        shapes.append(np.column_stack([xy, z]))
        at += 8 + length
    table = path.with_suffix(".dbf").read_bytes()
    count, head, width = struct.unpack_from("<IHH", table, 4)
    names, sizes = [], []
    for place in range(32, head - 1, 32):
        names.append(table[place : place + 11].rstrip(b"\0").decode())
        sizes.append(table[place + 16])
    assert names == ["height", "index", "kind"]
    ends = np.cumsum([1, *sizes])
    for number in range(count):
        row = table[head + number * width : head + (number + 1) * width]
        height, index, kind = (row[a:b].decode().strip() for a, b in pairwise(ends))
        assert kind == "orthometric"
        lines.append(Line(float(height), int(index) == 1, shapes[number]))
    assert CRS.from_wkt(path.with_suffix(".prj").read_text()).to_epsg(min_confidence=20) == 31982
    return lines


def read_dxf(path: Path) -> list[Line]:
    """Group codes and values; of polylines: layer (8), closed (70), elevation (38), vertices (10, 20)."""
    text = path.read_text().splitlines()
    groups = [(int(text[k]), text[k + 1].strip()) for k in range(0, len(text) - 1, 2)]
    assert groups[groups.index((9, "$INSUNITS")) + 1] == (70, "6")
    layers = {value for before, (code, value) in pairwise(groups) if code == 2 and before[0] == 100}
    starts = [k for k, group in enumerate(groups) if group[0] == 0]
    lines = []
    for first, last in pairwise(starts):
        if groups[first] != (0, "LWPOLYLINE"):
            continue
        part = groups[first:last]
        found = {code: value for code, value in part if code in (8, 38, 70)}
        x, y = ([float(value) for code, value in part if code == axis] for axis in (10, 20))
        xyz = np.column_stack([x, y, np.full(len(x), float(found[38]))])
        if int(found[70]) & 1:
            xyz = np.vstack([xyz, xyz[:1]])
        assert found[8] in layers
        lines.append(Line(float(found[38]), found[8] == "CONTOUR_INDEX", xyz))
    assert CRS.from_wkt(path.with_suffix(".prj").read_text()).to_epsg(min_confidence=20) == 31982
    return lines


READERS = {"gpkg": read_gpkg, "shp": read_shp, "dxf": read_dxf}


@pytest.fixture(scope="module")
def model(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("cone") / "cone.tif"
    write_terrain(cone(), path)
    return path


@pytest.mark.parametrize("ending", READERS)
def test_contours_of_a_cone_are_circles(model: Path, tmp_path: Path, ending: str) -> None:
    path = tmp_path / f"lines.{ending}"
    done = CliRunner().invoke(app, ["contours", str(model), "--interval", "2", "-o", str(path), "--json"])
    assert done.exit_code == 0, done.output
    lines = READERS[ending](path)
    # From the highest centre (a cell's half diagonal below the top) to the circle that touches the border.
    inner = [line for line in lines if line.height > TOP - 50]
    assert [line.height for line in inner] == [float(h) for h in range(82, 130, 2)]
    for line in inner:
        radius = TOP - line.height
        found = np.hypot(line.xyz[:, 0] - EAST, line.xyz[:, 1] - NORTH)
        assert line.xyz[:, 2] == pytest.approx(line.height, abs=1e-9)
        assert (line.xyz[0] == line.xyz[-1]).all()
        assert line.is_index == (line.height % 10 == 0)
        # Heights between two centres are those of the cone but for its bending within a cell.
        assert (found < radius + ROUNDING).all()
        assert (found > radius - SAGITTA / max(radius - CELL, CELL) - ROUNDING).all()
        length = np.hypot(*np.diff(line.xyz[:, :2], axis=0).T).sum()
        assert length == pytest.approx(2 * np.pi * radius, rel=2 * (CELL / radius) ** 2)
    outer = [line for line in lines if line.height < TOP - 50]
    assert outer
    assert not any((line.xyz[0] == line.xyz[-1]).all() for line in outer)
    # Nothing crosses the corner without heights.
    assert not any(((line.xyz[:, :2] > (EAST + 40, NORTH + 40)).all(axis=1)).any() for line in lines)
    figures = json.loads(done.stdout)
    assert (figures["lines"], figures["crs"]) == (len(lines), "SIRGAS 2000 / UTM zone 22S")


def test_the_same_model_gives_the_same_file(model: Path, tmp_path: Path) -> None:
    made = []
    for name in ("one", "two"):
        path = tmp_path / name / "lines.gpkg"
        assert (
            CliRunner().invoke(app, ["contours", str(model), "--interval", "5", "-o", str(path)]).exit_code
            == 0
        )
        assert list(path.parent.iterdir()) == [path]
        made.append(path.read_bytes())
    assert made[0] == made[1]


def test_a_turned_raster_of_a_plane() -> None:
    # Heights fall 0.1 m a column; rows and columns are turned by 30 degrees.
    turn = np.radians(30.0)
    heights = np.tile(10.05 - 0.1 * np.arange(40), (30, 1))
    transform = (np.cos(turn), np.sin(turn), 7.0, np.sin(turn), -np.cos(turn), 9.0)
    lines = contour_lines(Terrain(heights, transform, "", "local"), 1.0)
    assert [number for number, _ in lines] == [7, 8, 9, 10]
    along = np.array([np.cos(turn), np.sin(turn)])
    for number, xy in lines:
        column = (10.05 - number) / 0.1
        assert (xy - (7.0, 9.0)) @ along == pytest.approx(column + 0.5, abs=1e-9)


def test_points_of_a_table(tmp_path: Path) -> None:
    table, path = tmp_path / "points.csv", tmp_path / "lines.gpkg"
    table.write_text("X,Y,Z\n0,0,0\n10,0,0\n0,10,10\n10,10,10\n")
    words = ["contours", str(table), "--interval", "4", "--cell", "1", "--heights", "local", "-o", str(path)]
    done = CliRunner().invoke(app, words)
    assert "2 contours every 4 m, 4 to 8 m (local heights), 0 of them index contours; no reference" in (
        " ".join(done.output.split())
    )
    with closing(sqlite3.connect(path)) as base:
        assert base.execute("SELECT height FROM contours ORDER BY height").fetchall() == [(4.0,), (8.0,)]


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (["-o", "lines.kml", "--interval", "1"], "has no known extension"),
        (["-o", "lines.dxf", "--interval", "0"], "are impossible"),
        (["-o", "lines.dxf", "--interval", "500"], "choose a smaller interval"),
        (["-o", "lines.dxf", "--interval", "1e-4"], "choose a larger interval"),
        (["-o", "lines.dxf", "--interval", "1", "--heights", "ellipsoidal"], "correct the kind"),
        (["-o", "lines.dxf", "--interval", "1", "--crs", SYSTEM], "names none"),
    ],
)
def test_refusals(model: Path, tmp_path: Path, words: list[str], said: str) -> None:
    words = [str(tmp_path / word) if word.startswith("lines") else word for word in words]
    done = CliRunner().invoke(app, ["contours", str(model), *words])
    assert isinstance(done.exception, PhotocalError)
    assert said in str(done.exception)
    assert not list(tmp_path.iterdir())
