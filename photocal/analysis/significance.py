"""Whether a parameter, or a group of them, is different from zero."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np

from photocal.analysis.estimates import Estimates, quadratic_form

GROUPS = (("x0", "y0"), ("K1", "K2", "K3"), ("P1", "P2"), ("B1", "B2"))
CUMULATIVE = (("K1",), ("K1", "K2"), ("K1", "K2", "K3"), ("K1", "K2", "K3", "K4"))


@dataclass(frozen=True)
class FTest:
    """Outcome of one test of "these parameters are zero".

    kind: "single", "group" or "cumulative".
    parameters: the p parameters tested together.
    statistic, critical: F and its critical value, dimensionless.
    p_value: probability of an F at least as large if the parameters were zero.
    significant: whether the statistic reaches the critical value.
    """

    kind: str
    parameters: tuple[str, ...]
    statistic: float
    critical: float
    p_value: float
    significant: bool


def f_test(
    estimates: Estimates,
    parameters: Iterable[str],
    degrees_of_freedom: float,
    alpha: float,
    kind: str = "group",
) -> FTest:
    """Test one group of parameters, F = x' S^-1 x / p against F(1 - alpha; p, dof).

    Notes
    -----
    Canon ELPH study (FCT-UNESP), equations 11 to 13.
    """
    from scipy import stats

    chosen = estimates.select(parameters)
    p = len(chosen.names)
    statistic = quadratic_form(chosen) / p
    # With sigmas that are known for sure p F is chi-squared; the library's F has no such limit.
    known = np.isinf(degrees_of_freedom)
    critical = float(
        stats.chi2.ppf(1 - alpha, p) / p if known else stats.f.ppf(1 - alpha, p, degrees_of_freedom)
    )
    p_value = float(
        stats.chi2.sf(p * statistic, p) if known else stats.f.sf(statistic, p, degrees_of_freedom)
    )
    return FTest(kind, chosen.names, statistic, critical, p_value, statistic >= critical)


def significance(estimates: Estimates, degrees_of_freedom: float, alpha: float = 0.10) -> tuple[FTest, ...]:
    """Test every parameter alone, the usual groups, and the radial terms one after the other.

    estimates: parameters with their covariance, scaled by the a posteriori variance of unit weight.
    raises IllPosedError: when the covariance of a group is not positive definite.
    """
    single = [((name,), "single") for name in estimates.names]
    groups = [(_estimated(group, estimates), "group") for group in GROUPS]
    cumulative = [(group, "cumulative") for group in CUMULATIVE if set(group) <= set(estimates.names)]
    wanted = single + [(names, kind) for names, kind in groups if len(names) > 1] + cumulative
    return tuple(f_test(estimates, names, degrees_of_freedom, alpha, kind) for names, kind in wanted)


def _estimated(group: tuple[str, ...], estimates: Estimates) -> tuple[str, ...]:
    return tuple(name for name in group if name in estimates.names)
