"""Kinds of arrays, for annotations, and arrays and dataclasses as JSON values."""

import math
from collections.abc import Callable, Mapping
from dataclasses import fields, is_dataclass, replace
from operator import attrgetter
from types import NoneType, UnionType
from typing import Any, Literal, Self, get_args, get_origin, get_type_hints

import numpy as np
from numpy.typing import NDArray

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


def spread(places: Floats, count: int, first: list[int]) -> list[int]:
    """Choose rows of places (n, 2) far from each other: after the first ones always the farthest.

    first: empty: the place farthest from the middle. Source: Gonzalez (1985).
    """
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


def from_plain(kind: Any, value: Any, place: str = "") -> Any:
    """Read back what `as_plain` gave, as its annotation says; null is NaN where a number must stand.

    raises ValueError: names the place of what does not fit.
    """
    origin, parts = get_origin(kind), get_args(kind)
    if origin is UnionType:
        rest = next(part for part in parts if part is not NoneType)
        return None if value is None else from_plain(rest, value, place)
    try:
        if origin is np.ndarray:
            return np.array(value, dtype=get_args(parts[1])[0])
        if isinstance(kind, type) and is_dataclass(kind):
            hints = get_type_hints(kind)
            known = [field.name for field in fields(kind) if field.name in value]
            make: Callable[..., Any] = kind
            return make(**{n: from_plain(hints[n], value[n], f"{place}.{n}") for n in known})
        if origin is tuple:
            each = [parts[0]] * len(value) if parts[-1] is ... else parts
            rows = zip(each, value, strict=True)
            return tuple(from_plain(member, row, f"{place}[{k}]") for k, (member, row) in enumerate(rows))
        if origin in (dict, Mapping):
            return {key: from_plain(parts[1], each, f"{place}.{key}") for key, each in value.items()}
    except (TypeError, AttributeError) as failure:
        raise ValueError(f"{place.lstrip('.')}: {failure}") from None
    if kind is float and (value is None or type(value) is int):
        return math.nan if value is None else float(value)
    if kind is Any or (value in parts if origin is Literal else type(value) is kind):
        return value
    raise ValueError(f"{place.lstrip('.')}: {str(value)[:40]!r} stands where a {kind} is expected")
