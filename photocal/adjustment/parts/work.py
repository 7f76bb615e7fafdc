"""What is done at one part, by any process that sees its folder.

A task says all that it needs: part, state, damping. What was computed for the task before is kept in the
memory of the process; where it is not, because another process did that, or died, it is computed again from
the part's file and its last state.
"""

from collections import OrderedDict
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from photocal.adjustment.covariance import complete
from photocal.adjustment.datum import Correction, resisted, similarity_moves, transformed
from photocal.adjustment.normal import normal_equations
from photocal.adjustment.parts.fronts import Front
from photocal.adjustment.parts.interior import (
    CondensedPart,
    Interior,
    condensed,
    factored_part,
    found,
    handed_on,
    interior,
    reduced_right,
    spread_points,
    stepped,
)
from photocal.adjustment.parts.part import SubNetwork
from photocal.adjustment.solution import Group, Solution
from photocal.adjustment.state import State, start_state
from photocal.base.arrays import Flags, Floats, Integers
from photocal.base.codec import packed, unpacked
from photocal.base.files import output_file
from photocal.base.operating_system import available_memory

# Free memory that is left alone. Where there is less, the part that was used last falls out: each is used in
# turn, and of those that stay something is found.
SPARE = 1 << 30


@dataclass
class _Held:
    """What a process has of a part: made ready, its last state, and the factor at a state with a damping."""

    interior: Interior
    state: tuple[int, State] | None = None
    condensed: tuple[int, float, CondensedPart] | None = None


_PARTS = OrderedDict[tuple[str, int], _Held]()


@dataclass(frozen=True)
class At:
    """A part, by its folder and number, at one of its states.

    job: tells adjustments apart that use the same folder one after the other.
    damping: with which its equations are factorised.
    """

    folder: str
    job: str
    part: int
    state: int = 0
    damping: float = 0.0


def part_number(task: Any) -> int:
    """Part that any task is about: processes that know it are preferred."""
    while not isinstance(task, At):
        task = task.moved if isinstance(task, DatumSpread) else task.at
    return task.part


def part_file(folder: str | Path, part: int) -> Path:
    """Where a part stands."""
    return Path(folder) / f"part-{part:05}.npz"


def solution_file(folder: str | Path, part: int) -> Path:
    """Where what was found of a part stands."""
    return Path(folder) / f"solution-{part:05}.npz"


def write(path: Path, value: object) -> None:
    """Write an object of arrays."""
    with output_file(path) as aside, aside.open("wb") as stream:
        np.savez(stream, **packed(value))  # type: ignore[arg-type]


@dataclass(frozen=True)
class _Stored:
    """A part without its names, and these: as arrays, of which there may be many."""

    part: SubNetwork
    images: NDArray[np.str_]
    points: NDArray[np.str_]


def write_part(folder: Path, number: int, part: SubNetwork) -> None:
    """Write a part."""
    network = part.network
    bare = replace(part, network=replace(network, image_names=(), point_names=()))
    names = np.array(network.image_names, dtype=np.str_), np.array(network.point_names, dtype=np.str_)
    write(part_file(folder, number), _Stored(bare, *names))


def read_part(folder: str | Path, number: int) -> SubNetwork:
    """Read a part."""
    with np.load(part_file(folder, number)) as arrays:
        stored = unpacked(_Stored, arrays)
    images, points = (tuple(names.tolist()) for names in (stored.images, stored.points))
    part: SubNetwork = stored.part
    return replace(part, network=replace(part.network, image_names=images, point_names=points))


def _held(at: At) -> _Held:
    key = at.job, at.part
    if key not in _PARTS:
        for other in [other for other in _PARTS if other[0] != at.job]:
            del _PARTS[other]
        free = available_memory()
        if _PARTS and free is not None and free < SPARE:
            _PARTS.popitem()
        _PARTS[key] = _Held(interior(read_part(at.folder, at.part)))
    _PARTS.move_to_end(key)
    return _PARTS[key]


def _state_file(at: At, number: int) -> Path:
    return Path(at.folder) / f"state-{at.part:05}-{number:03}.npz"


def _state(at: At) -> State:
    held = _held(at)
    if held.state is None or held.state[0] != at.state:
        if at.state == 0:
            state = start_state(held.interior.part.network)
        else:
            with np.load(_state_file(at, at.state)) as arrays:
                state = unpacked(State, arrays)
        held.state = at.state, state
    return held.state[1]


def _put(at: At, number: int, state: State) -> None:
    """Write a state after that of a task; those before it are gone."""
    write(_state_file(at, number), state)
    _held(at).state = number, state
    for old in range(1, at.state):
        _state_file(at, old).unlink(missing_ok=True)


def _condensed(at: At) -> CondensedPart:
    held = _held(at)
    if held.condensed is None or held.condensed[:2] != (at.state, at.damping):
        room = None if held.condensed is None else held.condensed[2].normal.kept
        held.condensed = None
        made = condensed(held.interior, _state(at), at.damping, room)
        held.condensed = at.state, at.damping, made
    return held.condensed[2]


@dataclass(frozen=True)
class HandedOn:
    """What a part hands on of its equations."""

    front: Front
    right: Floats
    chi_squared: float


def condense(at: At) -> HandedOn:
    """Set up a part's equations and eliminate all that no other part has."""
    made = _condensed(at)
    return HandedOn(made.front, made.right, made.normal.chi_squared)


@dataclass(frozen=True)
class PartStep:
    """A step of a part to another state, and what it has of it in common with others, (m,)."""

    at: At
    to: int
    common: Floats


def step(task: PartStep) -> float:
    """Make a step; returns its share of the squared length, in units of the standard deviations."""
    at = task.at
    made, state = _condensed(at), _state(at)
    moved, decrement = stepped(_held(at).interior, made, state, task.common)
    _put(at, task.to, moved)
    return decrement


def middle(at: At) -> tuple[Floats, int]:
    """Sum of the centres of the images at home, (3,), and how many there are."""
    home = _held(at).interior.part.home
    return _state(at).centre[home].sum(axis=0), int(home.sum())


@dataclass(frozen=True)
class DatumQuestion:
    """A question about similarity transformations of a part, about a place (3,).

    combined (7, d): combinations of them.
    """

    at: At
    about: Floats
    combined: Floats


def resist(task: DatumQuestion) -> tuple[Floats, Floats, Integers, Floats]:
    """How a part resists transformations, see `resisted`; how they move its border, by number, (m, 7)."""
    held, state = _held(task.at), _state(task.at)
    at = held.interior
    normal = normal_equations(at.problem, state, others=at.others(state).values())
    moves = similarity_moves(at.problem, state, task.about)[0]
    return *resisted(at.problem, normal, moves), at.common, moves[at.of_common]


def away(task: DatumQuestion) -> tuple[Floats, Floats, float, float]:
    """Normal equations of a transformation that brings datum points back; their largest moves and width."""
    at, state = _held(task.at).interior, _state(task.at)
    chosen = at.part.network.datum_points
    points = similarity_moves(at.problem, state, task.about)[1] @ task.combined
    moves = points[chosen].reshape(-1, points.shape[2])
    off = (at.part.network.points.values - state.points)[chosen].ravel()
    return moves.T @ moves, moves.T @ off, float(np.abs(moves).max(initial=0.0)), float(np.ptp(state.points))


@dataclass(frozen=True)
class Transform:
    """A similarity transformation (7,) of a part, about a place, to another state."""

    at: At
    to: int
    about: Floats
    change: Floats


def transform(task: Transform) -> None:
    """Transform a part."""
    _put(task.at, task.to, transformed(_state(task.at), task.change, task.about))


def _datum_right(task: DatumQuestion) -> tuple[Interior, CondensedPart, Floats, Floats, Floats, Floats]:
    """Transformations of a part, (size, d), (points, 3, d), and right-hand sides of its datum points."""
    held, state = _held(task.at), _state(task.at)
    at, made = held.interior, _condensed(task.at)
    reduced, points = similarity_moves(at.problem, state, task.about)
    reduced, points = reduced @ task.combined, points @ task.combined
    right = np.zeros_like(points)
    chosen = at.part.network.datum_points
    right[chosen] = points[chosen]
    return at, made, reduced, points, right, reduced_right(at, made, np.moveaxis(right, 2, 0))


def datum_right(task: DatumQuestion) -> Floats:
    """What the right-hand sides of the datum hand on, (m, d)."""
    at, made, _, _, _, right = _datum_right(task)
    return handed_on(at, made.factor, right)


@dataclass(frozen=True)
class DatumSpread:
    """What the right-hand sides of the datum come to for the border of a part, (m, d)."""

    moved: DatumQuestion
    common: Floats


def _spread(task: DatumSpread) -> tuple[Floats, Floats, Floats, Floats, Floats]:
    at, made, reduced, points, right, of_reduced = _datum_right(task.moved)
    steps = found(at, made, of_reduced, task.common)
    moved = spread_points(at, made, steps, np.moveaxis(right, 2, 0))
    return reduced, steps, points, np.moveaxis(moved, 0, 2), right


def spread(task: DatumSpread) -> tuple[Floats, Floats]:
    """Sums G'A and G'QG of the datum points, (d, d)."""
    _, _, points, moved, right = _spread(task)
    return np.einsum("nak,nal->kl", right, points), np.einsum("nak,nal->kl", right, moved)


@dataclass(frozen=True)
class Finish:
    """What a part needs for its statistics.

    state: number of the one at the minimum; that of `at` may be the one before, whose factor serves both.
    covariance (m, m): of its border.
    datum: of a free network; with (G'A)^-1 and G'QG of the whole.
    """

    at: At
    state: int
    covariance: Floats
    datum: tuple[DatumSpread, Floats, Floats] | None = None


@dataclass(frozen=True)
class Found:
    """What was found of a part, with covariances in the datum of the whole.

    solution: of its network; its sums count what counts here.
    images, points, rays, home: as in `SubNetwork`.
    """

    solution: Solution
    images: Integers
    points: Integers
    rays: Integers
    home: Flags


@dataclass(frozen=True)
class Sums:
    """Sums over parts, and of the first part what all have in common.

    first: whether this is it.
    """

    groups: tuple[Group, ...]
    unknowns: int
    cameras: Floats
    camera_covariance: Floats
    common: Floats
    common_covariance: Floats
    first: bool


def finish(task: Finish) -> Sums:
    """Give a part its statistics, and write them."""
    held = _held(task.at)
    at, made = held.interior, _condensed(task.at)
    datum = None
    if task.datum is not None:
        asked, inverse, cofactor = task.datum
        reduced, steps, points, moved, _ = _spread(asked)
        datum = Correction(reduced, steps, points, moved, inverse, cofactor)
    state = _state(replace(task.at, state=task.state))
    whole = complete(factored_part(at, made, state, task.covariance, datum), ())
    part, problem = at.part, at.problem
    count = int(np.sum(at.counted & ~problem.held)) + int(np.sum(~part.network.points.held))
    write(
        solution_file(task.at.folder, task.at.part),
        Found(whole, part.images, part.points, part.rays, part.home),
    )
    del _PARTS[task.at.job, task.at.part]
    return Sums(
        whole.groups,
        count,
        whole.cameras,
        whole.camera_covariance,
        state.common,
        whole.common_covariance,
        part.first,
    )
