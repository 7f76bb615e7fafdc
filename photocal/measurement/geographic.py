"""From the positions that images state to the block's local frame."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from drivers.arrays import Floats
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
