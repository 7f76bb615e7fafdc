"""The first pair of a model: two images that see much of the same from different places."""

from dataclasses import replace

import numpy as np

from photocal.adjustment.start.bearings import Bearings
from photocal.adjustment.start.model import Model, empty_model, grown, misfit, support
from photocal.base.arrays import Flags
from photocal.geometry.camera import Camera
from photocal.geometry.relative_orientation import FEWEST, RelativeOrientation, relative_orientations

# Pairs that are looked at, and images that a trial model has.
PAIRS, TRIALS, TRIAL_IMAGES = 24, 6, 4
# Beyond this angle (radians) a wider base makes a pair no better.
WIDE = np.radians(25.0)
# A trial is good when its rays miss by this share of the principal distance, and this share of them meets.
CLOSE, MEETING = 1e-3, 0.7
# Shares of the given principal distance that are tried where it gives no good one.
OTHER_C = (1.0, 1.2, 0.83)


def first_model(bearings: Bearings, free: Flags) -> Model | None:
    """Small model of the images that orient each other best.

    A pose that only the plane of the points suggested fits no third image: what counts is how many rays meet
    in threes.
    """
    free_bearings = bearings.some(free[bearings.rays.image])
    best: Model | None = None
    for share in OTHER_C:
        # What fits best of a wrong principal distance may be a wrong model.
        seen = free_bearings.by(tuple(_scaled(camera, share) for camera in free_bearings.given))
        if share == 1 or any(camera.estimated[0] for camera in free_bearings.given):
            best = _best_trial(seen, free, best)
        if best is not None and best.oriented.sum() == min(TRIAL_IMAGES, free.sum()) and _good(best):
            break
    return None if best is None else replace(best, bearings=bearings.by(best.bearings.cameras))


def _scaled(camera: Camera, share: float) -> Camera:
    values = camera.values.copy()
    values[0] *= share if camera.estimated[0] else 1.0
    return camera.with_values(values)


def _best_trial(seen: Bearings, free: Flags, best: Model | None) -> Model | None:
    """The best of a few trials, and of one that was made before."""
    for first, second, candidates in _pairs(seen, free)[:TRIALS]:
        for candidate in candidates:
            trial = grown(_pair_model(seen, first, second, candidate), free, TRIAL_IMAGES)
            holds = trial.oriented.sum() >= 2 and trial.placed.any()
            if holds and (best is None or _rank(trial) > _rank(best)):
                best = trial
        if best is not None and best.oriented.sum() == TRIAL_IMAGES and _good(best):
            break
    return best


def _rank(trial: Model) -> tuple[int, int, float]:
    return min(int(trial.oriented.sum()), 3), support(trial), -misfit(trial)


def _good(trial: Model) -> bool:
    seen = trial.oriented[trial.bearings.rays.image]
    count = np.bincount(trial.bearings.rays.point[seen], minlength=trial.bearings.points)
    return misfit(trial) < CLOSE and support(trial) > MEETING * count[count >= 3].sum()


def _pairs(bearings: Bearings, free: Flags) -> list[tuple[int, int, list[RelativeOrientation]]]:
    """Pairs with their relative orientations, the most promising first."""
    together = bearings.together().tocoo()
    image, other = together.coords
    use = (image < other) & free[image] & free[other] & (together.data >= FEWEST)
    order = np.argsort(-together.data[use], kind="stable")
    # Neighbours that see most are often too close to each other: some with less in common are looked at too.
    steps = np.unique(np.concatenate([np.arange(PAIRS), np.linspace(0, len(order) - 1, PAIRS).astype(int)]))
    pairs = []
    for k in order[steps[(steps >= 0) & (steps < len(order))]]:
        a, b = int(image[use][k]), int(other[use][k])
        first, second = bearings.common(a, b)
        candidates = relative_orientations(bearings.slopes[first], bearings.slopes[second])
        if candidates:
            value = min(len(first), 100) * min(max(candidate.angle for candidate in candidates), WIDE)
            pairs.append((value, a, b, candidates))
    pairs.sort(key=lambda entry: -entry[0])
    return [(a, b, candidates) for _, a, b, candidates in pairs]


def _pair_model(bearings: Bearings, first: int, second: int, pair: RelativeOrientation) -> Model:
    model = empty_model(bearings, np.full((bearings.points, 3), np.nan))
    model.rotation[[first, second]] = np.eye(3), pair.rotation
    model.centre[[first, second]] = np.zeros(3), pair.base
    return model
