"""Place and time of a simulated flight, and its local frame on the ellipsoid GRS 80."""

import datetime as dt
from functools import cached_property
from typing import TYPE_CHECKING, Annotated, Self

import numpy as np
from pydantic import Field, FiniteFloat, model_validator

from photocal.base.arrays import Floats
from photocal.base.checked_toml import Table
from photocal.base.errors import ConfigurationError
from photocal.base.geodesy import enu_axes, geocentric, geodetic

if TYPE_CHECKING:
    from pyproj import Transformer

# GPS time minus UTC, and how long that is known to hold (IERS Bulletin C).
LEAP_S = 18
LEAP_SECONDS_SINCE, LEAP_SECONDS_KNOWN_TO = dt.date(2017, 1, 1), dt.date(2027, 6, 28)
_ELLIPSOID = "+ellps=GRS80"


class Place(Table):
    """Where and when: the origin of the local frame on the ellipsoid, the system of control and results.

    The frame is topocentric: X east, Y north, Z up, metres.

    crs: the projected system of control and results; ellipsoidal heights.
    """

    latitude_deg: Annotated[float, Field(gt=-85, lt=85)]
    longitude_deg: Annotated[float, Field(ge=-180, le=180)]
    height_m: FiniteFloat
    crs: Annotated[str, Field(pattern=r"^EPSG:\d+$")]
    start_utc: dt.datetime
    geoid_m: FiniteFloat = 0.0

    @model_validator(mode="after")
    def _has_zone(self) -> Self:
        if self.start_utc.utcoffset() is None:
            raise ValueError("start_utc needs its zone, such as 2025-06-15T14:00:00Z")
        if not LEAP_SECONDS_SINCE <= self.start_utc.date() < LEAP_SECONDS_KNOWN_TO:
            raise ValueError(
                f"start_utc must lie between {LEAP_SECONDS_SINCE} and {LEAP_SECONDS_KNOWN_TO}, "
                f"when GPS time was {LEAP_S} s ahead of UTC"
            )
        return self

    @cached_property
    def axes(self) -> Floats:
        """Rows: east, north and up in geocentric axes, shape (3, 3)."""
        return enu_axes(self.latitude_deg, self.longitude_deg)

    @cached_property
    def origin_m(self) -> Floats:
        """Geocentric coordinates of the origin, shape (3,)."""
        return geocentric(self.latitude_deg, self.longitude_deg, self.height_m, _ELLIPSOID)

    def to_geocentric(self, local_m: Floats) -> Floats:
        """Give geocentric coordinates of local ones, shape (n, 3)."""
        return np.asarray(self.origin_m + local_m @ self.axes)

    def to_geodetic(self, local_m: Floats) -> Floats:
        """Give latitude and longitude (rad) and height above the ellipsoid (m), shape (n, 3)."""
        latitude, longitude, height = geodetic(self.to_geocentric(local_m), _ELLIPSOID)
        return np.column_stack([np.radians(latitude), np.radians(longitude), height])

    def to_projected(self, local_m: Floats) -> Floats:
        """Give east, north and ellipsoidal height in the projected system, shape (n, 3)."""
        place = self.to_geodetic(local_m)
        east, north = self._projection.transform(*np.degrees(place[:, 1::-1]).T)
        return np.column_stack([east, north, place[:, 2]])

    @cached_property
    def _projection(self) -> "Transformer":
        from pyproj import CRS, Transformer
        from pyproj.exceptions import CRSError

        remedy = "name a projected system in metres, such as EPSG:31982"
        try:
            system = CRS.from_user_input(self.crs)
        except CRSError as refusal:
            raise ConfigurationError(f"{self.crs} is not known", where="[place]", remedy=remedy) from refusal
        if not system.is_projected or {axis.unit_name for axis in system.axis_info[:2]} != {"metre"}:
            raise ConfigurationError(f"{self.crs} is not a map in metres", where="[place]", remedy=remedy)
        # Geographic coordinates of the system itself: no change of datum is involved.
        return Transformer.from_crs(system.geodetic_crs, system, always_xy=True)
