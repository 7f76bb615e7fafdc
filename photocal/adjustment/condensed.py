"""Normal equations condensed to what all images share: cameras, mounting and heads of rigs.

Images and points are eliminated. What is left is small, and tells in closed form what an adjustment becomes
when shared values are freed, held or observed with other standard deviations: from the minimum of one network
the fall of v'Pv, the estimates and their covariances of any other, to first order (Rao 1948).
"""

from dataclasses import dataclass
from itertools import compress

import numpy as np

from photocal.adjustment.covariance import Shared, degrees_of_freedom
from photocal.adjustment.envelope import solve
from photocal.adjustment.factored import Factored
from photocal.adjustment.mounting import Mounting
from photocal.base.arrays import Flags, Floats, Integers
from photocal.base.errors import IllPosedError
from photocal.geometry.camera import PARAMETERS, Camera


@dataclass(frozen=True)
class Condensed:
    """The condensed normal equations of a network at a state: matrix x = right.

    matrix (k, k), right (k,): of steps of the shared unknowns from the state.
    camera_columns: for each camera the positions of its unknown parameters and their columns.
    common_columns (c,): column of each common value; -1 for those that are no unknowns.
    cameras, mounting: with the standard deviations that stand in the matrix.
    values (cameras, parameters), common (c,): at the state.
    chi_squared, degrees_of_freedom: of the network at the state.
    """

    matrix: Floats
    right: Floats
    camera_columns: tuple[tuple[Integers, Integers], ...]
    common_columns: Integers
    cameras: tuple[Camera, ...]
    mounting: Mounting
    values: Floats
    common: Floats
    chi_squared: float
    degrees_of_freedom: int

    def stepped(self, step: Floats, covariance: Floats, chi_squared: float, freedom: int) -> Shared:
        """Give what images share after a step of it, with the covariance (k, k) of the unknowns."""
        values, spread = self.values.copy(), np.zeros((len(self.values), len(PARAMETERS), len(PARAMETERS)))
        for k, (active, columns) in enumerate(self.camera_columns):
            values[k, active] += step[columns]
            spread[k][np.ix_(active, active)] = covariance[np.ix_(columns, columns)]
        unknown = np.flatnonzero(self.common_columns >= 0)
        columns = self.common_columns[unknown]
        common, joint = self.common.copy(), np.zeros((len(self.common), len(self.common)))
        common[unknown] += step[columns]
        joint[np.ix_(unknown, unknown)] = covariance[np.ix_(columns, columns)]
        return Shared(chi_squared, freedom, values, spread, common, joint)

    def covariance(self, cameras: tuple[Camera, ...], mounting: Mounting) -> Floats:
        """Give the covariance (k, k) with other standard deviations; it is zero for what is held.

        raises IllPosedError: when the equations are singular.
        """
        there = observed(self, self.cameras, self.mounting)
        here = observed(self, cameras, mounting)
        square = np.ix_(here.unknown, here.unknown)
        covariance = np.zeros_like(self.matrix)
        try:
            covariance[square] = np.linalg.inv((self.matrix - there.weight + here.weight)[square])
        except np.linalg.LinAlgError:
            raise IllPosedError("the observations do not determine what is common to all images") from None
        return covariance


def condensed(at: Factored) -> Condensed:
    """Condense the normal equations of a network in which control or observations fix the datum."""
    problem, normal, state = at.problem, at.normal, at.state
    layout = problem.layout
    structure = layout.envelope
    lone = [columns for _, columns in compress(layout.camera_columns, layout.with_image)]
    shared = np.concatenate([*lone, structure.band + np.arange(structure.border)]).astype(np.int64)
    if lone:
        matrix = np.asarray(np.linalg.inv(at.joint(shared)), dtype=np.float64)
    else:
        factor = np.tril(structure.panels(normal.matrix)[-1]) if structure.border else np.zeros((0, 0))
        matrix = factor @ factor.T
    step = solve(structure, normal.matrix, -normal.gradient)[shared]
    place = np.full(layout.size + 1, -1)
    place[shared] = np.arange(len(shared))
    return Condensed(
        matrix,
        matrix @ step,
        tuple((active, place[columns]) for active, columns in layout.camera_columns),
        place[layout.common_columns],
        problem.network.cameras,
        problem.network.mounting,
        state.cameras,
        state.common,
        normal.chi_squared,
        degrees_of_freedom(at),
    )


@dataclass(frozen=True)
class Observed:
    """What given values of shared unknowns, as observations, bring to the normal equations.

    weight (k, k), pull (k,): their normal matrix, and that times state less given.
    unknown (k,): which columns are not held.
    redundancy: observations less unknowns.
    """

    weight: Floats
    pull: Floats
    unknown: Flags
    chi_squared: float
    redundancy: int


def observed(whole: Condensed, cameras: tuple[Camera, ...], mounting: Mounting) -> Observed:
    """Give what values of what is shared bring as observations, with their standard deviations."""
    size = len(whole.right)
    weight, pull = np.zeros((size, size)), np.zeros(size)
    unknown = np.ones(size, dtype=np.bool_)
    observations, chi_squared = 0, 0.0
    for camera, values, (active, columns) in zip(cameras, whole.values, whole.camera_columns, strict=True):
        unknown[columns] = camera.estimated[active]
        stated = camera.estimated[active] & np.isfinite(camera.prior_sigma[active])
        where, sigma = active[stated], camera.prior_sigma[active][stated]
        covariance = np.outer(sigma, sigma)
        given = camera.prior_correlation
        covariance *= np.eye(len(where)) if given is None else given[np.ix_(where, where)]
        information, off = np.linalg.inv(covariance), (values - camera.values)[where]
        at = columns[stated]
        weight[np.ix_(at, at)] += information
        pull[at] += information @ off
        chi_squared += float(off @ information @ off)
        observations += len(where)
    count = len(mounting.values)
    columns, sigma = whole.common_columns[:count], mounting.sigma
    known = columns >= 0
    unknown[columns[known]] = sigma[known] != 0.0
    stated = known & np.isfinite(sigma) & (sigma > 0.0)
    at, information = columns[stated], sigma[stated] ** -2.0
    off = (whole.common[:count] - mounting.values)[stated]
    weight[at, at] += information
    pull[at] += information * off
    chi_squared += float(np.sum(information * off**2))
    observations += int(stated.sum())
    return Observed(weight, pull, unknown, chi_squared, observations - int(unknown.sum()))
