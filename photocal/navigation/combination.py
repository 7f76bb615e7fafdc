"""The engine's combination of both directions, held against the directions themselves."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from drivers.arrays import Flags
from photocal.navigation.engine_output import EngineSolution
from photocal.navigation.trajectory import enu_axes, enu_offsets, geocentric, geodetic

# Positions are printed to 0.1 mm, and a mean weighted by full matrices may leave the line between both.
_ROUNDING_M = 0.005


def between_directions(
    combined: EngineSolution, forward: EngineSolution, backward: EngineSolution
) -> tuple[EngineSolution, Flags]:
    """Replace combined positions that lie apart from both directions.

    The engine now and then inverts a covariance that has lost its digits; its combination is then up to some
    decimetres off although both directions agree.
    """
    origin = np.array([combined.lat_deg[0], combined.lon_deg[0], combined.height_m[0]])
    here, fore, back = (
        enu_offsets(s.lat_deg, s.lon_deg, s.height_m, origin) for s in (combined, forward, backward)
    )
    f, b = forward.at(combined.time), backward.at(combined.time)
    # A direction with the worse status took no part.
    both = (f >= 0) & (b >= 0) & (forward.quality[f] == backward.quality[b])
    apart = np.linalg.norm(fore[f] - back[b], axis=1) + _ROUNDING_M
    off = both & (np.linalg.norm(here - fore[f], axis=1) > apart)
    off &= np.linalg.norm(here - back[b], axis=1) > apart
    if not off.any():
        return combined, off
    f, b = f[off], b[off]
    variance = [
        np.trace(s.covariance_m2[rows], axis1=1, axis2=2) for s, rows in ((forward, f), (backward, b))
    ]
    share = (variance[1] / (variance[0] + variance[1]))[:, None]
    mean = share * fore[f] + (1 - share) * back[b]
    larger = (variance[0] >= variance[1])[:, None, None]
    covariance = combined.covariance_m2.copy()
    covariance[off] = np.where(larger, forward.covariance_m2[f], backward.covariance_m2[b])
    centre = geocentric(origin[None, 0], origin[None, 1], origin[None, 2])
    place = [values.copy() for values in (combined.lat_deg, combined.lon_deg, combined.height_m)]
    for values, moved in zip(place, geodetic(mean @ enu_axes(*origin[:2]) + centre), strict=True):
        values[off] = moved
    lat, lon, height = place
    return (
        replace(combined, lat_deg=lat, lon_deg=lon, height_m=height, covariance_m2=covariance),
        off,
    )
