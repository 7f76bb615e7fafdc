"""What one more unknown would be and explain, from the normal equations as they stand.

The unknown changes the computed image coordinates by a field. At the minimum without it, the slope of v'Pv
along that field, less what all other unknowns take up, tells its estimate and the fall of v'Pv (Rao 1948).
"""

from dataclasses import dataclass

import numpy as np

from photocal.adjustment.datum import full_solution
from photocal.adjustment.factored import Factored
from photocal.adjustment.normal import values_of
from photocal.adjustment.sensitivity import across, along
from photocal.base.arrays import Floats


@dataclass(frozen=True)
class Score:
    """Normal equations of t further unknowns, all others eliminated: information x = -slope.

    slope (t,): half the derivative of v'Pv.
    information (t, t): inverse of the covariance that they would have.
    share (t,): of each field's length, weighted, what the other unknowns do not take up; squared.
    steps (t, layout.size), moved (t, points, 3): how all other unknowns follow a unit of each: reduced part
        and points.
    """

    slope: Floats
    information: Floats
    share: Floats
    steps: Floats
    moved: Floats


def score(at: Factored, residuals: Floats, fields: Floats) -> Score:
    """Set up the normal equations of further unknowns.

    residuals (rays, 2): there, computed minus measured.
    fields (t, rays, 2): change of the computed image coordinates by a unit of each.
    """
    flat = fields.reshape(len(fields), -1)
    weighted = flat * at.problem.design.weight.ravel()
    reduced, points = pulled(at, fields)
    steps, moved = full_solution(at.problem, at.normal, reduced, points)
    # Points that stay in the reduced system stand in both parts.
    points[:, at.problem.layout.kept_points] = 0.0
    followed = reduced @ steps.T + points.reshape(len(fields), -1) @ moved.reshape(len(fields), -1).T
    whole = weighted @ flat.T
    information = whole - (followed + followed.T) / 2
    size = np.diag(whole)
    share = np.diag(information) / np.where(size > 0.0, size, 1.0)
    return Score(weighted @ residuals.ravel(), information, share, steps, moved)


def pulled(at: Factored, fields: Floats) -> tuple[Floats, Floats]:
    """Right-hand sides A'P d of the normal equations for changes d of all image coordinates."""
    problem, values = at.problem, values_of(at.problem, at.state)
    gradients = np.zeros((len(problem.design.pieces) - 1, len(fields), problem.layout.size))
    points = np.zeros((len(fields), *at.state.points.shape))
    across(problem.design, values, problem.layout.envelope, np.ascontiguousarray(fields), gradients, points)
    reduced = gradients.sum(axis=0)
    reduced[:, problem.layout.point_columns] += points[:, problem.layout.kept_points]
    return reduced, points


def followed_by(at: Factored, step: Floats, moved: Floats) -> Floats:
    """Change of all image coordinates with a step of the unknowns, reduced part and points; (rays, 2).

    Or with several along the first axis.
    """
    problem, change = at.problem, np.zeros((*step.shape[:-1], *at.problem.design.weight.shape))
    directions = np.ascontiguousarray(step), np.ascontiguousarray(moved)
    along(problem.design, values_of(problem, at.state), problem.layout.envelope, *directions, change)
    return change
