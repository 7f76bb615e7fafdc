"""How long a metre on the ground is in a map system: point scale factor, elevation factor and both."""

from dataclasses import dataclass

import numpy as np

from photocal.base.arrays import Floats
from photocal.base.errors import ConfigurationError
from photocal.geometry.frames import ReferenceFrame, parsed


@dataclass(frozen=True)
class GroundScale:
    """Factors from a horizontal distance on the ground to that of the map, at each place.

    point_factor (n,): from the ellipsoid to the map; the geometric mean of all directions where the
        projection is not conformal.
    elevation_factor (n,): from the ground to the ellipsoid.
    """

    point_factor: Floats
    elevation_factor: Floats

    @property
    def combined(self) -> Floats:
        """Both, shape (n,)."""
        return self.point_factor * self.elevation_factor


def ground_scale(crs: str, places: Floats) -> GroundScale:
    """Give the factors at places, of PROJ's point scale and Gauss's mean radius of the ellipsoid.

    crs: a map system; with a vertical one, too, heights go through its geoid.
    places (n, 3): coordinates as given in it, m; heights of a system that says nothing of a geoid count from
        the ellipsoid (six metres of geoid are one millionth).
    raises ConfigurationError: for a system that is no map.
    """
    from pyproj import Proj

    system = parsed(crs)
    horizontal = system.sub_crs_list[0] if system.is_compound else system
    if not horizontal.is_projected:
        raise ConfigurationError(
            f"{crs} is no map system: it has no scale",
            "name the map system that the distances belong to",
            where="frame",
        )
    longitude, latitude, height = ReferenceFrame(crs, np.zeros(3)).geodetic(places).T
    factors = Proj(horizontal.to_2d()).get_factors(longitude, latitude, errcheck=True)
    ellipsoid = system.ellipsoid
    axes = ellipsoid.semi_major_metre, ellipsoid.semi_minor_metre
    squared = 1.0 - (axes[1] / axes[0]) ** 2
    radius = axes[1] / (1.0 - squared * np.sin(np.radians(latitude)) ** 2)
    return GroundScale(np.sqrt(np.atleast_1d(factors.areal_scale)), radius / (radius + height))


def combined_factor(crs: str, places: Floats) -> Floats:
    """Length in a map system of a metre on the ground, shape (n,): point scale times elevation factor.

    A horizontal distance that was measured on the ground, times this factor, is its distance in the map:
    control "on the ground" stands beside a frame "on the grid" by this scale (`combined_factor(...) - 1`).

    crs: the map system, as "EPSG:31982"; see `ground_scale` for the heights.
    places (n, 3): coordinates as given in it, m.
    raises ConfigurationError: for a system that is no map.
    """
    return ground_scale(crs, places).combined
