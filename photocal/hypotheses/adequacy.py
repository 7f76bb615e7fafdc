"""Whether a model explains its observations, by groups, and whether what is left is scatter or a pattern.

Detection, identification, adaptation (Teunissen 2018, doi 10.1007/s00190-017-1045-7): a cause is named when
the model that has it passes. Not every sigma is right, so that v'Pv alone does not tell: residuals that are
larger than stated are scatter where neighbours on an image, or in time, do not share them.
"""

import math
from dataclasses import dataclass

import numpy as np
from scipy import special

from photocal.adjustment.adjusted import AdjustedNetwork
from photocal.adjustment.groups import GroupTest, tested
from photocal.adjustment.network import Network
from photocal.adjustment.solution import Solution
from photocal.base.arrays import Floats, Integers
from photocal.base.policy import policy

# An image is divided into so many cells each way, to see what neighbouring rays share.
_CELLS = 3
# Groups whose residuals show what is wrong on the ground.
GROUPS = ("position", "attitude", "control")


@dataclass(frozen=True)
class Adequacy:
    """How well a model explains its observations.

    groups: those of positions, attitudes and control that do not pass, by name.
    pattern: share of the rays' v'Pv that neighbours on their images have in common.
    noise: variance factor of the rays without it.
    factor: variance factor of the whole.
    """

    groups: tuple[str, ...]
    pattern: float
    noise: float
    factor: float

    @property
    def passes(self) -> bool:
        """Whether nothing is left that asks for a cause."""
        return not self.groups and (self.pattern <= policy.pattern or self.factor <= policy.equivalent**2)


def fit_of(adjusted: AdjustedNetwork) -> Adequacy:
    """Judge an adjusted network."""
    solution = adjusted.solution
    failed = tuple(test.name for test in groups_of_ground(solution) if not _passes(test))
    return Adequacy(failed, *_pattern(adjusted), solution.variance_factor)


def groups_of_ground(solution: Solution) -> list[GroupTest]:
    """Test positions, attitudes and control against their stated standard deviations."""
    groups = (group for group in solution.groups if group.name in GROUPS)
    return [tested(g) for g in groups if g.redundancy >= policy.fewest_redundant and g.chi_squared > 0.0]


def _passes(test: GroupTest) -> bool:
    above = float(special.chdtrc(test.redundancy, test.chi_squared))
    return above >= policy.significance or test.factor <= policy.worth_a_word


def _pattern(adjusted: AdjustedNetwork) -> tuple[float, float]:
    """Share of v'Pv that rays of one cell of an image have in common, and the variance factor without it."""
    network, solution = adjusted.network, adjusted.solution
    w = (
        solution.residuals
        / network.rays.sigma
        / np.sqrt(np.maximum(solution.redundancy, policy.least_checked))
    )
    used = (solution.redundancy > policy.least_checked).all(axis=1)
    if used.sum() < 4:
        return 0.0, 1.0
    w, image = w[used], network.rays.image[used]
    size = np.array([np.multiply(c.size_px, c.pitch) for c in network.cameras])[
        network.exposures.camera[image]
    ]
    place = np.clip(((network.rays.plane[used] / size + 0.5) * _CELLS).astype(np.int64), 0, _CELLS - 1)
    cell = image * _CELLS**2 + place[:, 0] * _CELLS + place[:, 1]
    count = np.bincount(cell)
    seen = count > 0
    count, sums = count[seen], np.column_stack([np.bincount(cell, w[:, a])[seen] for a in (0, 1)])
    between, total = float(np.sum(sums**2 / count[:, None])), float(np.sum(w**2))
    cells, rays = 2.0 * len(count), float(w.size)
    if rays - cells < cells / 2:
        return 0.0, total / rays
    noise = (total - between) / (rays - cells)
    f = between / cells / max(noise, 1e-300)
    # The unknowns of the images take some of what cells have in common: F is cautious.
    if special.fdtrc(cells, rays - cells, f) >= policy.significance:
        return 0.0, total / rays
    return max(0.0, between - cells * noise) / total, noise


@dataclass(frozen=True)
class Memory:
    """Correlation of the residuals of neighbouring positions.

    correlation: of one exposure and the next in its strip, all axes together.
    p_value: of so large a one where errors are independent.
    size: by residuals and redundancy, in stated standard deviations.
    """

    correlation: float
    p_value: float
    pairs: int
    size: float = 1.0

    @property
    def significant(self) -> bool:
        """Whether the positions share their errors."""
        return self.correlation > 0.0 and self.p_value < policy.significance

    @property
    def likely(self) -> bool:
        """Whether that is likely enough not to call their errors independent."""
        return self.correlation > 0.0 and self.p_value < policy.repeat_significance

    @property
    def exceeds(self) -> bool:
        """Whether what they have in common is larger than independent errors as stated would make it.

        Whoever states sigmas with caution has room for what positions share.
        """
        return self.size * math.sqrt(self.inflation) > 1.0 + policy.wrong_sigma

    @property
    def inflation(self) -> float:
        """By how much the variance of what they have in common is larger than of independent ones (AR(1))."""
        rho = min(max(self.correlation, 0.0), 0.99)
        return (1.0 + rho) / (1.0 - rho)


def memory_of(adjusted: AdjustedNetwork) -> Memory | None:
    """Compare each position's residual with that of the next exposure; None for too few of them."""
    network = adjusted.network
    positions = network.positions
    if len(positions.image) < 2 * policy.smallest_sample:
        return None
    residual = adjusted.factored.others["position"].residual.reshape(-1, 3)
    order = np.lexsort((_moment(network, positions.image), positions.strip))
    residual, strip = residual[order], positions.strip[order]
    # A few gross ones are no memory.
    spread = np.median(np.abs(residual), axis=0) * policy.mad_to_sigma
    limit = policy.times_999 * np.where(spread > 0.0, spread, np.inf)
    residual = np.clip(residual, -limit, limit)
    together = strip[1:] == strip[:-1]
    pairs = int(together.sum())
    if pairs < policy.smallest_sample:
        return None
    square = np.mean(residual**2, axis=0)
    scaled = residual / np.sqrt(np.where(square > 0.0, square, 1.0))
    correlation = float(np.mean((scaled[1:] * scaled[:-1])[together]))
    # Without correlation its variance is one over the number of products (Bartlett 1946).
    p_value = float(special.ndtr(-correlation * np.sqrt(3.0 * pairs)))
    group = next(group for group in adjusted.solution.groups if group.name == "position")
    size = math.sqrt(max(group.chi_squared, 0.0) / max(group.redundancy, 1.0))
    return Memory(correlation, p_value, pairs, size)


def _moment(network: Network, images: Integers) -> Floats:
    time = network.exposures.time
    known = time is not None and np.isfinite(time[images]).all()
    return np.asarray(time[images] if known and time is not None else images, dtype=np.float64)
