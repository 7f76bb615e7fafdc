"""Compile the kernels once, at setup, so that the first adjustment does not wait for it.

Several processes share the work.
"""

from dataclasses import replace

import numpy as np

from photocal.adjustment.adjust import adjust
from photocal.adjustment.adjusted import fit
from photocal.adjustment.factored import factored
from photocal.adjustment.leverage import cameras_without
from photocal.adjustment.mounting import STRIPS, Attitudes, Mounting, Positions
from photocal.adjustment.near import Removals
from photocal.adjustment.network import ExteriorOrientations, Network, Points, Rays, Relations, point_weights
from photocal.adjustment.score import followed_by, score
from photocal.adjustment.snooping import snoop
from photocal.adjustment.solution import Solution
from photocal.base.compiled import AHEAD, FOLDER
from photocal.base.operating_system import lock
from photocal.geometry.camera import PARAMETERS, SHAKE_DEGREES, camera
from photocal.geometry.distortion import distorted, undistorted
from photocal.geometry.rotation import NADIR


def _network() -> Network:
    """Make the smallest network that passes through every kernel."""
    grid = np.array([[x, y, 0.1 * x * y] for x in (-2.0, -1.0, 1.0, 2.0) for y in (-2.0, -1.0, 1.0, 2.0)])
    stations = np.array([[-1.0, 0.0, 5.0], [1.0, 0.0, 5.0]])
    values = np.hstack([np.zeros((2, 3)), stations])
    sigma = np.full((2, 6), np.inf)
    sigma[0, 0], sigma[1, 3] = 1.0, 1.0
    held, weight = point_weights(np.full((16, 3), 0.01))
    q = grid[:, None, :] - stations
    plane = (-20.0 * q[..., :2] / q[..., 2:]).reshape(-1, 2)
    image, point = np.tile([0, 1], 16), np.repeat(np.arange(16), 2)
    lens = camera("c", "brown-observed", "mm", (100, 100), (0.1, 0.1), {"c": 20.0}, estimate=("c",))
    rays = Rays(image, point, plane, np.full(plane.shape, 0.01))
    names = tuple(str(j) for j in range(16))
    exposures = ExteriorOrientations(np.zeros(2, np.int64), values, sigma)
    return Network((lens,), exposures, Points(grid, held, weight), rays, ("a", "b"), names)


def _placed(network: Network) -> Network:
    """With observed positions and attitudes."""
    images, covariance = np.arange(2), np.tile(1e-4 * np.eye(3), (2, 1, 1))
    nothing = np.zeros(2)
    positions = Positions(
        images,
        network.exposures.values[:, 3:],
        covariance,
        np.zeros((2, 3)),
        np.zeros(2, np.int64),
        nothing,
        nothing,
    )
    attitudes = Attitudes(images, np.tile(NADIR, (2, 1, 1)), covariance)
    held = np.zeros(STRIPS + 6)
    return replace(network, positions=positions, attitudes=attitudes, mounting=Mounting(NADIR, held, held))


def compile_usual() -> None:
    """Compile what networks of Brown's lenses without a rolling shutter need."""
    network = _network()
    distorted(network.cameras[0], undistorted(network.cameras[0], network.rays.plane))
    adjust(_placed(network))
    solution = adjust(network)
    snoop(network)
    _followed(network, solution)
    Removals(factored(network, solution.state)).stepped(np.array([True, False]), 1.0)
    cameras_without(fit(network, solution.state), [np.array([True, False])])
    # A free network with a scale bar passes through what the datum and kept points need.
    points = network.points.values
    length = np.linalg.norm(points[15:] - points[:1], axis=1)
    ends = np.zeros(1, np.int64), np.full(1, 15)
    bar = Relations(np.zeros(1, np.int64), *ends, length, np.full(1, 0.001))
    free = Points(points, *point_weights(np.full((16, 3), np.inf)))
    lens = camera("c", "brown-observed", "mm", (100, 100), (0.1, 0.1), {"c": 20.0})
    adjust(replace(network, cameras=(lens,), points=free, relations=bar, datum_points=np.zeros(0, np.int64)))


def _followed(network: Network, solution: Solution) -> None:
    """Do what an analysis does with the factor, and what steps around a bend need."""
    at = factored(network, solution.state)
    ones = score(at, solution.residuals, np.ones((1, *solution.residuals.shape)))
    followed_by(at, ones.steps, ones.moved)


def compile_other_lenses() -> None:
    """Compile what lenses that are not Brown's need, and the test of a readout."""
    # Cameras without a rolling shutter share lenses of any model.
    adjust(replace(_network(), cameras=(camera("c", "rational", "mm", (100, 100), (0.1, 0.1), {"c": 20.0}),)))


def compile_ahead() -> None:
    """Do so, unless another process is at it."""
    with (FOLDER / AHEAD).open("ab+") as taken:
        if lock(taken):
            compile_other_lenses()


def compile_unusual() -> None:
    """Compile what other lenses and parameters of single images need."""
    compile_other_lenses()
    network = _network()
    # With a few photo-variant parameters every image has columns for them.
    varied = replace(network.cameras[0], deviation_sigma=np.where(np.arange(len(PARAMETERS)) == 1, 0.1, 0.0))
    adjust(replace(network, cameras=(varied,)))


def compile_rolling() -> None:
    """Compile what rolling shutters need: moving while it is read, every image has six more columns."""
    network = _moving(())
    _followed(network, adjust(network))


def compile_shaking() -> None:
    """Compile what images need that shake: fifteen columns more."""
    network = _moving((1e-4,) * (1 + len(SHAKE_DEGREES)))
    _followed(network, adjust(network))


def _moving(shake: tuple[float, ...]) -> Network:
    network = _network()
    rolls = camera("c", "brown-observed", "mm", (100, 100), (0.1, 0.1), {"c": 20.0, "readout": 0.01})
    moving = replace(network.exposures, motion=np.ones((2, 6)), motion_sigma=np.ones((2, 6)))
    return replace(network, cameras=(replace(rolls, shake=shake),), exposures=moving)
