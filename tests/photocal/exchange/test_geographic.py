"""GeoJSON, KML and GeoPackage: places, footprints, residuals."""

from __future__ import annotations

import json
import math
import sqlite3
import struct
from contextlib import closing
from dataclasses import replace
from pathlib import Path
from xml.etree.ElementTree import parse

import numpy as np
import pytest

from photocal.base.geodesy import GeodeticPlace
from photocal.block.model import Block, Images
from photocal.exchange.exporting import Choices
from photocal.exchange.geographic import footprints, topocentric, write_geojson, write_geopackage, write_kml
from photocal.geometry.camera import PARAMETERS
from tests.photocal.exchange.conftest import residuals_of


def test_topocentric_against_the_textbook() -> None:
    """Closed form: geodetic to geocentric, turned and moved (Kaplan and Hegarty 2017, ch. 2)."""
    a, f = 6378137.0, 1 / 298.257223563
    lat, lon, h = math.radians(47.3), math.radians(8.6), 450.0
    e2 = f * (2 - f)

    def geocentric(phi: float, lam: float, height: float) -> np.ndarray:
        n = a / math.sqrt(1 - e2 * math.sin(phi) ** 2)
        return np.array(
            [
                (n + height) * math.cos(phi) * math.cos(lam),
                (n + height) * math.cos(phi) * math.sin(lam),
                (n * (1 - e2) + height) * math.sin(phi),
            ]
        )

    east = np.array([-math.sin(lon), math.cos(lon), 0])
    up = np.array([math.cos(lat) * math.cos(lon), math.cos(lat) * math.sin(lon), math.sin(lat)])
    local = np.array([120.0, -340.0, 25.0])
    there = geocentric(lat, lon, h) + local @ np.array([east, np.cross(up, east), up])
    found = topocentric(GeodeticPlace(47.3, 8.6, 450.0))(local[None])[0]
    back = geocentric(math.radians(found[1]), math.radians(found[0]), found[2])
    assert np.abs(back - there).max() < 1e-6


def test_footprint_of_a_vertical_image(vision: Block) -> None:
    pose = np.array([[0.0, 0.0, 0.0, 10.0, 20.0, 100.0]])
    own = replace(vision.cameras[0], values=np.eye(len(PARAMETERS))[0] * 1000.0)
    single = replace(vision, cameras=(own,), images=Images(("a",), np.array([0]), pose))
    # 4608 x 3456 px, c = 1000 px, 100 m above the plane.
    expected = [
        [10 - 230.4, 20 + 172.8, 0],
        [10 + 230.4, 20 + 172.8, 0],
        [10 + 230.4, 20 - 172.8, 0],
        [10 - 230.4, 20 - 172.8, 0],
    ]
    np.testing.assert_allclose(footprints(single, 0.0)[0], expected, atol=1e-9)
    assert np.isnan(footprints(single, 200.0)).all()


def test_geojson_and_kml(tmp_path: Path, vision: Block) -> None:
    choices = Choices(origin=GeodeticPlace(47.3, 8.6, 450.0))
    write_geojson(tmp_path / "b.geojson", vision, choices)
    write_kml(tmp_path / "b.kml", vision, choices)
    content = json.loads((tmp_path / "b.geojson").read_text())
    kinds = [feature["properties"]["kind"] for feature in content["features"]]
    assert kinds.count("exposure") == kinds.count("footprint") == 6
    assert (kinds.count("control"), kinds.count("check"), kinds.count("tie")) == (1, 1, 38)
    for feature in content["features"]:
        if feature["geometry"]["type"] == "Point":
            longitude, latitude, height = feature["geometry"]["coordinates"]
            assert abs(longitude - 8.6) < 0.01
            assert abs(latitude - 47.3) < 0.01
            assert 440 < height < 600
    root = parse(tmp_path / "b.kml").getroot()  # noqa: S314
    assert len(root.findall(".//{http://www.opengis.net/kml/2.2}Placemark")) == len(content["features"])


@pytest.mark.parametrize("origin", [None, GeodeticPlace(47.3, 8.6, 450.0)])
def test_geopackage(tmp_path: Path, vision: Block, origin: GeodeticPlace | None) -> None:
    """Read with plain SQLite by the standard's layout (OGC 12-128r15, clause 2.1.3)."""
    path = tmp_path / "b.gpkg"
    made = "2026-01-31T12:00:00.000Z"
    write_geopackage(path, vision, Choices(None, origin, made, residuals_of(vision)))
    with closing(sqlite3.connect(path)) as database:
        assert database.execute("PRAGMA application_id").fetchone()[0] == 0x47504B47
        assert database.execute("PRAGMA foreign_key_check").fetchall() == []
        system = -1 if origin is None else 4326
        tables = dict(database.execute("SELECT table_name, srs_id FROM gpkg_geometry_columns"))
        assert tables == dict.fromkeys(("exposures", "footprints", "points"), system)
        rows = database.execute("SELECT geom, name, kappa_deg FROM exposures ORDER BY fid").fetchall()
        assert [name for _, name, _ in rows] == list(vision.images.names)
        for k, (geometry, _, kappa) in enumerate(rows):
            magic, version, flags, number, order, kind, x, y, z = struct.unpack("<2sBBiBI3d", geometry)
            assert (magic, version, flags, number, order, kind) == (b"GP", 0, 1, system, 1, 1001)
            assert kappa == pytest.approx(np.degrees(vision.images.values[k, 2]))
            if origin is None:
                np.testing.assert_allclose([x, y, z], vision.images.values[k, 3:], rtol=1e-12)
            else:
                assert (round(x, 1), round(y, 1)) == (8.6, 47.3)
        residuals = database.execute(
            "SELECT column_px, row_px, vx_px, vy_px FROM image_residuals ORDER BY fid"
        )
        expected = np.hstack([vision.observations.values, residuals_of(vision)])
        np.testing.assert_allclose(residuals.fetchall(), expected, rtol=1e-12)
        assert database.execute("SELECT count(*) FROM points WHERE kind = 'control'").fetchone() == (1,)
