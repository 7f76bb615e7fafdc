"""What one more unknown would be and explain, from the normal equations as they stand.

The unknown changes the computed image coordinates by a field. At the minimum without it, the slope of v'Pv
along that field, less what all other unknowns take up, tells its estimate and the fall of v'Pv (Rao 1948).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from drivers.arrays import Floats
from photocal.adjustment.datum import full_solution
from photocal.adjustment.factored import Factored
from photocal.adjustment.normal import values_of
from photocal.adjustment.sensitivity import across, along


@dataclass(frozen=True)
class Score:
    """Normal equations of t further unknowns, all others eliminated: information x = -slope.

    slope (t,): half the derivative of v'Pv.
    information (t, t): inverse of the covariance that they would have.
    share (t,): of each field's length, weighted, what the other unknowns do not take up; squared.
    visible (t, rays, 2): change of the residuals by a unit of each, when all others follow.
    """

    slope: Floats
    information: Floats
    share: Floats
    visible: Floats


def score(at: Factored, residuals: Floats, fields: Floats) -> Score:
    """Set up the normal equations of further unknowns.

    residuals (rays, 2): there, computed minus measured.
    fields (t, rays, 2): change of the computed image coordinates by a unit of each.
    """
    weight = at.problem.design.weight
    visible = np.array([field - taken_up(at, field) for field in fields])
    weighted = fields * weight
    information = np.einsum("srk,trk->st", weighted, visible)
    whole = np.einsum("trk,trk->t", weighted, fields)
    share = np.diag(information) / np.where(whole > 0.0, whole, 1.0)
    slope = np.einsum("trk,rk->t", weighted, residuals)
    return Score(slope, (information + information.T) / 2, share, visible)


def taken_up(at: Factored, field: Floats) -> Floats:
    """Part of a change of all image coordinates that the unknowns of an adjustment follow, (rays, 2)."""
    step, moved = followed(at, field)
    problem, followed_by = at.problem, np.zeros_like(field)
    along(problem.design, values_of(problem, at.state), problem.structure, step, moved, followed_by)
    return followed_by


def followed(at: Factored, field: Floats) -> tuple[Floats, Floats]:
    """Change of all unknowns with a change of all image coordinates: reduced part and points."""
    problem = at.problem
    reduced = np.zeros((len(problem.design.pieces) - 1, problem.layout.size))
    points = np.zeros_like(at.state.points)
    change = np.ascontiguousarray(field)
    across(problem.design, values_of(problem, at.state), problem.structure, change, reduced, points)
    right = reduced.sum(axis=0)
    right[problem.layout.point_columns] += points[problem.layout.kept_points]
    step, moved = full_solution(problem, at.normal, right, points)
    return np.ascontiguousarray(step), np.ascontiguousarray(moved)
