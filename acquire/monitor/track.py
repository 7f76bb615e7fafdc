"""Where something was, thinned so that a day's flight fits in a small window."""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np

from drivers.arrays import Floats, Integers

LONGEST = 4000
# Points that lie closer to the last one show nothing new.
STEP_M = 0.5
_METRES_PER_DEG = 111_195.0  # mean sphere: only a threshold hangs on it


def _nowhere() -> Floats:
    return np.empty((0, 2))


def _never() -> Integers:
    return np.empty(0, np.int64)


@dataclass(frozen=True)
class Track:
    """Points in order.

    points (n, 2): latitude and longitude, degrees.
    times_ns (n,): when it was there, UTC.
    thinned: how many times every second point was left out; as long as it stays, points are only added.
    """

    points: Floats = field(default_factory=_nowhere)
    times_ns: Integers = field(default_factory=_never)
    thinned: int = 0


def extended(track: Track, points: Floats, times_ns: Integers) -> Track:
    """Add points."""
    if not len(points):
        return track
    least_m2 = (STEP_M * 2**track.thinned) ** 2
    per_degree = np.array([_METRES_PER_DEG, _METRES_PER_DEG * np.cos(np.radians(points[0, 0]))])
    metres = (points * per_degree).tolist()
    last = (track.points[-1] * per_degree).tolist() if len(track.points) else [np.inf, np.inf]
    new = []
    for row, here in enumerate(metres):
        if not (here[0] - last[0]) ** 2 + (here[1] - last[1]) ** 2 < least_m2:
            new.append(row)
            last = here
    longer = replace(
        track,
        points=np.concatenate([track.points, points[new]]),
        times_ns=np.concatenate([track.times_ns, times_ns[new]]),
    )
    while len(longer.points) > LONGEST:
        longer = Track(longer.points[::2], longer.times_ns[::2], longer.thinned + 1)
    return longer


def place_at(track: Track, time_ns: int) -> tuple[float, float] | None:
    """Return latitude and longitude (deg) at a moment, on the straight line between points; None: unknown."""
    if not len(track.points):
        return None
    # Differences to the moment fit a double; nanoseconds since 1970 do not.
    since = (track.times_ns - time_ns).astype(float)
    latitude, longitude = (float(np.interp(0.0, since, track.points[:, axis])) for axis in (0, 1))
    return latitude, longitude
