"""Reduced normal equations of the images at the edges of parts: added, eliminated, solved and inverted.

What a part hands on is a front: normal equations of the unknowns that it has in common with others. Fronts of
two neighbours are added; what no other part has is eliminated; what is left is the front of both. So on up to
the whole block (Helmert 1880, Wolf 1978). Covariances come down the same way.
"""

from collections.abc import Callable
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from scipy.linalg import blas, lapack

from photocal.base.arrays import Flags, Floats, Integers


@dataclass(frozen=True)
class Front:
    """Normal equations of unknowns that several parts have.

    unknown (m,): their numbers, growing.
    matrix (m, m): below the diagonal and on it.
    diagonal (m,): of the matrix before anything was eliminated.
    """

    unknown: Integers
    matrix: Floats
    diagonal: Floats


@dataclass(frozen=True)
class Joined:
    """The sum of fronts, with the unknowns that no other front has apart from those that are handed on.

    own (k,), above (m,): their numbers, growing.
    root (k, k), below (m, k), left (m, m): the matrix, of root and left below the diagonal and on it.
    own_diagonal, above_diagonal: as in `Front`.
    """

    own: Integers
    above: Integers
    root: Floats
    below: Floats
    left: Floats
    own_diagonal: Floats
    above_diagonal: Floats


def joined(fronts: list[Front], is_own: Callable[[Integers], Flags]) -> Joined:
    """Add the normal equations of several fronts.

    is_own: which unknowns, by number, are eliminated from the sum.
    """
    unknown = np.unique(np.concatenate([front.unknown for front in fronts]))
    mine = is_own(unknown)
    own, above = unknown[mine], unknown[~mine]
    count, rest = len(own), len(above)
    sum_ = Joined(
        own,
        above,
        np.zeros((count, count)),
        np.zeros((rest, count)),
        np.zeros((rest, rest)),
        np.zeros(count),
        np.zeros(rest),
    )
    place = np.empty(len(unknown), dtype=np.int64)
    place[mine], place[~mine] = np.arange(count), count + np.arange(rest)
    for front in fronts:
        at = place[np.searchsorted(unknown, front.unknown)]
        _add(sum_, front, at)
        here = at < count
        sum_.own_diagonal[at[here]] += front.diagonal[here]
        sum_.above_diagonal[at[~here] - count] += front.diagonal[~here]
    return sum_


def _add(sum_: Joined, front: Front, at: Integers) -> None:
    """Add the lower triangle of a front, by runs of unknowns that stand together in both."""
    count = len(sum_.own)
    breaks = np.flatnonzero((np.diff(at) != 1) | ((at[1:] >= count) & (at[:-1] < count)))
    runs = [slice(*ends) for ends in pairwise([0, *(breaks + 1).tolist(), len(at)])]
    places = [(int(at[run.start]), int(at[run.stop - 1]) + 1) for run in runs]
    for i, (rows, (top, foot)) in enumerate(zip(runs, places, strict=True)):
        for columns, (left, right) in zip(runs[: i + 1], places, strict=False):
            block = front.matrix[rows, columns]
            # What stands below the diagonal in the front may stand above it in the sum.
            (a, b), (c, d) = ((top, foot), (left, right)) if top >= left else ((left, right), (top, foot))
            turned = block if top >= left else block.T
            if a < count:
                sum_.root[a:b, c:d] += turned
            elif c < count:
                sum_.below[a - count : b - count, c:d] += turned
            else:
                sum_.left[a - count : b - count, c - count : d - count] += turned


@dataclass(frozen=True)
class Level:
    """What is left of a front whose own unknowns have been eliminated, for the way back.

    own, above: numbers of the unknowns that were eliminated, and of those that were handed on.
    root (k, k), below (m, k): Cholesky factor of the former, and the rows of the latter under it.
    weakest: smallest share of an element of the diagonal that was left when all before it were eliminated; -1
        where the matrix is not positive definite.
    worst: number of the unknown where that was.
    """

    own: Integers
    above: Integers
    root: Floats
    below: Floats
    weakest: float
    worst: int

    def reduced(self, unknown: Integers, right: Floats) -> tuple[Floats, Floats]:
        """Forward solution of own unknowns, (k, t), and what of right-hand sides is left above, (m, t)."""
        at, above = np.searchsorted(unknown, self.own), np.searchsorted(unknown, self.above)
        forward = self._solved(right[at], back=False)
        return forward, right[above] - self.below @ forward

    def back(self, forward: Floats, above: Floats) -> Floats:
        """Own unknowns, (k, t), from their forward solution and the unknowns above."""
        return self._solved(forward - self.below.T @ above, back=True)

    def _solved(self, right: Floats, *, back: bool) -> Floats:
        if not right.size:
            return right
        return np.asarray(blas.dtrsm(1.0, self.root.T, right, lower=0, trans_a=int(not back)))

    def covariance(self, above: Floats) -> tuple[Integers, Floats]:
        """Numbers of own unknowns and those above, and their covariance, from that of those above."""
        count, size = len(self.own), len(self.own) + len(self.above)
        whole = np.empty((size, size))
        whole[count:, count:] = above
        if count:
            back = lapack.dtrtri(self.root.T, lower=0)[0].T
            scaled = self.below @ back
            product = above @ scaled
            whole[:count, :count] = back.T @ back + scaled.T @ product
            whole[count:, :count] = -product
            whole[:count, count:] = -product.T
        return np.concatenate([self.own, self.above]), whole


def eliminated(front: Joined) -> tuple[Level, Front]:
    """Eliminate own unknowns, in their place; returns what leads back, and the front of all others."""
    count, root, below, left = len(front.own), front.root, front.below, front.left
    weakest, worst = 1.0, -1
    if count:
        # The transposed view of a C array is what Fortran takes; its upper factor is our lower one.
        factor, info = lapack.dpotrf(root.T, lower=0, clean=1, overwrite_a=1)
        root = factor.T
        share = np.diag(root) ** 2 / np.maximum(front.own_diagonal, np.finfo(float).tiny)
        at = int(np.argmin(share)) if info == 0 else info - 1
        weakest, worst = float(share[at]) if info == 0 else -1.0, int(front.own[at])
        if info == 0 and len(front.above):
            below = blas.dtrsm(1.0, root.T, below.T, lower=0, trans_a=1, overwrite_b=1).T
            left = blas.dsyrk(-1.0, below.T, beta=1.0, c=left.T, trans=1, lower=0, overwrite_c=1).T
    level = Level(front.own, front.above, root, below, weakest, worst)
    return level, Front(front.above, left, front.above_diagonal)
