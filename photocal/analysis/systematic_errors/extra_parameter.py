"""Testing one more parameter: how much the sum of squares falls when it is allowed, and if images agree."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from drivers.arrays import Floats
from drivers.errors import IllPosedError, NotConvergedError
from photocal.adjustment.factored import factored
from photocal.adjustment.kernels.residuals import evaluate
from photocal.adjustment.near import Removals
from photocal.adjustment.normal import values_of
from photocal.adjustment.score import Score, followed_by, score
from photocal.analysis.robust import FEWEST, LEAST_CHECKED
from photocal.analysis.systematic_errors.candidates import Candidate
from photocal.analysis.systematic_errors.jackknife import groups_of, standard_error, state_without
from photocal.analysis.systematic_errors.refit import Fit, left_without, without_images

# What the unknowns take up cannot be tested: less than a thousandth of the displacement is left.
LEFT = 1e-6


@dataclass(frozen=True)
class ExtraParameter:
    """Outcome of the test of one candidate.

    candidate: what was tested.
    amount, sigma: estimate and a priori standard deviation, in the unit of the candidate.
    fall: by how much the sum of squares falls with it.
    statistic, p_value: F = fall over the variance that remains, and its probability without the error.
    effect_px: largest displacement of a ray, px.
    by_images: the same probability by how the images differ, to first order; too small for few of them, see
        `agreed`.
    tested: candidates that were looked at: the level is shared by them (Bonferroni).
    alike: other candidates that explain the residuals as well: the network does not separate them.
    """

    candidate: Candidate
    amount: float
    sigma: float
    fall: float
    statistic: float
    p_value: float
    effect_px: float
    by_images: float = 0.0
    tested: int = 1
    alike: tuple[str, ...] = ()


def estimated_amount(fit: Fit, candidate: Candidate) -> ExtraParameter | None:
    """Estimate the amount of a candidate as one more unknown of the adjustment, to first order."""
    # What is added to the measurements is taken off the residuals, computed minus measured.
    one = score(fit.factored, fit.solution.residuals, -candidate.displacement[None])
    slope, information = float(one.slope[0]), float(one.information[0, 0])
    if not one.share[0] > LEFT:
        return None
    amount = -slope / information
    outcome = judged(fit, candidate, amount, information**-0.5, slope**2 / information)
    shown = _shown(fit, candidate, one)
    corrected = fit.solution.residuals + amount * shown
    images = int(np.sum(fit.network.exposures.camera == candidate.camera))
    sigma = _spread(fit, one, shown, corrected) * (images / max(images - 1, 1)) ** 0.5
    return replace(outcome, by_images=_probability(amount, sigma, images - 1))


def judged(fit: Fit, candidate: Candidate, amount: float, sigma: float, fall: float) -> ExtraParameter:
    """Make the F test of a fall of the sum of squares."""
    from scipy import stats

    redundancy = fit.solution.degrees_of_freedom - 1
    left = max(fit.solution.chi_squared - fall, 1e-300)
    statistic = fall / (left / redundancy)
    pitch = fit.network.cameras[candidate.camera].pitch
    moved = np.abs(amount) * np.linalg.norm(candidate.displacement / np.array(pitch), axis=1)
    p_value = float(stats.f.sf(statistic, 1, redundancy))
    return ExtraParameter(candidate, amount, sigma, fall, statistic, p_value, float(moved.max(initial=0.0)))


def agreed(fit: Fit, candidate: Candidate, amount: float) -> float:
    """Probability of an amount that is none, by how the images differ about it; 1 where too few can be asked.

    fit: with the amount corrected.

    Notes
    -----
    The F test takes rays for independent. What matching, focus or a moving shutter do to one image they do to
    all of its rays, and the next image has it otherwise: a test over images as they are (Liang and Zeger
    1986) sees that. With many images by the sandwich, see `robust.sandwich`, with few by the jackknife.
    """
    camera = fit.network.cameras[candidate.camera]
    images = int(np.sum(fit.network.exposures.camera == candidate.camera))
    freedom = images - int(camera.estimated.sum()) - 1
    if freedom >= FEWEST:
        one = score(fit.factored, fit.solution.residuals, -candidate.displacement[None])
        checked = np.maximum(fit.solution.redundancy, LEAST_CHECKED)
        weighed = fit.solution.residuals / np.sqrt(checked)
        sigma = _spread(fit, one, _shown(fit, candidate, one), weighed) * (images / freedom) ** 0.5
        return _probability(amount, sigma, freedom)
    amounts = _left_out(fit, candidate)
    return _probability(amount, float(standard_error(amounts)), len(amounts) - 1)


def _shown(fit: Fit, candidate: Candidate, one: Score) -> Floats:
    """Change of the residuals by a unit of a candidate, when all other unknowns follow."""
    return -candidate.displacement - followed_by(fit.factored, one.steps[0], one.moved[0])


def _spread(fit: Fit, one: Score, shown: Floats, residuals: Floats) -> float:
    """Standard deviation of an amount when the residuals of an image are one observation of it."""
    pull = fit.network.rays.sigma**-2.0 * residuals
    by_image = np.bincount(fit.network.rays.image, np.einsum("rk,rk->r", shown, pull))
    return float(np.linalg.norm(by_image)) / float(one.information[0, 0])


def _probability(amount: float, sigma: float, freedom: int) -> float:
    from scipy import stats

    return float(2 * stats.t.sf(abs(amount) / sigma, freedom)) if sigma > 0.0 and freedom > 0 else 1.0


def _left_out(fit: Fit, candidate: Candidate) -> Floats:
    """What is left of an amount when images are left out, (m,)."""
    removals, amounts = Removals(fit.factored.problem, fit.state), []
    for out in groups_of(fit):
        try:
            network, state = without_images(fit.network, state_without(fit, removals, out), out)
            at = factored(network, state)
        except (IllPosedError, NotConvergedError):
            continue
        residuals, depth = np.empty(network.rays.plane.shape), np.empty(len(network.rays.image))
        evaluate(at.problem.design, values_of(at.problem, at.state), residuals, depth)
        kept = left_without(fit.network, out)[1]
        one = score(at, residuals, -candidate.displacement[None, kept])
        if one.share[0] > LEFT:
            amounts.append(-float(one.slope[0]) / float(one.information[0, 0]))
    return np.array(amounts)
