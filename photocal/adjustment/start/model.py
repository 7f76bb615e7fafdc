"""A model: images oriented to each other, their cameras, and the points where their rays meet."""

from dataclasses import dataclass, replace

import numpy as np

from photocal.adjustment.datum import with_datum
from photocal.adjustment.network import ExteriorOrientations, Network, Points, Rays
from photocal.adjustment.normal import prepare
from photocal.adjustment.snooping import ray_fit, robust_state
from photocal.adjustment.start.bearings import Bearings
from photocal.adjustment.state import State, start_state
from photocal.base.arrays import Flags, Floats, Integers
from photocal.geometry.camera import PARAMETERS, Camera, among
from photocal.geometry.resection import intersect, ray_residuals, resection
from photocal.geometry.rotation import angles_from_matrix

# Rays of a point have to meet at more than this angle (radians) to say how far it is.
SHARP = np.radians(1.0)
# Images are resected from this many points, or from fewer when there are no more; those that see at least
# this share of what the best one sees, together.
PLENTY, FEWEST, BATCH = 10, 4, 0.5
# A ray is left out when it misses its point by this many times the median, within these bounds (in principal
# distances); so many of one point at most.
UNLIKE, LEAST, ASTRAY = 8.0, 2e-3, 0.03
# A pose holds when this share of its rays fits; of few rays more, for three points fit any pose.
SHARE, SHARE_OF_FEW, MANY = 0.3, 0.6, 12
# Of the interior orientation only this is estimated here, where the camera is to be estimated at all, from
# three images with so many rays each; with a prior sigma of c of this share of it where none is given, and
# of the distortion at the corner of the image of this share of the radius.
LENS = among("c", "K1", "K2")
CALIBRATING, RAYS_EACH = 3, 40
C_SHARE, DISTORTION_SHARE = 0.2, 0.1


@dataclass(frozen=True)
class Model:
    """Poses and points in one system; NaN where unknown.

    bearings: the rays, by the cameras as the model has found them.
    rotation (images, 3, 3).
    centre (images, 3).
    points (points, 3).
    fixed (points,): points that were given and keep their coordinates.
    """

    bearings: Bearings
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


def empty_model(bearings: Bearings, given: Floats) -> Model:
    """Make a model of points with given coordinates only, shape (points, 3), NaN for the others."""
    fixed = np.asarray(np.isfinite(given).all(axis=1))
    points = np.where(fixed[:, None], given, np.nan)
    images = bearings.images
    return Model(bearings, np.full((images, 3, 3), np.nan), np.full((images, 3), np.nan), points, fixed)


def grown(model: Model, among: Flags, limit: int | None = None) -> Model:
    """Orient image after image, until no more can be reached."""
    model = intersected(model)
    adjusted_at = int(model.oriented.sum())
    failed = ~among
    # The model is adjusted whenever it has grown by this share.
    growth = 1.2
    while limit is None or model.oriented.sum() < limit:
        most = len(among) if limit is None else limit - int(model.oriented.sum())
        model, tried = _next_images(model, failed, most)
        if not tried.any():
            if (failed == ~among).all() or model.oriented.sum() == adjusted_at:
                break
            # What could not be oriented is tried once more with better points.
            model, failed = adjusted(model), ~among
            adjusted_at = int(model.oriented.sum())
            continue
        failed |= tried & ~model.oriented
        model = intersected(model)
        if model.oriented.sum() > growth * adjusted_at:
            model = adjusted(model)
            adjusted_at = int(model.oriented.sum())
    return without_misfits(adjusted(model)) if model.oriented.any() else model


def _next_images(model: Model, failed: Flags, most: int) -> tuple[Model, Flags]:
    """Resect at most so many of the images that see most points of the model; which ones were tried."""
    rays, slopes = model.bearings.rays, model.bearings.slopes
    known = model.placed[rays.point]
    count = np.bincount(rays.image[known], minlength=model.bearings.images)
    count[model.oriented | failed] = 0
    tried = np.asarray(count >= max(FEWEST, min(PLENTY, int(count.max(initial=0)))))
    if (count >= PLENTY).any():
        tried &= count >= BATCH * count.max()
    tried[np.argsort(-count, kind="stable")[most:]] = False
    limit = fitting_limit(_residuals(model))
    rotation, centre = model.rotation.copy(), model.centre.copy()
    for image in np.flatnonzero(tried):
        in_image = np.flatnonzero(known & (rays.image == image))
        pose = resection(model.points[rays.point[in_image]], slopes[in_image])
        # A camera that is not calibrated yet strains the first images more than those before.
        if pose is not None and np.sum(pose.residual < 2 * limit) >= _enough(len(in_image)):
            rotation[image], centre[image] = pose.rotation, pose.centre
    return replace(model, rotation=rotation, centre=centre), tried


def _enough(count: int) -> float:
    """How many of so many rays have to fit a pose."""
    return max(FEWEST, min(SHARE_OF_FEW * count, MANY), SHARE * count)


def intersected(model: Model) -> Model:
    """Place the points that rays of oriented images meet at, all but those that were given.

    Rays that miss by far more than most are left out, one of a point at a time.
    """
    # So many of one point at most.
    stray_rays = 3
    seen = model.bearings
    rays = np.flatnonzero(model.oriented[seen.rays.image] & ~model.fixed[seen.rays.point])
    rays = rays[np.isfinite(seen.slopes[rays, 0])]
    if not len(rays):
        return model
    for _ in range(stray_rays + 1):
        image, point = seen.rays.image[rays], seen.rays.point[rays]
        rotation, centre = model.rotation[image], model.centre[image]
        points = intersect(point, seen.points, centre, rotation, seen.slopes[rays], np.ones(len(rays)))
        residual = ray_residuals(rotation, centre, points[point], seen.slopes[rays])
        stray = residual > fitting_limit(residual)
        count = np.bincount(point, minlength=seen.points)
        order = np.lexsort((-np.nan_to_num(residual, nan=0.0, posinf=1e9), point))
        _, first = np.unique(point[order], return_index=True)
        worst = order[first]
        out = worst[stray[worst] & (count[point[worst]] > 2)]
        if not len(out):
            break
        rays = np.delete(rays, out)
    missed = np.bincount(point[stray], minlength=seen.points) > 0
    points[missed | (_angles(model, rays, points) < SHARP)] = np.nan
    return replace(model, points=np.where(model.fixed[:, None], model.points, points))


def fitting_limit(residual: Floats) -> float:
    """Residual beyond which a ray misses its point by far more than most; NaN counts for nothing."""
    known = residual[np.isfinite(residual)]
    return float(np.clip(UNLIKE * np.median(known) if len(known) else 0.0, LEAST, ASTRAY))


def _angles(model: Model, rays: Integers, points: Floats) -> Floats:
    """Largest angle between a point's first ray and its others, radians; 0 for a single ray."""
    image, point = model.bearings.rays.image[rays], model.bearings.rays.point[rays]
    away = points[point] - model.centre[image]
    with np.errstate(invalid="ignore", divide="ignore"):
        away = away / np.linalg.norm(away, axis=1)[:, None]
    first = np.searchsorted(point, np.arange(len(points)))
    reference = away[np.minimum(first, len(rays) - 1)][point]
    angle = np.arccos(np.clip(np.sum(away * reference, axis=1), -1.0, 1.0))
    largest = np.zeros(len(points))
    np.fmax.at(largest, point, angle)
    return largest


def adjusted(model: Model) -> Model:
    """Adjust poses, points and what is to be estimated of the cameras, with the rays that fit.

    Points that were given hold the datum when there are enough of them; else the model floats.
    """
    seen = model.bearings
    images = np.flatnonzero(model.oriented)
    residual = _residuals(model)
    # Given coordinates may be wrong, and a ray of one of them says what no other does.
    taken = (residual <= fitting_limit(residual)) | (np.isfinite(residual) & model.fixed[seen.rays.point])
    count = np.bincount(seen.rays.point[taken], minlength=seen.points)
    points = np.flatnonzero(count >= np.where(model.fixed, 1, 2))
    rays = np.flatnonzero(taken & np.isin(seen.rays.point, points))
    held = model.fixed[points]
    if len(images) < 2 or not len(rays):
        return model
    network = Network(
        _to_calibrate(seen, rays),
        ExteriorOrientations(
            seen.camera_of[images],
            np.hstack([angles_from_matrix(model.rotation[images]), model.centre[images]]),
            np.full((len(images), 6), np.inf),
        ),
        Points(model.points[points], np.repeat(held[:, None], 3, axis=1), np.zeros((len(points), 3, 3))),
        Rays(
            np.searchsorted(images, seen.rays.image[rays]),
            np.searchsorted(points, seen.rays.point[rays]),
            seen.rays.plane[rays],
            seen.rays.sigma[rays],
        ),
        tuple(str(i) for i in images),
        tuple(str(j) for j in points),
        datum_points=None if held.any() else np.zeros(0, dtype=np.int64),
    )
    start = replace(start_state(network), cameras=np.array([camera.values for camera in seen.cameras]))
    with np.errstate(all="ignore"):
        state, _ = robust_adjustment(network, start)
    rotation, centre = model.rotation.copy(), model.centre.copy()
    rotation[images], centre[images] = state.rotation, state.centre
    where = model.points.copy()
    where[points] = state.points
    better = replace(model, rotation=rotation, centre=centre, points=where)
    if any(camera.estimated.any() for camera in network.cameras):
        cameras = tuple(camera.with_values(v) for camera, v in zip(seen.cameras, state.cameras, strict=True))
        better = replace(better, bearings=seen.by(cameras))
    # Adjustment may raise the median residual by this factor where it brings the points' own residuals down.
    strained = 1.5
    return better if misfit(better) < strained * misfit(model) else model


def robust_adjustment(network: Network, start: State) -> tuple[State, Floats]:
    """State that gross errors do not bend, from start values, and how its rays fit."""
    problem = with_datum(prepare(network), start)
    state = robust_state(problem, start)
    return state, ray_fit(problem, state)


def _to_calibrate(seen: Bearings, rays: Integers) -> tuple[Camera, ...]:
    """Cameras as they were given, with what so many rays can tell of them."""
    camera = seen.camera_of[seen.rays.image[rays]]
    cameras = []
    for k, given in enumerate(seen.given):
        images = len(np.unique(seen.rays.image[rays][camera == k]))
        enough = images >= CALIBRATING and np.sum(camera == k) >= RAYS_EACH * images
        corner = float(np.hypot(given.size_px[0] * given.pitch[0], given.size_px[1] * given.pitch[1])) / 2
        loose = np.full(len(PARAMETERS), np.inf)
        loose[0] = C_SHARE * given.value("c")
        loose[3:5] = DISTORTION_SHARE / corner**2, DISTORTION_SHARE / corner**4
        cameras.append(
            replace(
                given if enough else seen.cameras[k],
                estimated=given.estimated & LENS & enough,
                prior_sigma=np.minimum(loose, given.prior_sigma),
                prior_correlation=None,
                deviation_sigma=np.zeros(len(PARAMETERS)),
            )
        )
    return tuple(cameras)


def held_to_given(model: Model) -> Model:
    """The same images and points with the principal distances that were given, reached in steps."""
    seen = model.bearings
    first = [camera.value("c") for camera in seen.cameras]
    away = max(abs(given.value("c") / c - 1.0) for given, c in zip(seen.given, first, strict=True))
    # Of a difference that is just credible a quarter is longer than this.
    step = 0.05
    for share in (1.0,) if away < step else (0.25, 0.5, 0.75, 1.0):
        cameras = []
        for camera, given, c in zip(model.bearings.cameras, seen.given, first, strict=True):
            values = camera.values.copy()
            values[0] = c + share * (given.value("c") - c)
            estimated = camera.estimated & (np.arange(len(PARAMETERS)) > 0)
            cameras.append(replace(camera.with_values(values), estimated=estimated))
        stepped = replace(model.bearings.by(tuple(cameras)), given=tuple(cameras))
        model = adjusted(intersected(replace(model, bearings=stepped)))
    return without_misfits(intersected(model))


def without_misfits(model: Model) -> Model:
    """Take out the images whose rays do not fit the model, and what only they placed."""
    residual = _residuals(model)
    image = model.bearings.rays.image
    known = np.isfinite(residual)
    total = np.bincount(image[known], minlength=model.bearings.images)
    fits = np.bincount(image[known & (residual <= fitting_limit(residual))], minlength=model.bearings.images)
    gone = model.oriented & (fits < [_enough(count) for count in total])
    if not gone.any():
        return model
    rotation, centre = model.rotation.copy(), model.centre.copy()
    rotation[gone], centre[gone] = np.nan, np.nan
    return intersected(replace(model, rotation=rotation, centre=centre))


def _residuals(model: Model) -> Floats:
    """Residual of each ray, in units of the principal distance; NaN where image or point is unknown."""
    image, point = model.bearings.rays.image, model.bearings.rays.point
    known = np.flatnonzero(model.oriented[image] & model.placed[point])
    residual = np.full(len(image), np.nan)
    residual[known] = ray_residuals(
        model.rotation[image[known]],
        model.centre[image[known]],
        model.points[point[known]],
        model.bearings.slopes[known],
    )
    return residual


def misfit(model: Model) -> float:
    """Median residual of the rays in the model, in units of the principal distance."""
    residual = _residuals(model)
    known = residual[~np.isnan(residual)]
    return float(np.median(known)) if len(known) else float("inf")


def support(model: Model) -> int:
    """How many rays of points with three and more of them meet within the model."""
    fits = _residuals(model) <= LEAST
    count = np.bincount(model.bearings.rays.point[fits], minlength=model.bearings.points)
    return int(count[count >= 3].sum())
