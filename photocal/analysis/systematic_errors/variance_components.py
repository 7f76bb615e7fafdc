"""Variance components: which images, cameras or axes scatter more than the others."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from drivers.arrays import Floats, Integers


@dataclass(frozen=True)
class VarianceComponent:
    """Scatter of one group of observations.

    name: image, camera or axis.
    observations: number of observations.
    redundancy: sum of their redundancy numbers.
    ratio: standard deviation found over the one that was assumed.
    p_value: two-sided probability of so different a scatter from that of all others, already multiplied by
        the number of groups.
    """

    name: str
    observations: int
    redundancy: float
    ratio: float
    p_value: float


def variance_components(
    names: tuple[str, ...], group: Integers, squares: Floats, redundancy: Floats
) -> tuple[VarianceComponent, ...]:
    """Estimate the variance of groups of observations from their residuals and redundancy numbers.

    names: names of the m groups.

    Notes
    -----
    sigma_i^2 = v'Pv_i / r_i (Foerstner 1979, one step), judged by F with r_i and r - r_i degrees of freedom.
    """
    from scipy import stats

    m = len(names)
    total = np.bincount(group, squares, m)
    checked = np.bincount(group, redundancy, m)
    count = np.bincount(group, minlength=m)
    whole, all_checked = float(total.sum()), float(checked.sum())
    others = all_checked - checked
    with np.errstate(invalid="ignore", divide="ignore"):
        statistic = (total / checked) / ((whole - total) / others)
        upper = stats.f.sf(statistic, checked, others)
    p_value = np.minimum(1.0, 2.0 * m * np.minimum(upper, 1.0 - upper))
    p_value[(others < 2.0) | (total <= 0.0) | (total >= whole)] = 1.0
    return tuple(
        VarianceComponent(
            name,
            int(count[i]),
            float(checked[i]),
            float(np.sqrt(total[i] / checked[i])),
            float(p_value[i]),
        )
        for i, name in enumerate(names)
        if checked[i] >= 2.0
    )


@dataclass(frozen=True)
class AssumedSigma:
    """Standard deviation of the image coordinates, assumed and found.

    assumed, found: in the unit of the image plane.
    rms: root mean square of the residuals, in the same unit.
    lower, upper: confidence interval of the one that was found.
    redundancy: what it rests on.
    p_value: two-sided probability of the residuals if the assumption holds.
    """

    assumed: float
    found: float
    rms: float
    lower: float
    upper: float
    redundancy: float
    p_value: float


def assumed_sigma(
    sigma: Floats, residual: Floats, redundancy: Floats, probability: float = 0.95
) -> AssumedSigma:
    """Compare the assumed standard deviation of image coordinates with that of the residuals."""
    from scipy import stats

    squares, r = float(np.sum((residual / sigma) ** 2)), float(redundancy.sum())
    tail = (1.0 - probability) / 2.0
    assumed = float(np.median(sigma))
    above = float(stats.chi2.sf(squares, r))
    return AssumedSigma(
        assumed,
        assumed * float(np.sqrt(squares / r)),
        float(np.sqrt(np.mean(residual**2))),
        assumed * float(np.sqrt(squares / stats.chi2.ppf(1.0 - tail, r))),
        assumed * float(np.sqrt(squares / stats.chi2.ppf(tail, r))),
        r,
        2.0 * min(above, 1.0 - above),
    )
