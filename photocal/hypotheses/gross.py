"""Gross rays: single ones that miss by far more than all others, set aside before causes are sought."""

from dataclasses import replace

import numpy as np
from scipy import special

from photocal.adjustment.adjusted import AdjustedNetwork, fit
from photocal.adjustment.ledger import because
from photocal.adjustment.snooping import significance_of, worst_of_points
from photocal.base import policy
from photocal.base.arrays import Flags
from photocal.base.errors import IllPosedError, NotConvergedError
from photocal.hypotheses.control import control_points

# Rounds of gross rays, and the share of the rays of an image or point that is no longer single.
_SNOOPED, _SINGLE = 3, 0.3
# Gross rays are set aside by this factor of their sigmas.
ASIDE = 1e3


def without_gross_rays(first: AdjustedNetwork) -> tuple[AdjustedNetwork, Flags]:
    """Set single rays aside that miss by far more than all others, the worst of each point in each round."""
    network, given = first.network, first
    gross = np.zeros(len(network.rays.image), dtype=np.bool_)
    for _ in range(_SNOOPED):
        found = gross_rays(given) & ~gross
        if not found.any():
            break
        worst = np.zeros(len(gross), dtype=np.bool_)
        worst[worst_of_points(given.network, given.solution, "tau")] = True
        gross |= found & worst if (found & worst).any() else found
        sigma = np.where(gross[:, None], network.rays.sigma * ASIDE, network.rays.sigma)
        try:
            with because("without gross rays"):
                given = fit(replace(network, rays=replace(network.rays, sigma=sigma)), given.state)
        except (IllPosedError, NotConvergedError):
            return first, np.zeros(len(gross), dtype=np.bool_)
    return given, gross


def gross_rays(adjusted: AdjustedNetwork) -> Flags:
    """Single rays that miss by more than chance allows, on the scale of the others."""
    network = adjusted.network
    w = np.abs(np.nan_to_num(adjusted.solution.standardised(network.rays.sigma)))
    scale = max(1.0, float(np.median(w)) * policy.MAD_TO_SIGMA)
    limit = -special.ndtri(significance_of(w.size) / w.size / 2.0) * scale if w.size else np.inf
    far = np.asarray(w.max(axis=1, initial=0.0) > limit)
    for of in (network.rays.image, network.rays.point):
        count = np.bincount(of, far)
        # A whole image or a whole point is another matter than rays.
        far = far & ~((count > _SINGLE * np.bincount(of)) & (count > 2))[of]
    # So is a control point whose rays miss together.
    count = np.bincount(
        network.rays.point, w.max(axis=1, initial=0.0) > limit / 2.0, len(network.point_names)
    )
    surveyed = np.isin(network.rays.point, control_points(network))
    many = count > np.maximum(_SINGLE * np.bincount(network.rays.point, minlength=len(count)), 1)
    return np.asarray(far & ~(surveyed & many[network.rays.point]))
