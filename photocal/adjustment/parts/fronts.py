"""Reduced normal equations of the images at the edges of parts: added, eliminated, solved and inverted.

What a part hands on is a front: normal equations of the unknowns that it has in common with others. Fronts of
two neighbours are added; what no other part has is eliminated; what is left is the front of both. So on up to
the whole block (Helmert 1880, Wolf 1978). Covariances come down the same way.
"""

from dataclasses import dataclass

import numpy as np
from scipy.linalg import blas, lapack

from photocal.base.arrays import Floats, Integers


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


def joined(fronts: list[Front]) -> Front:
    """Add the normal equations of several fronts."""
    unknown = np.unique(np.concatenate([front.unknown for front in fronts]))
    size = len(unknown)
    matrix, diagonal = np.zeros((size, size)), np.zeros(size)
    for front in fronts:
        at = np.searchsorted(unknown, front.unknown)
        matrix[np.ix_(at, at)] += front.matrix
        diagonal[at] += front.diagonal
    return Front(unknown, matrix, diagonal)


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
        forward = _solved(self.root, right[at], transposed=False)
        return forward, right[above] - self.below @ forward

    def back(self, forward: Floats, above: Floats) -> Floats:
        """Own unknowns, (k, t), from their forward solution and the unknowns above."""
        return _solved(self.root, forward - self.below.T @ above, transposed=True)

    def covariance(self, above: Floats) -> tuple[Integers, Floats]:
        """Numbers of own unknowns and those above, and their covariance, from that of those above."""
        count, unknown = len(self.own), np.concatenate([self.own, self.above])
        back = lapack.dtrtri(self.root, lower=1)[0] if count else self.root
        scaled = self.below @ back
        product = above @ scaled
        whole = np.empty((len(unknown), len(unknown)))
        whole[:count, :count] = back.T @ back + scaled.T @ product
        whole[count:, :count], whole[:count, count:] = -product, -product.T
        whole[count:, count:] = above
        order = np.argsort(unknown)
        return unknown[order], whole[np.ix_(order, order)]


def _solved(root: Floats, right: Floats, *, transposed: bool) -> Floats:
    if not right.size:
        return right
    return np.asarray(blas.dtrsm(1.0, root, right, lower=1, trans_a=int(transposed)))


def eliminated(front: Front, own: Integers) -> tuple[Level, Front]:
    """Eliminate some unknowns of a front; returns what leads back to them, and the front of all others."""
    mine = np.isin(front.unknown, own)
    here, above = np.flatnonzero(mine), np.flatnonzero(~mine)
    # The lower triangle stays one: of a column that is handed on, some rows may be eliminated.
    first = front.matrix[np.ix_(here, here)]
    across = np.where(
        above[:, None] > here, front.matrix[np.ix_(above, here)], front.matrix[np.ix_(here, above)].T
    )
    left = np.asfortranarray(front.matrix[np.ix_(above, above)])
    weakest, worst, root, below = 1.0, -1, first, across
    if len(here):
        root, info = lapack.dpotrf(np.asfortranarray(first), lower=1, clean=1, overwrite_a=1)
        share = np.diag(root) ** 2 / np.maximum(front.diagonal[here], np.finfo(float).tiny)
        worst = int(np.argmin(share)) if info == 0 else info - 1
        weakest = float(share[worst]) if info == 0 else -1.0
        worst = int(front.unknown[here[worst]])
        if info == 0 and len(above):
            below = blas.dtrsm(
                1.0, root, np.asfortranarray(across), side=1, lower=1, trans_a=1, overwrite_b=1
            )
            left = blas.dsyrk(-1.0, below, beta=1.0, c=left, lower=1, overwrite_c=1)
    level = Level(front.unknown[here], front.unknown[above], root, below, weakest, worst)
    return level, Front(front.unknown[above], left, front.diagonal[above])
