"""A calibration carried into direct georeferencing: camera and mounting with their joint covariance.

Camera and mounting of one adjustment are correlated, often nearly fully (principal point and boresight,
principal distance and vertical lever arm): what one takes from the other cancels on the ground. Diagonals
alone would predict errors many times too large.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from drivers.arrays import Floats
from drivers.errors import ConfigurationError
from photocal.adjustment.adjust import adjust
from photocal.adjustment.covariance import blocks
from photocal.adjustment.envelope import factorise, selected_inverse
from photocal.adjustment.mounting import OF_FLIGHT, STRIPS, Mounting
from photocal.adjustment.normal import normal_equations, prepare
from photocal.block.model import Block
from photocal.block.network import assemble
from photocal.geometry.camera import PARAMETERS


@dataclass(frozen=True)
class Calibration:
    """Camera and mounting as one adjustment has found them.

    cameras (n, parameters): in the order of the block's cameras.
    mounting (11,): lever arm (m), boresight (rad), time offset (s); shift (m) and height scale of its flight.
    covariance (11 + n parameters, 11 + n parameters): of the mounting, then of the cameras; zero for what was
        held.
    """

    cameras: Floats
    mounting: Floats
    covariance: Floats

    def on_flight(self, mounting: Mounting) -> Calibration:
        """Give the calibration for another flight, whose positions have errors of their own."""
        values, covariance = self.mounting.copy(), self.covariance.copy()
        values[OF_FLIGHT] = mounting.values[OF_FLIGHT]
        covariance[OF_FLIGHT], covariance[:, OF_FLIGHT] = 0.0, 0.0
        stated = mounting.sigma[OF_FLIGHT]
        at = np.arange(len(covariance))[OF_FLIGHT]
        covariance[at, at] = np.where(np.isfinite(stated), stated, 0.0) ** 2
        return Calibration(self.cameras, values, covariance)


def calibrate(block: Block) -> Calibration:
    """Adjust a block and keep camera and mounting; raises PhotocalError as the adjustment does."""
    network = assemble(block).network
    solution = adjust(network)
    problem = prepare(network)
    normal = normal_equations(problem, solution.state)
    factorise(problem.layout.envelope, normal.matrix)
    inverse = selected_inverse(problem.layout.envelope, normal.matrix)
    columns = [problem.layout.common_columns[:STRIPS]]
    for active, at in problem.layout.camera_columns:
        own = np.full(len(PARAMETERS), -1)
        own[active] = at
        columns.append(own)
    column = np.concatenate(columns)
    unknown = np.flatnonzero(column >= 0)
    covariance = np.zeros((len(column), len(column)))
    if len(unknown):
        found = blocks(column[unknown][None, :], problem.structure, inverse)[0]
        covariance[np.ix_(unknown, unknown)] = found
    return Calibration(solution.cameras, solution.state.common[:STRIPS], covariance)


def with_calibration(block: Block, calibration: Calibration) -> Block:
    """Return a block with camera and mounting of a calibration of its own flight, or one made `on_flight`."""
    if len(calibration.cameras) != len(block.cameras):
        raise ConfigurationError(
            f"the calibration has {len(calibration.cameras)} cameras, the block {len(block.cameras)}",
            where=block.name,
            remedy="take the calibration of the same rig",
        )
    cameras = tuple(
        own.with_values(values) for own, values in zip(block.cameras, calibration.cameras, strict=True)
    )
    values = block.mounting.values.copy()
    values[:STRIPS] = calibration.mounting
    return replace(block, cameras=cameras, mounting=replace(block.mounting, values=values))


def joint_covariance(calibration: Calibration, common: int) -> Floats:
    """Give the covariance of all common values of a block and its cameras.

    common: number of the block's common values; shifts and drifts of its strips are taken as known.
    returns (common + n parameters, common + n parameters).
    """
    size = len(calibration.covariance)
    at = np.concatenate([np.arange(STRIPS), common + np.arange(size - STRIPS)])
    joint = np.zeros((common + size - STRIPS, common + size - STRIPS))
    joint[np.ix_(at, at)] = calibration.covariance
    return joint
