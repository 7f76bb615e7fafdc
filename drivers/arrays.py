"""Kinds of arrays, for annotations, and arrays and dataclasses as JSON values."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import fields, is_dataclass, replace
from typing import Any, Self

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
            for name, value in vars(self).items()
            if hasattr(value, "__getitem__") and not isinstance(value, str | tuple)
        }
        return replace(self, **kept)  # type: ignore[type-var]


def as_plain(value: Any) -> Any:
    """Turn dataclasses into mappings and arrays into lists; what is no finite number becomes null."""
    if isinstance(value, np.ndarray | np.generic):
        return as_plain(value.tolist())
    if is_dataclass(value):
        return {field.name: as_plain(getattr(value, field.name)) for field in fields(value)}
    if isinstance(value, Mapping):
        return {key: as_plain(each) for key, each in value.items()}
    if isinstance(value, list | tuple):
        return [as_plain(each) for each in value]
    return None if isinstance(value, float) and not math.isfinite(value) else value
