"""Sigmas of tie points from the residuals of their adjustment: of a ray's class and of its image."""

from __future__ import annotations

import numpy as np

from drivers.arrays import Floats, Integers

# A ray is wrong when its residual exceeds so many of its standard deviations.
GROSS = 3.5
# Rays of a kind have one sigma: classes of feature scale, or of the precision of the match.
CLASSES, FEWEST_IN_CLASS = 8, 200
FINEST_PX = 0.02
# An image with fewer rays has the sigmas of all.
FEWEST_IN_IMAGE = 100
_ROUNDS = 8
# Classes and images in turn, until neither changes.
_TURNS = 4
# Of errors with less redundancy nothing shows.
_SEEN = 0.05


def ray_sigmas(scale: Floats, image: Integers, size: Floats, redundancy: Floats) -> Floats:
    """Sigma of a coordinate for each ray: that of its class, times a factor of its image.

    Height, light and blur make images differently sharp; with one sigma for all, those that are worse would
    weigh too much, and what depends on them would seem surer than it is.
    """
    images = int(image.max(initial=-1)) + 1
    seen = redundancy > _SEEN
    count = np.bincount(image[seen], minlength=images)
    judged = np.flatnonzero(count >= FEWEST_IN_IMAGE)
    factor = np.ones(images)
    for _ in range(_TURNS):
        of_class = class_sigmas(scale, size / factor[image], redundancy)
        for k in judged:
            mine = (image == k) & seen
            factor[k] = _sigma_of_the_kept((size[mine] / of_class[mine]) ** 2, 2 * redundancy[mine])
        # Their mean is 1, so that images of few rays have the sigmas of all.
        factor[judged] /= (
            np.exp(np.average(np.log(factor[judged]), weights=count[judged])) if len(judged) else 1
        )
    of_class = class_sigmas(scale, size / factor[image], redundancy)
    return np.maximum(of_class * factor[image], FINEST_PX)


def class_sigmas(scale: Floats, size: Floats, redundancy: Floats) -> Floats:
    """Sigma of a coordinate for each ray: of its class of scale, robust against what is still wrong."""
    classes = int(np.clip(len(scale) // FEWEST_IN_CLASS, 1, CLASSES))
    edges = np.quantile(scale, np.linspace(0, 1, classes + 1)[1:-1])
    member = np.searchsorted(edges, scale)
    sigma = np.ones(len(scale))
    for k in range(classes):
        mine = (member == k) & (redundancy > _SEEN)
        if mine.any():
            sigma[member == k] = _sigma_of_the_kept(size[mine] ** 2, 2 * redundancy[mine])
    return np.maximum(sigma, FINEST_PX)


def _sigma_of_the_kept(squares: Floats, redundancy: Floats) -> float:
    """Sigma of the rays that stay when those beyond `GROSS` of it are rejected."""
    share = squares / redundancy
    # Such shares are exponential in units of the variance: their median is ln 2 of it.
    variance = float(np.median(share) / np.log(2))
    for _ in range(_ROUNDS):
        good = share <= GROSS**2 * variance
        variance = float(squares[good].sum() / redundancy[good].sum())
    return float(np.sqrt(variance))
