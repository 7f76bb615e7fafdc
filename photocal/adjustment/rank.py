"""What a network leaves undetermined, in words."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from drivers.errors import IllPosedError
from photocal.adjustment.datum import open_combinations, similarity_moves
from photocal.adjustment.envelope import dense
from photocal.adjustment.normal import Normal, Problem, diagonal_addresses, normal_equations
from photocal.adjustment.state import State
from photocal.geometry.camera import PARAMETERS

Floats = NDArray[np.float64]

# A scaled eigenvalue below this means that rounding, not an observation, holds the unknowns.
NULL = 1e-10
POSE_NAMES = ("omega", "phi", "kappa", "X", "Y", "Z")
DATUM_NAMES = (
    "position in X",
    "position in Y",
    "position in Z",
    "rotation about X",
    "rotation about Y",
    "rotation about Z",
    "scale",
)


def weakest_pivot(factor_diagonal: Floats, diagonal: Floats) -> float:
    """Smallest share of a diagonal element that remains when all before it are eliminated."""
    with np.errstate(divide="ignore", invalid="ignore"):
        share = factor_diagonal**2 / diagonal
    return float(np.nanmin(share, initial=1.0))


def explain_singular(problem: Problem, state: State) -> None:
    """Raise what the observations leave undetermined; return when they determine everything.

    Parameters
    ----------
    problem : Problem
    state : State
        Where the normal equations are looked at.

    Raises
    ------
    IllPosedError
        Naming the points, the datum elements or the parameters concerned.
    """
    normal = normal_equations(problem, state)
    names = problem.network.point_names
    if len(normal.singular):
        some = ", ".join(names[j] for j in normal.singular[:5])
        raise IllPosedError(
            f"the rays of {len(normal.singular)} object point(s) do not intersect ({some})",
            remedy="give these points rays from different places, or take them out",
        )
    matrix = dense(problem.layout.envelope, normal.matrix)
    scale = np.sqrt(np.maximum(np.diag(matrix), np.finfo(float).tiny))
    scaled = matrix / np.outer(scale, scale)
    eigenvalues, vectors = np.linalg.eigh(scaled)
    null = vectors[:, eigenvalues < NULL]
    if not null.shape[1]:
        return
    datum = _datum_defects(problem, normal, state)
    remainder = null.shape[1] - len(datum)
    parts = []
    if datum:
        parts.append(f"nothing fixes the datum ({', '.join(datum)})")
    if remainder > 0 or not datum:
        parts.append("the observations do not separate " + _loaded(problem, null))
    raise IllPosedError(
        f"the network is singular (rank defect {null.shape[1]}): " + "; ".join(parts),
        remedy="add control points, weighted positions or prior sigmas, or hold what cannot be determined",
    )


def _datum_defects(problem: Problem, normal: Normal, state: State) -> list[str]:
    """Elements of the datum along which nothing changes."""
    moves, _ = similarity_moves(problem, state)
    combinations = open_combinations(problem, normal, moves)
    share = np.abs(combinations) * np.sqrt(normal.matrix[diagonal_addresses(problem)] @ moves**2)[:, None]
    taking_part = (share > 0.5 * share.max(axis=0, initial=0.0)).any(axis=1)
    return [name for name, hit in zip(DATUM_NAMES, taking_part, strict=True) if hit]


def _loaded(problem: Problem, null: Floats) -> str:
    """Name the unknowns that take part in what is undetermined."""
    load = np.linalg.norm(null, axis=1)
    strong = load > 0.2 * load.max()
    found = []
    for camera, (active, columns) in zip(problem.network.cameras, problem.layout.camera_columns, strict=True):
        named = [PARAMETERS[p] for p, c in zip(active, columns, strict=True) if strong[c]]
        if named:
            found.append(f"{', '.join(named)} of camera {camera.id}")
    per_image = strong[problem.layout.image_columns]
    names = [name for name, hit in zip(POSE_NAMES, per_image.any(axis=0), strict=True) if hit]
    if names:
        images = [problem.network.image_names[i] for i in np.flatnonzero(per_image.any(axis=1))]
        which = ", ".join(images[:5]) + (f" and {len(images) - 5} more" if len(images) > 5 else "")
        found.append(f"{', '.join(names)} of image(s) {which}")
    return " and ".join(found)
