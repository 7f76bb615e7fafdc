"""Exposures, footprints, points and image residuals as a GeoPackage (OGC 12-128r15).

With the origin of the local frame the coordinates are longitude, latitude (deg, WGS 84) and ellipsoidal
height (m); without it they are the local ones (m) in an undefined Cartesian system. Image residuals stand in
a table without geometry: column and row (px, centre of the upper-left pixel (0, 0)), residuals computed minus
measured.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from photocal.exchange.formats import Choices
from photocal.exchange.geographic import ToGeographic, features, located
from photocal.exchange.reconstruction import Reconstruction
from photocal.geometry.conversion import Conversion
from photocal.geopackage import LOCAL, Feature, Layer, Value, add_layer, add_table, geopackage, wgs84

_SIGMAS = {"sX_m": "DOUBLE", "sY_m": "DOUBLE", "sZ_m": "DOUBLE"}
_ANGLES = {"omega_deg": "DOUBLE", "phi_deg": "DOUBLE", "kappa_deg": "DOUBLE"}
_EXPOSURES = Layer(
    "exposures",
    "POINT",
    has_heights=True,
    columns={"name": "TEXT", "camera": "TEXT", **_ANGLES, **_SIGMAS},
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


def write_geopackage(
    path: Path, given: Reconstruction, to_geographic: ToGeographic | None, changed_utc: str
) -> None:
    """Write a GeoPackage.

    to_geographic: from `geographic.topocentric`; None keeps local coordinates.
    """
    system = LOCAL if to_geographic is None else wgs84()
    layers: dict[str, tuple[Layer, list[Feature]]] = {
        one.name: (one, []) for one in (_EXPOSURES, _FOOTPRINTS, _POINTS)
    }
    for geometry, properties in features(given, to_geographic or np.array):
        layer = _KINDS.get(properties["kind"], _POINTS)
        values = [properties.get(column) for column in layer.columns]
        layers[layer.name][1].append((_corners(geometry), values))
    with geopackage(path, system) as database:
        for layer, found in layers.values():
            add_layer(database, layer, system, found, changed_utc)
        add_table(database, "image_residuals", _RESIDUALS, _residuals(given), changed_utc)


def _corners(geometry: dict[str, Any]) -> np.ndarray[Any, np.dtype[np.float64]]:
    """Corners of a geometry as in GeoJSON, shape (n, 2) or (n, 3)."""
    polygon = geometry["type"] == "Polygon"
    return np.array(geometry["coordinates"][0] if polygon else [geometry["coordinates"]], dtype=float)


def _residuals(given: Reconstruction) -> Iterator[Sequence[Value]]:
    residuals = given.residuals_px if len(given.residuals_px) else np.full(given.pixels.shape, np.nan)
    for i, j, pixel, residual in zip(
        given.image.tolist(), given.point.tolist(), given.pixels.tolist(), residuals.tolist(), strict=True
    ):
        yield given.image_names[i], given.point_names[j], *pixel, *residual


def export(folder: Path, given: Reconstruction, choices: Choices) -> tuple[Conversion, ...]:
    """A layer for each kind of thing."""
    turn: ToGeographic | None = None
    if choices.origin is not None or given.frame != "local":
        given, turn = located(given, choices)
    write_geopackage(folder / "block.gpkg", given, turn, choices.changed_utc)
    return ()
