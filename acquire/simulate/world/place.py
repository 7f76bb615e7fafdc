"""The local frame of a simulated flight: topocentric at its origin on the ellipsoid GRS 80."""

from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING, Self

import numpy as np

from acquire.simulate.world import configuration
from photocal.base.arrays import Floats
from photocal.base.errors import ConfigurationError
from photocal.base.geodesy import enu_axes, geocentric, geodetic

if TYPE_CHECKING:
    from pyproj import Transformer


_ELLIPSOID = "+ellps=GRS80"


@dataclass(frozen=True)
class Place:
    """A topocentric frame: X east, Y north, Z up, metres.

    latitude, longitude: of its origin, radians.
    height_m: of its origin above the ellipsoid.
    crs: the projected system of control and results; ellipsoidal heights.
    """

    latitude: float
    longitude: float
    height_m: float
    crs: str

    @classmethod
    def of(cls, given: configuration.PlaceKeys) -> Self:
        """Make the frame of a configuration."""
        latitude, longitude = np.radians([given.latitude_deg, given.longitude_deg]).tolist()
        return cls(latitude, longitude, given.height_m, given.crs)

    @cached_property
    def axes(self) -> Floats:
        """Rows: east, north and up in geocentric axes, shape (3, 3)."""
        return enu_axes(*np.degrees([self.latitude, self.longitude]))

    @cached_property
    def origin_m(self) -> Floats:
        """Geocentric coordinates of the origin, shape (3,)."""
        latitude_deg, longitude_deg = np.degrees([self.latitude, self.longitude]).tolist()
        return geocentric(latitude_deg, longitude_deg, self.height_m, _ELLIPSOID)

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
            raise ConfigurationError(f"{self.crs} is no map in metres", where="[place]", remedy=remedy)
        # Geographic coordinates of the system itself: no change of datum is involved.
        return Transformer.from_crs(system.geodetic_crs, system, always_xy=True)
