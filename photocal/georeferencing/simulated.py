"""Direct georeferencing simulated: an adjusted exterior orientation made as bad as a stated GNSS/IMU."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from drivers.errors import ConfigurationError
from photocal.adjustment.adjust import adjust
from photocal.adjustment.mounting import NO_ATTITUDES, NO_MOUNTING, NO_POSITIONS
from photocal.block.model import Block
from photocal.block.network import assemble
from photocal.georeferencing.methods import local_origin, without_weak_images


@dataclass(frozen=True)
class Degradation:
    """Noise that is added to an adjusted exterior orientation.

    position_m, attitude_rad: standard deviations of X, Y, Z and of omega, phi, kappa.
    """

    position_m: float
    attitude_rad: float

    def __post_init__(self) -> None:
        if not (self.position_m > 0.0 and self.attitude_rad > 0.0):
            raise ConfigurationError(
                "the noise of simulated orientations must be positive",
                remedy="give standard deviations such as 0.08 m and 0.02 deg",
            )

    @property
    def note(self) -> str:
        """What a reader must know about results with it."""
        return (
            f" [SIMULATED: adjusted orientation with added noise of {self.position_m:g} m and "
            f"{np.degrees(self.attitude_rad):g} deg; no GNSS/IMU measured it]"
        )


def degraded(block: Block, noise: Degradation, rng: np.random.Generator) -> Block:
    """Adjust a block and give its images the result with noise, as observations."""
    adjusted, weak = without_weak_images(block)
    assembly = assemble(adjusted)
    exposures = adjust(assembly.network).exposures
    sigma = np.broadcast_to(
        np.repeat([noise.attitude_rad, noise.position_m], 3), block.images.sigma.shape
    ).copy()
    values = exposures + np.concatenate([np.zeros(3), local_origin(assembly)])
    sigma[weak] = np.inf
    values = values + rng.normal(0.0, 1.0, values.shape) * np.where(np.isfinite(sigma), sigma, 0.0)
    return replace(
        block,
        images=replace(block.images, values=values, sigma=sigma),
        positions=NO_POSITIONS,
        attitudes=NO_ATTITUDES,
        mounting=NO_MOUNTING,
    )
