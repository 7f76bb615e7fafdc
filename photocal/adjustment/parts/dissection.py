"""Which images of a block belong together, and which ones separate them: nested dissection (George 1973).

A set of images is halved across its length. The fewest images whose removal leaves no common point of both
halves are its separator; each half is halved again, down to parts of some hundred images.
"""

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from scipy.sparse import csr_array
from scipy.sparse.csgraph import maximum_bipartite_matching

from photocal.base.arrays import Flags, Floats, Integers

# Directions that are tried for each cut, and where it is made, as shares of the images.
DIRECTIONS, CUTS = 6, (0.42, 0.5, 0.58)


@dataclass(frozen=True)
class Dissection:
    """A tree of sets of images: parts at its ends, separators above them.

    node (images,): the set of each image. Sets are numbered so that those below come before.
    parent (nodes,): the set above; -1 for the last, which is above all others.
    """

    node: Integers
    parent: Integers

    @cached_property
    def parts(self) -> Integers:
        """The sets with none below, in their order."""
        above = np.zeros(len(self.parent), dtype=np.bool_)
        above[self.parent[self.parent >= 0]] = True
        return np.flatnonzero(~above)

    @cached_property
    def first_part(self) -> Integers:
        """The first place among the parts of those at or below each set, (nodes,)."""
        first = np.full(len(self.parent), len(self.parts))
        first[self.parts] = np.arange(len(self.parts))
        for node, above in enumerate(self.parent):
            if above >= 0:
                first[above] = min(first[above], first[node])
        return first

    @cached_property
    def last_part(self) -> Integers:
        """One past the last of those places, (nodes,)."""
        last = np.zeros(len(self.parent), dtype=np.int64)
        last[self.parts] = 1 + np.arange(len(self.parts))
        for node, above in enumerate(self.parent):
            if above >= 0:
                last[above] = max(last[above], last[node])
        return last

    def children(self, node: int) -> list[int]:
        """List the sets right below one."""
        return [int(below) for below in np.flatnonzero(self.parent == node)]


def dissect(together: csr_array, centre: Floats, most: int) -> Dissection:
    """Divide images into parts with at most so many each, and separators between them.

    together (images, images): pairs that share a point, symmetric.
    centre (images, 3): about where they were taken.
    """
    node, parent = np.full(len(centre), -1), list[int]()
    places = np.nan_to_num(centre)

    def divided(images: Integers) -> int:
        """Number the sets of some images; returns the last, which is above the others."""
        separated = _separated(together, places, images) if len(images) > most else None
        below = [] if separated is None else [divided(half) for half in separated[1:]]
        number = len(parent)
        parent.append(-1)
        for child in below:
            parent[child] = number
        node[images if separated is None else separated[0]] = number
        return number

    divided(np.arange(len(centre)))
    return Dissection(node, np.array(parent, dtype=np.int64))


def _separated(
    together: csr_array, places: Floats, images: Integers
) -> tuple[Integers, Integers, Integers] | None:
    """Separator of some images and the two halves; None where nothing is left of a half."""
    among = together[images][:, images].tocoo()
    row, column = (np.asarray(ends, dtype=np.int64) for ends in among.coords)
    middle = places[images] - places[images].mean(axis=0)
    plane = middle @ np.linalg.svd(middle.T @ middle)[0][:, :2]
    best: tuple[float, Flags] | None = None
    for turn in np.pi / DIRECTIONS * np.arange(DIRECTIONS):
        along = plane @ [np.cos(turn), np.sin(turn)]
        rank = np.empty(len(images), dtype=np.int64)
        rank[np.argsort(along, kind="stable")] = np.arange(len(images))
        for cut in CUTS:
            first = rank < cut * len(images)
            across = row[first[row] & ~first[column]]
            # Of one side, those that share a point with the other: no cover of the cut needs more.
            least = min(len(np.unique(across)), len(np.unique(column[first[row] & ~first[column]])))
            if best is None or least < best[0]:
                best = least, first
    if best is None:
        return None
    first = best[1]
    cover = _cover(row, column, first)
    halves = np.flatnonzero(first & ~cover), np.flatnonzero(~first & ~cover)
    if not len(halves[0]) or not len(halves[1]):
        return None
    return images[np.flatnonzero(cover)], images[halves[0]], images[halves[1]]


def _cover(row: Integers, column: Integers, first: Flags) -> Flags:
    """Fewest images at one end at least of each pair across a cut (Koenig 1931, from a largest matching)."""
    across = first[row] & ~first[column]
    size = len(first)
    pairs = csr_array((np.ones(across.sum()), (row[across], column[across])), shape=(size, size))
    partner = maximum_bipartite_matching(pairs, perm_type="column").astype(np.int64)
    mate = np.full(size, -1)
    matched = np.flatnonzero(partner >= 0)
    mate[partner[matched]] = matched
    reached, frontier = first & (partner < 0), np.flatnonzero(first & (partner < 0))
    touched = np.zeros(size, dtype=np.bool_)
    while len(frontier):
        seen = np.unique(pairs[frontier].indices)
        seen = seen[~touched[seen]]
        touched[seen] = True
        frontier = mate[seen]
        frontier = frontier[(frontier >= 0) & ~reached[frontier]]
        reached[frontier] = True
    left = np.zeros(size, dtype=np.bool_)
    left[row[across]] = True
    return np.asarray((left & first & ~reached) | touched)
