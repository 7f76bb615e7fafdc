"""Normal equations of a network, reduced to images and cameras."""

from __future__ import annotations

from dataclasses import dataclass

import numba
import numpy as np

from drivers.arrays import Flags, Floats, Integers
from photocal.adjustment.equations import Equations, add_equations
from photocal.adjustment.kernels.data import WIDTHS, Design, Eliminated, Structure, Values
from photocal.adjustment.kernels.elimination import accumulate
from photocal.adjustment.layout import Layout, layout
from photocal.adjustment.network import Network, own_parameters
from photocal.adjustment.observations import (
    camera_equations,
    deviation_equations,
    exposure_equations,
    mounting_equations,
    relation_equations,
)
from photocal.adjustment.state import State, lens_by_image, lenses, turn_basis
from photocal.geometry.camera import MOTION, PARAMETERS
from photocal.geometry.lens import optics

RAYS_PER_THREAD = 4000


@dataclass(frozen=True)
class Problem:
    """A network made ready for the kernels.

    held (layout.size,): columns of the reduced system that are no unknowns.
    stiffened: columns that carry the datum of a free network, see `datum.with_datum`.
    """

    network: Network
    layout: Layout
    design: Design
    structure: Structure
    held: Flags
    stiffened: Integers


@dataclass(frozen=True)
class Normal:
    """Reduced normal equations at one state.

    matrix: values within the structure of the layout.
    gradient (layout.size,): A'Pv of the reduced system.
    chi_squared: sum of v'Pv.
    singular: points that their rays do not determine.
    kept: what the points' steps need.
    """

    matrix: Floats
    gradient: Floats
    chi_squared: float
    singular: Integers
    kept: Eliminated


def prepare(network: Network) -> Problem:
    """Order a network's unknowns and lay out its arrays for the kernels."""
    rays, points, exposures = network.rays, network.points, network.exposures
    ray_start = np.searchsorted(rays.point, np.arange(len(points.values) + 1))
    where = layout(network, ray_start)
    cameras = len(network.cameras)
    # Images share the lens of their camera, unless it varies from image to image.
    shared = not lens_by_image(network)
    camera_of = np.arange(cameras) if shared else exposures.camera
    own = own_parameters(network)[: len(camera_of)]
    still = np.zeros((len(camera_of), len(MOTION)))
    motion = still if shared or exposures.motion is None else exposures.motion
    active = np.zeros((cameras, len(PARAMETERS)), dtype=np.int64)
    for k, (positions, _) in enumerate(where.camera_columns):
        active[k, : len(positions)] = positions
    count = np.array([len(positions) for positions, _ in where.camera_columns], dtype=np.int64)
    point_column = np.full(len(points.values), -1)
    point_column[where.kept_points] = where.point_columns[:, 0] - where.envelope.band
    # Threads only wait for each other in small networks.
    threads = min(numba.get_num_threads(), 1 + len(rays.image) // RAYS_PER_THREAD)
    shares = np.linspace(0, len(rays.image), threads + 1)
    pieces = np.searchsorted(ray_start, shares)
    pieces[0], pieces[-1] = 0, len(points.values)
    arrays = Design(
        pieces=pieces,
        ray_start=ray_start,
        ray_image=rays.image,
        plane=rays.plane,
        weight=rays.sigma**-2.0,
        width=np.zeros((1,) * (1 + WIDTHS.index(where.width))),
        image_lens=exposures.camera if shared else np.arange(len(exposures.camera)),
        image_column=where.image_columns[:, 0],
        pose_free=(exposures.sigma != 0).astype(float),
        own=np.maximum(own, 0),
        own_count=(own >= 0).sum(axis=1),
        optics=np.hstack([np.array([optics(camera) for camera in network.cameras])[camera_of], motion]),
        active=active[camera_of],
        active_count=count[camera_of],
        active_column=(np.cumsum(count) - count)[camera_of],
        point_column=point_column,
        point_free=(~points.held).astype(float),
        prior_points=points.values,
        prior_weight=points.weight,
    )
    # One memory layout and one integer type, or the kernels would be compiled anew for each.
    design = Design(
        *(np.ascontiguousarray(a, dtype=np.int64 if a.dtype.kind == "i" else float) for a in arrays)
    )
    envelope = where.envelope
    structure = Structure(
        envelope.panel,
        envelope.last,
        envelope.width,
        envelope.offset,
        envelope.band,
        envelope.border,
        int(count.sum()),
    )
    held = np.zeros(where.size, dtype=np.bool_)
    held[: where.envelope.band] = True
    held[where.image_columns[exposures.sigma != 0]] = False
    held[where.own_columns[where.own_columns >= 0]] = False
    held[where.point_columns[points.held[where.kept_points]]] = True
    return Problem(network, where, design, structure, held, np.zeros(0, dtype=np.int64))


def values_of(problem: Problem, state: State) -> Values:
    """Arrange a state for the kernels."""
    arrays = (
        lenses(problem.network, state),
        state.rotation,
        turn_basis(problem.network, state),
        state.centre,
        state.points,
    )
    # One memory layout, or the kernels would be compiled anew for each.
    return Values(*(np.ascontiguousarray(array) for array in arrays))


def other_equations(problem: Problem, state: State) -> dict[str, Equations]:
    """Observations beside the rays and the points, by group."""
    return {
        "camera": camera_equations(problem.network, problem.layout, state),
        **deviation_equations(problem.network, problem.layout, state),
        "exposure": exposure_equations(problem.network, problem.layout, state),
        **relation_equations(problem.network, problem.layout, state),
        **mounting_equations(problem.network, problem.layout, state),
    }


def normal_equations(
    problem: Problem, state: State, damping: float = 0.0, room: Eliminated | None = None
) -> Normal:
    """Set up the reduced normal equations at a state."""
    design, structure, where = problem.design, problem.structure, problem.layout
    threads, points = len(design.pieces) - 1, len(design.point_free)
    kept = room or Eliminated(
        np.empty((len(design.ray_image), 3, where.width)),
        np.empty((points, 3, structure.lens)),
        np.empty((points, 3, 3)),
        np.empty((points, 3)),
    )
    matrices = np.zeros((threads, int(structure.offset[-1])))
    gradients, totals = np.zeros((threads, where.size)), np.zeros(threads)
    singular = np.zeros(points, dtype=np.bool_)
    values = values_of(problem, state)
    accumulate(design, values, structure, damping, matrices, gradients, totals, kept, singular)
    matrix, gradient, total = matrices[0], gradients[0], float(totals.sum())
    for more, gradient_more in zip(matrices[1:], gradients[1:], strict=True):
        matrix += more
        gradient += gradient_more
    for equations in other_equations(problem, state).values():
        add_equations(*equations, structure, matrix, gradient)
        total += equations.chi_squared()
    diagonal = diagonal_addresses(problem)
    matrix[diagonal] *= 1.0 + damping
    matrix[diagonal[problem.held]] = 1.0
    # As many pseudo-observations as the datum has defects are met exactly, whatever their weight.
    matrix[diagonal[problem.stiffened]] *= 2.0
    return Normal(matrix, gradient, total, np.flatnonzero(singular), kept)


def diagonal_addresses(problem: Problem) -> Integers:
    """Where the diagonal stands among the values of the reduced matrix, shape (layout.size,)."""
    structure = problem.structure
    column = np.arange(structure.band)
    home = column // structure.panel
    inside = column - home * structure.panel
    border = np.arange(structure.border)
    return np.concatenate(
        [
            structure.offset[home] + inside * structure.width[home] + inside,
            structure.offset[len(structure.width) - 1] + border * (structure.border + 1),
        ]
    )
