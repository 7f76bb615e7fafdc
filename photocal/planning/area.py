"""The area to be flown, and the local plane that it is laid into."""

import json
import math
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from photocal.base.archives import DAMAGES, unzipped
from photocal.base.arrays import Flags, Floats
from photocal.base.errors import InputMalformedError, reading
from photocal.base.text_tables import read_wider_table


@dataclass(frozen=True)
class Area:
    """A simple polygon on WGS 84.

    latitude_deg, longitude_deg (n,): corners in order, degrees, the first not repeated at the end.
    """

    latitude_deg: Floats
    longitude_deg: Floats

    def __repr__(self) -> str:
        """Say in one line how many corners it has, and where it lies."""
        latitude, longitude = self.centre_deg
        return (
            f"Area: {len(self.latitude_deg)} corners about latitude {latitude:.5f}, longitude {longitude:.5f}"
        )

    @property
    def centre_deg(self) -> tuple[float, float]:
        """Middle of the extent: latitude and longitude, degrees."""
        return (
            float(self.latitude_deg.min() + self.latitude_deg.max()) / 2.0,
            float(self.longitude_deg.min() + self.longitude_deg.max()) / 2.0,
        )


@dataclass(frozen=True)
class LocalPlane:
    """Azimuthal equidistant plane about a point: true to a millimetre over some kilometres."""

    latitude_deg: float
    longitude_deg: float

    def to_plane(self, latitude_deg: Floats, longitude_deg: Floats) -> Floats:
        """Lay positions into the plane."""
        return np.column_stack(self._projection()(longitude_deg, latitude_deg))

    def to_degrees(self, plane_m: Floats) -> tuple[Floats, Floats]:
        """Take positions back from the plane."""
        longitude, latitude = self._projection()(plane_m[:, 0], plane_m[:, 1], inverse=True)
        return np.asarray(latitude), np.asarray(longitude)

    def _projection(self) -> Any:
        from pyproj import Proj

        return Proj(proj="aeqd", lat_0=self.latitude_deg, lon_0=self.longitude_deg, ellps="WGS84")


def area_from_corners(corners_deg: list[tuple[float, float]], where: str) -> Area:
    """Make an area from its corners; an area that cannot be flown raises an error.

    Parameters
    ----------
    corners_deg
        Longitude and latitude of each corner, degrees, in their order around the area.
    where
        File or name of the area, for error messages.

    Returns
    -------
    Area
        The polygon.

    Raises
    ------
    InputMalformedError
        For fewer than three corners, sides that cross, or an area of more than 100 km.

    Examples
    --------
    >>> import photocal
    >>> corners = [(-51.41, -22.12), (-51.40, -22.12), (-51.40, -22.13)]
    >>> len(photocal.area_from_corners(corners, "field").latitude_deg)
    3
    """
    wrong = InputMalformedError.at(where)
    if len(corners_deg) > 1 and corners_deg[0] == corners_deg[-1]:
        corners_deg = corners_deg[:-1]
    if len(set(corners_deg)) < 3:
        raise wrong("has fewer than three different corners")
    for longitude, latitude in corners_deg:
        if not (math.isfinite(longitude) and math.isfinite(latitude)):
            raise wrong("has a corner that is not a number")
        if abs(latitude) > 90.0 or abs(longitude) > 180.0:
            raise wrong(
                f"has a corner at latitude {latitude:g}, longitude {longitude:g}",
                "latitude and longitude may be swapped, or the coordinates are not degrees",
            )
    longitude_deg, latitude_deg = (
        np.array(column, dtype=np.float64) for column in zip(*corners_deg, strict=True)
    )
    area = Area(latitude_deg, longitude_deg)
    corners_m = LocalPlane(*area.centre_deg).to_plane(latitude_deg, longitude_deg)
    # Beyond this the plane of one flight is no plane any more, and the polygon rather a mistake.
    largest_extent_m = 100_000.0
    if not np.isfinite(corners_m).all() or float(np.ptp(corners_m, axis=0).max()) > largest_extent_m:
        raise wrong("is larger than 100 km", "check for a wrong corner; one flight covers a few kilometres")
    if abs(polygon_area(corners_m)) < 1.0 or _crosses_itself(corners_m):
        raise wrong("is not a simple polygon (no area, or sides that cross)", "put the corners in order")
    return area


def polygon_area(corners_m: Floats) -> float:
    """Give the area of a polygon."""
    x, y = (corners_m - corners_m[0]).T
    return 0.5 * float(np.sum(x * np.roll(y, -1) - np.roll(x, -1) * y))


def grid(low: Floats, high: Floats, step_m: float) -> Floats:
    """Give the middles of square cells between two corners, shape (n, 2)."""
    axes = [np.arange(a + step_m / 2.0, b, step_m) for a, b in zip(low, high, strict=True)]
    return np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, 2)


def inside(points_m: Floats, corners_m: Floats) -> Flags:
    """Say which points lie in a polygon."""
    from matplotlib.path import Path as Outline

    return np.asarray(Outline(corners_m).contains_points(points_m))


def _crosses_itself(corners: Floats) -> bool:
    (x, y), away = (np.roll(corners, -1, axis=0) - corners).T[:, :, None], corners - corners[:, None]
    # On which side of each border each corner lies; a border whose ends lie on either side of another one's
    # line, and the other way round, crosses it.
    side = np.sign(x * away[:, :, 1] - y * away[:, :, 0])
    parted = side * np.roll(side, -1, axis=1) < 0.0
    return bool((parted & parted.T).any())


def read_area(path: str | Path) -> Area:
    """Read the polygon of a flight.

    Parameters
    ----------
    path
        `.geojson` or `.json` (RFC 7946), `.kml`, `.kmz`, or `.csv` with the columns lat_deg and lon_deg.

    Returns
    -------
    Area
        The polygon.

    Raises
    ------
    InputNotFoundError
        When there is no such file.
    InputMalformedError
        When it does not contain exactly one simple polygon.

    Examples
    --------
    >>> import photocal
    >>> photocal.read_area("field.kml").latitude_deg.tolist()
    [-22.12, -22.12, -22.13]
    """
    path = Path(path)
    if path.suffix.lower() == ".csv":
        table = read_wider_table(path, ("lat_deg", "lon_deg"))
        longitude, latitude = (table.numbers(name).tolist() for name in ("lon_deg", "lat_deg"))
        return area_from_corners(list(zip(longitude, latitude, strict=True)), str(path))
    readers = {".geojson": _from_geojson, ".json": _from_geojson, ".kml": _from_kml, ".kmz": _from_kml}
    reader = readers.get(path.suffix.lower())
    if reader is None:
        raise InputMalformedError(
            f"unknown kind of area {path.suffix!r}", where=path, remedy="give GeoJSON, KML or CSV"
        )
    try:
        with reading(path):
            octets = path.read_bytes()
        text = (_packed_kml(octets, path) if path.suffix.lower() == ".kmz" else octets).decode("utf-8-sig")
    except UnicodeDecodeError as refusal:
        raise InputMalformedError("is not UTF-8 text", where=path) from refusal
    return area_from_corners(reader(text, str(path)), str(path))


def _packed_kml(octets: bytes, path: Path) -> bytes:
    """The text of a KMZ, as Google Earth saves places: the first KML in the zip."""
    # More is no polygon.
    most_bytes = 1 << 26
    try:
        files = unzipped(octets, most_bytes)
    except DAMAGES as refusal:
        raise InputMalformedError(f"is not KMZ ({refusal})", where=path) from refusal
    return next((text for name, text in files.items() if name.lower().endswith(".kml")), b"")


def _from_geojson(text: str, where: str) -> list[tuple[float, float]]:
    wrong = InputMalformedError.at(where)
    try:
        content = json.loads(text)
    except (ValueError, RecursionError) as refusal:
        raise wrong(f"is not JSON ({refusal})") from refusal
    rings = list(_polygons(content, where))
    if len(rings) != 1:
        raise wrong(f"holds {len(rings)} polygons, one is needed", "keep the polygon to be flown")
    if not isinstance(rings[0], list) or len(rings[0]) != 1:
        raise wrong("is a polygon with holes", "keep the outer ring; holes are flown over")
    try:
        return [(float(position[0]), float(position[1])) for position in rings[0][0]]
    except (TypeError, ValueError, IndexError, KeyError, OverflowError) as refusal:
        raise wrong("has a corner that is not a position") from refusal


def _polygons(content: Any, where: str) -> list[Any]:
    if not isinstance(content, dict):
        raise InputMalformedError("is not GeoJSON", where=where)
    kind = content.get("type")
    if kind == "FeatureCollection" and isinstance(content.get("features"), list):
        return [ring for feature in content["features"] for ring in _polygons(feature, where)]
    if kind == "GeometryCollection" and isinstance(content.get("geometries"), list):
        return [ring for geometry in content["geometries"] for ring in _polygons(geometry, where)]
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

    wrong = InputMalformedError.at(where)
    try:
        root = fromstring(text)
    except (ParseError, DefusedXmlException, ValueError) as refusal:
        raise wrong(f"is not KML ({refusal})") from refusal
    # The polygon may be all that there is, without `<kml>` about it.
    polygons = [element for element in root.iter() if element.tag.rpartition("}")[2] == "Polygon"]
    if len(polygons) != 1:
        raise wrong(f"holds {len(polygons)} polygons, one is needed", "keep the polygon to be flown")
    rings = polygons[0].findall(".//{*}coordinates")
    if len(rings) != 1:
        raise wrong("is a polygon with holes or without corners", "keep the outer ring")
    try:
        fields = [position.split(",") for position in (rings[0].text or "").split()]
        return [(float(field[0]), float(field[1])) for field in fields]
    except (ValueError, IndexError) as refusal:
        raise wrong("has a corner that is not lon,lat") from refusal
