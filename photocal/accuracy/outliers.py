"""Outliers among discrepancies: the generalised extreme Studentised deviate test (Rosner 1983)."""

from __future__ import annotations

import math

import numpy as np
from scipy import stats

from drivers.arrays import Floats

# Below this many points a deviation cannot be told from the spread it makes itself.
SMALLEST_SAMPLE = 5
# More outliers than this are no outliers any more but another distribution.
MOST_TESTED = 100


def outliers(values_m: Floats, confidence: float) -> tuple[int, ...]:
    """Find the values that do not belong to the normal distribution of the others.

    They are shown, never removed: a check point with a large error is the reason for checking.
    """
    if len(values_m) < SMALLEST_SAMPLE:
        return ()
    rows = np.arange(len(values_m))
    removed: list[int] = []
    found = 0
    for _ in range(min(max(1, len(values_m) // 4), MOST_TESTED)):
        rest = values_m[rows]
        deviation = np.abs(rest - np.mean(rest))
        std = float(np.std(rest, ddof=1))
        if std == 0.0:
            break
        worst = int(np.argmax(deviation))
        removed.append(int(rows[worst]))
        # The number of outliers is the last step that passes, not the first that fails: two outliers
        # side by side hide each other in the first step.
        if float(deviation[worst]) / std > critical_deviate(len(rest), confidence):
            found = len(removed)
        rows = np.delete(rows, worst)
    return tuple(removed[:found])


def critical_deviate(n: int, confidence: float) -> float:
    """Give the largest Studentised deviate that n normal values may show."""
    t = float(stats.t.ppf(1.0 - (1.0 - confidence) / (2.0 * n), n - 2))
    return (n - 1) * t / math.sqrt((n - 2 + t**2) * n)
