"""Positions that images state, in a local frame and in a coordinate reference system."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from drivers.arrays import Floats
from drivers.errors import ConfigurationError
from photocal.measurement.image_facts import ImageFacts


def local_places(facts: Sequence[ImageFacts]) -> tuple[Floats, tuple[float, float, float]]:
    """Projection centres in a topocentric frame (east, north, up) at their median.

    A picture from elsewhere in the folder does not tilt it.
    """
    from pyproj import Transformer

    known = np.array([f.has_position for f in facts])
    geographic = np.array([[f.latitude_deg, f.longitude_deg, f.altitude_m] for f in facts])
    if not known.any():
        return np.full((len(facts), 3), np.nan), (float("nan"),) * 3
    latitude, longitude, height = np.median(geographic[known], axis=0)
    # Rounded, so that the origin can be written and read without loss.
    origin = (round(float(latitude), 6), round(float(longitude), 6), float(round(float(height))))
    pipeline = (
        "+proj=pipeline +step +proj=cart +ellps=WGS84 +step +proj=topocentric +ellps=WGS84 "
        f"+lat_0={origin[0]!r} +lon_0={origin[1]!r} +h_0={origin[2]!r}"
    )
    transformer = Transformer.from_pipeline(pipeline)
    places = np.full((len(facts), 3), np.nan)
    places[known] = np.column_stack(
        transformer.transform(geographic[known, 1], geographic[known, 0], geographic[known, 2], radians=False)
    )
    return places, origin


def map_places(facts: Sequence[ImageFacts], crs: str) -> Floats:
    """Projection centres in a system, to start from.

    The images' heights are of no known kind, so they are taken as they are: between ellipsoid and geoid lie
    up to 100 m, which start values bear and observations would not.
    """
    from pyproj import CRS, Transformer
    from pyproj.exceptions import ProjError

    places = np.full((len(facts), 3), np.nan)
    known = np.array([f.has_position for f in facts], dtype=np.bool_)
    if not known.any():
        return places
    longitude, latitude, altitude = np.array(
        [(f.longitude_deg, f.latitude_deg, f.altitude_m) for f in facts]
    )[known].T
    try:
        system = CRS.from_user_input(crs)
        level = system.sub_crs_list[0] if system.is_compound else system
        way = Transformer.from_crs("EPSG:4326", level.to_2d(), always_xy=True)
        east, north = way.transform(longitude, latitude, errcheck=True)
    except ProjError as refusal:
        raise ConfigurationError(
            f"positions of the images cannot be taken to {crs} ({refusal})",
            remedy="name a system that covers the place",
        ) from refusal
    places[known] = np.column_stack([east, north, altitude])
    return places
