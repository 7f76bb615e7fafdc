"""Testing one more parameter: how much the sum of squares falls when it is allowed."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from photocal.adjustment.state import State
from photocal.analysis.estimates import Array
from photocal.analysis.systematic_errors.candidates import Candidate
from photocal.analysis.systematic_errors.refit import Fit, lowest, with_measurements


@dataclass(frozen=True)
class ExtraParameter:
    """Outcome of the test of one candidate.

    Attributes
    ----------
    candidate : Candidate
        What was tested.
    amount, sigma : float
        Estimate and a priori standard deviation, in the unit of the candidate.
    statistic, p_value : float
        F = fall of the sum of squares over the variance that remains, and its probability without the error.
    effect_px : float
        Largest displacement of a ray, px.
    alike : tuple of str
        Other candidates that explain the residuals as well: the network does not separate them.
    """

    candidate: Candidate
    amount: float
    sigma: float
    statistic: float
    p_value: float
    effect_px: float
    alike: tuple[str, ...] = ()


def estimated_amount(fit: Fit, candidate: Candidate) -> ExtraParameter | None:
    """Estimate the amount of a candidate as if it were one more unknown of the adjustment.

    The minimum of the sum of squares is a parabola in the amount; it is found from two more adjustments.
    """
    sigma = fit.network.rays.sigma
    length = float(np.sqrt(np.sum((candidate.displacement / sigma) ** 2)))
    if length <= 0.0:
        return None
    # A step that alone would raise the sum of squares by 4: small enough for a parabola.
    step = 2.0 / length
    base = fit.solution.chi_squared
    above, below = (
        lowest(
            with_measurements(fit.network, fit.network.rays.plane + sign * step * candidate.displacement),
            fit.state,
        ).chi_squared
        for sign in (1.0, -1.0)
    )
    curvature = (above + below - 2.0 * base) / step**2
    # What the unknowns take up cannot be tested: less than a thousandth of the displacement is left.
    if curvature * step**2 < 2.0 * 4.0 * 1e-6:
        return None
    slope = (above - below) / (2.0 * step)
    amount, spread = -slope / curvature, float(np.sqrt(2.0 / curvature))
    return judged(fit, candidate, amount, spread, slope**2 / (2.0 * curvature))


def judged(fit: Fit, candidate: Candidate, amount: float, sigma: float, fall: float) -> ExtraParameter:
    """Make the F test of a fall of the sum of squares.

    Parameters
    ----------
    fit : Fit
        The network without the candidate.
    candidate : Candidate
        What was allowed.
    amount, sigma : float
        Its estimate and standard deviation.
    fall : float
        By how much the sum of squares falls with it.

    Returns
    -------
    ExtraParameter
        The outcome.
    """
    from scipy import stats

    redundancy = fit.solution.degrees_of_freedom - 1
    left = max(fit.solution.chi_squared - fall, 1e-300)
    statistic = fall / (left / redundancy)
    pitch = fit.network.cameras[candidate.camera].pitch
    moved = np.abs(amount) * np.linalg.norm(candidate.displacement / np.array(pitch), axis=1)
    return ExtraParameter(
        candidate,
        amount,
        sigma,
        statistic,
        float(stats.f.sf(statistic, 1, redundancy)),
        float(moved.max(initial=0.0)),
    )


def corrected(fit: Fit, parameter: ExtraParameter) -> tuple[Array, State]:
    """Correct the measurements by a parameter.

    Parameters
    ----------
    fit : Fit
        The network.
    parameter : ExtraParameter
        With its amount.

    Returns
    -------
    plane : (n, 2) array
        Corrected image plane coordinates.
    state : State
        Where to start the next adjustment.
    """
    return fit.network.rays.plane + parameter.amount * parameter.candidate.displacement, fit.state
