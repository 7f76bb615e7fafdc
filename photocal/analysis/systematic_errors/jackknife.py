"""Leaving out images: how much the interior orientation hangs on any one of them."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from drivers.arrays import Flags, Floats
from drivers.errors import IllPosedError, NotConvergedError
from photocal.adjustment.near import Removals
from photocal.adjustment.state import State
from photocal.analysis.systematic_errors.refit import Fit, left_without, lowest, without_images

# Beyond this many images, neighbours are left out together, in so many groups.
MOST_REMOVALS, GROUPS = 30, 15
# Left of each adjustment, see `minimise`: some 1e-4 standard deviations.
NEAR = 1e-8


@dataclass(frozen=True)
class Jackknife:
    """Camera parameters with images left out.

    left_out: images that were left out together, one entry for each of m adjustments.
    cameras (m, cameras, 20): parameters without them.
    standard_error (cameras, 20): NaN for fewer than three of them.
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
    left_out, cameras, not_possible = list[tuple[str, ...]](), list[Floats](), list[str]()
    removals = Removals(fit.factored.problem, fit.state)
    for out in groups_of(fit):
        group = tuple(names[i] for i in np.flatnonzero(out))
        try:
            cameras.append(state_without(fit, removals, out).cameras)
            left_out.append(group)
        except (IllPosedError, NotConvergedError):
            not_possible += group
        done()
    values = np.array(cameras).reshape(-1, *fit.state.cameras.shape)
    return Jackknife(tuple(left_out), values, standard_error(values), tuple(not_possible))


def groups_of(fit: Fit) -> list[Flags]:
    """Images that are left out together: each alone, in a large network neighbours."""
    count = len(fit.network.image_names)
    parts = np.array_split(np.arange(count), count if count <= MOST_REMOVALS else GROUPS)
    return [np.isin(np.arange(count), part) for part in parts]


def state_without(fit: Fit, removals: Removals, out: Flags) -> State:
    """Leave images out of a minimum: near it where the way is short, else adjusted anew.

    returns: as large as before; what was left out keeps its values.
    raises IllPosedError, NotConvergedError: when the rest is not determined.
    """
    nearby = removals.without(out, NEAR)
    if nearby is not None:
        return nearby.state
    network, state = without_images(fit.network, fit.state, out)
    rest, (points, _) = lowest(network, state, NEAR).state, left_without(fit.network, out)
    whole = replace(
        rest,
        rotation=fit.state.rotation.copy(),
        centre=fit.state.centre.copy(),
        points=fit.state.points.copy(),
        deviations=fit.state.deviations.copy(),
    )
    whole.rotation[~out], whole.centre[~out] = rest.rotation, rest.centre
    whole.points[points], whole.deviations[~out] = rest.points, rest.deviations
    return whole


def standard_error(values: Floats) -> Floats:
    """Jackknife standard error of m estimates, (m, ...): sqrt((m - 1) / m sum (t - mean)^2)."""
    m = len(values)
    if m < 3:
        return np.full(values.shape[1:], np.nan)
    return np.asarray(np.sqrt((m - 1) / m * np.sum((values - values.mean(axis=0)) ** 2, axis=0)))
