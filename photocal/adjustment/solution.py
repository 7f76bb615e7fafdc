"""What an adjustment found: values, covariances, residuals and how far each can be believed."""

from dataclasses import dataclass, field

import numpy as np

from photocal.adjustment.solver import Iteration
from photocal.adjustment.state import State
from photocal.base.arrays import Floats, Integers


@dataclass(frozen=True)
class Group:
    """One kind of observation.

    chi_squared: its part of v'Pv.
    redundancy: sum of its redundancy numbers.
    """

    name: str
    observations: int
    chi_squared: float
    redundancy: float


@dataclass(frozen=True)
class ComponentFactor:
    """By what the given sigmas of a group of observations were multiplied; no sigma where it was held."""

    name: str
    observations: int
    redundancy: float
    factor: float
    sigma: float | None
    estimated: bool


@dataclass(frozen=True)
class PhotoVariant:
    """Parameters whose values vary from image to image, one row for each.

    image, parameter (n,): image, and position in `OWN`: a parameter of the camera, or movement during the
        readout.
    values, sigma (n,): of the image's own lens; for a movement the sigma of its deviation.
    deviations, deviation_sigma (n,): from the value of the camera, or from the given motion.
    """

    image: Integers
    parameter: Integers
    values: Floats
    sigma: Floats
    deviations: Floats
    deviation_sigma: Floats


@dataclass(frozen=True)
class Solution:
    """Result of an adjustment; covariances are scaled by the a priori unit variance 1.

    chi_squared: v'Pv at the minimum.
    datum_defect: elements of the datum that inner constraints fixed.
    cameras (cameras, 20).
    camera_covariance (cameras, 20, 20): zero for parameters that are held.
    exposures (images, 6): omega, phi, kappa in radians, X, Y, Z in m.
    exposure_covariance (images, 6, 6).
    points (points, 3).
    point_covariance (points, 3, 3).
    residuals, redundancy (rays, 2): computed minus measured, in the image plane; redundancy numbers.
    common_covariance (k, k): of the common values of mounting and rigs; zero for those that are held.
    state: the values as the adjustment holds them.
    laser_residuals, laser_redundancy (lasers,): computed minus measured, m; redundancy numbers.
    """

    iterations: tuple[Iteration, ...]
    chi_squared: float
    observations: int
    unknowns: int
    datum_defect: int
    groups: tuple[Group, ...]
    cameras: Floats
    camera_covariance: Floats
    exposures: Floats
    exposure_covariance: Floats
    points: Floats
    point_covariance: Floats
    residuals: Floats
    redundancy: Floats
    common_covariance: Floats
    photo_variant: PhotoVariant
    state: State
    laser_residuals: Floats = field(default_factory=lambda: np.zeros(0))
    laser_redundancy: Floats = field(default_factory=lambda: np.zeros(0))

    @property
    def degrees_of_freedom(self) -> int:
        """Observations and datum constraints less unknowns."""
        return self.observations + self.datum_defect - self.unknowns

    @property
    def variance_factor(self) -> float:
        """A posteriori variance of unit weight; NaN without redundancy."""
        return self.chi_squared / self.degrees_of_freedom if self.degrees_of_freedom > 0 else float("nan")

    def standardised(self, sigma: Floats) -> Floats:
        """Standardised residuals w = v / (sigma sqrt(r)) (Baarda 1968); NaN where nothing checks a ray."""
        checked = self.redundancy > 1e-9
        scale = np.where(checked, sigma * np.sqrt(np.where(checked, self.redundancy, 1.0)), np.nan)
        return np.asarray(self.residuals / scale)
