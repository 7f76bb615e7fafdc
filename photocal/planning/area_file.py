"""The area to be flown, read from GeoJSON, KML or CSV."""

from __future__ import annotations

import csv
import io
import json
from pathlib import Path
from typing import Any

from drivers.errors import InputMalformedError, InputNotFoundError
from photocal.planning.area import Area, area_from_corners


def read_area(path: Path) -> Area:
    """Read the polygon of a flight.

    path: `.geojson` or `.json` (RFC 7946), `.kml`, or `.csv` with the columns lat_deg and lon_deg.
    raises InputNotFoundError: when there is no such file.
    raises InputMalformedError: when it does not hold exactly one simple polygon.
    """
    readers = {".geojson": _from_geojson, ".json": _from_geojson, ".kml": _from_kml, ".csv": _from_csv}
    reader = readers.get(path.suffix.lower())
    if reader is None:
        raise InputMalformedError(
            f"unknown kind of area {path.suffix!r}", where=path, remedy="give GeoJSON, KML or CSV"
        )
    try:
        text = path.read_text(encoding="utf-8-sig")
    except OSError as refusal:
        reason = refusal.strerror or str(refusal)
        raise InputNotFoundError(f"cannot be read ({reason})", where=path) from refusal
    except UnicodeDecodeError as refusal:
        raise InputMalformedError("is not UTF-8 text", where=path) from refusal
    return area_from_corners(reader(text, str(path)), str(path))


def _from_geojson(text: str, where: str) -> list[tuple[float, float]]:
    try:
        content = json.loads(text)
    except (ValueError, RecursionError) as refusal:
        raise InputMalformedError(f"is not JSON ({refusal})", where=where) from refusal
    rings = list(_polygons(content, where))
    if len(rings) != 1:
        raise InputMalformedError(
            f"holds {len(rings)} polygons, one is needed", where=where, remedy="keep the polygon to be flown"
        )
    if not isinstance(rings[0], list) or len(rings[0]) != 1:
        raise InputMalformedError(
            "is a polygon with holes", where=where, remedy="keep the outer ring; holes are flown over"
        )
    try:
        return [(float(position[0]), float(position[1])) for position in rings[0][0]]
    except (TypeError, ValueError, IndexError, KeyError, OverflowError) as refusal:
        raise InputMalformedError("has a corner that is not a position", where=where) from refusal


def _polygons(content: Any, where: str) -> list[Any]:
    if not isinstance(content, dict):
        raise InputMalformedError("is not GeoJSON", where=where)
    kind = content.get("type")
    if kind == "FeatureCollection" and isinstance(content.get("features"), list):
        return [ring for feature in content["features"] for ring in _polygons(feature, where)]
    if kind == "Feature":
        return _polygons(content["geometry"], where) if content.get("geometry") else []
    if kind == "Polygon":
        return [content.get("coordinates")]
    if kind == "MultiPolygon" and isinstance(content.get("coordinates"), list):
        return list(content["coordinates"])
    return []


def _from_kml(text: str, where: str) -> list[tuple[float, float]]:
    from xml.etree.ElementTree import ParseError

    from defusedxml.common import DefusedXmlException
    from defusedxml.ElementTree import fromstring

    try:
        root = fromstring(text)
    except (ParseError, DefusedXmlException, ValueError) as refusal:
        raise InputMalformedError(f"is not KML ({refusal})", where=where) from refusal
    polygons = [element for element in root.iter() if _local(element.tag) == "Polygon"]
    if len(polygons) != 1:
        raise InputMalformedError(
            f"holds {len(polygons)} polygons, one is needed",
            where=where,
            remedy="keep the polygon to be flown",
        )
    rings = [element for element in polygons[0].iter() if _local(element.tag) == "coordinates"]
    if len(rings) != 1:
        raise InputMalformedError(
            "is a polygon with holes or without corners", where=where, remedy="keep the outer ring"
        )
    try:
        fields = [position.split(",") for position in (rings[0].text or "").split()]
        return [(float(field[0]), float(field[1])) for field in fields]
    except (ValueError, IndexError) as refusal:
        raise InputMalformedError("has a corner that is not lon,lat", where=where) from refusal


def _local(tag: object) -> str:
    return str(tag).rpartition("}")[2]


def _from_csv(text: str, where: str) -> list[tuple[float, float]]:
    try:
        reader = csv.DictReader(io.StringIO(text))
        if not {"lat_deg", "lon_deg"} <= set(reader.fieldnames or ()):
            raise InputMalformedError("has no columns lat_deg and lon_deg", where=where)
        corners = []
        for row in reader:
            try:
                corners.append((float(row["lon_deg"]), float(row["lat_deg"])))
            except (TypeError, ValueError) as refusal:
                raise InputMalformedError(
                    "is not a position",
                    where=f"{where}, line {reader.line_num}",
                    remedy="give lat_deg and lon_deg",
                ) from refusal
    except csv.Error as refusal:
        raise InputMalformedError(f"is not a table ({refusal})", where=where) from refusal
    return corners
