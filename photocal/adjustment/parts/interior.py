"""A part of a block: its points and inner images eliminated, and what is found of them afterwards.

The normal equations of a part are those of a network. Its inner images form a band; what it has in common
with other parts, images at its edges and the parameters of cameras and mounting, forms the border.
"""

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from scipy.linalg import blas, lapack
from scipy.sparse import csr_array

from photocal.adjustment.datum import Correction
from photocal.adjustment.envelope import PANEL, envelope, factorise, on_one_thread, selected_inverse
from photocal.adjustment.equations import Equations
from photocal.adjustment.factored import Factored
from photocal.adjustment.kernels.data import Eliminated, Structure
from photocal.adjustment.kernels.substitution import back_substitute, reduce_right
from photocal.adjustment.layout import Layout, order
from photocal.adjustment.normal import (
    Normal,
    Problem,
    diagonal_addresses,
    normal_equations,
    other_equations,
    prepare,
)
from photocal.adjustment.parts.fronts import Front
from photocal.adjustment.parts.part import OF_CAMERA, OF_IMAGE, SubNetwork, images_together
from photocal.adjustment.rank import weakest_pivot
from photocal.adjustment.solver import SINGULAR_PIVOT
from photocal.adjustment.state import State, moved_exposures
from photocal.adjustment.unknowns import unknowns
from photocal.base.arrays import Flags, Floats, Integers
from photocal.base.errors import IllPosedError


@dataclass(frozen=True)
class Interior:
    """A part made ready.

    structure: band of its inner images, border of what it has in common with others.
    column (layout.size,): column in that structure of each column of the problem; -1 for what is held.
    common (m,): numbers in the whole of the unknowns of the border, growing.
    lower: addresses of the elements of the problem's matrix that may not be zero, and where they go.
    full: the same, with both triangles of the blocks on the diagonal.
    """

    part: SubNetwork
    problem: Problem
    structure: Structure
    column: Integers
    common: Integers
    lower: tuple[Integers, Integers]
    full: tuple[Integers, Integers]

    @cached_property
    def of_common(self) -> Integers:
        """Columns of the problem of the unknowns of the border, (m,)."""
        at = np.flatnonzero(self.column >= self.structure.band)
        place = np.empty(len(at), dtype=np.int64)
        place[self.column[at] - self.structure.band] = at
        return place

    @cached_property
    def counted(self) -> Flags:
        """Columns of what counts here: of images at home, and of cameras and mounting in the first part."""
        layout, part = self.problem.layout, self.part
        counted = np.full(layout.size, part.first)
        counted[: layout.envelope.band] = np.repeat(_by_place(layout, part.home), layout.width)
        return counted

    def others(self, state: State) -> dict[str, Equations]:
        """Observations beside the rays that count here, by group."""
        equations = other_equations(self.problem, state)
        # Positions and attitudes are those of images at home already.
        whole = ("position", "attitude")
        return {
            name: rows if name in whole else _only(rows, self.counted) for name, rows in equations.items()
        }


def _by_place(layout: Layout, flags: Flags) -> Flags:
    """Flags of images in the order of their columns."""
    ordered = np.empty_like(flags)
    ordered[layout.image_columns[:, 0] // layout.width] = flags
    return ordered


def _only(rows: Equations, columns: Flags) -> Equations:
    """Keep observations whose first unknown is among some columns."""
    if not len(rows.weight):
        return rows
    chosen = columns[rows.column[rows.start[:-1]]]
    count = np.diff(rows.start)
    coefficients = np.repeat(chosen, count)
    return Equations(
        np.concatenate([[0], np.cumsum(count[chosen])]).astype(np.int64),
        rows.column[coefficients],
        rows.coefficient[coefficients],
        rows.residual[chosen],
        rows.weight[chosen],
    )


def interior(part: SubNetwork) -> Interior:
    """Order the inner images of a part, and number what it has in common with others."""
    network = part.network
    problem = prepare(replace(network, datum_points=None))
    layout = problem.layout
    number = _numbers(part, problem)
    together = images_together(network.rays.image, network.rays.point, len(part.images))
    inner = np.flatnonzero(part.inside)
    position, last = order(together[inner][:, inner], network.exposures.started[inner, 3:])
    column = np.full(layout.size, -1)
    wide = layout.width
    offsets = np.arange(wide)
    # Of inner images every column has its place, also those that are held.
    at = layout.image_columns[inner, :1] + offsets
    column[at] = wide * position[:, None] + offsets
    band = wide * len(inner)
    outside = column < 0
    open_ones = np.flatnonzero(outside & ~problem.held)
    open_ones = open_ones[np.argsort(number[open_ones])]
    column[open_ones] = band + np.arange(len(open_ones))
    structure = envelope(wide * (last + 1), wide, len(open_ones), PANEL)
    return Interior(
        part, problem, structure, column, number[open_ones], *_addresses(problem, together, structure, column)
    )


def _numbers(part: SubNetwork, problem: Problem) -> Integers:
    """Number in the whole of each column: of images, of cameras, of what is common; (layout.size,)."""
    layout = problem.layout
    number = np.full(layout.size, -1)
    number[layout.image_columns] = OF_IMAGE * part.images[:, None] + np.arange(6)
    image, place = np.nonzero(layout.own_columns >= 0)
    number[layout.own_columns[image, place]] = OF_IMAGE * part.images[image] + 6 + place
    first = OF_IMAGE * part.count
    for k, (active, columns) in enumerate(layout.camera_columns):
        number[columns] = first + OF_CAMERA * k + active
    first += OF_CAMERA * len(layout.camera_columns)
    known = np.flatnonzero(layout.common_columns >= 0)
    number[layout.common_columns[known]] = first + known
    return number


def _addresses(
    problem: Problem, together: csr_array, structure: Structure, column: Integers
) -> tuple[tuple[Integers, Integers], tuple[Integers, Integers]]:
    """Where elements stand in the problem's matrix and in that of a part, see `Interior`."""
    layout, offsets = problem.layout, np.arange(problem.layout.width)
    image, other = together.nonzero()
    first = layout.image_columns[:, 0]
    every = np.arange(len(first))
    image, other = np.concatenate([image, every]), np.concatenate([other, every])
    once = np.unique(np.column_stack([image, other])[first[image] >= first[other]], axis=0)
    row = (first[once[:, 0], None, None] + offsets[:, None] + 0 * offsets).ravel()
    below = (first[once[:, 1], None, None] + offsets + 0 * offsets[:, None]).ravel()
    border = layout.envelope.band + np.arange(layout.envelope.border)
    in_border = (np.repeat(border, layout.size), np.tile(np.arange(layout.size), len(border)))
    row, below = np.concatenate([row, in_border[0]]), np.concatenate([below, in_border[1]])
    kept = ((row >= below) | (row < layout.envelope.band)) & (column[row] >= 0) & (column[below] >= 0)
    row, below = row[kept], below[kept]
    there = np.sort([column[row], column[below]], axis=0)
    source = addresses(layout.envelope, row, below)
    target = addresses(structure, there[1], there[0])
    lower = row >= below
    return (source[lower], target[lower]), (source, target)


def addresses(structure: Structure, row: Integers, column: Integers) -> Integers:
    """Where elements stand among the values of a matrix; rows above columns only within a panel's block."""
    home = np.minimum(column // structure.panel, len(structure.width) - 1)
    in_border = column >= structure.band
    home[in_border] = len(structure.width) - 1
    last = np.append(structure.last, 0)[home]
    top = np.where(in_border, structure.band, home * structure.panel)
    step, start = structure.width[home], structure.offset[home]
    inside = np.where(row < structure.band, row - top, last - top + row - structure.band)
    inside = np.where(in_border, row - structure.band, inside)
    return np.asarray(start + inside * step + column - top)


@dataclass(frozen=True)
class CondensedPart:
    """A part at a state, with its points and inner images eliminated.

    normal: of the problem; its matrix is gone.
    factor: of the inner images; the corner of the border is free.
    front, right: what is handed on, with the right-hand side (m, 1) of the step.
    """

    normal: Normal
    factor: Floats
    front: Front
    right: Floats


def condensed(
    at: Interior, state: State, damping: float = 0.0, room: Eliminated | None = None
) -> CondensedPart:
    """Set up the normal equations of a part and eliminate all that no other part has.

    raises IllPosedError: where that is not determined.
    """
    structure = at.structure
    normal = normal_equations(at.problem, state, damping, room, at.others(state).values())
    if len(normal.singular):
        some = ", ".join(at.part.network.point_names[j] for j in normal.singular[:5])
        raise IllPosedError(
            f"{len(normal.singular)} object point(s) are not determined by their rays ({some})",
            "give these points rays from different places, or remove them",
        )
    values = structure.zeros()
    values[at.lower[1]] = normal.matrix[at.lower[0]]
    border = np.arange(structure.border)
    places = structure.band + border
    diagonal = values[addresses(structure, places, places)].copy()
    corner = _eliminated(at, values)
    reduced = handed_on(at, values, -normal.gradient[:, None])
    front = Front(at.common, corner, diagonal)
    return CondensedPart(replace(normal, matrix=np.zeros(0)), values, front, reduced)


def _eliminated(at: Interior, values: Floats) -> Floats:
    """Factorise the band in its place, leave the unit matrix in the border and return what is left there."""
    structure = at.structure
    width, offset = structure.width[:-1], structure.offset[:-1]
    inner = structure._replace(width=width, offset=offset, border=0)
    columns = np.arange(structure.band)
    diagonal = addresses(structure, columns, columns)
    before = values[diagonal]
    failed = factorise(inner, values)
    if failed < 0 and structure.band and weakest_pivot(values[diagonal], before) < SINGULAR_PIVOT:
        failed = int(np.argmin(values[diagonal] ** 2 / before))
    if failed >= 0:
        unknown = unknowns(at.problem)[int(np.flatnonzero(at.column == failed)[0])]
        name = "" if unknown is None else unknown.name
        raise IllPosedError(
            f"{name} is not determined within its part",
            "give its image more points, or adjust the block whole: then all that is not determined is named",
        )
    panels = structure.panels(values)
    corner = np.array(panels[-1].T, order="F")
    for j, last in enumerate(structure.last):
        rows = panels[j][int(last) - structure.start(j) :]
        if len(rows):
            blas.dsyrk(-1.0, rows.T, beta=1.0, c=corner, trans=1, overwrite_c=1)
    return np.ascontiguousarray(corner.T)


def found(at: Interior, condensed: CondensedPart, right: Floats, common: Floats) -> Floats:
    """Columns of the problem, (layout.size, t), from its right-hand sides and the unknowns of the border."""
    free = at.column >= 0
    inner = np.zeros((at.structure.size, right.shape[1]))
    inner[at.column[free]] = right[free]
    _forward(at.structure, condensed.factor, inner)
    inner[at.structure.band :] = common
    _back(at.structure, condensed.factor, inner)
    step = np.zeros_like(right)
    step[free] = inner[at.column[free]]
    step[at.problem.held] = 0.0
    return step


def handed_on(at: Interior, factor: Floats, right: Floats) -> Floats:
    """What of right-hand sides (layout.size, t) is left for the border, (m, t), without all else."""
    free = (at.column >= 0) & ~at.problem.held
    inner = np.zeros((at.structure.size, right.shape[1]))
    inner[at.column[free]] = right[free]
    _forward(at.structure, factor, inner)
    return inner[at.structure.band :]


def _panels(structure: Structure, factor: Floats) -> list[tuple[Floats, slice, slice, int]]:
    """Panels of the band, their columns, the rows of the band below, and where those of the border begin."""
    listed = []
    for panel, width, last, j in zip(
        structure.panels(factor), structure.width, structure.last, range(len(structure.last)), strict=False
    ):
        top = structure.start(j)
        here, rows = slice(top, top + int(width)), slice(top + int(width), int(last))
        listed.append((panel, here, rows, int(last) - top))
    return listed


@on_one_thread
def _forward(structure: Structure, factor: Floats, x: Floats) -> None:
    """Solve for the band from above, in place, and leave in the border what it has not taken."""
    border = x[structure.band :]
    for panel, here, rows, split in _panels(structure, factor):
        width = here.stop - here.start
        x[here] = blas.dtrsm(1.0, panel[:width].T, x[here], lower=0, trans_a=1)
        x[rows] -= panel[width:split] @ x[here]
        border -= panel[split:] @ x[here]


@on_one_thread
def _back(structure: Structure, factor: Floats, x: Floats) -> None:
    """Solve for the band from below, in place, with the border as it is given."""
    border = x[structure.band :]
    for panel, here, rows, split in reversed(_panels(structure, factor)):
        width = here.stop - here.start
        part = x[here] - panel[width:split].T @ x[rows] - panel[split:].T @ border
        x[here] = blas.dtrsm(1.0, panel[:width].T, part, lower=0)


def stepped(at: Interior, condensed: CondensedPart, state: State, common: Floats) -> tuple[State, float]:
    """State after a step whose common part (m,) is given, and its share of the squared length of the step."""
    problem, normal = at.problem, condensed.normal
    right = np.where(problem.held, 0.0, -normal.gradient)[:, None]
    step = found(at, condensed, right, common[:, None])[:, 0]
    moved = moved_exposures(problem.network, problem.layout, state, step)
    points = state.points.copy()
    kept = normal.kept
    decrease = back_substitute(problem.design, problem.layout.envelope, step, kept, kept.gradient, points)
    return replace(moved, points=points), float(decrease - normal.gradient @ step)


def reduced_right(at: Interior, condensed: CondensedPart, points: Floats) -> Floats:
    """Right-hand sides of the problem, (layout.size, t), that those of points (t, points, 3) become."""
    design, structure = at.problem.design, at.problem.layout.envelope
    taken = np.zeros((len(design.pieces) - 1, len(points), at.problem.layout.size))
    reduce_right(design, structure, np.ascontiguousarray(points), condensed.normal.kept, taken)
    right = np.asarray(taken.sum(axis=0).T)
    right[at.problem.held] = 0.0
    return right


def spread_points(at: Interior, condensed: CondensedPart, steps: Floats, points: Floats) -> Floats:
    """Points (t, points, 3) that belong to steps (layout.size, t) and right-hand sides of the points."""
    result = np.zeros_like(points)
    back_substitute(
        at.problem.design,
        at.problem.layout.envelope,
        np.ascontiguousarray(steps.T),
        condensed.normal.kept,
        -np.ascontiguousarray(points),
        result,
    )
    return result


@dataclass(frozen=True)
class FactoredPart(Factored):
    """A part at the minimum of the whole, with its part of the covariance.

    values: of the inverse, within the structure of the problem.
    rows: observations beside the rays that count here.
    """

    values: Floats
    rows: dict[str, Equations]

    @property
    def inverse(self) -> Floats:
        """Its part of the inverse of the whole."""
        return self.values

    @property
    def others(self) -> dict[str, Equations]:
        """Observations beside the rays, by group."""
        return self.rows


def factored_part(
    at: Interior, condensed: CondensedPart, state: State, common: Floats, datum: Correction | None
) -> FactoredPart:
    """Give a part the covariance among its unknowns, from that (m, m) of its border."""
    structure = at.structure
    factor = condensed.factor
    if structure.border:
        # The lower triangle T with T'T the covariance is the inverse of a Cholesky factor.
        flipped, info = lapack.dpotrf(common[::-1, ::-1], lower=0, clean=1)
        if info:
            raise IllPosedError("what parts have in common is not determined", "adjust the block whole")
        root = lapack.dtrtri(np.ascontiguousarray(flipped[::-1, ::-1]), lower=1)[0]
        structure.panels(factor)[-1][:] = root
    inside = selected_inverse(structure, factor)
    values = at.problem.layout.envelope.zeros()
    values[at.full[0]] = inside[at.full[1]]
    # Of an image's columns that are no unknowns the whole inverse has ones.
    diagonal = diagonal_addresses(at.problem)
    values[diagonal[at.problem.held & (at.column < 0)]] = 1.0
    return FactoredPart(at.problem, state, condensed.normal, datum, values, at.others(state))
