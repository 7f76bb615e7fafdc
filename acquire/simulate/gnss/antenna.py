"""Where an antenna is: its phase centre as a smooth function of GPS time."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from drivers.arrays import Floats, Integers

Path = Callable[[Integers], Floats]


@dataclass(frozen=True)
class Antenna:
    """The way of an antenna's phase centre.

    position, velocity: from GPS nanoseconds, int64 (n,), to metres and metres per second, earth-centred,
        earth-fixed, float64 (n, 3). They are asked up to a second before and after a session.
    """

    position: Path
    velocity: Path

    @classmethod
    def still(cls, ecef_m: Floats) -> Antenna:
        """Return an antenna that does not move, at float64 (3,)."""
        place = np.array(ecef_m, np.float64)
        return cls(lambda t: np.tile(place, (len(t), 1)), lambda t: np.zeros((len(t), 3)))
