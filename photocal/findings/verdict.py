"""The one verdict: what follows of all findings for what a client uses, the same sentence everywhere."""

from __future__ import annotations

import math
from collections.abc import Iterable

from photocal.findings.finding import Finding, untested

# Limit of equivalence: a smaller error of the stated standard deviations is no finding, however sure it is.
FACTOR = 0.05
# Errors of what the client uses: not small, they withhold acceptance like the grave ones.
_EFFECTIVE = ("c-drift", "rolling-shutter")


def of_global_test(
    chi_squared: float, degrees_of_freedom: int, accepted: bool | None, *, estimated: bool = False
) -> Finding:
    """Give what the global test says of the stated standard deviations.

    accepted: its outcome; None without degrees of freedom.
    """
    if accepted is None or degrees_of_freedom < 1:
        return untested("global-factor", "no-redundancy")
    factor = math.sqrt(chi_squared / degrees_of_freedom)
    figures = {"factor": factor, "limit": FACTOR}
    if estimated:
        return untested("global-factor", "sigmas-from-residuals", figures)
    if accepted or abs(factor - 1.0) <= FACTOR:
        return Finding("global-factor", "passed", figures=figures)
    return Finding("global-factor", "doubtful", figures=figures, remedy="scale-sigmas")


def verdict(findings: Iterable[Finding]) -> Finding:
    """Judge over all findings: what is grave withholds acceptance, what is doubtful is a reservation."""
    listed = tuple(findings)
    grave = [f for f in listed if _grave(f)]
    doubtful = [f for f in listed if f.severity in ("doubtful", "consequence") and f not in grave]
    decided = tuple(dict.fromkeys(f.code for f in grave or doubtful))
    figures = {"n": float(len(grave or doubtful)), "codes": decided, "limit": FACTOR}
    if grave:
        return Finding("not-usable", "grave", figures=figures)
    if doubtful:
        return Finding("usable-with-reservations", "doubtful", figures=figures)
    return Finding("usable", "passed", figures=figures)


def _grave(one: Finding) -> bool:
    return one.severity in ("refused", "grave") or (one.code in _EFFECTIVE and not one.small)
