"""Normal equations of a network, reduced to images and cameras."""

import itertools
from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np

from photocal.adjustment import observations
from photocal.adjustment.equations import Equations, add_equations
from photocal.adjustment.kernels.data import POSE, WIDTHS, Design, Eliminated, Reduced, Values
from photocal.adjustment.kernels.elimination import Contribution, accumulate, join
from photocal.adjustment.kernels.lanes import padded
from photocal.adjustment.layout import Layout, layout
from photocal.adjustment.network import Network, own_parameters
from photocal.adjustment.state import State, lenses, turn_basis
from photocal.base.arrays import Flags, Floats, Integers
from photocal.geometry.camera import MOTION, PARAMETERS
from photocal.geometry.lens import OTHERS, optics

# Pieces of work: as many as threads can be of use, but none so small that threads only wait for each other,
# and no more elements of borders, and of strips, than this for all of them.
PIECES, RAYS_IN_PIECE, BORDERS, STRIPS = 16, 10_000, 4_000_000, 192_000_000


@dataclass(frozen=True)
class Problem:
    """A network made ready for the kernels.

    held (layout.size,): columns of the reduced system that are no unknowns.
    stiffened: columns that carry the datum of a free network, see `datum.with_datum`.
    """

    network: Network
    layout: Layout
    design: Design
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
    shared = not network.lens_by_image
    camera_of = np.arange(cameras) if shared else exposures.camera
    variant = _with_image(network, where, camera_of, shared=shared)
    lens = np.array([optics(camera) for camera in network.cameras])
    # As many axes as the place in `WIDTHS`: the first for Brown's lenses alone.
    plain = shared and where.width == WIDTHS[0] and bool((lens[:, 0] < OTHERS).all())
    axes = 1 if plain else len(WIDTHS) - WIDTHS[::-1].index(where.width)
    still = np.zeros((len(camera_of), len(MOTION)))
    motion = still if shared or exposures.motion is None else exposures.motion
    active = np.zeros((cameras, len(PARAMETERS)), dtype=np.int64)
    for k, (positions, _) in enumerate(where.camera_columns):
        active[k, : len(positions)] = positions
    count = np.array([len(positions) for positions, _ in where.camera_columns], dtype=np.int64)
    count[where.with_image] = 0
    point_column = np.full(len(points.values), -1)
    point_column[where.kept_points] = where.point_columns[:, 0] - where.envelope.band
    order, pieces, spans, reach = pieces_of(where, ray_start, rays.image)
    arrays = Design(
        order=order,
        pieces=pieces,
        spans=spans,
        reach=reach,
        ray_start=ray_start,
        ray_image=rays.image,
        plane=rays.plane,
        weight=rays.sigma**-2.0,
        width=np.zeros((1,) * axes),
        image_lens=exposures.camera if shared else np.arange(len(exposures.camera)),
        image_column=where.image_columns[:, 0],
        pose_free=(exposures.sigma != 0).astype(float),
        variant=np.maximum(variant, 0),
        variant_count=(variant >= 0).sum(axis=1),
        optics=np.hstack([lens[camera_of], motion]),
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
    held = np.zeros(where.size, dtype=np.bool_)
    held[: where.envelope.band] = True
    held[where.image_columns[exposures.sigma != 0]] = False
    held[where.own_columns[where.own_columns >= 0]] = False
    for _, columns in itertools.compress(where.camera_columns, where.with_image):
        held[columns] = False
    held[where.point_columns[points.held[where.kept_points]]] = True
    return Problem(network, where, design, held, np.zeros(0, dtype=np.int64))


def _with_image(network: Network, where: Layout, camera_of: Integers, *, shared: bool) -> Integers:
    """Positions of the parameters of each lens whose columns stand with its image's; -1 where it has fewer.

    camera_of (lenses,): cameras, of images that do not share them.
    """
    result = np.full((len(camera_of), where.width - POSE), -1)
    if not shared:
        own = own_parameters(network)
        result[:, : own.shape[1]] = own
    for lens in np.flatnonzero(where.with_image[camera_of]):
        active, _ = where.camera_columns[camera_of[lens]]
        result[lens, : len(active)] = active
    return result


def pieces_of(
    where: Layout, ray_start: Integers, ray_image: Integers
) -> tuple[Integers, Integers, Integers, Integers]:
    """Order of the points, pieces of it and of the points, and what images the former reach, see `Design`."""
    strip = where.image_columns[ray_image, 0] // where.width
    point = np.repeat(np.arange(len(ray_start) - 1), np.diff(ray_start))
    seen = np.diff(ray_start) > 0
    first, last = np.full(len(seen), len(where.image_columns)), np.zeros(len(seen), dtype=np.int64)
    np.minimum.at(first, point, strip)
    np.maximum.at(last, point, strip + 1)
    order = np.lexsort((last, first))
    rays = np.concatenate([[0], np.cumsum(np.diff(ray_start)[order])])
    most = min(PIECES, 1 + BORDERS // max(where.envelope.border, 1) ** 2)
    count = min(most, 1 + len(ray_image) // RAYS_IN_PIECE)
    lanes = padded(where.width)
    # Twice the matrix, and more of a small one: to fill and add up what is mostly zero takes its time, too.
    room = min(max(2 * lanes * int(where.strips.offset[-1]), STRIPS // 6), STRIPS)
    while True:
        shares = np.linspace(0, len(ray_image), count + 1)
        pieces, spans = (np.searchsorted(starts, shares) for starts in (rays, ray_start))
        for bounds in (pieces, spans):
            bounds[0], bounds[-1] = 0, len(seen)
        reach = np.zeros((count, 2), dtype=np.int64)
        for piece, (begin, end) in enumerate(itertools.pairwise(pieces)):
            points = order[begin:end][seen[order[begin:end]]]
            if len(points):
                reach[piece] = first[points].min(), last[points].max()
        # Where points reach across much of a block, each piece fills much of the matrix.
        if count == 1 or lanes * np.diff(where.strips.offset[reach], axis=1).sum() <= room:
            break
        count //= 2
    return order, pieces, spans, reach


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
        "camera": observations.camera_equations(problem.network, problem.layout, state),
        **observations.deviation_equations(problem.network, problem.layout, state),
        **placing_equations(problem, state),
    }


def placing_equations(problem: Problem, state: State) -> dict[str, Equations]:
    """Those of them that change when the whole block is moved, turned or enlarged."""
    return {
        "exposure": observations.exposure_equations(problem.network, problem.layout, state),
        **observations.relation_equations(problem.network, problem.layout, state),
        **observations.mounting_equations(problem.network, problem.layout, state),
        **observations.distance_equations(problem.network, problem.layout, state),
    }


def eliminated(problem: Problem, rays: int, points: int) -> Eliminated:
    """Make room for what elimination leaves of some rays and points."""
    return Eliminated(
        np.empty((rays, 3, problem.layout.width)),
        np.empty((points, 3, problem.layout.envelope.lens)),
        np.empty((points, 3, 3)),
        np.empty((points, 3)),
        np.zeros(points, dtype=np.bool_),
    )


def add_rays(
    problem: Problem, design: Design, values: Values, kept: Eliminated, matrix: Floats, damping: float = 0.0
) -> tuple[Floats, float]:
    """Add the reduced normal equations of rays and weighted points alone to a matrix.

    returns gradient (layout.size,), chi_squared.
    """
    structure, strips = problem.layout.envelope, problem.layout.strips
    first, last = design.reach.T
    start = np.concatenate([[0], np.cumsum(strips.offset[last] - strips.offset[first])])
    room = np.zeros((int(start[-1]), padded(problem.layout.width)))
    corners = np.zeros((len(first), strips.border, padded(strips.border)))
    bases = start[:-1] - strips.offset[first]
    parts = [Contribution(int(base), room, corner) for base, corner in zip(bases, corners, strict=True)]
    total = accumulate(design, values, strips, damping, parts, kept)
    gradient = np.zeros(problem.layout.size)
    join(design, strips, Reduced(structure, matrix, gradient), start, room)
    corner = corners.sum(axis=0)[1:]
    gradient[structure.band :] = corner[:, 0]
    matrix[structure.offset[-2] :] += corner[:, 1 : 1 + structure.border].ravel()
    return gradient, total


def normal_equations(
    problem: Problem,
    state: State,
    damping: float = 0.0,
    room: Eliminated | None = None,
    others: Iterable[Equations] | None = None,
) -> Normal:
    """Set up the reduced normal equations at a state.

    others: observations beside the rays and the points, where these are not all of the problem's.
    """
    design, structure = problem.design, problem.layout.envelope
    kept = room or eliminated(problem, len(design.ray_image), len(design.point_free))
    matrix = np.zeros(int(structure.offset[-1]))
    values = values_of(problem, state)
    gradient, total = add_rays(problem, design, values, kept, matrix, damping=damping)
    for equations in other_equations(problem, state).values() if others is None else others:
        add_equations(*equations, structure, matrix, gradient)
        total += equations.chi_squared()
    diagonal = diagonal_addresses(problem)
    matrix[diagonal] *= 1.0 + damping
    matrix[diagonal[problem.held]] = 1.0
    # As many pseudo-observations as the datum has defects are met exactly, whatever their weight.
    matrix[diagonal[problem.stiffened]] *= 2.0
    return Normal(matrix, gradient, total, np.flatnonzero(kept.singular), kept)


def diagonal_addresses(problem: Problem) -> Integers:
    """Where the diagonal stands among the values of the reduced matrix, shape (layout.size,)."""
    structure = problem.layout.envelope
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
