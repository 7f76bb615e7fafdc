"""Whether a printed matrix is a correlation matrix, and if not, which entry was misprinted."""

from __future__ import annotations

import numpy as np

from drivers.arrays import Floats
from photocal.findings.finding import Finding

# A computed matrix may miss by the rounding of its own arithmetic.
ARITHMETIC = 1e-10


def correlation_findings(names: tuple[str, ...], matrix: Floats | None, rounding: float) -> list[Finding]:
    """Check that a matrix is symmetric with ones on its diagonal and no negative eigenvalue.

    Notes
    -----
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
    slack = max((n - 1) * rounding, ARITHMETIC)
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
