"""The geoid's height above the ellipsoid, as GNSS receivers tell it beside their positions."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from drivers.frames import Batch
from drivers.nmea import kind_of
from drivers.ubx import decode as ubx

_GGA = kind_of(b"GPGGA")
_SEPARATION, _QUALITY = 11, 6


def told_by_receiver(batch: Batch, payloads: list[bytes]) -> list[float]:
    """Return height above the ellipsoid less height above sea level (m) of every position in a batch.

    Receivers take it from a coarse model: u-blox interpolates EGM 96 in a grid of 10 degrees, some metres off
    in places.
    """
    found: list[float] = []
    for kind in (ubx.NAV_PVT, ubx.NAV_POSLLH):
        fields = ubx.decode(batch, kind).fields
        if kind == ubx.NAV_PVT:
            fields = fields[(fields["flags"] & 1) != 0]
        found.extend(_difference(fields))
    found.extend(
        separation
        for row in np.flatnonzero(batch.kind == _GGA).tolist()
        if (separation := _of_sentence(payloads[row])) is not None
    )
    return found


def _difference(fields: NDArray[np.void]) -> list[float]:
    difference = (fields["height"].astype(float) - fields["hMSL"]) * 1e-3
    return [float(v) for v in difference.tolist()]


def _of_sentence(sentence: bytes) -> float | None:
    parts = sentence.split(b",")
    if len(parts) <= _SEPARATION or parts[_QUALITY] in (b"", b"0"):
        return None
    try:
        return float(parts[_SEPARATION])
    except ValueError:
        return None
