"""Whether the scatter of the residuals agrees with the standard deviations that were assumed."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class GlobalTest:
    """Outcome of the test of the a posteriori variance of unit weight.

    Attributes
    ----------
    chi_squared, degrees_of_freedom : float
        The weighted sum of squares of the residuals and the redundancy.
    lower, upper : float
        Bounds of acceptance of chi_squared; lower is 0.
    accepted : bool
        Whether it lies between them.
    p_value : float
        Probability of a value at least as far from the middle if the assumptions hold.
    """

    chi_squared: float
    degrees_of_freedom: float
    lower: float
    upper: float
    accepted: bool
    p_value: float


def upper_global_test(chi_squared: float, degrees_of_freedom: float, probability: float = 0.90) -> GlobalTest:
    """Test whether the residuals are larger than assumed (one-sided).

    Notes
    -----
    Canon ELPH study (FCT-UNESP), table 5, tested at 90 %.
    """
    from scipy import stats

    upper = float(stats.chi2.ppf(probability, degrees_of_freedom))
    p_value = float(stats.chi2.sf(chi_squared, degrees_of_freedom))
    return GlobalTest(chi_squared, degrees_of_freedom, 0.0, upper, chi_squared <= upper, p_value)
