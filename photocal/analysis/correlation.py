"""Strong correlations, and what causes each of them."""

from __future__ import annotations

from dataclasses import dataclass

from photocal.analysis.estimates import Estimates

# Pairs of families: what makes two parameters look alike, and what would separate them.
_RADIAL = frozenset({"K1", "K2", "K3", "K4"})
_DECENTRING = frozenset({"P1", "P2", "P3", "P4"})
_SHIFT_TILT = (
    "a shift of the principal point with a small tilt looks like decentring; rolled photos separate them"
)
_SAME_HEADING = (
    "photos with the same heading: the principal point moves with the camera; "
    "opposite or rolled photos separate them"
)
_RADII = "powers of the same radius; points out to the corners separate them, or leave out the highest term"
_SCALE_RADII = (
    "a change of scale looks like radial distortion where the radii are alike; points from centre to corner "
    "separate them, or the balanced form"
)
_HEIGHT = (
    "vertical photos of flat ground: a longer principal distance is a higher camera; relief, two heights or "
    "convergent photos separate them"
)
_ALONG_THE_AXIS = (
    "tilted photos: a longer principal distance is a camera farther back along its axis; relief or photos "
    "from opposite sides separate them"
)
_TWO_SCALES = "one scale is seen in two directions only by photos rolled by 90 degrees"
_ONE_SIDE = "the photos see the object from one side only; opposite tilts or rolled photos separate them"
_ALL_AROUND = "decentring of the same form; only points all around the image separate them"
_CAUSES: tuple[tuple[frozenset[str], frozenset[str], str], ...] = (
    (_RADIAL, _RADIAL, _RADII),
    (frozenset({"x0"}), frozenset({"P1"}), _SHIFT_TILT),
    (frozenset({"y0"}), frozenset({"P2"}), _SHIFT_TILT),
    (frozenset({"c"}), _RADIAL, _SCALE_RADII),
    (frozenset({"c"}), frozenset({"Z", "Z0"}), _HEIGHT),
    (frozenset({"c"}), frozenset({"X", "X0", "Y", "Y0", "omega", "phi"}), _ALONG_THE_AXIS),
    (frozenset({"x0", "y0"}), frozenset({"X", "X0", "phi", "Y", "Y0", "omega"}), _SAME_HEADING),
    (frozenset({"c", "x0", "y0"}), frozenset({"B1", "B2"}), _TWO_SCALES),
    (frozenset({"x0"}), frozenset({"y0"}), _ONE_SIDE),
    (frozenset({"c"}), frozenset({"x0", "y0"}) | _DECENTRING, _ONE_SIDE),
    (_DECENTRING, _DECENTRING, _ALL_AROUND),
)
_UNKNOWN = "no usual cause; look at the distribution of the points over the image"


@dataclass(frozen=True)
class StrongCorrelation:
    """Two parameters that the network separates badly.

    Attributes
    ----------
    first, second : str
        The parameters.
    value : float
        Their correlation.
    cause : str
        Why, and what would separate them.
    """

    first: str
    second: str
    value: float
    cause: str


def strong_correlations(estimates: Estimates, threshold: float = 0.8) -> tuple[StrongCorrelation, ...]:
    """List the pairs of parameters with a correlation over a threshold, strongest first.

    Parameters
    ----------
    estimates : Estimates
        Parameters with their covariance; X0, Y0, Z0, omega, phi, kappa may be among them.
    threshold : float
        Absolute value from which a correlation is named.

    Returns
    -------
    tuple of StrongCorrelation
        Pairs with their cause.
    """
    r = estimates.correlation
    found = [
        StrongCorrelation(b, a, float(r[i, j]), cause(a, b))
        for i, a in enumerate(estimates.names)
        for j, b in enumerate(estimates.names[:i])
        if abs(r[i, j]) >= threshold
    ]
    return tuple(sorted(found, key=lambda pair: -abs(pair.value)))


def cause(first: str, second: str) -> str:
    """Say why two parameters are correlated and what would separate them.

    Parameters
    ----------
    first, second : str
        Names of parameters, in either order.

    Returns
    -------
    str
        Cause and remedy, half a sentence each.
    """
    for left, right, words in _CAUSES:
        if (first in left and second in right) or (first in right and second in left):
            return words
    return _UNKNOWN
