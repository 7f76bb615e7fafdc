"""Start values of a block without exterior orientation."""

from dataclasses import dataclass, replace

import numpy as np

from photocal.adjustment.network import NO_RELATIONS, RELATIONS, Rays, Relations
from photocal.adjustment.start.bearings import Bearings, bearings
from photocal.adjustment.start.model import Model, adjusted, empty_model, grown, intersected
from photocal.adjustment.start.pairs import first_model
from photocal.base.arrays import Floats, Integers
from photocal.geometry.camera import Camera
from photocal.geometry.rotation import angles_from_matrix, matrix_from_angles
from photocal.geometry.similarity import Similarity, robust_similarity

DISTANCE = list(RELATIONS).index("distance")


@dataclass(frozen=True)
class StartValues:
    """Start values.

    exposures (images, 6): omega, phi, kappa in radians, X, Y, Z in m; NaN for images that were not reached.
    points (points, 3): m; NaN for points whose rays do not meet well enough.
    lost: images that were not reached.
    """

    exposures: Floats
    points: Floats
    lost: Integers


def start_values(
    cameras: tuple[Camera, ...],
    camera_of: Integers,
    exposures: Floats,
    points: Floats,
    rays: Rays,
    relations: Relations = NO_RELATIONS,
    *,
    free: bool = False,
) -> StartValues:
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
    return StartValues(result, model.points, np.flatnonzero(~model.oriented))


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
