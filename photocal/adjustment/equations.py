"""Linearised observations in compressed rows, and how they enter the normal equations."""

from typing import NamedTuple

import numpy as np

from photocal.adjustment.kernels.data import Structure
from photocal.adjustment.kernels.ray import element_address
from photocal.base.arrays import Floats, Integers
from photocal.base.compiled import compiled


class Equations(NamedTuple):
    """Linearised observations in compressed rows.

    start (n + 1,): where the coefficients of each observation begin.
    residual, weight (n,): computed minus observed, and 1 / sigma^2.
    """

    start: Integers
    column: Integers
    coefficient: Floats
    residual: Floats
    weight: Floats

    def chi_squared(self) -> float:
        """Sum of v'Pv."""
        return float(np.sum(self.weight * self.residual**2))


@compiled
def add_equations(
    start: Integers,
    column: Integers,
    coefficient: Floats,
    residual: Floats,
    weight: Floats,
    structure: Structure,
    matrix: Floats,
    gradient: Floats,
) -> None:
    """Add observations to the normal equations."""
    for row in range(len(residual)):
        p = weight[row]
        for a in range(start[row], start[row + 1]):
            gradient[column[a]] += coefficient[a] * p * residual[row]
            for b in range(start[row], start[row + 1]):
                if column[b] <= column[a]:
                    at = element_address(structure, column[a], column[b])
                    matrix[at] += p * coefficient[a] * coefficient[b]
