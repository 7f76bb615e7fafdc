"""Tracks: the same place in many images, joined from matches of pairs."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.sparse import coo_matrix, csr_array

from photocal.base.arrays import Columns, Flags, Floats, Integers
from photocal.measurement.features import Features


@dataclass(frozen=True)
class Tracks(Columns):
    """Rays of tie points, sorted by track, then by image.

    track, image (n,).
    pixels (n, 2).
    scale (n,): what its precision depends on: diameter of the feature, or sigma of the match, px.
    conflicts: tracks that were taken out because they had two places in one image.
    """

    track: Integers
    image: Integers
    pixels: Floats
    scale: Floats
    conflicts: int = 0

    @property
    def count(self) -> int:
        """Number of tracks."""
        return int(self.track[-1]) + 1 if len(self.track) else 0

    @property
    def rays(self) -> Integers:
        """Number of rays of each track, shape (count,)."""
        return np.bincount(self.track, minlength=self.count)

    def some(self, rays: Flags, fewest: int = 2) -> "Tracks":
        """Keep some of the rays, and of those the tracks with enough of them; tracks are numbered anew."""
        left = np.bincount(self.track[rays], minlength=self.count)
        stay = left >= fewest
        # Of millions of rays a copy of the same takes hundreds of megabytes.
        if rays.all() and stay.all():
            return self
        keep = rays & stay[self.track]
        return replace(self.rows(keep), track=(np.cumsum(stay) - 1)[self.track[keep]])

    def pieces(self) -> Iterator[tuple[slice, slice, "Tracks"]]:
        """The tracks in pieces: which tracks, which rays, and these by themselves.

        What is computed of each ray takes some hundred bytes: of all at once that is gigabytes.
        """
        most_rays = 250_000
        ends = np.cumsum(self.rays)
        first, done = 0, 0
        while first < len(ends):
            last = max(first + 1, int(np.searchsorted(ends, done + most_rays, side="right")))
            rays = slice(done, int(ends[last - 1]))
            some = self.rows(rays)
            yield slice(first, last), rays, replace(some, track=some.track - first)
            first, done = last, rays.stop


def join_tracks(features: Sequence[Features], pairs: Integers, matches: Sequence[Integers]) -> Tracks:
    """Join matches of pairs to tracks; those with two places in one image are taken out."""
    from scipy.sparse.csgraph import connected_components

    offset = np.r_[0, np.cumsum([len(f.pixels) for f in features])]
    total = int(offset[-1])
    place = np.concatenate([_places(f) + o for f, o in zip(features, offset[:-1], strict=True)])
    first = [place[offset[a] + m[:, 0]] for (a, _), m in zip(pairs, matches, strict=True)]
    second = [place[offset[b] + m[:, 1]] for (_, b), m in zip(pairs, matches, strict=True)]
    ends = np.array([np.concatenate([place[:0], *of_pairs]) for of_pairs in (first, second)])
    graph = coo_matrix((np.ones(len(ends[0]), dtype=np.int8), (ends[0], ends[1])), shape=(total, total))
    _, label = connected_components(graph, directed=False)
    matched = np.zeros(total, dtype=np.bool_)
    matched[ends] = True
    used = np.flatnonzero(matched)
    image = np.searchsorted(offset, used, side="right") - 1
    joined = np.zeros(int(label.max(initial=-1)) + 1, dtype=np.bool_)
    joined[label[used]] = True
    track = (np.cumsum(joined) - 1)[label[used]]
    pixels = np.concatenate([f.pixels for f in features]).astype(float)[used]
    scale = np.concatenate([f.scale for f in features]).astype(float)[used]
    order = np.lexsort((image, track))
    track, image = track[order], image[order].astype(np.int64)
    twice = np.flatnonzero((np.diff(track) == 0) & (np.diff(image) == 0))
    bad = np.zeros(int(track.max(initial=-1)) + 1, dtype=np.bool_)
    bad[track[twice]] = True
    tracks = Tracks(track, image, pixels[order], scale[order], int(np.count_nonzero(bad)))
    return tracks.some(~bad[track])


def in_common(tracks: Tracks, pairs: Integers, images: int) -> Integers:
    """Number of tracks that both images of each pair show, shape (n,)."""
    if not len(pairs) or not tracks.count:
        return np.zeros(len(pairs), dtype=np.int64)
    rays = np.ones(len(tracks.image), dtype=np.int32)
    seen = csr_array((rays, (tracks.image, tracks.track)), shape=(images, tracks.count))
    return np.asarray((seen @ seen.T)[pairs[:, 0], pairs[:, 1]], dtype=np.int64).ravel()


def without_twins(tracks: Tracks, apart_px: float) -> Tracks:
    """Take out tracks that show a place again that a track with more rays shows."""
    rank = np.empty(tracks.count, dtype=np.int64)
    rank[np.argsort(-tracks.rays, kind="stable")] = np.arange(tracks.count)
    rows = np.column_stack([tracks.image, np.floor(tracks.pixels / apart_px).astype(np.int64)])
    cell = np.unique(_numbered(rows), return_inverse=True)[1]
    first = np.full(int(cell.max(initial=-1)) + 1, tracks.count, dtype=np.int64)
    np.minimum.at(first, cell, rank[tracks.track])
    twin = np.zeros(tracks.count, dtype=np.bool_)
    twin[tracks.track[first[cell] < rank[tracks.track]]] = True
    return tracks.some(~twin[tracks.track])


def of_images(tracks: Tracks, keep: Flags) -> Tracks:
    """Rays in some of the images only, which are numbered anew; `keep` (images,)."""
    left = tracks.some(keep[tracks.image])
    if keep.all():
        return left
    return replace(left, image=(np.cumsum(keep) - 1)[left.image])


def _places(features: Features) -> Integers:
    """For each feature the first one of its image at the same place."""
    # Features with several directions stand at one place: they are one.
    same_px = 0.25
    key = np.round(features.pixels / same_px).astype(np.int64)
    _, first, inverse = np.unique(_numbered(key), return_index=True, return_inverse=True)
    return np.asarray(first[inverse], dtype=np.int64)


def _numbered(rows: Integers) -> Integers:
    """A number for each row, the same for equal rows: to sort rows themselves takes ten times as long."""
    low = rows.min(axis=0, initial=0)
    number = np.zeros(len(rows), dtype=np.int64)
    for column, size in zip((rows - low).T, rows.max(axis=0, initial=0) - low + 1, strict=True):
        number = number * size + column
    return number
