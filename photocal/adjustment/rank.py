"""What a network leaves undetermined, in words."""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

import numpy as np
from scipy.linalg import eigh, qr

from photocal.adjustment.datum import similarity_moves
from photocal.adjustment.envelope import dense
from photocal.adjustment.normal import Normal, Problem, normal_equations
from photocal.adjustment.state import State
from photocal.adjustment.unknowns import XYZ, Unknown, unknowns
from photocal.base.arrays import Floats, Integers
from photocal.base.errors import IllPosedError


class RankLimits(NamedTuple):
    """Below which shares of their own scale quantities count as undetermined.

    parallel: scaled determinant of a point's own block, about the square of the angle between its rays.
    null: scaled eigenvalue of the reduced matrix.
    """

    parallel: float
    null: float


# What rounding alone holds: null eigenvalues of whole blocks come out below 1e-14. And what to suspect first
# when an adjustment fails or means nothing.
SINGULAR = RankLimits(1e-10, 1e-12)
SUSPECT = RankLimits(1e-4, 1e-7)
# A standard deviation of this share of the value itself: the linearisation no longer means anything.
LOST_POINT, LOST_CAMERA = 0.5, 0.1
DATUM_NAMES = (*(f"position in {axis}" for axis in XYZ), *(f"rotation about {axis}" for axis in XYZ), "scale")


@dataclass(frozen=True)
class _NullSpace:
    """What the normal equations at a state determine hardly or not at all."""

    problem: Problem
    state: State

    @cached_property
    def normal(self) -> Normal:
        """The normal equations."""
        return normal_equations(self.problem, self.state)

    @cached_property
    def scaled(self) -> tuple[Floats, Floats]:
        """Scale of the unknowns, and the reduced matrix in it."""
        matrix = dense(self.problem.layout.envelope, self.normal.matrix)
        # Of an unknown that nothing resists only rounding is left, of either sign.
        nothing = np.diag(matrix) <= 0.0
        matrix[nothing], matrix[:, nothing] = 0.0, 0.0
        scale = np.sqrt(np.where(nothing, 1.0, np.diag(matrix)))
        return scale, matrix / np.outer(scale, scale)

    @cached_property
    def _weak(self) -> tuple[Floats, Floats]:
        """Eigenvalues of the scaled matrix that are suspect, with their eigenvectors."""
        matrix = self.scaled[1]
        if not np.isfinite(matrix).all():
            # Of coordinates beyond all measure nothing can be said.
            return np.zeros(0), np.zeros((len(matrix), 0))
        values, vectors = eigh(matrix, subset_by_value=(-np.inf, SUSPECT.null))
        return values, vectors

    def vectors(self, limit: float) -> Floats:
        """Eigenvectors of the scaled matrix with eigenvalues below a limit, as columns."""
        values, vectors = self._weak
        return np.asarray(vectors[:, values < limit])

    def parallel(self, limit: float) -> Integers:
        """Points whose rays come from one place: their own block is nearly singular."""
        normal = self.normal
        eliminated = self.problem.design.point_column < 0
        eliminated[normal.singular] = False
        point_normal = np.linalg.inv(normal.kept.inverse[eliminated])
        share = np.linalg.det(point_normal) / np.prod(np.diagonal(point_normal, axis1=1, axis2=2), axis=1)
        weak = np.flatnonzero(eliminated)[share < limit]
        return np.union1d(normal.singular, weak)


def weakest_pivot(factor_diagonal: Floats, diagonal: Floats) -> float:
    """Smallest share of a diagonal element that remains when all before it are eliminated."""
    with np.errstate(divide="ignore", invalid="ignore"):
        share = factor_diagonal**2 / diagonal
    return float(np.nanmin(share, initial=1.0))


def explain_singular(problem: Problem, state: State, limits: RankLimits = SINGULAR) -> None:
    """Raise what the observations leave undetermined; return when they determine everything."""
    _explain(_NullSpace(problem, state), limits)


def _explain(space: _NullSpace, limits: RankLimits) -> None:
    problem = space.problem
    names = problem.network.point_names
    alone = space.parallel(limits.parallel)
    if len(alone):
        some = ", ".join(names[j] for j in alone[:5])
        raise IllPosedError(
            f"the rays of {len(alone)} object point(s) do not intersect ({some})",
            "give these points rays from different places, or remove them",
        ).of_points(tuple(names[j] for j in alone))
    null = space.vectors(limits.null)
    if not null.shape[1]:
        return
    datum, other = _datum_part(space, null)
    named = unknowns(problem)
    parts = []
    if datum:
        parts.append(f"nothing fixes the datum ({', '.join(datum)})")
    if other.shape[1]:
        parts.append("the observations do not separate " + _loaded(problem, named, other))
    how = "singular" if limits == SINGULAR else "nearly singular"
    raise IllPosedError(
        f"the network is {how} (rank defect {null.shape[1]}): " + "; ".join(parts),
        "add control points, weighted positions or prior sigmas, or hold what cannot be determined",
        details=_null_vectors(named, null, space.scaled[0]),
    )


def require_determined(
    problem: Problem, state: State, point_covariance: Floats, camera_covariance: Floats
) -> None:
    """Refuse a solution whose points or principal distances are not determined in any useful sense."""
    design = problem.design
    first = state.centre[design.ray_image[np.minimum(design.ray_start[:-1], len(design.ray_image) - 1)]]
    distance = np.linalg.norm(state.points - first, axis=1)
    spread = np.sqrt(np.trace(point_covariance, axis1=1, axis2=2))
    lost = np.flatnonzero(~(spread < LOST_POINT * distance))
    space = _NullSpace(problem, state)
    if len(lost):
        # Where rounding alone has let a singular system through, no weak datum excuses it.
        _explain(space, SINGULAR)
    if len(lost) and not _only_the_datum(space):
        _explain(space, SUSPECT)
        some = ", ".join(problem.network.point_names[j] for j in lost[:5])
        raise IllPosedError(
            f"{len(lost)} object point(s) are uncertain by more than half of their distance ({some}): "
            "their rays do not intersect",
            "give these points rays from different places, or remove them",
        ).of_points(tuple(problem.network.point_names[j] for j in lost))
    require_cameras(problem, state, camera_covariance)


def require_cameras(problem: Problem, state: State, camera_covariance: Floats) -> None:
    """Refuse principal distances that are not determined in any useful sense."""
    for camera, values, covariance in zip(
        problem.network.cameras, state.cameras, camera_covariance, strict=True
    ):
        share = np.sqrt(covariance[0, 0]) / values[0]
        if not share < LOST_CAMERA:
            raise IllPosedError(
                f"c of camera {camera.id} is not determined: its standard deviation is {share:.0%} of it",
                "hold c, or add heights, positions, relief or convergent images",
            )


def only_the_datum_is_weak(problem: Problem, state: State) -> bool:
    """Whether all that is uncertain is where the whole lies: rays do not mind, and the shape is known."""
    return _only_the_datum(_NullSpace(problem, state))


def _only_the_datum(space: _NullSpace) -> bool:
    if len(space.parallel(SUSPECT.parallel)):
        return False
    datum, other = _datum_part(space, space.vectors(SUSPECT.null))
    return bool(datum) and not other.shape[1]


def share_of_datum(problem: Problem, state: State, step: Floats, scale: Floats) -> float:
    """How much of a step moves the block as a whole, 0 to 1, all unknowns scaled alike."""
    moves, _ = np.linalg.qr(similarity_moves(problem, state)[0] * scale[:, None])
    return float(np.linalg.norm(moves.T @ (step * scale)) / np.linalg.norm(step * scale))


def _datum_part(space: _NullSpace, null: Floats) -> tuple[list[str], Floats]:
    """Datum elements that make up null vectors, and the null vectors that are something else."""
    scale, scaled = space.scaled
    moves = similarity_moves(space.problem, space.state)[0] * scale[:, None]
    length = np.linalg.norm(moves, axis=0)
    unit = moves / np.where(length > 0, length, 1.0)
    weights = np.linalg.lstsq(unit, null, rcond=None)[0]
    nearest = unit @ weights
    size = np.sum(nearest**2, axis=0)
    # The datum is open only if moving it alone costs hardly more than the null vector does: all heights
    # of a flat block move with c, but not without it.
    cost = np.einsum("nk,nk->k", nearest, scaled @ nearest) / np.maximum(size, np.finfo(float).tiny)
    null_cost = np.einsum("nk,nk->k", null, scaled @ null)
    # Share of a null vector that similarity transformations must explain to be called the datum.
    mostly = 0.5
    explained = (size > mostly) & (cost < 100 * np.maximum(null_cost, np.finfo(float).eps))
    strong = np.abs(weights) > 0.5 * np.abs(weights).max(axis=0)
    named = strong[:, explained].any(axis=1)
    return [name for name, hit in zip(DATUM_NAMES, named, strict=True) if hit], null[:, ~explained]


def _loaded(problem: Problem, named: Sequence[Unknown | None], null: Floats) -> str:
    """Name the unknowns that take part in what is undetermined."""
    load = np.linalg.norm(null, axis=1)
    strong = load > 0.2 * load.max()
    taking = [unknown for unknown, hit in zip(named, strong, strict=True) if unknown is not None and hit]
    parts = []
    for camera in problem.network.cameras:
        key = ("camera", camera.id)
        of_camera = [unknown.parameter for unknown in taking if (unknown.kind, unknown.of) == key]
        if of_camera:
            parts.append(f"{', '.join(of_camera)} of camera {camera.id}")
    for kind, plural in (("image", "image(s)"), ("point", "point(s)"), ("head", "head(s)")):
        parameters = list(dict.fromkeys(unknown.parameter for unknown in taking if unknown.kind == kind))
        if parameters:
            owners = list(dict.fromkeys(unknown.of for unknown in taking if unknown.kind == kind))
            which = ", ".join(owners[:5]) + (f" and {len(owners) - 5} more" if len(owners) > 5 else "")
            parts.append(f"{', '.join(parameters)} of {plural} {which}")
    parts += [unknown.parameter for unknown in taking if unknown.kind == "mounting"]
    return " and ".join(parts)


def _null_vectors(named: Sequence[Unknown | None], null: Floats, scale: Floats) -> tuple[str, ...]:
    """Print what may change together without changing any observation, a line for each null vector."""
    # Unknowns that are printed of a null vector.
    most_shown = 12
    # The basis is turned so that each vector moves one leading unknown by 1 and not those of the others.
    loads = null * np.array([unknown is not None for unknown in named])[:, None]
    _, _, order = qr(loads.T, mode="economic", pivoting=True)
    leading = np.sort(order[: null.shape[1]])
    loads = loads @ np.linalg.inv(loads[leading])
    lines = []
    for number, (lead, load) in enumerate(zip(leading.tolist(), loads.T, strict=True), start=1):
        # Equal loads, but for rounding, keep the order of the unknowns.
        rest = np.argsort(-np.round(np.abs(load), 6), kind="stable").tolist()
        shown = [lead] + [k for k in rest if k != lead and abs(load[k]) > 0.02 * np.abs(load).max()]
        change = load / scale
        parts = [_part(named[k], change[k], named[lead], change[lead]) for k in shown[:most_shown]]
        more = f" and {len(shown) - most_shown} more" if len(shown) > most_shown else ""
        lines.append(f"null vector {number}: {', '.join(parts)}{more}")
    return tuple(lines)


def _part(unknown: Unknown | None, change: float, lead: Unknown | None, unit: float) -> str:
    """Print the change of an unknown per unit of the leading one."""
    if unknown is None or lead is None:
        return ""
    figure = f"{change * unknown.scale / (unit * lead.scale):+.4g}"
    return f"{figure} {unknown.unit} {unknown.name}" if unknown.unit else f"{figure} {unknown.name}"
