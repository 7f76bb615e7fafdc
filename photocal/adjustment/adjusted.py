"""A network at its minimum, and the same with something changed or taken out: where to start anew.

Which points their rays determine: those whose rays come from places that are far enough apart.
"""

from dataclasses import dataclass, replace
from functools import cached_property
from typing import TypeVar

import numpy as np

from photocal.adjustment.covariance import complete
from photocal.adjustment.datum import with_datum
from photocal.adjustment.envelope import on_one_thread
from photocal.adjustment.factored import Factored, factorised
from photocal.adjustment.groups import Member
from photocal.adjustment.mounting import Attitudes, Positions
from photocal.adjustment.network import Network
from photocal.adjustment.normal import prepare
from photocal.adjustment.solution import Solution
from photocal.adjustment.solver import CONVERGED, Minimum, Near, minimise
from photocal.adjustment.state import State, start_state
from photocal.base.arrays import Flags, Floats, Integers


def determined(network: Network, kept: Flags) -> Flags:
    """Points that some of the rays determine, (points,); others than those that lose rays are taken as such.

    kept (rays,): which ones stay.
    """
    rays, points = network.rays, network.points
    size = len(points.values)
    count = np.bincount(rays.point[kept], minlength=size)
    known = points.held.any(axis=1) | (np.diagonal(points.weight, axis1=1, axis2=2) > 0).any(axis=1)
    enough = (count >= 2) | (known & (count >= 1))
    loses = np.bincount(rays.point[~kept], minlength=size) > 0
    some = np.flatnonzero(kept & (loses & enough & ~known)[rays.point])
    point, image = rays.point[some], rays.image[some]
    towards = points.values[point] - network.exposures.started[image, 3:]
    towards /= np.linalg.norm(towards, axis=1)[:, None]
    mean = np.column_stack([np.bincount(point, towards[:, axis], size) for axis in range(3)])
    c = np.array([camera.value("c") for camera in network.cameras])[network.exposures.camera[image]]
    # In units of the standard deviation of a direction, over the mean of the rays.
    away = np.linalg.norm(towards - mean[point] / count[point][:, None], axis=1)
    turned = np.zeros(size)
    np.maximum.at(turned, point, 2 * away * c / rays.sigma[some].max(axis=1))
    # Rays that turn by less than so many of their standard deviations tell a fifth of the distance at best.
    # Heads of one exposure are centimetres apart: a point that only they see has no distance.
    least = 5.0
    return enough & ~(loses & ~known & (turned < least))


Observed = TypeVar("Observed", Positions, Attitudes)


@dataclass(frozen=True)
class AdjustedNetwork:
    """A network at its minimum."""

    network: Network
    state: State
    solution: Solution
    factored: Factored

    @property
    def computed(self) -> Floats:
        """Image coordinates as the unknowns give them."""
        return self.network.rays.plane + self.solution.residuals

    @cached_property
    def seen(self) -> Floats:
        """Points of the rays from their images, in the axes of the cameras, (rays, 3), m."""
        rays, state = self.network.rays, self.state
        apart = state.points[rays.point] - state.centre[rays.image]
        return np.asarray(np.einsum("nij,nj->ni", state.rotation[rays.image], apart))


def fit(network: Network, state: State | None = None) -> AdjustedNetwork:
    """Adjust a network with its statistics."""
    start = start_state(network) if state is None else state
    problem = with_datum(prepare(network), start)
    minimum = minimise(problem, start)
    at = factorised(problem, minimum)
    return AdjustedNetwork(network, minimum.state, complete(at, minimum.iterations), at)


@on_one_thread
def at_minimum(network: Network, solution: Solution) -> AdjustedNetwork:
    """Factorise the equations of an adjusted network again; a free one has the datum of its start values."""
    problem = with_datum(prepare(network), start_state(network))
    factored = factorised(problem, Minimum(solution.state, None, ()))
    return AdjustedNetwork(network, solution.state, solution, factored)


def lowest(network: Network, state: State, near: float = CONVERGED) -> Near:
    """Adjust a network without statistics."""
    minimum = minimise(with_datum(prepare(network), state), state, near=near)
    return Near(minimum.state, minimum.iterations[-1].chi_squared, near)


def with_measurements(network: Network, plane: Floats) -> Network:
    """Give the network other measured image coordinates."""
    return replace(network, rays=replace(network.rays, plane=plane))


def with_sigmas(network: Network, factor: float) -> Network:
    """Give the network other standard deviations of the image coordinates."""
    return replace(network, rays=replace(network.rays, sigma=network.rays.sigma * factor))


def left_without(network: Network, left_out: Flags) -> tuple[Flags, Flags]:
    """Points that are determined without some images, (points,), and rays that stay, (rays,)."""
    kept = ~left_out[network.rays.image]
    points = determined(network, kept)
    return points, kept & points[network.rays.point]


def without_images(network: Network, state: State, left_out: Flags) -> tuple[Network, State]:
    """Take images out of a network, and the points that are then not determined."""
    image_place = np.cumsum(~left_out) - 1
    points, kept = left_without(network, left_out)
    point_place = np.cumsum(points) - 1
    rays = network.rays
    relations = network.relations
    related = np.append(points, True)[relations.ends].all(axis=1)
    datum = network.datum_points
    smaller = replace(
        network,
        exposures=network.exposures.rows(~left_out),
        points=network.points.rows(points),
        rays=replace(rays, image=image_place[rays.image], point=point_place[rays.point]).rows(kept),
        image_names=tuple(name for name, out in zip(network.image_names, left_out, strict=True) if not out),
        relations=relations.moved(point_place).rows(related),
        datum_points=None if datum is None else point_place[datum[points[datum]]],
        positions=_of_images(network.positions, image_place, ~left_out),
        attitudes=_of_images(network.attitudes, image_place, ~left_out),
        rig=network.rig.of_images(image_place, ~left_out),
        lasers=network.lasers.of_points(point_place, points).of_images(image_place, ~left_out),
        point_names=tuple(name for name, has in zip(network.point_names, points, strict=True) if has),
    )
    return smaller, replace(
        state,
        rotation=state.rotation[~left_out],
        centre=state.centre[~left_out],
        points=state.points[points],
        deviations=state.deviations[~left_out],
    )


def without_member(network: Network, member: Member) -> Network:
    """Take an observed position out of a network, or what is observed of a control point."""
    if member.kind == "control":
        weight = network.points.weight.copy()
        weight[member.index] = 0.0
        return replace(network, points=replace(network.points, weight=weight))
    return replace(network, positions=network.positions.rows(network.positions.image != member.index))


def _of_images(observed: Observed, place: Integers, kept: Flags) -> Observed:
    """Return the positions or attitudes of the images that are kept, at the places that these have now."""
    return replace(observed, image=place[observed.image]).rows(kept[observed.image])
