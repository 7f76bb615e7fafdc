"""The first pair of a model: two images that see much of the same from different places."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from photocal.adjustment.start.bearings import Sights
from photocal.adjustment.start.model import Model, empty_model, grown, misfit
from photocal.geometry.relative_orientation import FEWEST, RelativeOrientation, relative_orientations

Flags = NDArray[np.bool_]

# Pairs that are looked at, and images that a trial model has.
PAIRS, TRIALS, TRIAL_IMAGES = 24, 3, 4
# Beyond this angle (radians) a wider base makes a pair no better.
WIDE = np.radians(25.0)


def first_model(sights: Sights, free: Flags) -> Model | None:
    """Small model of the images that orient each other best."""
    pairs = _pairs(sights, free)
    trials: list[Model] = []
    for first, second, candidates in pairs[:TRIALS]:
        trials += [
            grown(_pair_model(sights, first, second, candidate), _only(sights, free), TRIAL_IMAGES)
            for candidate in candidates
        ]
        trials = [trial for trial in trials if trial.oriented.sum() >= 2 and trial.placed.any()]
        if trials and min(misfit(trial, sights) for trial in trials) < 1e-3:
            break
    # A pose that only the plane of the points suggested fits no third image.
    return min(trials, key=lambda trial: (-int(trial.oriented.sum()), misfit(trial, sights)), default=None)


def _only(sights: Sights, free: Flags) -> Sights:
    """Sights of some images."""
    keep = free[sights.rays.image]
    rays = sights.rays
    own = replace(
        rays, image=rays.image[keep], point=rays.point[keep], plane=rays.plane[keep], sigma=rays.sigma[keep]
    )
    return replace(sights, rays=own, slopes=sights.slopes[keep])


def _pairs(sights: Sights, free: Flags) -> list[tuple[int, int, list[RelativeOrientation]]]:
    """Pairs with their relative orientations, the most promising first."""
    together = sights.together().tocoo()
    image, other = together.coords
    use = (image < other) & free[image] & free[other] & (together.data >= FEWEST)
    order = np.argsort(-together.data[use], kind="stable")
    # Neighbours that see most are often too close to each other: some with less in common are looked at too.
    steps = np.unique(np.concatenate([np.arange(PAIRS), np.linspace(0, len(order) - 1, PAIRS).astype(int)]))
    found = []
    for k in order[steps[(steps >= 0) & (steps < len(order))]]:
        a, b = int(image[use][k]), int(other[use][k])
        first, second = sights.common(a, b)
        candidates = relative_orientations(sights.slopes[first], sights.slopes[second])
        if candidates:
            angle = max(candidate.angle for candidate in candidates)
            value = min(len(first), 100) * min(angle, WIDE)
            found.append((value, a, b, candidates))
    found.sort(key=lambda entry: -entry[0])
    return [(a, b, candidates) for _, a, b, candidates in found]


def _pair_model(sights: Sights, first: int, second: int, pair: RelativeOrientation) -> Model:
    model = empty_model(sights.images, np.full((sights.points, 3), np.nan))
    model.rotation[[first, second]] = np.eye(3), pair.rotation
    model.centre[[first, second]] = np.zeros(3), pair.base
    return model
