"""A model: images oriented to each other, and the points where their rays meet."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from photocal.adjustment.datum import with_datum
from photocal.adjustment.intersection import intersect
from photocal.adjustment.network import Exposures, Network, Points, Rays
from photocal.adjustment.normal import prepare
from photocal.adjustment.snooping import robust_state
from photocal.adjustment.start.bearings import Sights
from photocal.adjustment.state import start_state
from photocal.geometry.resection import ray_residuals, resection
from photocal.geometry.rotation import angles_from_matrix

Floats = NDArray[np.float64]
Integers = NDArray[np.int64]
Flags = NDArray[np.bool_]

# Rays of a point have to meet at more than this angle (radians) to say how far it is.
SHARP = np.radians(1.0)
# An image is resected from this many points, or from fewer when there are no more.
PLENTY, FEWEST = 10, 4
# The model is adjusted whenever it has grown by this share.
GROWTH = 1.3
# Adjustment may raise the median residual by this factor where it brings the points' own residuals down.
STRAINED = 1.5
# A ray is left out when it misses its point by this many times the median, within these bounds (in principal
# distances); so many of one point at most.
UNLIKE, LEAST, ASTRAY = 8.0, 2e-3, 0.05
STRAY_RAYS = 3


@dataclass(frozen=True)
class Model:
    """Poses and points in one system; NaN where unknown.

    Attributes
    ----------
    rotation : ndarray, shape (images, 3, 3)
    centre : ndarray, shape (images, 3)
    points : ndarray, shape (points, 3)
    fixed : ndarray of bool, shape (points,)
        Points that were given and keep their coordinates.
    """

    rotation: Floats
    centre: Floats
    points: Floats
    fixed: Flags

    @property
    def oriented(self) -> Flags:
        """Images with a pose."""
        return np.asarray(np.isfinite(self.centre[:, 0]))

    @property
    def placed(self) -> Flags:
        """Points with coordinates."""
        return np.asarray(np.isfinite(self.points[:, 0]))


def empty_model(images: int, given: Floats) -> Model:
    """Make a model of points with given coordinates only, shape (points, 3), NaN for the others."""
    fixed = np.asarray(np.isfinite(given).all(axis=1))
    points = np.where(fixed[:, None], given, np.nan)
    return Model(np.full((images, 3, 3), np.nan), np.full((images, 3), np.nan), points, fixed)


def grown(model: Model, sights: Sights, limit: int | None = None) -> Model:
    """Orient image after image, until no more can be reached."""
    model = intersected(model, sights)
    adjusted_at = int(model.oriented.sum())
    failed = np.zeros(sights.images, dtype=np.bool_)
    while limit is None or model.oriented.sum() < limit:
        most = sights.images if limit is None else limit - int(model.oriented.sum())
        model, tried = _next_images(model, sights, failed, most)
        if not tried.any():
            if not failed.any() or model.oriented.sum() == adjusted_at:
                break
            # What could not be oriented is tried once more with better points.
            model, failed = adjusted(model, sights), np.zeros_like(failed)
            adjusted_at = int(model.oriented.sum())
            continue
        failed |= tried & ~model.oriented
        model = intersected(model, sights)
        if model.oriented.sum() > GROWTH * adjusted_at:
            model = adjusted(model, sights)
            adjusted_at = int(model.oriented.sum())
    return adjusted(model, sights) if model.oriented.any() else model


def _next_images(model: Model, sights: Sights, failed: Flags, most: int) -> tuple[Model, Flags]:
    """Resect at most so many of the images that see most points of the model; which ones were tried."""
    known = model.placed[sights.rays.point]
    count = np.bincount(sights.rays.image[known], minlength=sights.images)
    count[model.oriented | failed] = 0
    tried = np.asarray(count >= max(FEWEST, min(PLENTY, int(count.max(initial=0)))))
    if (count >= PLENTY).any():
        tried &= count >= 0.5 * count.max()
    tried[np.argsort(-count, kind="stable")[most:]] = False
    rotation, centre = model.rotation.copy(), model.centre.copy()
    for image in np.flatnonzero(tried):
        mine = np.flatnonzero(known & (sights.rays.image == image))
        found = resection(model.points[sights.rays.point[mine]], sights.slopes[mine])
        if found is not None and np.median(found.residual) < ASTRAY:
            rotation[image], centre[image] = found.rotation, found.centre
    return replace(model, rotation=rotation, centre=centre), tried


def intersected(model: Model, sights: Sights) -> Model:
    """Place the points that rays of oriented images meet at, all but those that were given.

    Rays that miss by far more than most are left out, one of a point at a time.
    """
    rays = np.flatnonzero(model.oriented[sights.rays.image] & ~model.fixed[sights.rays.point])
    if not len(rays):
        return model
    for _ in range(STRAY_RAYS + 1):
        image, point = sights.rays.image[rays], sights.rays.point[rays]
        found = intersect(
            point,
            sights.points,
            model.centre[image],
            model.rotation[image],
            sights.slopes[rays],
            np.ones(len(rays)),
        )
        residual = ray_residuals(
            model.rotation[image], model.centre[image], found[point], sights.slopes[rays]
        )
        stray = _strays(residual)
        count = np.bincount(point, minlength=sights.points)
        order = np.lexsort((-np.nan_to_num(residual, nan=0.0, posinf=1e9), point))
        _, first = np.unique(point[order], return_index=True)
        worst = order[first]
        out = worst[stray[worst] & (count[point[worst]] > 2)]
        if not len(out):
            break
        rays = np.delete(rays, out)
    missed = np.bincount(point[stray], minlength=sights.points) > 0
    found[missed | (_angles(model, sights, rays, found) < SHARP)] = np.nan
    return replace(model, points=np.where(model.fixed[:, None], model.points, found))


def _strays(residual: Floats) -> Flags:
    """Rays that miss their points by far more than most; NaN is none."""
    known = residual[np.isfinite(residual)]
    limit = np.clip(UNLIKE * np.median(known) if len(known) else 0.0, LEAST, ASTRAY)
    return np.asarray(residual > limit)


def _angles(model: Model, sights: Sights, rays: Integers, points: Floats) -> Floats:
    """Largest angle between a point's first ray and its others, radians; 0 for a single ray."""
    image, point = sights.rays.image[rays], sights.rays.point[rays]
    away = points[point] - model.centre[image]
    with np.errstate(invalid="ignore", divide="ignore"):
        away = away / np.linalg.norm(away, axis=1)[:, None]
    first = np.searchsorted(point, np.arange(sights.points))
    reference = away[np.minimum(first, len(rays) - 1)][point]
    angle = np.arccos(np.clip(np.sum(away * reference, axis=1), -1.0, 1.0))
    largest = np.zeros(sights.points)
    np.fmax.at(largest, point, angle)
    return largest


def adjusted(model: Model, sights: Sights) -> Model:
    """Adjust poses and points robustly, with the cameras as they are.

    Points that were given hold the datum when there are enough of them; else the model floats.
    """
    images = np.flatnonzero(model.oriented)
    taken = model.oriented[sights.rays.image] & model.placed[sights.rays.point]
    count = np.bincount(sights.rays.point[taken], minlength=sights.points)
    points = np.flatnonzero(count >= np.where(model.fixed, 1, 2))
    rays = np.flatnonzero(taken & np.isin(sights.rays.point, points))
    held = model.fixed[points]
    if len(images) < 2 or not len(rays):
        return model
    network = Network(
        tuple(replace(c, estimated=np.zeros_like(c.estimated)) for c in sights.cameras),
        Exposures(
            sights.camera_of[images],
            np.hstack([angles_from_matrix(model.rotation[images]), model.centre[images]]),
            np.full((len(images), 6), np.inf),
        ),
        Points(
            model.points[points],
            np.repeat(held[:, None], 3, axis=1),
            np.zeros((len(points), 3, 3)),
        ),
        Rays(
            np.searchsorted(images, sights.rays.image[rays]),
            np.searchsorted(points, sights.rays.point[rays]),
            sights.rays.plane[rays],
            sights.rays.sigma[rays],
        ),
        tuple(str(i) for i in images),
        tuple(str(j) for j in points),
        datum_points=None if held.any() else np.zeros(0, dtype=np.int64),
    )
    start = start_state(network)
    with np.errstate(all="ignore"):
        state = robust_state(with_datum(prepare(network), start), start)
    rotation, centre = model.rotation.copy(), model.centre.copy()
    rotation[images], centre[images] = state.rotation, state.centre
    where = model.points.copy()
    where[points] = state.points
    better = replace(model, rotation=rotation, centre=centre, points=where)
    return better if misfit(better, sights) < STRAINED * misfit(model, sights) else model


def misfit(model: Model, sights: Sights) -> float:
    """Median residual of the rays in the model, in units of the principal distance."""
    rays = np.flatnonzero(model.oriented[sights.rays.image] & model.placed[sights.rays.point])
    if not len(rays):
        return float("inf")
    image, point = sights.rays.image[rays], sights.rays.point[rays]
    residual = ray_residuals(
        model.rotation[image], model.centre[image], model.points[point], sights.slopes[rays]
    )
    return float(np.median(residual))
