"""Strong correlations, also with exterior orientations: what causes each, and what cannot be one."""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from photocal.adjustment.adjusted import AdjustedNetwork
from photocal.adjustment.factored import camera_covariance_column
from photocal.adjustment.state import turn_basis
from photocal.analysis.estimates import Estimates
from photocal.base.arrays import Floats
from photocal.findings.finding import Finding
from photocal.geometry.camera import PARAMETERS
from photocal.geometry.rotation import angles_from_matrix, turn_per_angle

_RADIAL = frozenset({"K1", "K2", "K3", "K4"})
_DECENTRING = frozenset({"P1", "P2", "P3", "P4"})
# Pairs of families: the code of what makes two parameters look alike.
_CAUSES: tuple[tuple[frozenset[str], frozenset[str], str], ...] = (
    (_RADIAL, _RADIAL, "radii"),
    (frozenset({"x0"}), frozenset({"P1"}), "shift-tilt"),
    (frozenset({"y0"}), frozenset({"P2"}), "shift-tilt"),
    (frozenset({"c"}), _RADIAL, "scale-radii"),
    (frozenset({"c"}), frozenset({"Z", "Z0"}), "height"),
    (frozenset({"c"}), frozenset({"X", "X0", "Y", "Y0", "omega", "phi"}), "along-the-axis"),
    (frozenset({"x0", "y0"}), frozenset({"X", "X0", "phi", "Y", "Y0", "omega"}), "same-heading"),
    (frozenset({"c", "x0", "y0"}), frozenset({"B1", "B2"}), "two-scales"),
    (frozenset({"x0"}), frozenset({"y0"}), "one-side"),
    (frozenset({"c"}), frozenset({"x0", "y0"}) | _DECENTRING, "one-side"),
    (_DECENTRING, _DECENTRING, "all-around"),
    (frozenset({"omega"}), frozenset({"kappa"}), "one-angle"),
)
UNKNOWN = "unknown"
ELEMENTS = ("omega", "phi", "kappa", "X0", "Y0", "Z0")


@dataclass(frozen=True)
class StrongCorrelation:
    """Two parameters that the network separates badly.

    cause: code of why, with what would separate them.
    """

    first: str
    second: str
    value: float
    cause: str


def strong_correlations(estimates: Estimates, threshold: float = 0.8) -> tuple[StrongCorrelation, ...]:
    """List the pairs of parameters with a correlation over a threshold, strongest first."""
    r = estimates.correlation
    strong = [
        StrongCorrelation(b, a, float(r[i, j]), cause(a, b))
        for i, a in enumerate(estimates.names)
        for j, b in enumerate(estimates.names[:i])
        if abs(r[i, j]) >= threshold
    ]
    return tuple(sorted(strong, key=lambda pair: -abs(pair.value)))


def cause(first: str, second: str) -> str:
    """Give the code of why two parameters are correlated."""
    for left, right, words in _CAUSES:
        if (first in left and second in right) or (first in right and second in left):
            return words
    return UNKNOWN


def correlation_findings(names: tuple[str, ...], matrix: Floats | None, rounding: float) -> list[Finding]:
    """Check that a matrix is symmetric with ones on its diagonal and no negative eigenvalue.

    Rounding adds a symmetric matrix with zero diagonal and entries up to `rounding`, whose eigenvalues
    are at most (n - 1) rounding (Gershgorin 1931); by Weyl (1912) no eigenvalue moves farther.
    """
    if matrix is None:
        return []
    n = len(names)
    if matrix.shape != (n, n) or not np.isfinite(matrix).all():
        return [Finding("correlation_malformed", "refused", " ".join(names))]
    proper = np.allclose(np.diag(matrix), 1.0, atol=1e-9) and np.allclose(
        matrix, matrix.T, atol=2 * rounding + 1e-9
    )
    if not proper or np.abs(matrix).max() > 1.0 + rounding + 1e-9:
        return [Finding("correlation_malformed", "refused", " ".join(names))]
    least = _least(matrix)
    # A computed matrix may miss by the rounding of its own arithmetic.
    arithmetic = 1e-10
    slack = max((n - 1) * rounding, arithmetic)
    if least >= -slack:
        return []
    figures = {"least_eigenvalue": least}
    pair, repaired = sign_repair(matrix)
    if repaired < -slack:
        return [Finding("correlation_not_positive", "refused", " ".join(names), figures)]
    figures |= {"entry": float(matrix[pair]), "repaired_eigenvalue": repaired}
    return [Finding("correlation_sign_lost", "refused", f"{names[pair[1]]}-{names[pair[0]]}", figures)]


def sign_repair(matrix: Floats) -> tuple[tuple[int, int], float]:
    """Find the one entry whose changed sign raises the least eigenvalue most."""
    best, least = (1, 0), -np.inf
    for i in range(1, len(matrix)):
        for j in range(i):
            changed = matrix.copy()
            changed[i, j] = changed[j, i] = -matrix[i, j]
            value = _least(changed)
            if value > least:
                best, least = (i, j), value
    return best, float(least)


def _least(matrix: Floats) -> float:
    return float(np.linalg.eigvalsh((matrix + matrix.T) / 2)[0])


@dataclass(frozen=True)
class ExteriorCorrelation:
    """A camera parameter and an element of the exterior orientation that the network separates badly.

    image: where the correlation is largest.
    images: number of images in which it is over the threshold.
    cause: code of why, with what would separate them.
    """

    parameter: str
    element: str
    image: str
    value: float
    images: int
    cause: str


def exterior_correlations(
    fit: AdjustedNetwork, camera: int, threshold: float, done: Callable[[], None] = lambda: None
) -> tuple[ExteriorCorrelation, ...]:
    """List camera parameters that are strongly correlated with exterior orientations."""
    correlations = []
    for at in np.flatnonzero(fit.network.cameras[camera].estimated):
        r = correlation_with(fit, camera, int(at))
        for k, element in enumerate(ELEMENTS):
            strong = np.abs(r[:, k]) >= threshold
            if strong.any():
                i = int(np.argmax(np.abs(r[:, k])))
                name, image = PARAMETERS[at], fit.network.image_names[i]
                figures = float(r[i, k]), int(strong.sum()), cause(name, element)
                correlations.append(ExteriorCorrelation(name, element, image, *figures))
        done()
    return tuple(sorted(correlations, key=lambda pair: -abs(pair.value)))


def correlation_with(fit: AdjustedNetwork, camera: int, parameter: int) -> Floats:
    """Give the correlation of one camera parameter with every exterior orientation, from its column."""
    layout = fit.factored.problem.layout
    active, columns = layout.camera_columns[camera]
    column, _ = camera_covariance_column(fit.factored, int(columns[active == parameter][0]))
    covariance = np.where(fit.network.exposures.sigma == 0, 0.0, column[layout.image_columns])
    angles = turn_per_angle(angles_from_matrix(fit.state.rotation))
    turns = np.einsum("nab,nb->na", turn_basis(fit.network, fit.state), covariance[:, :3])
    covariance[:, :3] = np.linalg.solve(angles, turns[:, :, None])[:, :, 0]
    sigma = np.sqrt(np.diagonal(fit.solution.exposure_covariance, axis1=1, axis2=2))
    parameter_sigma = float(np.sqrt(fit.solution.camera_covariance[camera, parameter, parameter]))
    r = np.divide(covariance, sigma * parameter_sigma, out=np.zeros_like(covariance), where=sigma > 0.0)
    return np.asarray(np.clip(r, -1.0, 1.0))
