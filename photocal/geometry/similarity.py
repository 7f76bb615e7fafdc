"""Similarity transformation between two systems of places in space."""

from dataclasses import dataclass

import numpy as np

from photocal.base.arrays import Flags, Floats

FEWEST = 3
# Triples that a robust similarity is sought among, and beyond how many medians a place does not fit it.
SAMPLES, STRAY = 300, 4.0


@dataclass(frozen=True)
class Similarity:
    """X' = s R X + t.

    rotation (3, 3).
    shift (3,).
    """

    scale: float
    rotation: Floats
    shift: Floats

    def applied(self, places: Floats) -> Floats:
        """Transformed places, shape (..., 3)."""
        return np.asarray(self.scale * places @ self.rotation.T + self.shift)

    def applied_to_rotations(self, matrices: Floats) -> Floats:
        """Rotations from the new system to camera axes, from those of the old one, shape (..., 3, 3)."""
        return np.asarray(matrices @ self.rotation.T)


def similarity(source: Floats, target: Floats) -> Similarity | None:
    """Similarity that brings one set of places closest to another (Umeyama 1991, eq. 40-42).

    source, target (n, 3).

    returns: none for fewer than three places, or places in a line.
    """
    # Places whose second extent is a smaller share of their first lie too close to a line.
    line_share = 0.02
    if len(source) < FEWEST:
        return None
    middle, goal = source.mean(axis=0), target.mean(axis=0)
    a, b = source - middle, target - goal
    for extent in (np.linalg.svd(a, compute_uv=False), np.linalg.svd(b, compute_uv=False)):
        if not extent[1] > line_share * extent[0]:
            return None
    u, singular, vt = np.linalg.svd(b.T @ a)
    sign = np.array([1.0, 1.0, np.sign(np.linalg.det(u @ vt))])
    rotation = (u * sign) @ vt
    scale = float(np.sum(singular * sign) / np.sum(a**2))
    return Similarity(scale, rotation, goal - scale * rotation @ middle)


def robust_similarity(source: Floats, target: Floats) -> tuple[Similarity, Flags] | None:
    """Similarity of least sum of misses among those of triples and of all, and the places that fit it.

    returns: fitted to the places that fit; None as in `similarity`.
    """
    count = len(source)
    rng = np.random.default_rng(count)
    choices = [np.arange(count)]
    if count > FEWEST:
        choices += [rng.choice(count, FEWEST, replace=False) for _ in range(SAMPLES)]
    moves = [move for chosen in choices if (move := similarity(source[chosen], target[chosen])) is not None]
    if not moves:
        return None
    best = min(moves, key=lambda move: float(misses_of(move, source, target).sum()))
    fits = np.ones(count, dtype=np.bool_)
    for _ in range(5):
        miss = misses_of(best, source, target)
        least = 1e-9 * float(np.ptp(target))
        fits = miss <= max(STRAY * float(np.median(miss)), least) if count > FEWEST + 1 else fits
        best = similarity(source[fits], target[fits]) or best
    return best, fits


def misses_of(move: Similarity, source: Floats, target: Floats) -> Floats:
    """Distance of each place from where a similarity takes it, shape (n,)."""
    return np.asarray(np.linalg.norm(move.applied(source) - target, axis=1))


def aligned_similarity(
    source: Floats, target: Floats, axes: Floats, goals: Floats, weight: float
) -> Similarity:
    """Similarity of places that need not determine it: directions help with the rotation.

    source, target (n, 3): one place and more.
    axes, goals (k, 3): directions in both systems.
    weight: of a direction beside those of the places, m squared.
    returns: of scale 1 where the places do not tell it.
    """
    middle, goal = source.mean(axis=0), target.mean(axis=0)
    a, b = source - middle, target - goal
    size = float(np.sum(a**2))
    scale = float(np.sqrt(np.sum(b**2) / size)) if size > 0 and np.sum(b**2) > 0 else 1.0
    u, _, vt = np.linalg.svd(scale * b.T @ a + weight * goals.T @ axes)
    rotation = (u * [1.0, 1.0, np.sign(np.linalg.det(u @ vt))]) @ vt
    return Similarity(scale, rotation, goal - scale * rotation @ middle)
