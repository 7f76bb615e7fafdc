"""Whether the images of a block agree about a systematic error, whatever their rays by the hundred say."""

from collections.abc import Sequence

import numpy as np
from scipy import special

from photocal.adjustment.adjusted import AdjustedNetwork
from photocal.adjustment.near import Removals
from photocal.adjustment.removed import FEWEST, groups_of, standard_error
from photocal.adjustment.score import followed_by, score
from photocal.base.arrays import Floats
from photocal.base.policy import policy
from photocal.hypotheses.fields import LEFT, RayField

# Left of the way without an image: a hundredth of a standard deviation.
_NEAR = 1e-4


def agreed(fit: AdjustedNetwork, fields: Sequence[RayField], amounts: Sequence[float]) -> list[float]:
    """Probability of each amount that is none, by how the images differ about it; 1 where few can be asked.

    The F test takes rays for independent. What matching, focus or a moving shutter do to one image they do to
    all of its rays, and the next image has it otherwise: a test over images as they are (Liang and Zeger
    1986) sees that. With many images by the sandwich, see `robust.sandwich`, with few by the jackknife.
    """
    changes = -np.array([field.displacement for field in fields])
    few = np.array([_freedom(fit, field) < FEWEST for field in fields])
    found = np.ones(len(fields))
    if few.any():
        left = _left_out(fit, changes[few])
        spread = [standard_error(values[np.isfinite(values)]) for values in left.T]
        freedom = np.isfinite(left).sum(axis=0) - 1
        found[few] = list(map(_probability, np.array(amounts)[few], np.array(spread), freedom))
    for k in np.flatnonzero(~few).tolist():
        found[k] = _by_sandwich(fit, fields[k], changes[[k]], amounts[k])
    return found.tolist()


def _freedom(fit: AdjustedNetwork, field: RayField) -> int:
    """Images of a field's camera beyond its parameters and the amount."""
    images = int(np.sum(fit.network.exposures.camera == field.camera))
    return images - int(fit.network.cameras[field.camera].estimated.sum()) - 1


def _by_sandwich(fit: AdjustedNetwork, field: RayField, change: Floats, amount: float) -> float:
    freedom = _freedom(fit, field)
    images = int(np.sum(fit.network.exposures.camera == field.camera))
    scored = score(fit.factored, fit.solution.residuals, change)
    checked = np.maximum(fit.solution.redundancy, policy.least_checked)
    shown = change[0] - followed_by(fit.factored, scored.steps, scored.moved)[0]
    # What the error itself makes of the residuals says nothing of how images differ about it.
    weighed = (fit.solution.residuals + amount * shown) / np.sqrt(checked)
    sigma = _spread(fit, float(scored.information[0, 0]), shown, weighed) * (images / freedom) ** 0.5
    return _probability(amount, sigma, freedom)


def _spread(fit: AdjustedNetwork, information: float, shown: Floats, residuals: Floats) -> float:
    """Standard deviation of an amount when the residuals of an image are one observation of it.

    shown: change of the residuals by a unit of it, when all other unknowns follow.
    """
    pull = fit.network.rays.sigma**-2.0 * residuals
    by_image = np.bincount(fit.network.rays.image, np.einsum("rk,rk->r", shown, pull))
    return float(np.linalg.norm(by_image)) / information


def _probability(amount: float, sigma: float, freedom: int) -> float:
    return float(2 * special.stdtr(freedom, -abs(amount) / sigma)) if sigma > 0.0 and freedom > 0 else 1.0


def _left_out(fit: AdjustedNetwork, changes: Floats) -> Floats:
    """What is left of t amounts when m images are left out, with one factor for each, (m, t); NaN where none.

    changes (t, rays, 2): of the computed image coordinates by a unit of each.
    """
    removals, groups = Removals(fit.factored), groups_of(fit)
    amounts = np.full((len(groups), len(changes)), np.nan)
    for values, out in zip(amounts, groups, strict=True):
        scored = removals.scored(out, changes, _NEAR)
        if scored is not None:
            some = scored.share > LEFT
            values[some] = -scored.slope[some] / np.diag(scored.information)[some]
    return amounts
