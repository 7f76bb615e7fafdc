"""Similarity transformation between two systems of places in space."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]

# Places whose second extent is a smaller share of their first lie too close to a line.
LINE = 0.02


@dataclass(frozen=True)
class Similarity:
    """X' = s R X + t.

    Attributes
    ----------
    rotation : ndarray, shape (3, 3)
    shift : ndarray, shape (3,)
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

    Parameters
    ----------
    source, target : ndarray, shape (n, 3)

    Returns
    -------
    Similarity or None
        None for fewer than three places, or places in a line.
    """
    if len(source) < 3:
        return None
    middle, goal = source.mean(axis=0), target.mean(axis=0)
    a, b = source - middle, target - goal
    for extent in (np.linalg.svd(a, compute_uv=False), np.linalg.svd(b, compute_uv=False)):
        if not extent[1] > LINE * extent[0]:
            return None
    u, singular, vt = np.linalg.svd(b.T @ a)
    sign = np.array([1.0, 1.0, np.sign(np.linalg.det(u @ vt))])
    rotation = (u * sign) @ vt
    scale = float(np.sum(singular * sign) / np.sum(a**2))
    return Similarity(scale, rotation, goal - scale * rotation @ middle)
