"""Kinds of arrays, for annotations, and arrays and dataclasses as JSON values."""

import math
from collections.abc import Callable, Mapping
from dataclasses import fields, is_dataclass, replace
from operator import attrgetter
from typing import Any, Self

import numpy as np
from numpy.typing import ArrayLike, NDArray

Floats = NDArray[np.float64]
Integers = NDArray[np.int64]
Flags = NDArray[np.bool_]
Bytes = NDArray[np.uint8]


class Columns:
    """What dataclasses of columns of one length have in common."""

    def rows(self, chosen: Any) -> Self:
        """Return some of the rows; what is no column stays."""
        kept: dict[str, Any] = {
            name: value.rows(chosen) if hasattr(value, "rows") else value[chosen]
            for name, value in ((f.name, getattr(self, f.name)) for f in fields(self))  # type: ignore[arg-type]
            if hasattr(value, "__getitem__") and not isinstance(value, str | tuple)
        }
        return replace(self, **kept)  # type: ignore[type-var]


def nearest(places: ArrayLike, wanted: ArrayLike) -> Integers:
    """Give the row of the nearest of some places, in growing order and at least one, for each wanted one."""
    at, to = np.asarray(places), np.asarray(wanted)
    after = np.minimum(np.searchsorted(at, to), len(at) - 1)
    before = np.maximum(after - 1, 0)
    return np.where(np.abs(to - at[before]) <= np.abs(at[after] - to), before, after)


def spread(places: Floats, count: int, first: list[int]) -> list[int]:
    """Choose rows of places (n, 2) far from each other: after the first ones always the farthest.

    first: empty: the place farthest from the middle. Source: Gonzalez (1985).
    """
    if not count:
        return []
    chosen = first or [int(np.argmax(np.hypot(*(places - places.mean(axis=0)).T)))]
    while len(chosen) < count:
        apart = np.hypot(*np.moveaxis(places[:, None] - places[chosen], 2, 0)).min(axis=1)
        chosen = [*chosen, int(np.argmax(apart))]
    return chosen[:count]


def as_plain(value: Any, beside: Callable[[Any], dict[str, Any]] = lambda _: {}) -> Any:
    """Turn dataclasses into mappings and arrays into lists; what is no finite number becomes null.

    beside: what else stands in the mapping of a dataclass.
    """
    if isinstance(value, np.ndarray | np.generic):
        return as_plain(value.tolist())
    if is_dataclass(value):
        members = {field.name: as_plain(getattr(value, field.name), beside) for field in fields(value)}
        return {**members, **beside(value)}
    if isinstance(value, Mapping):
        return {key: as_plain(each, beside) for key, each in value.items()}
    if isinstance(value, list | tuple):
        return [as_plain(each, beside) for each in value]
    return None if isinstance(value, float) and not math.isfinite(value) else value


def picked(value: Any, *names: str, **renamed: str) -> dict[str, Any]:
    """Give some attributes of an object as plain values, others by another name; their paths have dots."""
    wanted = {**{name: name for name in names}, **renamed}
    return {key: as_plain(attrgetter(path)(value)) for key, path in wanted.items()}
