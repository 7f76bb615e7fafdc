"""Tests of an adjustment: the chi-square test of its unit variance, and the power of tests of residuals."""

from dataclasses import dataclass
from typing import Literal

import numpy as np
from scipy import special

from photocal.base.policy import policy

Sided = Literal["two-sided", "one-sided", "none"]


@dataclass(frozen=True)
class GlobalTest:
    """Chi-square test of the a posteriori against the a priori unit variance; one-sided from 0.

    probability: confidence of the interval.
    lower, upper: interval of v'Pv when the model and the weights are right.
    p_value: of so large, or so different, a v'Pv.
    """

    probability: float
    lower: float
    upper: float
    p_value: float
    accepted: bool


def global_test(
    chi_squared: float, degrees_of_freedom: float, probability: float = 0.95, sided: Sided = "two-sided"
) -> GlobalTest | None:
    """Test whether v'Pv is as large as the weights claim; one-sided, whether it is larger.

    None without redundancy, or when the standard deviations are assumed ("none"). One-sided at 90 % is the
    test of the canon-elph study, Table 5.
    """
    if degrees_of_freedom <= 0 or sided == "none":
        return None
    # chdtr and chdtrc are the chi-squared distribution and its complement, chdtri inverts the latter.
    tails = (1 - probability) / (2 if sided == "two-sided" else 1)
    upper = float(special.chdtri(degrees_of_freedom, tails))
    p_value = float(special.chdtrc(degrees_of_freedom, chi_squared))
    lower = 0.0
    if sided == "two-sided":
        lower = float(special.chdtri(degrees_of_freedom, 1 - tails))
        p_value = min(2 * min(float(special.chdtr(degrees_of_freedom, chi_squared)), p_value), 1.0)
    return GlobalTest(probability, lower, upper, p_value, lower <= chi_squared <= upper)


def noncentrality(
    significance: float = policy.significance, power: float = policy.power, dimensions: int = 1
) -> float:
    """Shift of a standardised residual that its two-sided test finds with a stated power."""
    limit = special.chdtri(dimensions, significance)
    return float(np.sqrt(special.chndtrinc(limit, dimensions, 1.0 - power)))
