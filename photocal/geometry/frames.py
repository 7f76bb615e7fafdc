"""Object frames: what the surveyor's coordinates are, and the Cartesian frame that is adjusted in.

Map projections bend straight rays; a block in a coordinate reference system is taken through geocentric
to topocentric coordinates at its middle, adjusted there, and taken back.

How long a metre on the ground is in a map system: point scale factor, elevation factor and both.
"""

from dataclasses import dataclass
from functools import cache, cached_property
from typing import Any, Protocol

import numpy as np

from photocal.base.arrays import Floats
from photocal.base.errors import ConfigurationError, InputMalformedError
from photocal.base.geodesy import enu_axes, geocentric, geodetic


class LocalFrame(Protocol):
    """Coordinates as given, and the local right-handed Cartesian frame in metres."""

    def to_local(self, given: Floats) -> Floats:
        """Given coordinates, shape (n, 3), in the local frame; NaN stays NaN."""

    def to_given(self, local: Floats) -> Floats:
        """Local coordinates, shape (n, 3), as they are given."""

    def derivative(self, given: Floats) -> Floats:
        """Derivative of the local with respect to the given coordinates, shape (n, 3, 3)."""


@dataclass(frozen=True)
class ShiftedFrame:
    """A frame that is Cartesian already; large coordinates are shifted to keep their digits.

    origin (3,): given coordinates of the local origin, m.
    """

    origin: Floats

    def to_local(self, given: Floats) -> Floats:
        """See `LocalFrame`."""
        return np.asarray(given - self.origin)

    def to_given(self, local: Floats) -> Floats:
        """See `LocalFrame`."""
        return np.asarray(local + self.origin)

    def derivative(self, given: Floats) -> Floats:
        """See `LocalFrame`."""
        return np.broadcast_to(np.eye(3), (len(given), 3, 3))


@dataclass(frozen=True)
class ReferenceFrame:
    """A coordinate reference system, adjusted in topocentric coordinates (east, north, up).

    crs: name, for example `EPSG:31982`, or a compound `EPSG:25832+7837` for orthometric heights.
    origin (3,): given coordinates of the local origin.
    """

    crs: str
    origin: Floats

    @cached_property
    def _ellipsoid(self) -> str:
        ellipsoid = parsed(self.crs).ellipsoid
        return f"+a={ellipsoid.semi_major_metre!r} +b={ellipsoid.semi_minor_metre!r}"

    @cached_property
    def axes(self) -> tuple[Floats, Floats]:
        """Geocentric origin and rotation from geocentric to east, north, up."""
        longitude, latitude, _ = self.geodetic(self.origin[None])[0]
        return self._geocentric(self.origin[None])[0], enu_axes(latitude, longitude)

    def geodetic(self, given: Floats) -> Floats:
        """Longitude, latitude (deg) and ellipsoidal height (m) of given coordinates, shape (n, 3)."""
        from pyproj.exceptions import ProjError

        try:
            result = np.column_stack(_to_geodetic(self.crs).transform(*given.T, errcheck=True))
        except ProjError as failure:
            # A grid that is installed later is looked for again.
            _to_geodetic.cache_clear()
            raise InputMalformedError(
                f"coordinates cannot be transformed from {self.crs} ({failure})",
                where="block",
                remedy="check the zone and the order of the coordinates; "
                f"photocal fetch-grids {self.crs} installs a missing grid",
            ) from failure
        return result

    def _geocentric(self, given: Floats) -> Floats:
        longitude, latitude, height = self.geodetic(given).T
        return geocentric(latitude, longitude, height, self._ellipsoid)

    def to_local(self, given: Floats) -> Floats:
        """See `LocalFrame`."""
        origin, rotation = self.axes
        local = np.full(given.shape, np.nan)
        known = np.isfinite(given).all(axis=1)
        if known.any():
            local[known] = (self._geocentric(given[known]) - origin) @ rotation.T
        return local

    def to_given(self, local: Floats) -> Floats:
        """See `LocalFrame`."""
        origin, rotation = self.axes
        latitude, longitude, height = geodetic(local @ rotation + origin, self._ellipsoid)
        return np.column_stack(
            _to_geodetic(self.crs).transform(longitude, latitude, height, direction="INVERSE")
        )

    def derivative(self, given: Floats) -> Floats:
        """See `LocalFrame`."""
        geographic = parsed(self.crs).is_geographic
        steps = np.array([1e-5, 1e-5, 1.0]) if geographic else np.ones(3)
        moves = np.diag(steps)[:, None]
        ahead, behind = self.to_local(np.vstack([*(given + moves), *(given - moves)])).reshape(2, 3, -1, 3)
        return np.asarray(np.moveaxis((ahead - behind) / (2 * steps[:, None, None]), 0, 2))


@cache
def _to_geodetic(crs: str) -> Any:
    """The way from a system to longitude, latitude and ellipsoidal height; to find it takes milliseconds."""
    from pyproj import Transformer

    system = parsed(crs)
    geodetic = system.geodetic_crs.to_3d()
    source = system if len(system.axis_info) == 3 else system.to_3d()
    return Transformer.from_crs(source, geodetic, always_xy=True, allow_ballpark=False, only_best=True)


@cache
def system_of(text: str) -> Any:
    """Give the system that a code, a PROJ string or WKT names, parsed once.

    raises CRSError: where it names none.
    """
    from pyproj import CRS

    return CRS.from_user_input(text)


def parsed(name: str) -> Any:
    """Read the name of a coordinate reference system.

    raises ConfigurationError: for an unknown name, or units other than metres.
    """
    from pyproj.exceptions import CRSError

    wrong = ConfigurationError.at("block.toml")
    try:
        system = system_of(name)
    except CRSError as failure:
        raise wrong(
            f"frame {name!r} is not a coordinate system", 'use "local" or a name such as "EPSG:31982"'
        ) from failure
    units = {axis.unit_name for axis in system.axis_info}
    if not units <= {"metre", "degree"}:
        raise wrong(
            f"frame {name} is in {', '.join(sorted(units))}",
            "transform the coordinates to a system in metres",
        )
    return system


# Heights from files of another program that do not state the height reference: used unchanged.
UNSTATED = "unstated"


def reference_frame(name: str, height: str, origin: Floats) -> ReferenceFrame:
    """Make the frame of a block in a coordinate reference system.

    Orthometric heights in a system that does not name a geoid are used as if they referred to its ellipsoid:
    valid where nothing else has heights, see `require_geoid`.

    origin (3,): middle of the block.
    raises ConfigurationError: when the kind of the heights is not said or does not fit the system.
    """
    system = parsed(name)
    wrong = ConfigurationError.at("block.toml")
    if height == "ellipsoidal" and system.is_compound:
        raise wrong(
            f"heights are ellipsoidal, but frame {name} has a vertical system",
            "name the horizontal system alone",
        )
    if height not in ("orthometric", "ellipsoidal", UNSTATED):
        raise wrong(
            f"the height kind of frame {name} is not stated",
            'add height = "ellipsoidal" or height = "orthometric"',
        )
    return ReferenceFrame(name, origin)


def require_geoid(name: str, height: str, remedy: str = "") -> None:
    """Complain of orthometric heights without a geoid beside positions that GNSS has measured.

    raises ConfigurationError: for a system that has no heights of its own.
    """
    if height == "orthometric" and name != "local" and not parsed(name).is_compound:
        raise ConfigurationError(
            f"heights are orthometric, but frame {name} does not name a geoid",
            remedy or f'name a compound system, for example "{name}+3855" with the geoid EGM2008',
            where="block.toml",
        )


def nearest_rotation(matrix: Floats) -> Floats:
    """Nearest rotation to each matrix, shape (n, 3, 3): the orthogonal factor of its normalised columns."""
    unit = matrix / np.linalg.norm(matrix, axis=1, keepdims=True)
    left, _, right = np.linalg.svd(unit)
    return np.asarray(left @ right)


def level_of(system: Any) -> Any:
    """Give a system without its heights."""
    return system.sub_crs_list[0] if system.is_compound else system


def code_of(system: Any) -> str:
    """Give the code of a system in its register; empty where it has none."""
    authority = system.to_authority()
    return ":".join(authority) if authority else ""


def utm_zones(latitude: float, longitude: float, datum: str = "WGS 84") -> list[str]:
    """Give the codes of the UTM zones of a datum at a place, deg."""
    from pyproj.aoi import AreaOfInterest
    from pyproj.database import query_utm_crs_info

    here = AreaOfInterest(longitude, latitude, longitude, latitude)
    return [f"{zone.auth_name}:{zone.code}" for zone in query_utm_crs_info(datum, here)]


def has_scale(crs: str | None) -> bool:
    """Whether a system is a map, which has a scale."""
    if crs is None or crs == "local":
        return False
    system = parsed(crs)
    return bool(level_of(system).is_projected)


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
    places (n, 3): coordinates as given in it, m; heights of a system that does not name a geoid are taken as
        ellipsoidal (six metres of geoid are one millionth).
    raises ConfigurationError: for a system that is no map.
    """
    from pyproj import Proj

    system = parsed(crs)
    horizontal = level_of(system)
    if not has_scale(crs):
        raise ConfigurationError(
            f"{crs} is not a map system: it has no scale",
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
    control "on the ground" differs from a frame "on the grid" by this scale (`combined_factor(...) - 1`).

    crs: the map system, as "EPSG:31982"; see `ground_scale` for the heights.
    places (n, 3): coordinates as given in it, m.
    raises ConfigurationError: for a system that is no map.
    """
    return ground_scale(crs, places).combined
