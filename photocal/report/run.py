"""The results of an adjustment as a report needs them: what `photocal adjust` leaves in a folder."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from photocal.report.stored_analysis import StoredAnalysis

Floats = NDArray[np.float64]

RESULT = "result.json"
ANALYSIS = "analysis.json"


@dataclass(frozen=True)
class Software:
    """The program that made the results."""

    name: str
    version: str


@dataclass(frozen=True)
class BlockFacts:
    """What the adjusted block said of itself: its name, frame, heights, datum and observation unit.

    `source` is the folder with its files, seen from the run folder, and `setup` the set-up file of another
    program within it (empty for a block folder).
    """

    name: str
    frame: str
    datum: str
    observation_unit: Literal["mm", "px"]
    observation_axes: Literal["pixel", "photo"]
    height: str = ""
    source: str = ""
    setup: str = ""


@dataclass(frozen=True)
class InputFile:
    """One file that the adjustment read: path within the block folder, SHA-256 and size in bytes."""

    path: str
    sha256: str
    bytes: int


@dataclass(frozen=True)
class GlobalTest:
    """Two-sided chi-squared test of the variance of unit weight."""

    probability: float
    lower: float
    upper: float
    accepted: bool
    p_value: float


@dataclass(frozen=True)
class Group:
    """One kind of observations and its part of the weighted sum of squares."""

    name: str
    observations: int
    chi_squared: float
    redundancy: float


@dataclass(frozen=True)
class Parameter:
    """Value, a priori scaled standard deviation and that of a prior value, in the camera's unit."""

    value: float
    sigma: float
    estimated: bool
    prior_sigma: float | None = None


@dataclass(frozen=True)
class Correlation:
    """Correlation matrix of the estimated camera parameters, in the order of `names`."""

    names: tuple[str, ...]
    matrix: tuple[tuple[float, ...], ...]


@dataclass(frozen=True)
class CameraResult:
    """Interior orientation of one camera after the adjustment; unit and signs as in the block."""

    model: Literal["brown-observed", "brown-ideal"]
    unit: Literal["mm", "px"]
    size_px: tuple[int, int]
    parameters: dict[str, Parameter]
    correlation: Correlation
    pitch_mm: tuple[float, float] | None = None
    reference_radius: float = 0.0
    affinity: str = "additive"
    affinity_form: str = "fraser"
    focus_m: float | None = None
    photo_variant: tuple[str, ...] = ()

    def value(self, name: str) -> float:
        """Value of a parameter; 0 for one that the model does not have."""
        return self.parameters[name].value if name in self.parameters else 0.0

    @property
    def pitch(self) -> tuple[float, float]:
        """Size of a pixel in x and y, in the unit of the camera."""
        return (1.0, 1.0) if self.unit == "px" or self.pitch_mm is None else self.pitch_mm


@dataclass(frozen=True)
class ImageRms:
    """Root mean square of the residuals of one image, in the unit of the observations."""

    image: str
    rays: int
    rms_x: float
    rms_y: float


@dataclass(frozen=True)
class ImageSummary:
    """Number of images and the residuals of each."""

    n: int
    rms: tuple[ImageRms, ...]


@dataclass(frozen=True)
class CheckPoint:
    """Adjusted minus surveyed coordinates of a check point; standard deviations of the adjusted ones, m."""

    point: str
    dx: float
    dy: float
    dz: float
    sx: float
    sy: float
    sz: float


@dataclass(frozen=True)
class CheckSummary:
    """Check points and their root mean square differences, m (none without points)."""

    n: int
    rmse_m: dict[str, float | None]
    points: tuple[CheckPoint, ...] = ()


@dataclass(frozen=True)
class MountingValue:
    """A value that is common to all exposures (lever arm, boresight, time offset ...), with its sigma."""

    value: float
    sigma: float
    estimated: bool


@dataclass(frozen=True)
class Result:
    """The content of `result.json`; without redundancy there is no variance factor and no test.

    Where variance components were estimated, they are listed.
    """

    schema: str
    software: Software
    block: BlockFacts
    inputs: tuple[InputFile, ...]
    converged: bool
    iterations: int
    observations: int
    unknowns: int
    degrees_of_freedom: int
    chi_squared: float
    sigma0_squared: float | None
    global_test: GlobalTest | None
    groups: tuple[Group, ...]
    cameras: dict[str, CameraResult]
    images: ImageSummary
    checks: CheckSummary
    snooping: Literal["w", "tau"] | None = None
    mounting: dict[str, MountingValue] | None = None
    variance_components: tuple[dict[str, Any], ...] = ()


@dataclass(frozen=True)
class Exposures:
    """Adjusted exterior orientations of n images.

    Attributes
    ----------
    image, camera : tuple of str
        Names, in the order of the rows.
    position_m, position_sigma_m : ndarray, shape (n, 3)
        Projection centres X, Y, Z and their standard deviations.
    angles_deg, angles_sigma_deg : ndarray, shape (n, 3)
        omega, phi, kappa and their standard deviations.
    """

    image: tuple[str, ...]
    camera: tuple[str, ...]
    position_m: Floats
    position_sigma_m: Floats
    angles_deg: Floats
    angles_sigma_deg: Floats


@dataclass(frozen=True)
class Points:
    """Adjusted object points: role, coordinates and standard deviations (m, shape (n, 3)), number of rays."""

    point: tuple[str, ...]
    role: tuple[str, ...]
    position_m: Floats
    sigma_m: Floats
    rays: Floats


@dataclass(frozen=True)
class Residuals:
    """Image residuals (computed minus measured) in the unit and axes of the observations, shape (n, 2) each.

    Attributes
    ----------
    image, point : tuple of str
        Which ray each row is.
    measured, residual : ndarray, shape (n, 2)
        Measured coordinates and residuals.
    redundancy, standardised : ndarray, shape (n, 2)
        Redundancy numbers (0 to 1) and standardised residuals; nan where no other observation checks one.
    """

    image: tuple[str, ...]
    point: tuple[str, ...]
    measured: Floats
    residual: Floats
    redundancy: Floats
    standardised: Floats


@dataclass(frozen=True)
class Run:
    """Everything that a certificate says about an adjustment.

    Attributes
    ----------
    result : Result
        Figures of the whole adjustment and of the cameras.
    exposures : Exposures
        Exterior orientations.
    points : Points
        Object points.
    residuals : Residuals
        Image residuals.
    files : tuple of InputFile
        The files of the folder themselves, with their SHA-256.
    analysis : StoredAnalysis or None
        What `photocal analyse` found; None when it was not asked.
    """

    result: Result
    exposures: Exposures
    points: Points
    residuals: Residuals
    files: tuple[InputFile, ...]
    analysis: StoredAnalysis | None = None
