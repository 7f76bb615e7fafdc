"""Joint covariance of chosen unknowns: the cross-blocks that are not kept for all of them."""

from collections.abc import Sequence

import numpy as np

from photocal.adjustment.factored import Factored, covariance_column
from photocal.adjustment.state import turn_basis
from photocal.adjustment.unknowns import XYZ, Unknown, unknowns
from photocal.base.arrays import Floats
from photocal.base.errors import ConfigurationError
from photocal.geometry.rotation import angles_from_matrix, turn_per_angle


def joint_covariance(at: Factored, chosen: Sequence[tuple[str, str]]) -> tuple[tuple[Unknown, ...], Floats]:
    """Covariance of all unknowns of chosen images, cameras, points and of the mounting.

    returns: the unknowns, and their covariance (n, n) in the units of the adjustment (rad, m, unit of the
        camera), a priori unit variance 1.
    raises ConfigurationError: for what is no unknown of the network.
    """
    named, rows = list[Unknown](), list[tuple[Floats, Floats]]()
    columns = unknowns(at.problem)
    for kind, name in dict.fromkeys(chosen):
        functions = _functions(at, columns, kind, name)
        if not functions:
            raise ConfigurationError(
                f"{kind} {name} is no unknown of this adjustment".replace("  ", " "),
                "name image:NAME, camera:ID, head:CAMERA, point:NAME or mounting",
            )
        named += [unknown for unknown, _, _ in functions]
        rows += [(reduced, points) for _, reduced, points in functions]
    covariance = np.empty((len(rows), len(rows)))
    for k, (reduced, points) in enumerate(rows):
        step, moved = covariance_column(at, reduced, points)
        covariance[:, k] = [step @ other + np.sum(moved * place) for other, place in rows]
    return tuple(named), (covariance + covariance.T) / 2


def _functions(
    at: Factored, columns: list[Unknown | None], kind: str, name: str
) -> list[tuple[Unknown, Floats, Floats]]:
    """Unknowns of one thing as linear functions of the columns and of the eliminated points."""
    size, none = at.problem.layout.size, np.zeros_like(at.state.points)
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
        result.append((unknown, turns.get(unknown.parameter, row), none))
    if kind == "point" and not indices and name in at.problem.network.point_names:
        j = at.problem.network.point_names.index(name)
        for a, axis in enumerate(XYZ):
            if not at.problem.network.points.held[j, a]:
                place = np.zeros_like(at.state.points)
                place[j, a] = 1.0
                result.append((Unknown("point", name, axis, "m"), np.zeros(size), place))
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
