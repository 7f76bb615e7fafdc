"""How well the rays of each image and of each point fit and check each other."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from photocal.adjustment.network import Network
from photocal.adjustment.solution import Solution

Floats = NDArray[np.float64]
Integers = NDArray[np.int64]


@dataclass(frozen=True)
class RayStatistics:
    """Statistics of the rays of images, or of points.

    Attributes
    ----------
    rays : ndarray of int, shape (n,)
    rms : ndarray, shape (n, 2)
        Root mean square of the residuals in x and y, in the unit of the image plane; NaN without rays.
    redundancy : ndarray, shape (n,)
        Mean redundancy number of the image coordinates; NaN without rays.
    largest_w : ndarray, shape (n,)
        Largest standardised residual without sign; NaN where nothing checks any ray.
    worst_ray : ndarray of int, shape (n,)
        Ray that has it; -1 where there is none.
    """

    rays: Integers
    rms: Floats
    redundancy: Floats
    largest_w: Floats
    worst_ray: Integers


def by_image(network: Network, solution: Solution) -> RayStatistics:
    """Statistics of the rays of each image."""
    return _grouped(network, solution, network.rays.image, len(network.image_names))


def by_point(network: Network, solution: Solution) -> RayStatistics:
    """Statistics of the rays of each point."""
    return _grouped(network, solution, network.rays.point, len(network.point_names))


def _grouped(network: Network, solution: Solution, group: Integers, count: int) -> RayStatistics:
    rays = np.bincount(group, minlength=count)
    with np.errstate(divide="ignore", invalid="ignore"):
        squares = [np.bincount(group, v**2, count) / rays for v in solution.residuals.T]
        redundancy = np.bincount(group, solution.redundancy.mean(axis=1), count) / rays
    w = np.abs(solution.standardised(network.rays.sigma))
    worst = np.fmax(w[:, 0], w[:, 1])
    tested = np.flatnonzero(np.isfinite(worst))
    order = tested[np.lexsort((-worst[tested], group[tested]))]
    found, first = np.unique(group[order], return_index=True)
    worst_ray = np.full(count, -1)
    worst_ray[found] = order[first]
    largest = np.full(count, np.nan)
    largest[found] = worst[order[first]]
    return RayStatistics(rays, np.sqrt(np.column_stack(squares)), redundancy, largest, worst_ray)


def correlations(covariance: Floats) -> Floats:
    """Correlation matrices of covariance matrices.

    Parameters
    ----------
    covariance : ndarray, shape (..., n, n)

    Returns
    -------
    ndarray, shape (..., n, n)
        NaN in the rows and columns of values without variance: what is held correlates with nothing.
    """
    variance = np.diagonal(covariance, axis1=-2, axis2=-1)
    scale = np.sqrt(np.where(variance > 0, variance, np.nan))
    return np.asarray(covariance / (scale[..., :, None] * scale[..., None, :]))
