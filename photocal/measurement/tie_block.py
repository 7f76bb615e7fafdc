"""Tie points added to a block, and placed by its oriented images.

The block that tie points are added to: cameras and images, from what the images say of themselves.
"""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from photocal.adjustment.start.model import UNLIKE
from photocal.base.arrays import Flags, Floats, Integers
from photocal.base.policy import policy
from photocal.block.model import ROLES, Block, Images, Observations
from photocal.block.network import block_frame, observed_pixels, observed_plane
from photocal.geometry.camera import Camera, among
from photocal.geometry.distortion import slopes_of
from photocal.geometry.frames import LocalFrame
from photocal.geometry.oriented_images import OrientedImages, given_places, given_poses, local_poses
from photocal.geometry.resection import intersect, ray_residuals
from photocal.geometry.rotation import matrix_from_angles
from photocal.measurement.image_facts import ImageFacts, camera_temperatures, clock_seconds
from photocal.measurement.maker_camera import group_cameras, stated_camera
from photocal.measurement.tracks import Tracks

# Sigma of a position that the image does not state, m: single-frequency receivers in the air.
POSITION_SIGMA_M = (1.5, 1.5, 3.0)
# A level block without control says little about c, x0 and y0, which go with the heights and the
# positions: they are held until somebody asks for them.
ESTIMATE = ("K1", "K2")


def stated_cameras(facts: Sequence[ImageFacts]) -> tuple[tuple[Camera, ...], Integers]:
    """Cameras as images state them, little of them estimated, and which of them took each image."""
    names, member = group_cameras(facts)
    cameras = []
    for k, camera_name in enumerate(names):
        image = facts[int(np.flatnonzero(member == k)[0])]
        stated = stated_camera(camera_name, image)
        free, guessed = among(*ESTIMATE), stated.guessed
        cameras.append(replace(stated.camera, estimated=free, guessed=guessed, shutter="unknown"))
    return tuple(cameras), member


def start_block(
    facts: Sequence[ImageFacts],
    places: Floats,
    name: str,
    assumed: tuple[float, float, float] | None = POSITION_SIGMA_M,
    given: tuple[tuple[Camera, ...], Integers] | None = None,
) -> Block:
    """Make a block of images without points.

    assumed: sigma of positions that the images do not state; None leaves all of them free.
    given: cameras, and which of them took each image; without, as the images state.
    """
    cameras, member = stated_cameras(facts) if given is None else given
    poses = np.full((len(facts), 6), np.nan)
    poses[:, 3:] = places
    sigma = np.full((len(facts), 6), np.inf)
    if assumed is not None:
        stated = np.array([f.position_sigma_m for f in facts])
        sigma[:, 3:] = np.where(np.isfinite(stated) & (stated > 0), stated, assumed)
    sigma[np.isnan(places).any(axis=1)] = np.inf
    # Fewer positions do not fix a datum.
    fewest_positions = 3
    enough = np.isfinite(places).all(axis=1).sum() >= fewest_positions
    images = Images(
        tuple(f.name for f in facts),
        member,
        poses,
        sigma,
        time=clock_seconds(facts),
        temperature=camera_temperatures(facts),
    )
    return Block(name, "local", "", "control" if enough else "free", cameras, images)


def without_single_rays(block: Block) -> Block:
    """Take out what is measured in one image only: of a free block it determines nothing."""
    seen = block.observations
    count = np.bincount(seen.point, minlength=len(block.points.names))
    return replace(block, observations=seen.rows(count[seen.point] > 1))


TIE = ROLES.index("tie")
# Points whose rays deviate less from their mean lie too far away to be determined, rad.
LEAST_SPREAD = 0.005
# A ray is wrong when its residual exceeds so many of its standard deviations.
GROSS = 3.5
# Rays of a kind have one sigma: classes of feature scale, or of the precision of the match.
CLASSES, FEWEST_IN_CLASS = 8, 200
FINEST_PX = 0.02


def with_ties(block: Block, tracks: Tracks, values: Floats, sigma: Floats) -> Block:
    """Add tie points behind the points that a block has."""
    known = block.points
    return replace(
        block,
        points=known.with_ties(tuple(f"t{j + 1}" for j in range(tracks.count)), values),
        observations=block.observations.plus(
            tracks.image, tracks.track + len(known.names), tracks.pixels, np.column_stack([sigma, sigma])
        ),
    )


def tracks_of(seen: Observations, rays: Flags) -> tuple[Integers, Tracks]:
    """Take some observations, px of the stored grid, as tracks, and give the points that these are of."""
    rows = np.flatnonzero(rays)
    rows = rows[np.argsort(seen.point[rows], kind="stable")]
    points, track = np.unique(seen.point[rows], return_inverse=True)
    return points, Tracks(track, seen.image[rows], seen.values[rows], np.ones(len(rows)))


def marked_control(block: Block) -> Integers:
    """Control points that some image shows."""
    seen = block.observations.point
    return np.unique(seen[block.points.of_role("control")[seen]])


def place(
    block: Block, tracks: Tracks, least_spread: float = LEAST_SPREAD, known: Floats | None = None
) -> Floats:
    """Intersect the rays of tracks, (tracks.count, 3); NaN where they do not meet ahead, or spread.

    known (tracks.count, 3): where they meet, as far as that is known already; NaN elsewhere.
    """
    frame = block_frame(block)
    views = views_of(block, frame)
    points = np.full((tracks.count, 3), np.nan) if known is None else frame.to_local(known)
    met: Flags = np.asarray(np.isfinite(points).all(axis=1))
    if not met.all():
        points = np.where(met[:, None], points, intersected(views, tracks))
    away = points[tracks.track] - views.station[tracks.image]
    ahead = np.einsum("ni,ni->n", views.rotation[tracks.image, 2], away) < 0.0
    points[tracks.track[~ahead]] = np.nan
    with np.errstate(invalid="ignore"):
        points[~(spread(views, tracks, points) >= least_spread)] = np.nan
    return given_places(frame, points)


def rescaled_poses(block: Block, poses: Floats, tracks: Tracks, ratio: Floats) -> Floats:
    """Poses of images whose principal distances become others: as much nearer to what they see."""
    frame = block_frame(block)
    placed = place(replace(block, images=replace(block.images, values=poses)), tracks, 0.0)
    local, points = local_poses(frame, poses), frame.to_local(placed)
    axis = -matrix_from_angles(local[:, :3])[:, 2]
    depth = np.einsum("ni,ni->n", points[tracks.track] - local[tracks.image, 3:], axis[tracks.image])
    usual = np.array([np.nanmedian(depth[tracks.image == k]) for k in range(len(poses))])
    local[:, 3:] += axis * (usual * (1.0 - ratio))[:, None]
    return given_poses(frame, local)


def fitting(block: Block) -> Flags:
    """Rays that fit the start values: a gross error would keep least squares from converging."""
    seen = block.observations
    plane, _ = observed_plane(block)
    frame = block_frame(block)
    camera = block.images.camera[seen.image]
    c = np.array([lens.value("c") for lens in block.cameras])[camera]
    slopes = slopes_of(block.cameras, camera, plane)
    views = views_of(block, frame)
    rotation, station = views.at_lines(seen.image, observed_pixels(block))
    points = frame.to_local(block.points.values)[seen.point]
    miss = ray_residuals(rotation, station, points, slopes) * c
    tie = block.points.role[seen.point] == TIE
    typical = np.nanmedian(np.where(np.isfinite(miss) & tie, miss, np.nan))
    with np.errstate(invalid="ignore"):
        return np.asarray(miss <= UNLIKE * typical)


def intersected(views: OrientedImages, tracks: Tracks) -> Floats:
    """Points where the rays of tracks come closest, local, shape (tracks.count, 3); NaN where they do not."""
    points = np.empty((tracks.count, 3))
    for which, _, some in tracks.pieces():
        ideal, c = views.ideal(some.image, some.pixels)
        rotation, station = views.at_lines(some.image, some.pixels)
        points[which] = intersect(some.track, which.stop - which.start, station, rotation, ideal, c)
    return points


def reprojection_errors(views: OrientedImages, tracks: Tracks, points: Floats) -> Floats:
    """Distance of each ray from where its image should show its point, px; NaN where it cannot."""
    away = np.empty(len(tracks.track))
    for which, rays, some in tracks.pieces():
        shown = views.project(some.image, points[which][some.track])
        away[rays] = np.hypot(*(shown - some.pixels).T)
    return away


def spread(views: OrientedImages, tracks: Tracks, points: Floats) -> Floats:
    """Largest angle of a point's rays from their mean, rad, (tracks.count,); NaN without coordinates."""
    towards = views.station[tracks.image] - points[tracks.track]
    towards = towards / np.linalg.norm(towards, axis=1)[:, None]
    mean = np.column_stack([np.bincount(tracks.track, towards[:, k], tracks.count) for k in range(3)])
    mean = mean / np.linalg.norm(mean, axis=1)[:, None]
    # The chord keeps small angles exact.
    chord = np.linalg.norm(towards - mean[tracks.track], axis=1)
    angle = np.zeros(tracks.count)
    np.maximum.at(angle, tracks.track, 2 * np.arcsin(np.minimum(chord / 2, 1)))
    return angle


def views_of(block: Block, frame: LocalFrame) -> OrientedImages:
    """Give a block's images at their present values in a local frame; NaN where they are not oriented.

    They move during their readout as is known before an adjustment.
    """
    images = block.images
    readout = np.array([camera.value("readout") for camera in block.cameras])[images.camera]
    movement = np.nan_to_num(images.motion) * readout[:, None]
    views = OrientedImages(images.names, block.cameras, images.camera, images.values)
    return replace(views, movement=movement if movement.any() else None).in_local(frame)


def ray_sigmas(scale: Floats, image: Integers, size: Floats, redundancy: Floats) -> Floats:
    """Sigma of a coordinate for each ray: that of its class, times a factor of its image."""
    # Height, light and blur make images differently sharp; with one sigma for all, those that are worse would
    # weigh too much, and what depends on them would seem surer than it is.
    images = int(image.max(initial=-1)) + 1
    seen = redundancy > policy.least_checked
    count = np.bincount(image[seen], minlength=images)
    # An image with fewer rays has the sigmas of all.
    fewest_in_image = 100
    judged = np.flatnonzero(count >= fewest_in_image)
    rays = np.flatnonzero(seen)
    of_image = np.split(rays[np.argsort(image[rays], kind="stable")], np.cumsum(count)[:-1])
    factor = np.ones(images)
    # Classes and images in turn, until neither changes.
    turns, member = 4, _classes(scale)
    for _ in range(turns):
        of_class = _sigma_of_classes(member, size / factor[image], redundancy)
        for k in judged:
            own = of_image[k]
            factor[k] = _sigma_of_the_kept((size[own] / of_class[own]) ** 2, 2 * redundancy[own])
        # Their mean is 1, so that images of few rays have the sigmas of all.
        factor[judged] /= (
            np.exp(np.average(np.log(factor[judged]), weights=count[judged])) if len(judged) else 1
        )
    of_class = _sigma_of_classes(member, size / factor[image], redundancy)
    return np.maximum(of_class * factor[image], FINEST_PX)


def class_sigmas(scale: Floats, size: Floats, redundancy: Floats) -> Floats:
    """Sigma of a coordinate for each ray: of its class of scale, robust against what is still wrong."""
    return _sigma_of_classes(_classes(scale), size, redundancy)


def _classes(scale: Floats) -> Integers:
    """Class of each ray by its scale."""
    classes = int(np.clip(len(scale) // FEWEST_IN_CLASS, 1, CLASSES))
    edges = np.quantile(scale, np.linspace(0, 1, classes + 1)[1:-1])
    return np.asarray(np.searchsorted(edges, scale), dtype=np.int64)


def _sigma_of_classes(member: Integers, size: Floats, redundancy: Floats) -> Floats:
    sigma = np.ones(CLASSES)
    seen = np.where(redundancy > policy.least_checked, member, CLASSES)
    for k in range(CLASSES):
        of_class = np.flatnonzero(seen == k)
        if len(of_class):
            sigma[k] = _sigma_of_the_kept(size[of_class] ** 2, 2 * redundancy[of_class])
    return np.asarray(np.maximum(sigma, FINEST_PX)[member])


def _sigma_of_the_kept(squares: Floats, redundancy: Floats) -> float:
    """Sigma of the rays that stay when those beyond `GROSS` of it are rejected."""
    share = squares / redundancy
    # Such shares are exponential in units of the variance: their median is ln 2 of it.
    variance = float(np.median(share) / np.log(2))
    # It has mostly settled long before.
    rounds, kept = 8, -1
    for _ in range(rounds):
        good = share <= GROSS**2 * variance
        # As many as before of those that fit best are the same.
        before, kept = kept, int(np.count_nonzero(good))
        if kept == before:
            break
        variance = float(squares[good].sum() / redundancy[good].sum())
    return float(np.sqrt(variance))
