"""Partial volumes between neighbouring sections of a tank, and its filling table, with sigmas."""

from dataclasses import dataclass

import numpy as np

from photocal.base.arrays import Floats
from photocal.base.errors import ConfigurationError
from photocal.products.sections import Tank, volume_between_sections


@dataclass(frozen=True)
class Filled:
    """Volume between two levels, m above the lowest section, with its standard deviation, m3."""

    from_m: float
    to_m: float
    volume_m3: float
    sigma_m3: float


def partial_volumes(tank: Tank, wall_thickness: float = 0.0) -> tuple[Filled, ...]:
    """Volumes between neighbouring sections, by the end areas."""
    radius, height, covariance = _rings(tank, wall_thickness)
    parts = []
    for k in range(len(radius) - 1):
        made = volume_between_sections(radius[k : k + 2], height[k : k + 2], covariance[k : k + 2])
        parts.append(Filled(height[k] - height[0], height[k + 1] - height[0], made.value, made.sigma))
    return tuple(parts)


def filling_table(tank: Tank, step_m: float, wall_thickness: float = 0.0) -> tuple[Filled, ...]:
    """Volumes from the lowest section to levels that far apart; areas change evenly between sections.

    raises ConfigurationError: for a step that cannot be, or a single section.
    """
    radius, height, covariance = _rings(tank, wall_thickness)
    if len(radius) < 2:
        raise ConfigurationError("a filling table needs two sections", "measure another ring")
    whole = float(height[-1] - height[0])
    most_levels = 10_000
    if not whole / most_levels < step_m <= whole:
        raise ConfigurationError(f"levels every {step_m:g} m make no table", f"the sections span {whole:g} m")
    levels = np.append(np.arange(step_m, whole * (1 - 1e-9), step_m), whole)
    return tuple(Filled(0.0, float(at), *_filled(radius, height, covariance, float(at))) for at in levels)


def _rings(tank: Tank, wall_thickness: float) -> tuple[Floats, Floats, Floats]:
    radius = np.array([ring.circle.radius for ring in tank.sections]) - wall_thickness
    height = np.array([ring.height for ring in tank.sections])
    return radius, height, np.array([ring.covariance for ring in tank.sections])


def _filled(radius: Floats, height: Floats, covariance: Floats, level: float) -> tuple[float, float]:
    """Volume up to a level above the lowest section, and its standard deviation."""
    steps = 1e-6 * np.stack([radius, np.full_like(radius, height[-1] - height[0])], axis=1)
    gradient = np.zeros((len(radius), 2))
    for k in range(len(radius)):
        for axis in (0, 1):
            moved = [np.stack([radius, height], axis=1) for _ in "+-"]
            moved[0][k, axis] += steps[k, axis]
            moved[1][k, axis] -= steps[k, axis]
            above, below = (_volume(one[:, 0], one[:, 1], one[0, 1] + level) for one in moved)
            gradient[k, axis] = (above - below) / (2 * steps[k, axis])
    variance = float(np.einsum("mi,mij,mj->", gradient, covariance, gradient))
    return _volume(radius, height, height[0] + level), float(np.sqrt(variance))


def _volume(radius: Floats, height: Floats, top: float) -> float:
    """Integral of the area, even between sections, up to a height; beyond the last it goes on as there."""
    area, total = np.pi * radius**2, 0.0
    for k in range(len(radius) - 1):
        last = k == len(radius) - 2
        rise = float(height[k + 1] - height[k])
        up = max(top - height[k], 0.0) if last else min(max(top - height[k], 0.0), rise)
        total += area[k] * up + (area[k + 1] - area[k]) * up**2 / (2 * rise)
    return float(total)
