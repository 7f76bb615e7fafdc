"""Plates with coded patterns on the ground: where they lie, and what a survey says of them."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from acquire.simulate.world import configuration
from acquire.simulate.world.terrain import Terrain
from drivers.arrays import Flags, Floats, Integers

# The plate lies on the highest ground beneath it, on stones of this height.
ABOVE_GROUND_M = 0.03
_CANDIDATES = 60


@dataclass(frozen=True)
class Targets:
    """The plates.

    roles (n,): ``control`` or ``check``.
    codes (n,): identity in the dictionary.
    centre_m (n, 3): in the local frame.
    turn (n,): direction of the plate's upper edge, from east towards north, rad.
    surveyed_m (n, 3): what the survey says, in the local frame.
    """

    names: tuple[str, ...]
    roles: tuple[str, ...]
    codes: Integers
    centre_m: Floats
    turn: Floats
    surveyed_m: Floats


def make_targets(
    given: configuration.Targets, area_m: Floats, terrain: Terrain, random: np.random.Generator
) -> Targets:
    """Lay the plates far from each other over the area; those that spread widest become control."""
    count = given.control + given.check
    places = spread_points(area_m, count, random)
    centre = np.column_stack([places, _bed(terrain, places, given.side_m)])
    roles = np.full(count, "check", dtype=object)
    roles[widest(places, given.control)] = "control"
    numbers = {"control": 0, "check": 0}
    names = []
    for role in roles.tolist():
        numbers[role] += 1
        names.append(f"{'GCP' if role == 'control' else 'CHK'}{numbers[role]:02d}")
    surveyed = centre + random.standard_normal((count, 3)) * given.sigma_m
    return Targets(
        tuple(names),
        tuple(roles.tolist()),
        np.arange(1, count + 1),
        centre,
        random.uniform(0, 2 * np.pi, count),
        surveyed,
    )


def spread_points(area_m: Floats, count: int, random: np.random.Generator) -> Floats:
    """Draw points in a polygon, each far from those before (Mitchell 1991), shape (n, 2)."""
    low, high = area_m.min(axis=0), area_m.max(axis=0)
    chosen = np.empty((0, 2))
    while len(chosen) < count:
        drawn = random.uniform(low, high, (_CANDIDATES, 2))
        drawn = drawn[inside(area_m, drawn)]
        if not len(drawn):
            continue
        if len(chosen):
            apart = np.linalg.norm(drawn[:, None] - chosen, axis=2).min(axis=1)
            drawn = drawn[np.argmax(apart)][None]
        chosen = np.vstack([chosen, drawn[:1]])
    return chosen


def inside(area_m: Floats, points: Floats) -> Flags:
    """Tell which points lie in a polygon: a ray to the east crosses its border an odd number of times."""
    after = np.roll(area_m, -1, axis=0)
    odd = np.zeros(len(points), bool)
    for (ax, ay), (bx, by) in zip(area_m.tolist(), after.tolist(), strict=True):
        if ay == by:
            continue
        between = (ay > points[:, 1]) != (by > points[:, 1])
        odd ^= between & (points[:, 0] < ax + (points[:, 1] - ay) / (by - ay) * (bx - ax))
    return odd


def widest(places: Floats, count: int) -> list[int]:
    """Choose points far from each other, the first the farthest from the middle (Gonzalez 1985)."""
    if count == 0:
        return []
    chosen = [int(np.argmax(np.linalg.norm(places - places.mean(axis=0), axis=1)))]
    while len(chosen) < count:
        apart = np.linalg.norm(places[:, None] - places[chosen], axis=2).min(axis=1)
        chosen.append(int(np.argmax(apart)))
    return sorted(chosen)


def _bed(terrain: Terrain, places: Floats, side_m: float) -> Floats:
    steps = np.linspace(-0.6, 0.6, 7) * side_m
    east, north = np.meshgrid(steps, steps)
    around = terrain.height(places[:, 0, None] + east.ravel(), places[:, 1, None] + north.ravel())
    return np.asarray(around.max(axis=1) + ABOVE_GROUND_M)
