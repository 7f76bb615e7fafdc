"""Strong correlations, and what causes each of them."""

from __future__ import annotations

from dataclasses import dataclass

from photocal.analysis.estimates import Estimates

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
)
UNKNOWN = "unknown"


@dataclass(frozen=True)
class StrongCorrelation:
    """Two parameters that the network separates badly.

    first, second: the parameters.
    value: their correlation.
    cause: code of why, with what would separate them.
    """

    first: str
    second: str
    value: float
    cause: str


def strong_correlations(estimates: Estimates, threshold: float = 0.8) -> tuple[StrongCorrelation, ...]:
    """List the pairs of parameters with a correlation over a threshold, strongest first."""
    r = estimates.correlation
    found = [
        StrongCorrelation(b, a, float(r[i, j]), cause(a, b))
        for i, a in enumerate(estimates.names)
        for j, b in enumerate(estimates.names[:i])
        if abs(r[i, j]) >= threshold
    ]
    return tuple(sorted(found, key=lambda pair: -abs(pair.value)))


def cause(first: str, second: str) -> str:
    """Give the code of why two parameters are correlated."""
    for left, right, words in _CAUSES:
        if (first in left and second in right) or (first in right and second in left):
            return words
    return UNKNOWN
