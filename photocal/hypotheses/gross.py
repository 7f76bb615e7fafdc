"""Gross rays: single ones that miss by far more than all others, set aside before the search for causes."""

from dataclasses import replace

import numpy as np
from scipy import special

from photocal.adjustment.adjusted import AdjustedNetwork, fit
from photocal.adjustment.ledger import because
from photocal.adjustment.network import Network
from photocal.adjustment.snooping import significance_of
from photocal.base.arrays import Flags
from photocal.base.errors import IllPosedError, NotConvergedError
from photocal.base.policy import policy
from photocal.hypotheses.control import control_points

# Rounds of gross rays, and the share of the rays of an image or point that is no longer single.
_SNOOPED, _SINGLE = 8, 0.3
# Gross rays are set aside by this factor of their sigmas.
ASIDE = 1e3
# A place is where so many rays meet; those of a point that has fewer left hold it, and nothing else.
_LEAST_RAYS, _ALONE = 2, 30.0


def without_gross_rays(first: AdjustedNetwork) -> tuple[AdjustedNetwork, Flags]:
    """Set single rays aside that miss by far more than all others, the worst of each point in each round.

    A gross ray pulls its point and makes its neighbours miss, too: one at a time is judged, on the scale that
    all others have (by their median, which few gross ones do not move). What fits once its point stands
    without it comes back.
    """
    network, given = first.network, first
    gross = np.zeros(len(network.rays.image), dtype=np.bool_)
    for _ in range(_SNOOPED):
        found = _worst_of_points(given, gross_rays(given) & ~gross)
        if not found.any():
            break
        tried = _aside(given, network, gross | found)
        if tried is None:
            break
        given, gross = tried, gross | found
    if not gross.any():
        return first, gross
    kept = gross & ~_whole_points(network, gross) & ~_fitting(given)
    if not kept.any():
        return first, kept
    back = given if (kept == gross).all() else _aside(given, network, kept)
    return (given, gross) if back is None else (back, kept)


def _aside(given: AdjustedNetwork, network: Network, gross: Flags) -> AdjustedNetwork | None:
    """Adjust with gross rays set aside; None where that does not hold."""
    # One ray determines no place: what is left of such a point slides along it.
    point, known = network.rays.point, control_points(network)
    alone = (np.bincount(point, ~gross) < _LEAST_RAYS)[point] & ~np.isin(point, known)
    factor = np.where(alone, _ALONE, np.where(gross, ASIDE, 1.0))
    sigma = network.rays.sigma * factor[:, None]
    try:
        with because("without gross rays"):
            return fit(replace(network, rays=replace(network.rays, sigma=sigma)), given.state)
    except (IllPosedError, NotConvergedError):
        return None


def _worst_of_points(given: AdjustedNetwork, far: Flags) -> Flags:
    """Of each point the ray that misses most, of those that are far."""
    rays = given.network.rays
    w = np.abs(np.nan_to_num(given.solution.standardised(rays.sigma))).max(axis=1, initial=0.0)
    order = np.lexsort((-np.where(far, w, -1.0), rays.point))
    _, first = np.unique(rays.point[order], return_index=True)
    worst = np.zeros(len(far), dtype=np.bool_)
    worst[order[first]] = True
    return worst & far


def _whole_points(network: Network, gross: Flags) -> Flags:
    """Rays of points of which too many were set aside: that is another matter than rays."""
    point = network.rays.point
    count = np.bincount(point, gross)
    return np.asarray(((count > _SINGLE * np.bincount(point)) & (count > 2))[point])


def _fitting(given: AdjustedNetwork) -> Flags:
    """Rays that were set aside and fit all the same."""
    network = given.network
    aside = network.rays.sigma[:, 0] > ASIDE / 2.0 * np.median(network.rays.sigma[:, 0])
    w = np.abs(given.solution.residuals / network.rays.sigma) * ASIDE
    return np.asarray(aside & (w.max(axis=1) < policy.times_999))


def gross_rays(adjusted: AdjustedNetwork) -> Flags:
    """Single rays that miss by more than chance allows, on the scale of the others."""
    network = adjusted.network
    w = np.abs(np.nan_to_num(adjusted.solution.standardised(network.rays.sigma)))
    scale = max(1.0, float(np.median(w)) * policy.mad_to_sigma)
    limit = -special.ndtri(significance_of(w.size) / w.size / 2.0) * scale if w.size else np.inf
    far = np.asarray(w.max(axis=1, initial=0.0) > limit)
    # A whole image is another matter than rays.
    count = np.bincount(network.rays.image, far)
    far &= ~((count > _SINGLE * np.bincount(network.rays.image)) & (count > 2))[network.rays.image]
    # So is a control point whose rays miss together: one that is gross stands apart from the others.
    point, worst = network.rays.point, w.max(axis=1, initial=0.0)
    most = np.zeros(len(network.point_names))
    np.maximum.at(most, point, worst)
    count = np.bincount(point, worst > most[point] / 2.0, len(most))
    together = count > np.maximum(_SINGLE * np.bincount(point, minlength=len(most)), 1)
    return np.asarray(far & ~(np.isin(point, control_points(network)) & together[point]))
