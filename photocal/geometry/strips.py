"""Strips of a flight, told by the exposures."""

import re
from collections.abc import Sequence

import numpy as np

from photocal.base.arrays import Flags, Floats, Integers

# A strip ends with a turn of the track.
_TURN_DEG = 30.0


def strips(seconds: Floats, velocity: Floats) -> tuple[Integers, Floats]:
    """Tell strips by the turns and pauses between exposures.

    seconds (n,): times of the exposures, increasing.
    velocity (n, 3): along X, Y, Z, m/s.
    returns strip (n,).
    returns elapsed (n,): seconds since the middle of the strip.
    """
    # And with a pause, in intervals.
    pause = 4.0
    turned = _turns(velocity)
    wait = np.diff(seconds)
    paused = wait > pause * np.median(wait) if len(wait) else turned
    strip = np.concatenate([[0], np.cumsum(turned | paused)]).astype(np.int64)
    first = np.full(strip[-1] + 1, np.inf)
    last = np.full(strip[-1] + 1, -np.inf)
    np.minimum.at(first, strip, seconds)
    np.maximum.at(last, strip, seconds)
    return strip, np.asarray(seconds - ((first + last) / 2)[strip])


def _turns(course: Floats) -> Flags:
    """Where a course (n, 3) turns from one place to the next."""
    heading = np.degrees(np.arctan2(course[:, 0], course[:, 1]))
    return np.asarray(np.abs((np.diff(heading) + 180.0) % 360.0 - 180.0) > _TURN_DEG)


def order_of_places(names: Sequence[str], centre: Floats) -> Integers:
    """Order exposures without times: as listed, or by the numbers in their names, whichever way is shorter.

    centre (n, 3): m.
    """

    def counted(k: int) -> list[str | int]:
        """The parts of a name with its numbers as such: IMG_2 stands before IMG_10."""
        parts = re.split(r"([0-9]+)", names[k])
        return [int(part) if number % 2 else part for number, part in enumerate(parts)]

    listed = np.arange(len(names))
    orders = listed, np.array(sorted(listed.tolist(), key=counted), dtype=np.int64)
    return min(orders, key=lambda order: float(np.linalg.norm(np.diff(centre[order], axis=0), axis=1).sum()))


def lines_of_places(centre: Floats) -> Integers:
    """Tell strips by the places of exposures alone, in their order: a step across, or a corner, ends one.

    centre (n, 3): m.
    returns strip (n,).
    """
    if len(centre) < 3:
        return np.zeros(len(centre), dtype=np.int64)
    turned = _turns(np.diff(centre, axis=0))
    # Before and after each step; the ends turn with their only neighbour.
    before, after = np.concatenate([turned[:1], turned]), np.concatenate([turned, turned[-1:]])
    across = before & after
    # At a corner no step leads across: the exposure there ends its strip.
    corner = np.concatenate([[False], turned & ~across[:-1] & ~across[1:]])
    return np.concatenate([[0], np.cumsum(across | corner)]).astype(np.int64)
