"""Start values of a block without exterior orientation.

The first pair of a model: two images that see much of the same from different places.
"""

from collections.abc import Iterator
from dataclasses import replace
from itertools import islice

import numpy as np

from photocal.adjustment.network import NO_RELATIONS, RELATIONS, Rays, Relations
from photocal.adjustment.start.bearings import Bearings, bearings
from photocal.adjustment.start.model import Model, adjusted, empty_model, grown, intersected, misfit, support
from photocal.base.arrays import Flags, Floats, Integers
from photocal.geometry.camera import Camera
from photocal.geometry.localisation import Similarity, robust_similarity
from photocal.geometry.resection import FEWEST_PAIRS, RelativeOrientation, relative_orientations
from photocal.geometry.rotation import angles_from_matrix, matrix_from_angles

# Pairs that are tested, trials, and images of a trial model.
PAIRS, TRIALS, TRIAL_IMAGES = 24, 6, 4
# Beyond this angle (radians) a wider base makes a pair no better, nor do more points in common than so many.
WIDE, MANY_IN_COMMON = np.radians(25.0), 100
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
        seen = free_bearings.by(tuple(_with_c(camera, share) for camera in free_bearings.given))
        if share == 1 or any(camera.estimated[0] for camera in free_bearings.given):
            best = _best_trial(seen, free, best)
        if best is not None and best.oriented.sum() == min(TRIAL_IMAGES, free.sum()) and _good(best):
            break
    return None if best is None else replace(best, bearings=bearings.by(best.bearings.cameras))


def _with_c(camera: Camera, share: float) -> Camera:
    values = camera.values.copy()
    values[0] *= share if camera.estimated[0] else 1.0
    return camera.with_values(values)


def _best_trial(seen: Bearings, free: Flags, best: Model | None) -> Model | None:
    """The best of a few trials, and of one that was made before."""
    for first, second, candidates in islice(_pairs(seen, free), TRIALS):
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


def _pairs(bearings: Bearings, free: Flags) -> Iterator[tuple[int, int, list[RelativeOrientation]]]:
    """Give pairs with their relative orientations, the most promising first."""
    together = bearings.together().tocoo()
    image, other = together.coords
    use = (image < other) & free[image] & free[other] & (together.data >= FEWEST_PAIRS)
    order = np.argsort(-together.data[use], kind="stable")
    # Pairs with most points in common often have too short a base: test some with fewer, too.
    steps = np.unique(np.concatenate([np.arange(PAIRS), np.linspace(0, len(order) - 1, PAIRS).astype(int)]))
    pairs = []
    for k in order[steps[(steps >= 0) & (steps < len(order))]]:
        a, b = int(image[use][k]), int(other[use][k])
        first, second = bearings.common(a, b)
        candidates = relative_orientations(bearings.slopes[first], bearings.slopes[second])
        if not candidates:
            continue
        value = min(len(first), MANY_IN_COMMON) * min(max(candidate.angle for candidate in candidates), WIDE)
        # No other is better.
        if value == MANY_IN_COMMON * WIDE:
            yield a, b, candidates
        else:
            pairs.append((value, a, b, candidates))
    pairs.sort(key=lambda entry: -entry[0])
    yield from ((a, b, candidates) for _, a, b, candidates in pairs)


def _pair_model(bearings: Bearings, first: int, second: int, pair: RelativeOrientation) -> Model:
    model = empty_model(bearings, np.full((bearings.points, 3), np.nan))
    model.rotation[[first, second]] = np.eye(3), pair.rotation
    model.centre[[first, second]] = np.zeros(3), pair.base
    return model


DISTANCE = list(RELATIONS).index("distance")


def start_values(
    cameras: tuple[Camera, ...],
    camera_of: Integers,
    exposures: Floats,
    points: Floats,
    rays: Rays,
    relations: Relations = NO_RELATIONS,
    *,
    free: bool = False,
) -> tuple[Floats, Floats, Integers]:
    """Find the exterior orientation of images that have none, and the points that have no coordinates.

    Images that see enough known points are resected, points that oriented images see are intersected, and
    so on. Where that does not reach all images, models are built from relative orientations alone and
    brought to the known points and projection centres by a similarity. On the way the models are adjusted,
    gross errors weighed down.

    cameras: with rough values: a principal distance good to some percent.
    camera_of (images,).
    exposures (images, 6): NaN where unknown. Complete ones are kept as they are; of others a known X, Y, Z
        serves as control.
    points (points, 3): coordinates of control points, NaN for all others.
    relations: their distances give a free network its scale.
    returns: exposures (images, 6), NaN for images that were not reached; points (points, 3), m, NaN for those
        whose rays do not meet well enough; and the images that were not reached.
    """
    seen = bearings(cameras, camera_of, len(points), rays)
    model = empty_model(seen, points)
    known = np.isfinite(exposures).all(axis=1)
    model.rotation[known] = matrix_from_angles(exposures[known, :3])
    model.centre[known] = exposures[known, 3:]
    complete, everywhere = model.oriented, np.ones(seen.images, dtype=np.bool_)
    count = np.bincount(seen.rays.image[model.placed[seen.rays.point]], minlength=seen.images)
    # Two images, or the only one, are resected from five known points.
    if complete.any() or (count >= 5).sum() >= min(2, seen.images):
        model = grown(model, everywhere)
    while not model.oriented.all():
        more = _separate_model(model, exposures, relations, free=free and not model.oriented.any())
        if more is None:
            break
        model = _joined(model, more)
    result = exposures.copy()
    new = model.oriented & ~complete
    result[new] = np.hstack([angles_from_matrix(model.rotation[new]), model.centre[new]])
    result[~model.oriented] = np.nan
    return result, model.points, np.flatnonzero(~model.oriented)


def free_models(seen: Bearings) -> list[Model]:
    """Models from relative orientation alone, each in a system of its own, that of most images first."""
    remaining, models = np.ones(seen.images, dtype=np.bool_), list[Model]()
    while remaining.sum() >= 2:
        model = first_model(seen, remaining)
        if model is None:
            break
        model = grown(model, remaining)
        # What the adjustment lost again is no model, and would be found once more.
        if not model.oriented.any():
            break
        models.append(model)
        remaining &= ~model.oriented
    return sorted(models, key=lambda model: -int(model.oriented.sum()))


def _separate_model(model: Model, exposures: Floats, relations: Relations, *, free: bool) -> Model | None:
    """Model of images that are not oriented yet, in the object system; None when there is none."""
    remaining = ~model.oriented
    while remaining.any():
        separate = first_model(model.bearings, remaining)
        if separate is None:
            return None
        separate = grown(separate, np.ones_like(remaining))
        if not separate.oriented.any():
            return None
        move = _to_object(model, separate, exposures)
        if move is None and free:
            move = _scaled(separate, relations)
        if move is not None:
            return replace(
                separate,
                rotation=move.applied_to_rotations(separate.rotation),
                centre=move.applied(separate.centre),
                points=move.applied(separate.points),
            )
        # Nothing ties this model to the object system: the next is made of the other images.
        remaining &= ~separate.oriented
    return None


def _to_object(model: Model, separate: Model, exposures: Floats) -> Similarity | None:
    """Similarity from a model's system to the object system, over common points and projection centres."""
    both = separate.placed & model.placed
    centres = separate.oriented & (model.oriented | np.isfinite(exposures[:, 3:]).all(axis=1))
    places = np.where(model.oriented[:, None], model.centre, exposures[:, 3:])
    source = np.vstack([separate.points[both], separate.centre[centres]])
    fit = robust_similarity(source, np.vstack([model.points[both], places[centres]]))
    return None if fit is None else fit[0]


def _scaled(model: Model, relations: Relations) -> Similarity:
    """Scale of a free model from distances; 1, with the first base as unit, when there are none."""
    first, second = relations.first, relations.second
    known = (relations.kind == DISTANCE) & model.placed[first] & model.placed[second]
    length = np.linalg.norm(model.points[first[known]] - model.points[second[known]], axis=1)
    scale = float(np.median(relations.values[known] / length)) if known.any() else 1.0
    return Similarity(scale, np.eye(3), np.zeros(3))


def _joined(model: Model, more: Model) -> Model:
    """One model of two in the same system, adjusted and grown on; cameras are those of the larger one."""
    new = more.oriented & ~model.oriented
    together = replace(
        model,
        bearings=model.bearings if model.oriented.sum() > more.oriented.sum() else more.bearings,
        rotation=np.where(new[:, None, None], more.rotation, model.rotation),
        centre=np.where(new[:, None], more.centre, model.centre),
    )
    return grown(adjusted(intersected(together)), np.ones_like(new))
