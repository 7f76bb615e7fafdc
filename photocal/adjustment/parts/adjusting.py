"""The iteration of a block in parts: one decision about each step for the whole block.

Gauss-Newton steps, damped after Levenberg and Marquardt where they would fail, as those of `solver`.
"""

from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any, TypeVar
from uuid import uuid4

import numpy as np

from photocal.adjustment.datum import datum_columns, open_of
from photocal.adjustment.parts import work
from photocal.adjustment.parts.dissection import Dissection
from photocal.adjustment.parts.fronts import Front
from photocal.adjustment.parts.part import OF_IMAGE
from photocal.adjustment.parts.upper import UndeterminedError, Upper, upper
from photocal.adjustment.parts.work import (
    At,
    DatumQuestion,
    DatumSpread,
    Finish,
    Found,
    PartStep,
    Sums,
    Transform,
)
from photocal.adjustment.solution import Group, PhotoVariant, Solution
from photocal.adjustment.solver import CONVERGED, FIRST_DAMPING, ITERATIONS, NEARLY, ROUNDING, Iteration
from photocal.adjustment.state import State
from photocal.base.arrays import Floats, Integers
from photocal.base.codec import unpacked
from photocal.base.errors import IllPosedError, NotConvergedError
from photocal.base.homes import Homes, homes
from photocal.base.workers import Workers

Result = TypeVar("Result")


@dataclass(frozen=True)
class Adjusted:
    """What is found of a block in parts, but for what is written of each part.

    state: number of the last state of each part.
    groups, observations, unknowns, datum_defect, chi_squared, iterations: as in `Solution`.
    cameras, camera_covariance, common, common_covariance: as in `Shared`.
    """

    iterations: tuple[Iteration, ...]
    chi_squared: float
    groups: tuple[Group, ...]
    unknowns: int
    datum_defect: int
    cameras: Floats
    camera_covariance: Floats
    common: Floats
    common_covariance: Floats

    @property
    def observations(self) -> int:
        """Number of all observations."""
        return sum(group.observations for group in self.groups)


@dataclass(frozen=True)
class _Block:
    """Parts in a folder, and who works on them.

    job: tells it from others in the same folder.
    """

    folder: str
    dissection: Dissection
    homes: Homes
    job: str

    def each(self, function: Callable[[Any], Result], tasks: Iterable[Any]) -> Iterator[Result]:
        """Do a piece of work for each part, where its last results are."""
        return self.homes.each(function, tasks, work.part_number)

    def at(self, state: int, damping: float = 0.0) -> list[At]:
        """All parts at a state."""
        return [At(self.folder, self.job, part, state, damping) for part in range(len(self.dissection.parts))]

    def middle(self, state: int) -> Floats:
        """Middle of the centres of all images."""
        sums, counts = zip(*self.each(work.middle, self.at(state)), strict=True)
        return np.asarray(sum(sums) / sum(counts))


@dataclass(frozen=True)
class _Equations:
    """Factorised equations of a block at a state with a damping."""

    state: int
    damping: float
    upper: Upper
    rights: list[Floats]
    chi_squared: float


@dataclass(frozen=True)
class _Datum:
    """What no observation of a free block sees.

    about (3,), combined (7, d): combinations of transformations about a place.
    unknown (n,), moves (n, d): how they move the unknowns at the borders of parts, by number.
    """

    about: Floats
    combined: Floats
    unknown: Integers
    moves: Floats

    def held(self, unknown: Integers, diagonal: Floats) -> Floats:
        """Hold as many unknowns of the last separator lightly as there are combinations.

        raises IllPosedError: where it has too few.
        """
        at = np.minimum(np.searchsorted(self.unknown, unknown), len(self.unknown) - 1)
        null = np.where((self.unknown[at] == unknown)[:, None], self.moves[at], 0.0)
        if np.linalg.matrix_rank(null * np.sqrt(diagonal)[:, None]) < null.shape[1]:
            raise IllPosedError(
                "the parts have too little in common to carry a free datum", "use fewer parts"
            )
        added = np.zeros(len(unknown))
        columns = datum_columns(null, diagonal)
        added[columns] = diagonal[columns]
        return added


def adjust_parts(
    folder: Path,
    dissection: Dissection,
    workers: Workers = 1,
    report: Callable[[Iteration], None] | None = None,
    *,
    free: bool = False,
    near: float = CONVERGED,
) -> Adjusted:
    """Adjust a block whose parts stand in a folder; what is found of each is written beside it.

    free: whether inner constraints over the datum points fix what no observation does.
    near: squared distance to the minimum, in units of the standard deviations, that may be left.
    raises IllPosedError: when the observations do not determine the unknowns.
    raises NotConvergedError: when the iteration does not end.
    """
    with homes(workers) as opened:
        return _adjusted(_Block(str(folder.resolve()), dissection, opened, uuid4().hex), report, free, near)


def _adjusted(block: _Block, report: Callable[[Iteration], None] | None, free: bool, near: float) -> Adjusted:
    datum = _datum(block, 0) if free else None
    equations, last, steps = _minimised(block, datum, report, near)
    if datum is not None:
        # The states before the last are gone, and so is its factor: a free block is moved first.
        last = _released(block, last)
        datum = _datum(block, last)
        equations = _factorised(block, datum, last, 0.0)
    chi_squared = equations.chi_squared if equations.state == last else steps[-1].chi_squared
    sums = list(_finished(block, equations, last, datum))
    first = next(part for part in sums if part.first)
    return Adjusted(
        tuple(steps),
        chi_squared,
        _added(sums),
        sum(part.unknowns for part in sums),
        0 if datum is None else datum.combined.shape[1],
        first.cameras,
        first.camera_covariance,
        first.common,
        first.common_covariance,
    )


def _added(sums: list[Sums]) -> tuple[Group, ...]:
    names = dict.fromkeys(group.name for part in sums for group in part.groups)
    return tuple(
        Group(
            name,
            sum(one.observations for part in sums for one in part.groups if one.name == name),
            sum(one.chi_squared for part in sums for one in part.groups if one.name == name),
            sum(one.redundancy for part in sums for one in part.groups if one.name == name),
        )
        for name in names
    )


def _factorised(block: _Block, datum: _Datum | None, state: int, damping: float) -> _Equations:
    """Factorise the equations of all parts and of what joins them."""
    rights, totals = list[Floats](), list[float]()

    def fronts() -> Iterator[Front]:
        """Fronts as they come; all else that comes with them is noted."""
        for handed in block.each(work.condense, block.at(state, damping)):
            rights.append(handed.right)
            totals.append(handed.chi_squared)
            yield handed.front

    try:
        joined = upper(block.dissection, fronts(), None if datum is None else datum.held)
    except UndeterminedError as reason:
        image = int(reason.args[0]) // OF_IMAGE
        at = f" (image {image + 1})" if image < len(block.dissection.node) else ""
        raise IllPosedError(
            f"the images between the parts, or what all share, are not determined{at}",
            "add control points, weighted positions or prior sigmas, or hold what cannot be determined",
        ) from None
    return _Equations(state, damping, joined, rights, sum(totals))


def _stepped(block: _Block, equations: _Equations, to: int) -> float:
    """Make the step of some equations; returns its squared length."""
    common = equations.upper.solve(equations.rights)
    tasks = [
        PartStep(at, to, part[:, 0])
        for at, part in zip(block.at(equations.state, equations.damping), common, strict=True)
    ]
    return sum(block.each(work.step, tasks))


def _minimised(
    block: _Block, datum: _Datum | None, report: Callable[[Iteration], None] | None, near: float
) -> tuple[_Equations, int, list[Iteration]]:
    """Iterate; returns the last equations, the number of the state at the minimum, and the steps."""
    damping, decrement, worked, number, steps = 0.0, np.inf, FIRST_DAMPING, 0, list[Iteration]()
    # See `solver`: between steps so short the rate is known, and after one so short equations are the same.
    short, negligible = 1e4, 1e-12
    equations = _factorised(block, datum, 0, 0.0)

    def told(chi_squared: float, length: float) -> None:
        """Record a step."""
        steps.append(Iteration(len(steps) + 1, chi_squared, length, damping))
        if report:
            report(steps[-1])

    while len(steps) < ITERATIONS:
        number += 1
        length = _stepped(block, equations, number)
        shrinking, whole = min(1.0, length / decrement) if steps else 1.0, damping == 0.0
        last = whole and length < short * near and length * shrinking < near
        if last and length < negligible and datum is None:
            told(equations.chi_squared - length, length)
            return equations, number, steps
        calmer = damping / 10 if damping > 1e-6 and length >= ROUNDING else 0.0
        trial = _factorised(block, datum, number, calmer)
        lower = trial.chi_squared < equations.chi_squared
        settling = whole and length < min(NEARLY**2, decrement)
        if lower or settling or (whole and length < ROUNDING):
            worked = damping or worked
            equations, decrement = trial, length
            told(trial.chi_squared, length)
            damping = calmer
            if last or (whole and not lower and not settling):
                return equations, number, steps
            continue
        damping = 10 * damping if damping else worked
        if damping > 1e8:
            break
        equations = _factorised(block, datum, equations.state, damping)
    raise NotConvergedError(
        f"not converged after {len(steps)} iterations (last step {np.sqrt(decrement):.2g} sigma)",
        "check start values, units and axes of images and points, and look for gross errors",
    )


def _datum(block: _Block, state: int) -> _Datum:
    """What no observation sees at a state."""
    about = block.middle(state)
    asked = [DatumQuestion(at, about, np.eye(7)) for at in block.at(state)]
    alone, form, unknown, moves = zip(*block.each(work.resist, asked), strict=True)
    combined = open_of(sum(alone), sum(form))
    number, once = np.unique(np.concatenate(unknown), return_index=True)
    return _Datum(about, combined, number, np.concatenate(moves)[once] @ combined)


def _released(block: _Block, state: int) -> int:
    """Move a free block by a similarity so that its datum points come closest to their start values."""
    combined = _datum(block, state).combined
    for _ in range(50):
        about = block.middle(state)
        asked = [DatumQuestion(at, about, combined) for at in block.at(state)]
        form, pull, most, width = zip(*block.each(work.away, asked), strict=True)
        change = np.linalg.lstsq(sum(form), sum(pull), rcond=None)[0]
        tasks = [Transform(at, state + 1, about, combined @ change) for at in block.at(state)]
        list(block.each(work.transform, tasks))
        state += 1
        if max(most) * np.abs(change).max() < 1e-12 * max(width):
            break
    return state


def _finished(block: _Block, equations: _Equations, last: int, datum: _Datum | None) -> Iterator[Sums]:
    """Give all parts their statistics."""
    at = block.at(equations.state, equations.damping)
    of_datum = list[tuple[DatumSpread, Floats, Floats] | None]([None] * len(at))
    if datum is not None:
        asked = [DatumQuestion(one, datum.about, datum.combined) for one in at]
        common = equations.upper.solve(list(block.each(work.datum_right, asked)))
        spreads = [DatumSpread(one, part) for one, part in zip(asked, common, strict=True)]
        constraint, cofactor = (sum(each) for each in zip(*block.each(work.spread, spreads), strict=True))
        inverse = np.linalg.inv(constraint)
        of_datum = [(spread, inverse, cofactor) for spread in spreads]

    tasks = (
        Finish(at[part], last, covariance, of_datum[part])
        for part, covariance in equations.upper.covariances()
    )
    return block.each(work.finish, tasks)


def solution_of_parts(folder: Path, adjusted: Adjusted, parts: int) -> Solution:
    """Put together what was found of all parts, for a block that this process can hold."""
    found = []
    for part in range(parts):
        with np.load(work.solution_file(folder, part)) as arrays:
            found.append(unpacked(Found, arrays))
    images = 1 + max(int(one.images.max()) for one in found)
    points, rays = (
        1 + max(int(getattr(one, name).max(initial=-1)) for one in found) for name in ("points", "rays")
    )
    deviations = max(one.solution.state.deviations.shape[1] for one in found)
    exposures, covariance = np.zeros((images, 6)), np.zeros((images, 6, 6))
    places, place_covariance = np.zeros((points, 3)), np.zeros((points, 3, 3))
    residuals, redundancy = np.zeros((2, rays, 2))
    rotation, own = np.zeros((images, 3, 3)), np.zeros((images, deviations))
    variant = list[tuple[Any, ...]]()
    for one in found:
        solution, home = one.solution, one.home
        at = one.images[home]
        exposures[at], covariance[at] = solution.exposures[home], solution.exposure_covariance[home]
        rotation[at] = solution.state.rotation[home]
        own[at, : solution.state.deviations.shape[1]] = solution.state.deviations[home]
        places[one.points], place_covariance[one.points] = solution.points, solution.point_covariance
        residuals[one.rays], redundancy[one.rays] = solution.residuals, solution.redundancy
        varied = solution.photo_variant
        rows = home[varied.image]
        variant.append(
            (
                one.images[varied.image[rows]],
                varied.parameter[rows],
                varied.values[rows],
                varied.sigma[rows],
                varied.deviations[rows],
                varied.deviation_sigma[rows],
            )
        )
    columns = [np.concatenate(column) for column in zip(*variant, strict=True)]
    order = np.argsort(columns[0], kind="stable")
    state = State(adjusted.cameras, rotation, exposures[:, 3:].copy(), places, adjusted.common, own)
    return Solution(
        adjusted.iterations,
        adjusted.chi_squared,
        adjusted.observations,
        adjusted.unknowns,
        adjusted.datum_defect,
        adjusted.groups,
        adjusted.cameras,
        adjusted.camera_covariance,
        exposures,
        covariance,
        places,
        place_covariance,
        residuals,
        redundancy,
        adjusted.common_covariance,
        PhotoVariant(*(column[order] for column in columns)),
        state,
    )
