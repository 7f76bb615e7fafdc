"""Leaving out images: how much the interior orientation hangs on any one of them."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from drivers.errors import IllPosedError, NotConvergedError
from photocal.analysis.estimates import Array
from photocal.analysis.systematic_errors.refit import Fit, lowest, without_images

# Beyond this many images, neighbours are left out together.
MOST_REMOVALS = 30
# Left of each adjustment, see `minimise`: some 1e-5 standard deviations.
NEAR = 1e-9


@dataclass(frozen=True)
class Jackknife:
    """Camera parameters with images left out.

    Attributes
    ----------
    left_out : tuple of tuple of str
        Images that were left out together, one entry for each of m adjustments.
    cameras : (m, cameras, 13) array
        Parameters without them.
    standard_error : (cameras, 13) array
        Jackknife standard error, sqrt((m - 1) / m sum (t_i - mean)^2); NaN when m < 3.
    not_possible : tuple of str
        Images without which the rest is not determined.
    """

    left_out: tuple[tuple[str, ...], ...]
    cameras: Array
    standard_error: Array
    not_possible: tuple[str, ...]


def jackknife(fit: Fit, done: Callable[[], None] = lambda: None) -> Jackknife:
    """Adjust again without each image, or without each group of neighbours in a large network.

    Parameters
    ----------
    fit : Fit
        The network at its minimum.
    done : callable
        Called after each adjustment.

    Returns
    -------
    Jackknife
        Parameters without each, and their standard error.

    Notes
    -----
    Efron, The jackknife, the bootstrap and other resampling plans, 1982.
    """
    names = fit.network.image_names
    groups = np.array_split(np.arange(len(names)), min(len(names), MOST_REMOVALS))
    left_out, cameras, not_possible = [], [], []
    for group in groups:
        out = np.isin(np.arange(len(names)), group)
        try:
            network, state = without_images(fit.network, fit.state, out)
            cameras.append(lowest(network, state, NEAR).state.cameras)
            left_out.append(tuple(names[i] for i in group))
        except (IllPosedError, NotConvergedError):
            not_possible += [names[i] for i in group]
        done()
    values = np.array(cameras).reshape(-1, *fit.state.cameras.shape)
    m = len(values)
    error = np.full(fit.state.cameras.shape, np.nan)
    if m >= 3:
        error = np.sqrt((m - 1) / m * np.sum((values - values.mean(axis=0)) ** 2, axis=0))
    return Jackknife(tuple(left_out), values, error, tuple(not_possible))
