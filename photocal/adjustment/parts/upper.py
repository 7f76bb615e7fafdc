"""What joins the parts: separators eliminated from below to above, solved for and inverted from above."""

from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass
from functools import partial

import numpy as np

from photocal.adjustment.parts.dissection import Dissection
from photocal.adjustment.parts.fronts import Front, Level, eliminated, joined
from photocal.adjustment.parts.part import OF_IMAGE
from photocal.adjustment.solver import SINGULAR_PIVOT
from photocal.base.arrays import Flags, Floats, Integers

# From numbers of the last separator's unknowns and their diagonal: what is added to it, to hold the datum.
Held = Callable[[Integers, Floats], Floats]


class UndeterminedError(Exception):
    """The equations of all separators are singular at an unknown, by its number."""


@dataclass(frozen=True)
class Upper:
    """The factorised equations of all separators and of what all parts share.

    levels: of each set of the dissection that has others below, and of the last one.
    common: numbers of the unknowns that each part hands on.
    """

    dissection: Dissection
    levels: dict[int, Level]
    common: list[Integers]

    def solve(self, rights: list[Floats]) -> list[Floats]:
        """Unknowns of each part's border, (m, t), from what its right-hand sides hand on."""
        parts, parent = self.dissection.parts, self.dissection.parent
        waiting = dict[int, list[tuple[Integers, Floats]]]()
        forwards = dict[int, Floats]()
        for common, node, right in zip(self.common, parts, rights, strict=True):
            waiting.setdefault(self._above(int(node)), []).append((common, right))
        for node in sorted(self.levels):
            level = self.levels[node]
            unknown = np.sort(np.concatenate([level.own, level.above]))
            total = np.zeros((len(unknown), rights[0].shape[1]))
            for numbers, right in waiting.pop(node):
                total[np.searchsorted(unknown, numbers)] += right
            forwards[node], rest = level.reduced(unknown, total)
            if parent[node] >= 0:
                waiting.setdefault(int(parent[node]), []).append((level.above, rest))
        solved = dict[int, tuple[Integers, Floats]]()
        for node in sorted(self.levels, reverse=True):
            level, above = self.levels[node], np.zeros((0, rights[0].shape[1]))
            if parent[node] >= 0:
                numbers, values = solved[int(parent[node])]
                above = values[np.searchsorted(numbers, level.above)]
            unknown = np.concatenate([level.own, level.above])
            order = np.argsort(unknown)
            values = np.concatenate([level.back(forwards[node], above), above])
            solved[node] = unknown[order], values[order]
        result = []
        for common, node in zip(self.common, parts, strict=True):
            numbers, values = solved[self._above(int(node))]
            result.append(values[np.searchsorted(numbers, common)])
        return result

    def _above(self, node: int) -> int:
        """The level that a part hands on to; its own, where it is the only part."""
        parent = int(self.dissection.parent[node])
        return parent if parent >= 0 else node

    def covariances(self) -> Iterator[tuple[int, Floats]]:
        """Covariance (m, m) of each part's border, by the place of the part; few are held at a time."""
        parts = {int(node): place for place, node in enumerate(self.dissection.parts)}

        def down(node: int, above: Floats) -> Iterator[tuple[int, Floats]]:
            """Covariances at and below a set."""
            numbers, whole = self.levels[node].covariance(above)
            order = np.argsort(numbers)
            below = self.dissection.children(node) or [node]
            for child in below:
                of_part = child in parts
                wanted = self.common[parts[child]] if of_part else self.levels[child].above
                at = order[np.searchsorted(numbers, wanted, sorter=order)]
                part = whole[np.ix_(at, at)]
                if of_part:
                    yield parts[child], part
                else:
                    yield from down(child, part)

        yield from down(len(self.dissection.parent) - 1, np.zeros((0, 0)))


def _of_set(dissection: Dissection, node: int, unknown: Integers) -> Flags:
    """Unknowns, by number, of the images of a set; of the last one all that are left."""
    if node == len(dissection.parent) - 1:
        return np.ones(len(unknown), dtype=np.bool_)
    # Numbers of what images share come after those of all images.
    nodes = np.append(dissection.node, -1)
    return np.asarray(nodes[np.minimum(unknown // OF_IMAGE, len(dissection.node))] == node)


def upper(dissection: Dissection, fronts: Iterable[Front], held: Held | None = None) -> Upper:
    """Join the fronts of all parts, in their order, and eliminate all separators.

    held: where nothing else holds the datum of the last separator.
    raises UndeterminedError: with the number of an unknown that is not determined.
    """
    parent, last = dissection.parent, len(dissection.parent) - 1
    missing = np.bincount(parent[parent >= 0], minlength=last + 1)
    waiting, levels, common = dict[int, list[Front]](), dict[int, Level](), list[Integers]()
    for node, front in zip(dissection.parts, fronts, strict=True):
        common.append(front.unknown)
        at = int(parent[node]) if parent[node] >= 0 else int(node)
        while True:
            waiting.setdefault(at, []).append(front)
            if len(waiting[at]) < max(missing[at], 1):
                break
            whole = joined(waiting.pop(at), partial(_of_set, dissection, at))
            if at == last and held is not None:
                columns = np.arange(len(whole.own))
                whole.root[columns, columns] += held(whole.own, whole.own_diagonal)
            levels[at], front = eliminated(whole)
            if levels[at].weakest < SINGULAR_PIVOT:
                raise UndeterminedError(levels[at].worst)
            if at == last:
                break
            at = int(parent[at])
    return Upper(dissection, levels, common)
