"""What a block in parts will cost: counted from which images share points, before any work is done."""

from dataclasses import dataclass

import numpy as np
from scipy.sparse import csr_array

from photocal.adjustment.layout import order
from photocal.adjustment.parts.dissection import Dissection
from photocal.base.arrays import Floats, Integers

# Columns of an image, bytes of a number.
_WIDE, _BYTES = 6, 8


@dataclass(frozen=True)
class Forecast:
    """Sizes of the equations of a block in parts, of images with six unknowns each.

    inner, reach, border (parts,): inner images of a part; images down to which each of them reaches in the
        band, in the mean; images that it has in common with others.
    own, above (levels,): images of each separator, and those that its front hands on.
    waiting: most numbers of fronts that wait for others at a time.
    shared: unknowns of cameras and mounting.
    """

    inner: Integers
    reach: Floats
    border: Integers
    own: Integers
    above: Integers
    waiting: int
    shared: int

    @property
    def part_factor_flops(self) -> float:
        """Operations that eliminate all parts once."""
        n, b, m = _WIDE * self.inner, _WIDE * self.reach, _WIDE * self.border + self.shared
        return float(np.sum(n * (b + m) ** 2.0))

    @property
    def part_inverse_flops(self) -> float:
        """Operations of the covariances within all parts."""
        n, b, m = _WIDE * self.inner, _WIDE * self.reach, _WIDE * self.border + self.shared
        return float(np.sum(2.0 * n * (b + m) ** 2.0))

    @property
    def upper_factor_flops(self) -> float:
        """Operations that eliminate all separators once."""
        k, m = _WIDE * self.own, _WIDE * self.above + self.shared
        return float(np.sum(k**3.0 / 3 + k**2.0 * m + k * m**2.0))

    @property
    def upper_inverse_flops(self) -> float:
        """Operations of the covariances among all separators."""
        k, m = _WIDE * self.own, _WIDE * self.above + self.shared
        return float(np.sum(k**3.0 + 2.0 * k**2.0 * m + 2.0 * m**2.0 * k))

    @property
    def upper_bytes(self) -> float:
        """What the process that joins the parts holds: factors of all separators, and fronts that wait."""
        k, m = _WIDE * self.own, _WIDE * self.above + self.shared
        # Covariances come down one path of fronts, each with a copy for those below; areas of fronts halve
        # every second time: together about eight of the largest.
        path = 8.0 * np.max((k + m) ** 2.0, initial=0.0)
        return float(_BYTES * (np.sum(k * (k + m)) + max(path, float(self.waiting))))

    @property
    def part_bytes(self) -> Floats:
        """Factor and front of each part."""
        n, b, m = _WIDE * self.inner, _WIDE * self.reach, _WIDE * self.border + self.shared
        return np.asarray(_BYTES * (n * (b + m) + 2.0 * m**2))

    @property
    def traffic_bytes(self) -> float:
        """Fronts of all parts that are handed on, once for each set-up of the equations."""
        return float(_BYTES * np.sum((_WIDE * self.border + self.shared) ** 2.0))


def forecast(together: csr_array, centre: Floats, dissection: Dissection, shared: int = 0) -> Forecast:
    """Count the sizes of a dissected block.

    together, centre: as in `dissect`.
    shared: unknowns that all images have in common.
    """
    parts, parent = dissection.parts, dissection.parent
    own = np.bincount(dissection.node, minlength=len(parent))
    edges = dict[int, Integers]()
    inner, reach, border = [], [], []
    for node in parts:
        images = np.flatnonzero(dissection.node == node)
        seen = np.unique(together[images].indices)
        edges[int(node)] = seen[dissection.node[seen] != node]
        _, last = order(csr_array(together[images][:, images]), centre[images])
        inner.append(len(images))
        reach.append(float(np.mean(last - np.arange(len(last)) + 1.0)) if len(last) else 0.0)
        border.append(len(edges[int(node)]))
    levels, above, waiting, most = [], [], 0, 0
    for node in range(len(parent)):
        below = dissection.children(node)
        if below:
            common = np.unique(np.concatenate([edges.pop(child) for child in below]))
            edges[node] = common[dissection.node[common] != node]
            levels.append(own[node])
            above.append(len(edges[node]))
        # In their order, sets before this one that have handed on and are not yet joined.
        sizes = (_WIDE * len(edge) + shared for done, edge in edges.items() if done <= node < parent[done])
        waiting = sum(size**2 for size in sizes)
        most = max(most, waiting)
    return Forecast(
        np.array(inner),
        np.array(reach),
        np.array(border),
        np.array(levels, dtype=np.int64),
        np.array(above, dtype=np.int64),
        most,
        shared,
    )
