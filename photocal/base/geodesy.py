"""Geodetic and earth-centred coordinates, by PROJ."""

from functools import cache
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from photocal.base.arrays import Floats

if TYPE_CHECKING:
    from pyproj import Transformer


WGS84 = "+ellps=WGS84"


class GeodeticPlace(NamedTuple):
    """A place on the earth; `height_m`: above the ellipsoid, or above mean sea level where that is said."""

    latitude_deg: float
    longitude_deg: float
    height_m: float


@cache
def _cartesian(ellipsoid: str) -> "Transformer":
    from pyproj import Transformer

    degrees = "+proj=unitconvert +xy_in=deg +xy_out=rad"
    return Transformer.from_pipeline(f"+proj=pipeline +step {degrees} +step +proj=cart {ellipsoid}")


def geocentric(
    lat_deg: Floats | float, lon_deg: Floats | float, height_m: Floats | float, ellipsoid: str = WGS84
) -> Floats:
    """Return earth-centred coordinates (..., 3), m, of latitude, longitude (deg), ellipsoidal height (m).

    ellipsoid: in the words of PROJ, by its name or its axes.
    """
    return np.stack(_cartesian(ellipsoid).transform(lon_deg, lat_deg, height_m), axis=-1)


def geodetic(xyz_m: Floats, ellipsoid: str = WGS84) -> tuple[Floats, Floats, Floats]:
    """Return latitude, longitude (deg) and ellipsoidal height (m) of earth-centred coordinates (..., 3)."""
    x, y, z = np.moveaxis(np.asarray(xyz_m, np.float64), -1, 0)
    lon, lat, height = _cartesian(ellipsoid).transform(x, y, z, direction="INVERSE")
    return lat, lon, height


def enu_axes(lat_deg: Floats | float, lon_deg: Floats | float) -> Floats:
    """Return the rotations (..., 3, 3) from earth-centred to east, north, up axes."""
    (sb, cb), (sl, cl) = ((np.sin(a), np.cos(a)) for a in (np.radians(lat_deg), np.radians(lon_deg)))
    rows = [[-sl, cl, np.zeros_like(sl)], [-sb * cl, -sb * sl, cb], [cb * cl, cb * sl, sb]]
    return np.moveaxis(np.array(rows), (0, 1), (-2, -1))


def enu_offsets(lat_deg: Floats, lon_deg: Floats, height_m: Floats, origin: Floats) -> Floats:
    """Return topocentric east, north, up of geodetic positions on WGS 84."""
    return np.asarray(
        (geocentric(lat_deg, lon_deg, height_m) - geocentric(*origin)) @ enu_axes(*origin[:2]).T
    )
