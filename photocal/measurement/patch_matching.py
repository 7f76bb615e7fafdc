"""Tie points measured again by least squares matching, once the images are oriented.

Features are found to about half a pixel of their own scale. With the orientation known, the surroundings of a
tie point in one of its images are carried over to all images that should show it, and matched there by least
squares on the full images: the rays become precise, and rays that the features missed are found.
"""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from photocal.base.arrays import Columns, Flags, Floats, Integers
from photocal.base.workers import Workers, run_tasks
from photocal.geometry.oriented_images import OrientedImages
from photocal.measurement.features import Arrays, Floats32, array_key, cached, combined_key, kept
from photocal.measurement.image_file import as_eight_bit, read_grey
from photocal.measurement.tracks import Tracks

# Raised whenever the meaning of cached results changes.
VERSION = 3
# Patches of 21 x 21 pixels: their outermost ring serves the derivatives.
HALF = 11
# Before matching, images are smoothed, over so many pixels: aliasing would bias the places.
SMOOTHING_PX, _SMOOTHED_PX = 0.8, 7
# Views of a surface that differ by more than 65 degrees or a factor of two do not look alike. Strips with a
# side overlap of a fifth see it from 60 degrees apart, by the usual lens of 74 degrees.
_COS_APART, _ZOOM = 0.42, 2.0


@dataclass(frozen=True)
class ImageSource:
    """An image, the digest of its content, where results are kept, and how many times it is halved."""

    path: Path
    key: str
    cache: Path
    level: int = 0

    def key_of(self, kind: str, *given: Floats | Integers) -> str:
        """Key of what is measured in the image by given numbers."""
        return combined_key(VERSION, kind, self.key, self.level, array_key(*given))


@dataclass(frozen=True)
class _Rays(Columns):
    """Where to look for which track in which image: place and affinity from its patch, px."""

    track: Integers
    image: Integers
    place: Floats
    affinity: Floats


# An image, and the middles of the patches to be cut there; the key that they are kept by comes first.
_Cut = tuple[str, ImageSource, Floats]


@dataclass(frozen=True)
class _Patches:
    """The patches of some rays: for each, which of the cuts has it, and in which row."""

    cuts: Sequence[_Cut]
    cut: Integers
    row: Integers

    def read(self) -> Floats32:
        """Read them, shape (n, 23, 23)."""
        patches = np.empty((len(self.row), 2 * HALF + 1, 2 * HALF + 1), dtype=np.float32)
        for k, cut in enumerate(self.cuts):
            own = self.cut == k
            patches[own] = _cut_patches(cut)[self.row[own]]
        return patches


@dataclass(frozen=True)
class _Surface:
    """The surface at each track, as its reference image shows it.

    image (n,), middle (n, 2): reference image, and the middle of the pixel there.
    anchor (n, 3), axes (n, 2, 3): the place that it shows, and steps on the surface.
    to_axes (n, 2, 2): steps for each pixel of the reference image.
    towards (n, 3): direction to it.
    """

    image: Integers
    middle: Floats
    anchor: Floats
    axes: Floats
    to_axes: Floats
    towards: Floats


def refine(
    sources: Sequence[ImageSource],
    views: OrientedImages,
    tracks: Tracks,
    points: Floats,
    partners: Sequence[Integers],
    processes: Workers,
    done: Callable[[float], None],
    level: int = 0,
) -> Tracks:
    """Measure tracks again, in all images that should show them.

    level: how many times images are halved, where places are not known well enough: features of very large
        images are found in reduced ones; in the stored pixels they are off by more than matching reaches.
    """
    if level:
        sizes = [camera.size_px for camera in views.cameras]
        small = [_halved(size, level) for size in sizes]
        zoom = np.array([(w / v, h / u) for (w, h), (v, u) in zip(sizes, small, strict=True)])
        cameras = tuple(
            replace(camera, size_px=size, pitch=(camera.pitch[0] * x, camera.pitch[1] * y))
            for camera, size, (x, y) in zip(views.cameras, small, zoom.tolist(), strict=True)
        )
        factor = zoom[views.camera]
        reduced = replace(tracks, pixels=(tracks.pixels + 0.5) / factor[tracks.image] - 0.5)
        halved = [replace(source, level=level) for source in sources]
        found = refine(halved, replace(views, cameras=cameras), reduced, points, partners, processes, done)
        back = factor[found.image]
        return replace(found, pixels=(found.pixels + 0.5) * back - 0.5, scale=found.scale * back.mean(axis=1))
    surface = _surface(views, tracks, points)
    inside = _inside(surface.middle, views.sizes()[surface.image])
    cuts, row = list[_Cut](), np.zeros(tracks.count, dtype=np.int64)
    for k, source in enumerate(sources):
        own = (surface.image == k) & inside
        row[own] = np.arange(np.count_nonzero(own))
        cuts.append((source.key_of("patches", surface.middle[own]), source, surface.middle[own]))
    # Each picture is matched with the patches of others: they are kept, and read where they are used. All of
    # them would take two kilobytes a track here, and pass through here for each ray.
    list(run_tasks(_keep_patches, cuts, processes, done, _at_hand))

    by_image = np.argsort(tracks.image, kind="stable")
    ends = np.cumsum(np.bincount(tracks.image, minlength=len(sources)))[:-1]
    shown = np.split(tracks.track[by_image], ends)
    # A patch is known by its picture and its middle: its pixels are many times as much to digest.
    picture = np.array([int(combined_key(source.key)[:15], 16) for source in sources])[surface.image]

    def jobs() -> Iterator[tuple[str, ImageSource, tuple[_Rays, _Patches]]]:
        """Give the work of each image: its own rays and those of its partners."""
        # Image by image, while others are matched: all rays at once would need more memory than pictures do.
        for k, source in enumerate(sources):
            near = np.zeros(tracks.count, dtype=np.bool_)
            for partner in (*partners[k], k):
                near[shown[partner]] = True
            rays = _expected(views, k, np.flatnonzero(near & inside & (surface.image != k)), surface)
            of_patches = picture[rays.track], surface.middle[rays.track]
            key = source.key_of("matched", rays.place, rays.affinity, *of_patches)
            shown_by, reference = np.unique(surface.image[rays.track], return_inverse=True)
            yield key, source, (rays, _Patches([cuts[j] for j in shown_by], reference, row[rays.track]))

    refined = list(run_tasks(_match_image, jobs(), processes, done, _at_hand))
    inner = np.flatnonzero(inside)
    return _joined(refined, inner, surface.image[inner], surface.middle[inner], tracks.conflicts)


def _halved(size: tuple[int, int], level: int) -> tuple[int, int]:
    return max(1, round(size[0] / 2**level)), max(1, round(size[1] / 2**level))


def _directions(views: OrientedImages, image: Integers, xyz: Floats) -> Floats:
    towards = views.station[image] - xyz
    return np.asarray(towards / np.linalg.norm(towards, axis=1)[:, None])


def _surface(views: OrientedImages, tracks: Tracks, points: Floats) -> _Surface:
    """Where the images that look straightest at the tracks show them, in the middle of a pixel."""
    towards = _directions(views, tracks.image, points[tracks.track])
    mean = np.column_stack([np.bincount(tracks.track, towards[:, k], tracks.count) for k in range(3)])
    # Two rays are as near to their mean: the first one, and not the one that rounding would choose.
    along = np.round(np.einsum("nk,nk->n", towards, mean[tracks.track]), 9)
    order = np.lexsort((-along, tracks.track))
    reference = order[np.r_[True, np.diff(tracks.track[order]) > 0]]
    middle, image = np.round(tracks.pixels[reference]), tracks.image[reference]
    # The surface at a track is taken as square to the mean direction to its images.
    normal = mean / np.linalg.norm(mean, axis=1)[:, None]
    least = np.eye(3)[np.abs(normal).argmin(axis=1)]
    first = np.cross(normal, least)
    first = first / np.linalg.norm(first, axis=1)[:, None]
    distance = np.linalg.norm(views.station[image] - points, axis=1)
    # Steps of about a pixel or a few keep the differences within the local linearity.
    axes = np.stack([first, np.cross(normal, first)], axis=1) * (1e-3 * distance)[:, None, None]
    place = views.project(image, points)
    slopes = _jacobians(views, image, points, axes, place)
    steps = np.linalg.solve(slopes, (middle - place)[..., None])[..., 0]
    anchor = points + np.einsum("nk,nkj->nj", steps, axes)
    slopes = _jacobians(views, image, anchor, axes, views.project(image, anchor))
    to_axes = np.asarray(np.linalg.inv(slopes), dtype=np.float64)
    return _Surface(image, middle, anchor, axes, to_axes, _directions(views, image, anchor))


def _jacobians(views: OrientedImages, image: Integers, xyz: Floats, axes: Floats, place: Floats) -> Floats:
    """Pixels per step along the axes of the surface, shape (n, 2, 2); place: where images show the points."""
    # Of a step of some pixels: as small, the difference ahead is exact to its sixth digit.
    part = 1e-3
    ahead = [(views.project(image, xyz + part * axes[:, k]) - place) / part for k in (0, 1)]
    return np.stack(ahead, axis=2)


def _expected(views: OrientedImages, number: int, track: Integers, surface: _Surface) -> _Rays:
    """Where an image should show tracks."""
    image = np.full(len(track), number)
    anchor = surface.anchor[track]
    place = views.project(image, anchor)
    with np.errstate(invalid="ignore"):
        seen = _inside(place, views.sizes()[image])
    seen &= np.einsum("nk,nk->n", _directions(views, image, anchor), surface.towards[track]) > _COS_APART
    track, image, place, anchor = track[seen], image[seen], place[seen], anchor[seen]
    affinity = _jacobians(views, image, anchor, surface.axes[track], place) @ surface.to_axes[track]
    with np.errstate(invalid="ignore"):
        zoom = np.sqrt(np.abs(np.linalg.det(affinity)))
    alike = np.isfinite(affinity).all(axis=(1, 2)) & (zoom < _ZOOM) & (zoom > 1 / _ZOOM)
    return _Rays(track, image, place, affinity).rows(alike)


def _inside(place: Floats, size: Floats) -> Flags:
    # Pixels beyond the patch, for its interpolation.
    border_px = 2
    border = HALF + border_px
    return np.asarray(((place >= border) & (place <= size - 1 - border)).all(axis=1))


def _smoothed(source: ImageSource) -> Floats32:
    import cv2

    grey = as_eight_bit(read_grey(source.path))
    height, width = grey.shape
    small = _halved((width, height), source.level)
    reduced = cv2.resize(grey.astype("f4"), small, interpolation=cv2.INTER_AREA) if source.level else grey
    weights = cv2.getGaussianKernel(_SMOOTHED_PX, SMOOTHING_PX, cv2.CV_32F)
    return np.asarray(cv2.sepFilter2D(reduced, cv2.CV_32F, weights, weights), dtype=np.float32)


def _at_hand(task: tuple[str, ImageSource, object]) -> bool:
    key, source, _ = task
    return kept(source.cache, key)


def _keep_patches(task: _Cut) -> None:
    key, source, _ = task
    if not kept(source.cache, key):
        _cut_patches(task)


def _cut_patches(task: _Cut) -> Floats32:
    """The patches around some places of an image; from the cache, where they are kept."""
    key, source, middle = task
    side = np.arange(-HALF, HALF + 1)
    if not len(middle):
        return np.zeros((0, len(side), len(side)), dtype=np.float32)
    column, row = middle.astype(np.int64).T

    def make() -> Arrays:
        """Cut them."""
        image = _smoothed(source)
        return {"patches": image[row[:, None, None] + side[None, :, None], column[:, None, None] + side]}

    return np.asarray(cached(source.cache, key, ("patches",), make)["patches"], dtype=np.float32)


def _match_image(task: tuple[str, ImageSource, tuple[_Rays, _Patches]]) -> Tracks:
    """Rays that were matched, with their sigmas as scale."""
    key, source, (rays, patches) = task
    if not len(rays.track):
        return Tracks(rays.track, rays.image, rays.place, np.zeros(0))

    names = ("index", "pixels", "sigma")
    held = cached(source.cache, key, names, lambda: _matched(_smoothed(source), rays, patches.read()))
    index = held["index"]
    return Tracks(rays.track[index], rays.image[index], held["pixels"], held["sigma"])


def _matched(image: Floats32, rays: _Rays, patches: Floats32) -> Arrays:
    from photocal.measurement.patch_kernel import match_patches

    count = len(rays.track)
    places, likeness, covariance = np.empty((count, 2)), np.empty(count), np.zeros((count, 2, 2))
    # A match must settle as near as this to where it was expected.
    farthest_px = 4.0
    match_patches(patches, image, rays.place, rays.affinity, farthest_px, places, likeness, covariance)
    sigma = np.sqrt(np.trace(covariance, axis1=1, axis2=2) / 2)
    # A match must be as like as this.
    least_likeness = 0.8
    # A place is measured, not guessed, when its noise allows this sigma.
    coarsest_px = 0.5
    good = np.isfinite(places).all(axis=1) & (likeness >= least_likeness) & (sigma < coarsest_px)
    return {"index": np.flatnonzero(good), "pixels": places[good], "sigma": sigma[good]}


def _joined(
    refined: list[Tracks], kept: Integers, reference: Integers, middle: Floats, conflicts: int
) -> Tracks:
    """Join the rays of all images, which are taken out of `refined`: of many images they fill the memory."""
    tracks = [kept, *(one.track for one in refined)]
    images = [reference, *(one.image for one in refined)]
    pixels = [middle, *(one.pixels for one in refined)]
    sigmas = [np.full(len(kept), np.nan), *(one.scale for one in refined)]
    refined.clear()
    track, sigma = _whole(tracks), _whole(sigmas)
    # The reference ray is as sure as its matches: their median.
    order = np.lexsort((sigma, track))
    rays = np.bincount(track, minlength=int(track.max(initial=-1)) + 1)
    matched = rays - 1
    start = np.r_[0, np.cumsum(rays)[:-1]]
    usable = matched[kept] > 0
    middle_ray = order[np.minimum(start[kept] + matched[kept] // 2, len(order) - 1)]
    sigma[: len(kept)] = np.where(usable, sigma[middle_ray], np.inf)
    # A track of one ray is none; the others are numbered anew.
    fewest = 2
    stay = rays >= fewest
    image = _whole(images)
    order = np.lexsort((image, track))
    order = order[stay[track[order]]]
    track, image, sigma = (np.cumsum(stay) - 1)[track[order]], image[order], sigma[order]
    return Tracks(track, image, _whole(pixels)[order], sigma, conflicts)


def _whole(parts: list[NDArray[Any]]) -> NDArray[Any]:
    """Parts as one array; they are taken out of the list."""
    whole = np.concatenate(parts)
    parts.clear()
    return whole
