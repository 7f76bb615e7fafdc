"""Check points and their residual vectors as a GeoPackage for QGIS."""

from __future__ import annotations

import math
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from acquire.outputs import output_file
from drivers.arrays import Floats
from drivers.errors import ConfigurationError
from photocal.accuracy.discrepancies import Discrepancies
from photocal.geopackage import LOCAL, Layer, ReferenceSystem, add_layer, geopackage

# First number that no authority uses, for a coordinate system without one.
_OWN_SYSTEM = 100_000

# Longest drawn vector as a share of the extent of the points.
_LONGEST = 0.12

_NAMES = {"point": "TEXT", "role": "TEXT"}
_PLANE = {"dE_m": "DOUBLE", "dN_m": "DOUBLE"}
_POINTS = Layer(
    "ground_points",
    "POINT",
    has_heights=False,
    columns={**_NAMES, "h_m": "DOUBLE", **_PLANE, "dh_m": "DOUBLE", "plane_m": "DOUBLE"},
)
_VECTORS = Layer(
    "residual_vectors",
    "LINESTRING",
    has_heights=False,
    columns={**_NAMES, **_PLANE, "plane_m": "DOUBLE", "enlarged": "DOUBLE"},
)


def reference_system(crs: str | None) -> ReferenceSystem:
    """Look up a projected coordinate system.

    crs: such as `EPSG:31982`; None for a local system that nothing else is known of.
    raises ConfigurationError: when it is unknown, or not a projected system in metres.
    """
    if crs is None:
        return LOCAL
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

    raises ConfigurationError: when no point has a position.
    raises OutputError: when the file cannot be written.
    """
    rows = [row for role, discrepancies in groups for row in _rows(role, discrepancies)]
    if not rows:
        raise ConfigurationError(
            "a map needs the positions of the points",
            where=path,
            remedy="add the columns E and N to the table",
        )
    enlarged = _enlargement(rows)
    with output_file(path) as aside, geopackage(aside, system) as database:
        points = ((row.place, row.point_columns()) for row in rows)
        add_layer(database, _POINTS, system, points, changed_utc)
        vectors = ((row.vector(enlarged), row.vector_columns(enlarged)) for row in rows if row.has_vector)
        add_layer(database, _VECTORS, system, vectors, changed_utc)
    return len(rows)


@dataclass(frozen=True)
class _Row:
    """A point with its place (east, north, height) and its discrepancies, m."""

    role: str
    name: str
    e_n_h: Floats
    d: Floats

    @property
    def place(self) -> Floats:
        """Where it lies, shape (1, 2)."""
        return self.e_n_h[None, :2]

    @property
    def plane_m(self) -> float:
        """Length of the discrepancy in the plane."""
        return math.hypot(self.d[0], self.d[1])

    @property
    def has_vector(self) -> bool:
        """Whether its discrepancy in the plane is known."""
        return math.isfinite(self.plane_m)

    def vector(self, enlarged: float) -> Floats:
        """Give the drawn vector, shape (2, 2)."""
        return np.vstack([self.e_n_h[:2], self.e_n_h[:2] + enlarged * self.d[:2]])

    def point_columns(self) -> tuple[str | float, ...]:
        """Give what stands beside the point."""
        east, north, up = self.d.tolist()
        return self.name, self.role, float(self.e_n_h[2]), east, north, up, self.plane_m

    def vector_columns(self, enlarged: float) -> tuple[str | float, ...]:
        """Give what stands beside the vector."""
        return self.name, self.role, *self.d[:2].tolist(), self.plane_m, enlarged


def _rows(role: str, discrepancies: Discrepancies) -> list[_Row]:
    if discrepancies.positions_m is None:
        return []
    return [
        _Row(role, name, place, d)
        for name, place, d in zip(
            discrepancies.points, discrepancies.positions_m, discrepancies.d_m, strict=True
        )
        if np.isfinite(place[:2]).all()
    ]


def _enlargement(rows: list[_Row]) -> float:
    """Factor that makes the longest vector a fair share of the map."""
    longest = max((row.plane_m for row in rows if row.has_vector), default=0.0)
    extent = float(np.max(np.ptp(np.array([row.e_n_h[:2] for row in rows]), axis=0)))
    return _LONGEST * max(extent, 1.0) / longest if longest > 0.0 else 1.0
