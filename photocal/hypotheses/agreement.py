"""Whether the images of a block agree about a systematic error, whatever their rays by the hundred say."""

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


def agreed(fit: AdjustedNetwork, field: RayField, amount: float) -> float:
    """Probability of an amount that is none, by how the images differ about it; 1 where too few can be asked.

    The F test takes rays for independent. What matching, focus or a moving shutter do to one image they do to
    all of its rays, and the next image has it otherwise: a test over images as they are (Liang and Zeger
    1986) sees that. With many images by the sandwich, see `robust.sandwich`, with few by the jackknife.
    """
    camera = fit.network.cameras[field.camera]
    images = int(np.sum(fit.network.exposures.camera == field.camera))
    freedom = images - int(camera.estimated.sum()) - 1
    if freedom >= FEWEST:
        scored = score(fit.factored, fit.solution.residuals, -field.displacement[None])
        checked = np.maximum(fit.solution.redundancy, policy.least_checked)
        shown = -field.displacement - followed_by(fit.factored, scored.steps, scored.moved)[0]
        # What the error itself makes of the residuals says nothing of how images differ about it.
        weighed = (fit.solution.residuals + amount * shown) / np.sqrt(checked)
        sigma = _spread(fit, float(scored.information[0, 0]), shown, weighed) * (images / freedom) ** 0.5
        return _probability(amount, sigma, freedom)
    amounts = _left_out(fit, field)
    return _probability(amount, float(standard_error(amounts)), len(amounts) - 1)


def _spread(fit: AdjustedNetwork, information: float, shown: Floats, residuals: Floats) -> float:
    """Standard deviation of an amount when the residuals of an image are one observation of it.

    shown: change of the residuals by a unit of it, when all other unknowns follow.
    """
    pull = fit.network.rays.sigma**-2.0 * residuals
    by_image = np.bincount(fit.network.rays.image, np.einsum("rk,rk->r", shown, pull))
    return float(np.linalg.norm(by_image)) / information


def _probability(amount: float, sigma: float, freedom: int) -> float:
    return float(2 * special.stdtr(freedom, -abs(amount) / sigma)) if sigma > 0.0 and freedom > 0 else 1.0


def _left_out(fit: AdjustedNetwork, field: RayField) -> Floats:
    """What is left of an amount when images are left out, (m,): with one factor for each."""
    removals, amounts = Removals(fit.factored), []
    for out in groups_of(fit):
        scored = removals.scored(out, -field.displacement[None], _NEAR)
        if scored is not None and scored.share[0] > LEFT:
            amounts.append(-float(scored.slope[0]) / float(scored.information[0, 0]))
    return np.array(amounts)
