"""Positions that images state, in a coordinate reference system."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from drivers.arrays import Floats
from drivers.errors import ConfigurationError
from photocal.measurement.image_facts import ImageFacts


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
