"""The current values of all unknowns, and how a step changes them."""

from dataclasses import dataclass, replace

import numpy as np
from scipy.spatial.transform import Rotation

from photocal.adjustment.layout import Layout
from photocal.adjustment.network import Network, own_parameters
from photocal.base.arrays import Flags, Floats
from photocal.geometry.camera import MOTION, PARAMETERS, SHAKE
from photocal.geometry.rotation import angles_from_matrix, matrix_from_angles, turn_per_angle, turned


@dataclass(frozen=True)
class State:
    """Values of all unknowns.

    cameras (cameras, 20).
    rotation (images, 3, 3): object to camera axes.
    centre (images, 3).
    points (points, 3).
    common (k,): common values of the mounting, of the lasers, `lasers.OF_LASER`, then those of the heads of
        rigs, `rig.OF_HEAD` of each.
    deviations (images, n): how far each image's own parameters are from those of its camera and from its
        given movement.
    """

    cameras: Floats
    rotation: Floats
    centre: Floats
    points: Floats
    common: Floats
    deviations: Floats


def start_state(network: Network) -> State:
    """State of the network's start values."""
    exposures = network.exposures
    return State(
        np.array([camera.values for camera in network.cameras]).reshape(-1, len(PARAMETERS)),
        matrix_from_angles(exposures.started[:, :3]),
        exposures.started[:, 3:].copy(),
        network.points.values.copy(),
        np.concatenate(
            [network.mounting.values, np.zeros(len(network.lasers.common_sigma)), network.rig.values.ravel()]
        ),
        np.zeros(own_parameters(network).shape),
    )


def lenses(network: Network, state: State) -> Floats:
    """Parameters of every lens: those of the cameras or, where `Network.lens_by_image`, of each image.

    returns (cameras or images, 26 or 41): at the end the movement during the readout, and what shakes it.
    """
    exposures = network.exposures
    given = np.zeros((1, len(MOTION))) if exposures.motion is None else exposures.motion
    shakes = given.shape[1] > len(MOTION) or any(camera.shake for camera in network.cameras)
    still = len(MOTION + SHAKE if shakes else MOTION)
    by_image, at = network.lens_by_image, len(PARAMETERS)
    of_camera = state.cameras[exposures.camera] if by_image else state.cameras
    values = np.zeros((len(of_camera), at + still))
    values[:, :at] = of_camera
    if not by_image:
        return values
    values[:, at : at + given.shape[1]] = values[:, at - 1 : at] * given
    parameters = own_parameters(network)
    image, place = np.nonzero(parameters >= 0)
    values[image, parameters[image, place]] += state.deviations[image, place]
    return values


def head_values(network: Network, common: Floats) -> Floats:
    """Values of the heads of rigs among the common ones, shape (heads, 7)."""
    return common[len(common) - network.rig.values.size :].reshape(network.rig.values.shape)


def laser_values(network: Network, common: Floats) -> Floats:
    """Offset and scale of the lasers among the common values, shape (2,), or (0,) without lasers."""
    first = len(network.mounting.values)
    return common[first : first + len(network.lasers.common_sigma)]


def turn_basis(network: Network, state: State) -> Floats:
    """For each image the turn that its three rotation unknowns make, shape (images, 3, 3).

    Free rotations have the turn itself as unknown (identity), so that no orientation is singular. Where
    an angle is held, the unknowns are the angles.
    """
    basis = np.broadcast_to(np.eye(3), state.rotation.shape).copy()
    some = _angles_held(network)
    if some.any():
        basis[some] = turn_per_angle(angles_from_matrix(state.rotation[some]))
    return basis


def _angles_held(network: Network) -> Flags:
    held = network.exposures.sigma[:, :3] == 0
    return np.asarray(held.any(axis=1) & ~held.all(axis=1))


def moved_exposures(network: Network, layout: Layout, state: State, step: Floats) -> State:
    """State after a step of the reduced system; the points are still the old ones."""
    pose = step[layout.image_columns]
    rotation = turned(state.rotation, pose[:, :3])
    some = _angles_held(network)
    if some.any():
        rotation[some] = matrix_from_angles(angles_from_matrix(state.rotation[some]) + pose[some, :3])
    cameras = state.cameras.copy()
    camera, active, columns = layout.camera_parameters
    cameras[camera, active] += step[columns]
    common, unknown = state.common.copy(), layout.common_columns >= 0
    common[unknown] += step[layout.common_columns[unknown]]
    own_columns = layout.own_columns
    deviations = state.deviations + np.where(own_columns >= 0, step[own_columns], 0.0)
    return State(cameras, rotation, state.centre + pose[:, 3:], state.points, common, deviations)


def round_the_middle(network: Network, before: State, after: State) -> State:
    """Bend a step that turns the whole block from the tangent onto the circle.

    No ray resists a turn of everything. But a step moves the places along the tangent, which stretches the
    block by half the square of the angle, and the rays resist that: where only weak observations hold the
    orientation, steps would stay as short as their sharpness allows.
    """
    if (network.exposures.sigma == 0).any() or network.points.held.any():
        return after
    # The camera axes turn against the object space; single images may turn otherwise.
    turns = Rotation.from_matrix(np.swapaxes(after.rotation, 1, 2) @ before.rotation).as_rotvec()
    turn, middle = np.median(turns, axis=0), before.centre.mean(axis=0)
    matrix = Rotation.from_rotvec(turn).as_matrix()
    # Two products of matrices: other ways cost large blocks several times as much.
    along = matrix @ np.cross(np.eye(3), turn)
    shift = middle - matrix @ middle + along @ middle

    def bent(old: Floats, new: Floats) -> Floats:
        """New places after the common turn, less what it alone does to the old ones."""
        return np.asarray(new @ matrix.T - old @ along.T + shift)

    return replace(after, centre=bent(before.centre, after.centre), points=bent(before.points, after.points))
