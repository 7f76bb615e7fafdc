"""Volume of round tanks with its standard deviation."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from drivers.arrays import Floats
from drivers.errors import ConfigurationError


@dataclass(frozen=True)
class Volume:
    """A volume and what its uncertainty is made of.

    value: m3.
    radius_variance, height_variance: shares of the variance that come from the radii and from the heights,
        m6; they add up to the variance where radii and heights are uncorrelated.
    variance: m6.
    """

    value: float
    radius_variance: float
    height_variance: float
    variance: float

    @property
    def sigma(self) -> float:
        """Standard deviation, m3."""
        return float(np.sqrt(self.variance))

    @property
    def percent(self) -> float:
        """Standard deviation in per cent of the volume."""
        return 100 * self.sigma / self.value


def cylinder_volume(radius: float, radius_sigma: float, height: float, height_sigma: float) -> Volume:
    """Volume of an upright cylinder from its mean radius and its height.

    radius, radius_sigma, height, height_sigma: m; radius and height uncorrelated.
    raises ConfigurationError: for a radius or height that is not positive, or a sigma that is negative.
    """
    for name, value in (("radius", radius), ("height", height)):
        if not (np.isfinite(value) and value > 0):
            raise ConfigurationError(f"the {name} is {value:g} m", remedy="give a positive length in metres")
    for name, value in (("radius", radius_sigma), ("height", height_sigma)):
        if not (np.isfinite(value) and value >= 0):
            raise ConfigurationError(
                f"the standard deviation of the {name} is {value:g} m", remedy="give metres, not negative"
            )
    by_radius = (2 * np.pi * radius * height * radius_sigma) ** 2
    by_height = (np.pi * radius**2 * height_sigma) ** 2
    return Volume(np.pi * radius**2 * height, by_radius, by_height, by_radius + by_height)


def volume_between_sections(radius: Floats, height: Floats, covariance: Floats) -> Volume:
    """Volume from the lowest to the highest section by the end areas."""
    area, step = np.pi * radius**2, np.diff(height)
    around = np.concatenate([[0.0], step, [0.0]])
    by_radius = np.pi * radius * (around[:-1] + around[1:])
    means = (area[:-1] + area[1:]) / 2
    by_height = np.concatenate([[0.0], means]) - np.concatenate([means, [0.0]])
    gradient = np.column_stack([by_radius, by_height])
    return Volume(
        float(means @ step),
        float(by_radius**2 @ covariance[:, 0, 0]),
        float(by_height**2 @ covariance[:, 1, 1]),
        float(np.einsum("mi,mij,mj->", gradient, covariance, gradient)),
    )
