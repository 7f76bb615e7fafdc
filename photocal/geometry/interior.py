"""Interior orientation of one image: from machine or pixel readings to image coordinates.

Fiducial marks or frame corners are known in the image system and read in the machine system. The
transformation between the two is adjusted over them; its residuals tell how well the marks were read.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np

from photocal.base.arrays import Floats
from photocal.base.errors import IllPosedError

Transformation = Literal["conformal", "affine", "projective"]
PARAMETER_COUNT: dict[Transformation, int] = {"conformal": 4, "affine": 6, "projective": 8}
# Singular values whose ratio is smaller come from marks in a line, or fewer than they seem.
DEGENERATE = 1e-9


@dataclass(frozen=True)
class InteriorOrientation:
    """Transformation of one image's readings.

    matrix (3, 3): takes homogeneous readings to homogeneous image coordinates; its last element is 1 where it
        is not projective.
    residuals (marks, 2): computed minus known coordinates of the marks, in the unit of the image coordinates.
    redundancy: coordinates of the marks less parameters.
    sigma0: standard deviation of one coordinate of a mark, from the residuals; NaN without redundancy.
    """

    matrix: Floats
    residuals: Floats
    redundancy: int
    sigma0: float

    def applied(self, readings: Floats) -> Floats:
        """Image coordinates of readings, shape (n, 2)."""
        return _transform(self.matrix, readings)


def interior_orientation(
    readings: Floats, known: Floats, kind: Transformation, names: Sequence[str] = ()
) -> InteriorOrientation:
    """Find the transformation of least squares residuals at the marks.

    readings (n, 2): readings of the marks, in any unit and of either handedness.
    known (n, 2): their calibrated coordinates in the image system (x right, y up).
    raises IllPosedError: for too few marks, or marks in a line.
    """
    readings, known = np.asarray(readings, dtype=float), np.asarray(known, dtype=float)
    unknowns = PARAMETER_COUNT[kind]
    _require(readings, known, kind, names)
    # Both systems are centred and scaled, so that the equations do not depend on the units.
    to_unit, unit_readings = _normalised(readings)
    from_unit, unit_known = _normalised(known)
    if kind == "conformal":
        # Whether a reflection brings the marks closer to their known places than a rotation: the sign of the
        # determinant of the products of both systems decides (Kabsch 1976).
        mirrored = bool(np.linalg.det(unit_known.T @ unit_readings) < 0)
        matrix = _conformal(unit_readings, unit_known, mirrored)
    elif kind == "affine":
        design = np.column_stack([unit_readings, np.ones(len(readings))])
        matrix = np.vstack([np.linalg.lstsq(design, unit_known, rcond=None)[0].T, [0.0, 0.0, 1.0]])
    else:
        matrix = _projective(unit_readings, unit_known)
    matrix = np.linalg.inv(from_unit) @ matrix @ to_unit
    matrix = matrix / matrix[2, 2]
    residuals = _transform(matrix, readings) - known
    redundancy = known.size - unknowns
    sigma0 = float(np.sqrt(np.sum(residuals**2) / redundancy)) if redundancy else float("nan")
    return InteriorOrientation(matrix, residuals, redundancy, sigma0)


def _require(readings: Floats, known: Floats, kind: Transformation, names: Sequence[str]) -> None:
    """Refuse marks that do not determine the transformation."""
    where = f"marks {', '.join(names)}" if names else None
    fewest = PARAMETER_COUNT[kind] // 2
    ill_posed = IllPosedError.at(where)
    if len(readings) < fewest:
        raise ill_posed(
            f"{len(readings)} mark(s) do not determine a {kind} interior orientation",
            f"read at least {fewest}, one more to have a check",
        )
    for system, place in ((readings, "readings"), (known, "calibrated coordinates")):
        spread = np.linalg.svd(system - system.mean(axis=0), compute_uv=False)
        line = kind != "conformal" and spread[1] < DEGENERATE * spread[0]
        if spread[0] == 0 or line:
            what = "coincide" if spread[0] == 0 else "lie in a line"
            raise ill_posed(
                f"the {place} of the marks {what}", "read marks at the corners or the sides of the frame"
            )


def _normalised(system: Floats) -> tuple[Floats, Floats]:
    """Matrix to centred coordinates of size one, and those coordinates."""
    middle = system.mean(axis=0)
    size = float(np.sqrt(np.mean((system - middle) ** 2)))
    matrix = np.array([[1 / size, 0, -middle[0] / size], [0, 1 / size, -middle[1] / size], [0, 0, 1]])
    return matrix, (system - middle) / size


def _transform(matrix: Floats, plane: Floats) -> Floats:
    moved = np.asarray(plane, dtype=float) @ matrix[:, :2].T + matrix[:, 2]
    return np.asarray(moved[:, :2] / moved[:, 2:])


def _conformal(readings: Floats, known: Floats, mirrored: bool) -> Floats:
    flip = np.diag([1.0, -1.0 if mirrored else 1.0])
    x, y = (readings @ flip).T
    square = float(np.sum(x * x + y * y))
    a = float(x @ known[:, 0] + y @ known[:, 1]) / square
    b = float(x @ known[:, 1] - y @ known[:, 0]) / square
    matrix = np.eye(3)
    matrix[:2, :2] = np.array([[a, -b], [b, a]]) @ flip
    return matrix


def _projective(readings: Floats, known: Floats) -> Floats:
    """Eight parameters: linear start, then Gauss-Newton on the residuals at the marks."""
    # It settles in a few iterations.
    iterations = 30
    x, y = readings.T
    ones, zero = np.ones_like(x), np.zeros_like(x)
    rows = [
        np.column_stack([x, y, ones, zero, zero, zero, -known[:, 0] * x, -known[:, 0] * y, -known[:, 0]]),
        np.column_stack([zero, zero, zero, x, y, ones, -known[:, 1] * x, -known[:, 1] * y, -known[:, 1]]),
    ]
    _, singular, vectors = np.linalg.svd(np.vstack(rows))
    if singular[7] < DEGENERATE * singular[0]:
        raise IllPosedError(
            "three of the four marks lie in a line", "read marks at the four corners, or more marks"
        )
    matrix: Floats = vectors[-1].reshape(3, 3)
    matrix = matrix / matrix[2, 2]
    for _ in range(iterations):
        moved = _transform(matrix, readings)
        depth = readings @ matrix[2, :2] + 1.0
        top = np.column_stack([x, y, ones]) / depth[:, None]
        none = np.zeros_like(top)
        lens = np.column_stack([x, y]) / depth[:, None]
        design = np.vstack(
            [
                np.hstack([top, none, -moved[:, :1] * lens]),
                np.hstack([none, top, -moved[:, 1:] * lens]),
            ]
        )
        step = np.linalg.lstsq(design, (known - moved).T.ravel(), rcond=None)[0]
        matrix = matrix + np.append(step, 0.0).reshape(3, 3)
        if np.abs(step).max() < 1e-13:
            break
    return matrix
