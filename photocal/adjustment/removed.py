"""Images left out of an adjusted network, one by one or with their neighbours."""

import numpy as np

from photocal.adjustment.adjusted import AdjustedNetwork
from photocal.adjustment.near import Removals
from photocal.adjustment.state import State
from photocal.base.arrays import Flags, Floats
from photocal.base.errors import IllPosedError, NotConvergedError

# Beyond this many images, neighbours are left out together, in so many groups: the standard error is then
# itself good to a fifth, 1 / sqrt(2 (m - 1)), where three times the formal one is worth a line.
MOST_REMOVALS, REMOVED_TOGETHER = 30, 15
# Left of each adjustment, see `minimise`: some 1e-4 standard deviations.
NEAR = 1e-8
# With fewer images beyond the parameters their scatter tells too little of itself.
FEWEST = 10


def groups_of(fit: AdjustedNetwork) -> list[Flags]:
    """Images that are left out together: each alone, in a large network neighbours."""
    count = len(fit.network.image_names)
    parts = np.array_split(np.arange(count), count if count <= MOST_REMOVALS else REMOVED_TOGETHER)
    return [np.isin(np.arange(count), part) for part in parts]


def state_without(removals: Removals, out: Flags) -> State:
    """Leave images out of a minimum: the minimum, or where two set-ups of the equations lead towards it.

    returns: as large as before; what was left out keeps its values.
    raises IllPosedError: when the rest is not determined.
    raises NotConvergedError: when the first step leads behind a camera.
    """
    found = removals.without(out, NEAR)
    if found is None:
        raise IllPosedError(f"the block is not determined without {int(out.sum())} of {len(out)} images")
    if not np.isfinite(found.chi_squared):
        raise NotConvergedError(f"without {int(out.sum())} of {len(out)} images a point is behind a camera")
    return found.state


def standard_error(values: Floats) -> Floats:
    """Jackknife standard error of m estimates, (m, ...): sqrt((m - 1) / m sum (t - mean)^2)."""
    m = len(values)
    if m < 3:
        return np.full(values.shape[1:], np.nan)
    return np.asarray(np.sqrt((m - 1) / m * np.sum((values - values.mean(axis=0)) ** 2, axis=0)))


def least_standard_error(values: Floats, whole: Floats, m: int) -> Floats:
    """Lower bound of the jackknife standard error where some of m removals leave nothing determined.

    About the estimate of the whole, sqrt((m - 1) / m sum (t - t_whole)^2): each missing term would add to it.
    """
    if m < 3 or not len(values):
        return np.full(whole.shape, np.nan)
    return np.asarray(np.sqrt((m - 1) / m * np.sum((values - whole) ** 2, axis=0)))
