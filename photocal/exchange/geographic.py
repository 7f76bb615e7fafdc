"""Exposures, footprints and points as GeoJSON (RFC 7946) and KML.

Longitude and latitude in deg, height in m, WGS 84. A local frame is topocentric (east, north, up) about an
origin that the caller gives; heights are ellipsoidal. Both formats are written for looking at, not for
reading back into an adjustment.
"""

import json
import math
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any
from xml.etree.ElementTree import Element, SubElement

import numpy as np

from photocal.base.arrays import Floats
from photocal.base.errors import ConfigurationError
from photocal.base.geodesy import GeodeticPlace, enu_axes, geocentric, geodetic
from photocal.base.geopackage import LOCAL, Feature, Layer, add_layer, add_table, geopackage, wgs84
from photocal.block.model import ROLES, Block
from photocal.exchange.exporting import Choices, to_cartesian, to_wgs84
from photocal.exchange.source import write_xml
from photocal.geometry.conversion import Conversion
from photocal.geometry.oriented_images import OrientedImages

# Turns local coordinates, shape (n, 3), into longitude, latitude, height.
ToGeographic = Callable[[Floats], Floats]


def topocentric(origin: GeodeticPlace) -> ToGeographic:
    """Make the way from a topocentric frame (east, north, up) to WGS 84.

    raises ConfigurationError: for an origin that is not on the Earth.
    """
    if not (
        abs(origin.latitude_deg) <= 90 and abs(origin.longitude_deg) <= 360 and abs(origin.height_m) < 1e5
    ):
        raise ConfigurationError(
            f"origin {origin.latitude_deg}, {origin.longitude_deg}, {origin.height_m} is not on the Earth",
            "give latitude and longitude in degrees, ellipsoidal height in m",
        )
    middle = geocentric(*origin)
    axes = enu_axes(origin.latitude_deg, origin.longitude_deg)

    def turn(xyz: Floats) -> Floats:
        """Return longitude, latitude (deg) and height (m) of local coordinates (n, 3)."""
        latitude, longitude, height = geodetic(xyz @ axes + middle)
        return np.column_stack([longitude, latitude, height])

    return turn


def write_geojson(path: Path, given: Block, choices: Choices) -> tuple[Conversion, ...]:
    """Write exposures, footprints and points."""
    listed = [
        {"type": "Feature", "geometry": geometry, "properties": properties}
        for geometry, properties in located_features(given, choices)
    ]
    content = {"type": "FeatureCollection", "features": listed}
    path.write_text(json.dumps(content, allow_nan=False), encoding="utf-8", newline="\n")
    return ()


def write_kml(path: Path, given: Block, choices: Choices) -> tuple[Conversion, ...]:
    """Write exposures, footprints and points."""
    root = Element("kml", xmlns="http://www.opengis.net/kml/2.2")
    document = SubElement(root, "Document")
    folders: dict[str, Element] = {}
    for geometry, properties in located_features(given, choices):
        kind = properties["kind"]
        if kind not in folders:
            folders[kind] = SubElement(document, "Folder")
            SubElement(folders[kind], "name").text = kind
        place = SubElement(folders[kind], "Placemark")
        SubElement(place, "name").text = properties["name"]
        data = SubElement(place, "ExtendedData")
        for key, value in properties.items():
            SubElement(SubElement(data, "Data", name=key), "value").text = str(value)
        _kml_geometry(place, geometry)
    write_xml(path, root)
    return ()


def footprints(given: Block, height_m: float) -> Floats:
    """Corners of each image on a horizontal plane, (n, 4, 3); NaN for one that looks beyond it."""
    images = given.images
    shots = OrientedImages(images.names, given.cameras, images.camera, images.values)
    return shots.on_level(np.array([[0.0, 0.0], [1.0, 0.0], [1.0, 1.0], [0.0, 1.0]]), height_m)


def features(
    given: Block, residuals_px: Floats, to_geographic: ToGeographic
) -> Iterator[tuple[dict[str, Any], dict[str, Any]]]:
    """Give exposures, footprints on the median height of the points, and points.

    residuals_px (rays, 2): NaN where they are not known.
    """
    exposures = to_geographic(given.images.values[:, 3:])
    for k, name in enumerate(given.images.names):
        angles = dict(
            zip(
                ("omega_deg", "phi_deg", "kappa_deg"),
                np.degrees(given.images.values[k, :3]).tolist(),
                strict=True,
            )
        )
        camera = given.cameras[given.images.camera[k]].id
        known = {"camera": camera, **angles, **_sigma(given.images.sigma[k, 3:])}
        yield _point(exposures[k]), {"kind": "exposure", "name": name, **known}
    seen = np.bincount(given.observations.point, minlength=len(given.points.names))
    ground = float(np.median(given.points.values[:, 2])) if len(given.points.values) else math.nan
    for name, ring in zip(given.images.names, footprints(given, ground), strict=True):
        if np.isfinite(ring).all():
            closed = to_geographic(np.vstack([ring, ring[:1]]))
            # RFC 7946: exterior rings run counterclockwise.
            x, y = closed[:, 0] - closed[0, 0], closed[:, 1] - closed[0, 1]
            if np.sum(x[:-1] * y[1:] - x[1:] * y[:-1]) < 0:
                closed = closed[::-1]
            yield (
                {"type": "Polygon", "coordinates": [closed[:, :2].tolist()]},
                {"kind": "footprint", "name": name, "plane_z_m": ground},
            )
    points = to_geographic(given.points.values)
    for k, name in enumerate(given.points.names):
        known = {"rays": int(seen[k]), **_sigma(given.points.sigma[k])}
        residuals = residuals_px[given.observations.point == k]
        if len(residuals) and np.isfinite(residuals).all():
            known["residual_rms_px"] = float(np.sqrt(np.mean(residuals**2)))
        yield _point(points[k]), {"kind": ROLES[given.points.role[k]], "name": name, **known}


def _point(position: Floats) -> dict[str, Any]:
    return {"type": "Point", "coordinates": position.tolist()}


def _sigma(values: Floats) -> dict[str, float]:
    named = zip(("sX_m", "sY_m", "sZ_m"), values.tolist(), strict=True)
    return {name: value for name, value in named if math.isfinite(value)}


def _kml_geometry(place: Element, geometry: dict[str, Any]) -> None:
    if geometry["type"] == "Point":
        point = SubElement(place, "Point")
        SubElement(point, "altitudeMode").text = "absolute"
        SubElement(point, "coordinates").text = ",".join(repr(value) for value in geometry["coordinates"])
        return
    ring = SubElement(SubElement(SubElement(place, "Polygon"), "outerBoundaryIs"), "LinearRing")
    corners = geometry["coordinates"][0]
    SubElement(ring, "coordinates").text = " ".join(f"{x!r},{y!r}" for x, y in corners)


def located(given: Block, choices: Choices) -> tuple[Block, ToGeographic]:
    """A Cartesian block, and the way from its coordinates to longitude, latitude and height."""
    if given.frame != "local":
        if choices.origin is not None:
            raise ConfigurationError(
                f"the block lies in {given.frame}, which states where it is", "leave out --origin"
            )

        return to_cartesian(given), to_wgs84(given)
    if choices.origin is None:
        raise ConfigurationError(
            "the origin of the local frame is not given",
            "name its origin: --origin LATITUDE,LONGITUDE,HEIGHT (deg, m above the ellipsoid)",
        )
    return given, topocentric(choices.origin)


def located_features(given: Block, choices: Choices) -> Iterator[tuple[dict[str, Any], dict[str, Any]]]:
    """Features of a block at their longitudes, latitudes and heights."""
    there, to_geographic = located(given, choices)
    return features(there, choices.residuals_of(given), to_geographic)


_SIGMAS = {"sX_m": "DOUBLE", "sY_m": "DOUBLE", "sZ_m": "DOUBLE"}
_ANGLES = {"omega_deg": "DOUBLE", "phi_deg": "DOUBLE", "kappa_deg": "DOUBLE"}
_EXPOSURES = Layer(
    "exposures", "POINT", has_heights=True, columns={"name": "TEXT", "camera": "TEXT", **_ANGLES, **_SIGMAS}
)
_FOOTPRINTS = Layer(
    "footprints", "POLYGON", has_heights=False, columns={"name": "TEXT", "plane_z_m": "DOUBLE"}
)
_POINTS = Layer(
    "points",
    "POINT",
    has_heights=True,
    columns={"name": "TEXT", "kind": "TEXT", "rays": "INTEGER", **_SIGMAS, "residual_rms_px": "DOUBLE"},
)
_KINDS = {"exposure": _EXPOSURES, "footprint": _FOOTPRINTS}
_RESIDUALS = {
    "image": "TEXT",
    "point": "TEXT",
    "column_px": "DOUBLE",
    "row_px": "DOUBLE",
    "vx_px": "DOUBLE",
    "vy_px": "DOUBLE",
}


def write_geopackage(path: Path, given: Block, choices: Choices) -> tuple[Conversion, ...]:
    """Write a layer for each kind of thing; a local frame without an origin keeps its coordinates."""
    to_geographic: ToGeographic | None = None
    if choices.origin is not None or given.frame != "local":
        given, to_geographic = located(given, choices)
    residuals_px, seen = choices.residuals_of(given), given.observations
    system = LOCAL if to_geographic is None else wgs84()
    layers: dict[str, tuple[Layer, list[Feature]]] = {
        layer.name: (layer, []) for layer in (_EXPOSURES, _FOOTPRINTS, _POINTS)
    }
    for geometry, properties in features(given, residuals_px, to_geographic or np.array):
        layer = _KINDS.get(properties["kind"], _POINTS)
        values = [properties.get(column) for column in layer.columns]
        corners = geometry["coordinates"]
        corners = np.array(corners[0] if geometry["type"] == "Polygon" else [corners], dtype=float)
        layers[layer.name][1].append((corners, values))
    columns = (values.tolist() for values in (seen.image, seen.point, seen.values, residuals_px))
    rows = (
        (given.images.names[i], given.points.names[j], *xy, *v) for i, j, xy, v in zip(*columns, strict=True)
    )
    with geopackage(path, system) as database:
        for layer, layer_features in layers.values():
            add_layer(database, layer, system, layer_features, choices.changed_utc)
        add_table(database, "image_residuals", _RESIDUALS, rows, choices.changed_utc)
    return ()
