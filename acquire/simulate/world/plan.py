"""From an area and overlaps to strips, and the way that leads along all of them."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from acquire.simulate.world import configuration
from drivers.arrays import Floats

_CLIMB_M_S = 4.0


@dataclass(frozen=True)
class Strip:
    """A straight line of exposures.

    covers: number of its pass.
    begin_m, end_m (3,): where its first and its last exposure are wanted.
    """

    covers: int
    begin_m: Floats
    end_m: Floats
    exposures: int
    speed_m_s: float


@dataclass(frozen=True)
class Leg:
    """A straight piece of the way at one speed; of no length: a wait.

    to_m (3,).
    strip: index of the strip, -1 where nothing is taken.
    """

    to_m: Floats
    duration_s: float
    strip: int = -1


def strips(plan: configuration.Plan, camera: configuration.Camera) -> tuple[Strip, ...]:
    """Lay strips over the area, pass after pass, each next to the one before and flown the other way."""
    area = np.array(plan.area_m)
    found: list[Strip] = []
    for number, one in enumerate(plan.passes):
        course = np.radians(one.course_deg)
        along = np.array([np.sin(course), np.cos(course)])
        right = np.array([along[1], -along[0]])
        width, height = (side * camera.pitch_mm / camera.nominal_mm * one.height_m for side in camera.size_px)
        low, high = (area @ right).min(), (area @ right).max()
        count = max(2, int(np.ceil((high - low) / (width * (1 - one.side_overlap)))))
        for index in range(count):
            across = low + (high - low) * (index + 0.5) / count
            first, last = _crossing(area, right, along, across)
            shots = max(2, int(np.ceil((last - first) / (height * (1 - one.forward_overlap)))) + 1)
            ends = [np.append(across * right + at * along, one.height_m) for at in (first, last)]
            begin, end = ends if index % 2 == 0 else ends[::-1]
            found.append(Strip(number, begin, end, shots, one.speed_m_s))
    return tuple(found)


def _crossing(area: Floats, right: Floats, along: Floats, across: float) -> tuple[float, float]:
    """Give where a line parallel to `along` enters the polygon and leaves it for good."""
    side = area @ right - across
    following = np.roll(side, -1)
    cut = (side > 0) != (following > 0)
    share = side[cut] / (side[cut] - following[cut])
    points = area[cut] + share[:, None] * (np.roll(area, -1, axis=0) - area)[cut]
    places = points @ along
    return float(places.min()), float(places.max())


def legs(plan: configuration.Plan, lines: tuple[Strip, ...], ground_m: float) -> tuple[Floats, list[Leg]]:
    """Join the strips to one way, from the ground to the ground."""
    home = np.array([*plan.take_off_m, ground_m])
    way = _Way(home)
    way.wait(plan.on_ground_s)
    for number, line in enumerate(lines):
        ahead = line.end_m - line.begin_m
        ahead = ahead / np.linalg.norm(ahead)
        # Corners are rounded within three seconds: the strip itself is straight.
        run_up = 3.0 * line.speed_m_s
        if abs(way.at[2] - line.begin_m[2]) > 1.0:
            way.go(np.array([*way.at[:2], line.begin_m[2]]), _CLIMB_M_S)
        way.go(line.begin_m - run_up * ahead, line.speed_m_s)
        way.go(line.begin_m, line.speed_m_s)
        way.go(line.end_m, line.speed_m_s, number)
        way.go(line.end_m + run_up * ahead, line.speed_m_s)
    way.go(np.array([*home[:2], way.at[2]]), lines[-1].speed_m_s)
    way.go(home, _CLIMB_M_S)
    way.wait(plan.on_ground_s)
    return home, way.legs


class _Way:
    def __init__(self, start_m: Floats) -> None:
        self.at = start_m
        self.legs: list[Leg] = []

    def go(self, to_m: Floats, speed_m_s: float, strip: int = -1) -> None:
        length = float(np.linalg.norm(to_m - self.at))
        self.legs.append(Leg(to_m, length / speed_m_s, strip))
        self.at = to_m

    def wait(self, duration_s: float) -> None:
        self.legs.append(Leg(self.at, duration_s))
