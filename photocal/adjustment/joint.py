"""Joint covariance of chosen unknowns: the cross-blocks that are not kept for all of them."""

from collections.abc import Sequence

import numpy as np

from photocal.adjustment.factored import Factored, covariance_column
from photocal.adjustment.state import turn_basis
from photocal.adjustment.unknowns import XYZ, Unknown, unknowns
from photocal.base.arrays import Floats
from photocal.base.errors import ConfigurationError
from photocal.geometry.rotation import angles_from_matrix, turn_per_angle

# Right-hand sides that are solved for at once: each holds a value for every point.
AT_ONCE = 12
# A coordinate of a point that is eliminated, by point and axis; of none.
Place = tuple[int, int]
_NOWHERE: Place = (-1, -1)


def joint_covariance(at: Factored, chosen: Sequence[tuple[str, str]]) -> tuple[tuple[Unknown, ...], Floats]:
    """Covariance of all unknowns of chosen images, cameras, points and of the mounting.

    returns: the unknowns, and their covariance (n, n) in the units of the adjustment (rad, m, unit of the
        camera), a priori unit variance 1.
    raises ConfigurationError: for what is no unknown of the network.
    """
    named, rows = list[Unknown](), list[tuple[Floats, Place]]()
    columns = unknowns(at.problem)
    for kind, name in dict.fromkeys(chosen):
        functions = _functions(at, columns, kind, name)
        if not functions:
            raise ConfigurationError(
                f"{kind} {name} is not an unknown of this adjustment".replace("  ", " "),
                "name image:NAME, camera:ID, head:CAMERA, point:NAME or mounting",
            )
        named += [unknown for unknown, _, _ in functions]
        rows += [(reduced, place) for _, reduced, place in functions]
    covariance = np.empty((len(rows), len(rows)))
    reduced = np.array([row for row, _ in rows]).reshape(len(rows), -1)
    # Of a point's coordinate nothing else is asked than the coordinate itself.
    asked = np.array([place for _, place in rows], dtype=np.int64)
    for first in range(0, len(rows), AT_ONCE):
        part = slice(first, first + AT_ONCE)
        places = np.zeros((len(reduced[part]), *at.state.points.shape))
        of_point = np.flatnonzero(asked[part, 0] >= 0)
        places[of_point, asked[part, 0][of_point], asked[part, 1][of_point]] = 1.0
        steps, moved = covariance_column(at, reduced[part], places)
        along = np.where(asked[:, 0] >= 0, moved[:, asked[:, 0], asked[:, 1]], 0.0)
        covariance[:, part] = (steps @ reduced.T + along).T
    return tuple(named), (covariance + covariance.T) / 2


def _functions(
    at: Factored, columns: list[Unknown | None], kind: str, name: str
) -> list[tuple[Unknown, Floats, Place]]:
    """Unknowns of one thing as linear functions of the columns, or coordinates of eliminated points."""
    size = at.problem.layout.size
    indices = [
        k
        for k, column in enumerate(columns)
        if column is not None and (column.kind, column.of) == (kind, name)
    ]
    result = []
    turns = _angle_rows(at, name) if kind == "image" and indices else {}
    for k in indices:
        unknown = columns[k]
        assert unknown is not None  # noqa: S101 - chosen above
        row = np.zeros(size)
        row[k] = 1.0
        result.append((unknown, turns.get(unknown.parameter, row), _NOWHERE))
    if kind == "point" and not indices and name in at.problem.network.point_names:
        j = at.problem.network.point_names.index(name)
        for a, axis in enumerate(XYZ):
            if not at.problem.network.points.held[j, a]:
                result.append((Unknown("point", name, axis, "m"), np.zeros(size), (j, a)))
    return result


def _angle_rows(at: Factored, name: str) -> dict[str, Floats]:
    """Omega, phi and kappa of an image as functions of its three turns."""
    network, layout = at.problem.network, at.problem.layout
    i = network.image_names.index(name)
    angles = angles_from_matrix(at.state.rotation[i : i + 1])
    per_turn = np.linalg.solve(turn_per_angle(angles), turn_basis(network, at.state)[i : i + 1])[0]
    rows = {}
    for k, angle in enumerate(("omega", "phi", "kappa")):
        row = np.zeros(layout.size)
        row[layout.image_columns[i, :3]] = per_turn[k]
        row[at.problem.held] = 0.0
        rows[angle] = row
    return rows
