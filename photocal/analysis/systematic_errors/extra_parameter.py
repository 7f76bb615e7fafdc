"""Testing one more parameter: how much the sum of squares falls when it is allowed."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from photocal.adjustment.score import score
from photocal.analysis.systematic_errors.candidates import Candidate
from photocal.analysis.systematic_errors.refit import Fit

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
    tested: int = 1
    alike: tuple[str, ...] = ()


def estimated_amount(fit: Fit, candidate: Candidate) -> ExtraParameter | None:
    """Estimate the amount of a candidate as one more unknown of the adjustment, to first order."""
    # What is added to the measurements is taken off the residuals, computed minus measured.
    one = score(fit.factored, fit.solution.residuals, -candidate.displacement[None])
    slope, information = float(one.slope[0]), float(one.information[0, 0])
    if not one.share[0] > LEFT:
        return None
    return judged(fit, candidate, -slope / information, information**-0.5, slope**2 / information)


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
