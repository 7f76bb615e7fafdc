"""Leaving out images: how much the interior orientation hangs on any one of them."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from drivers.arrays import Flags, Floats
from drivers.errors import IllPosedError, NotConvergedError
from photocal.adjustment.near import Removals
from photocal.adjustment.state import State
from photocal.analysis.systematic_errors.refit import Fit, lowest, without_images

# Beyond this many images, neighbours are left out together, in so many groups.
MOST_REMOVALS, GROUPS = 30, 15
# Left of each adjustment, see `minimise`: some 1e-4 standard deviations.
NEAR = 1e-8


@dataclass(frozen=True)
class Jackknife:
    """Camera parameters with images left out.

    left_out: images that were left out together, one entry for each of m adjustments.
    cameras (m, cameras, 20): parameters without them.
    standard_error (cameras, 20): jackknife standard error, sqrt((m - 1) / m sum (t_i - mean)^2); NaN when m <
        3.
    not_possible: images without which the rest is not determined.
    """

    left_out: tuple[tuple[str, ...], ...]
    cameras: Floats
    standard_error: Floats
    not_possible: tuple[str, ...]


def jackknife(fit: Fit, done: Callable[[], None] = lambda: None) -> Jackknife:
    """Take each image out of the minimum, or each group of neighbours in a large network.

    Notes
    -----
    Efron, The jackknife, the bootstrap and other resampling plans, 1982.
    """
    names = fit.network.image_names
    count = len(names) if len(names) <= MOST_REMOVALS else GROUPS
    left_out, cameras, not_possible = [], [], []
    removals = Removals(fit.factored.problem, fit.state)
    for group in np.array_split(np.arange(len(names)), count):
        out = np.isin(np.arange(len(names)), group)
        try:
            nearby = removals.without(out, NEAR)
            state = _anew(fit, out) if nearby is None else nearby.state
            cameras.append(state.cameras)
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


def _anew(fit: Fit, out: Flags) -> State:
    network, state = without_images(fit.network, fit.state, out)
    return lowest(network, state, NEAR).state
