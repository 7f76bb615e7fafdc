"""Tables and settings as plain files: CSV and TOML."""

from __future__ import annotations

import json
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

# Format and values of each column, by its name.
Columns = dict[str, tuple[str, Iterable[Any]]]


def write_table(path: Path, columns: Columns) -> None:
    """Write a CSV file; `columns`: format of each value and the values; NaN becomes an empty cell."""
    cells = [
        [
            "" if isinstance(value, (float, np.floating)) and np.isnan(value) else format(value, form)
            for value in values
        ]
        for form, values in columns.values()
    ]
    lines = [",".join(columns), *(",".join(row) for row in zip(*cells, strict=True))]
    path.write_text("\n".join(lines) + "\n", encoding="utf-8")


def toml_text(sections: Sequence[tuple[str, Mapping[str, Any]]]) -> str:
    """Write TOML sections: each a header such as ``[flight]`` (empty for none) and its keys."""
    parts = []
    for header, keys in sections:
        lines = [header] if header else []
        lines += [f"{key} = {_value(value)}" for key, value in keys.items()]
        parts.append("\n".join(lines))
    return "\n\n".join(parts) + "\n"


def _value(value: Any) -> str:
    if isinstance(value, Mapping):
        return "{ " + ", ".join(f"{json.dumps(str(k))} = {_value(v)}" for k, v in value.items()) + " }"
    if isinstance(value, (list, tuple, np.ndarray)):
        return "[" + ", ".join(_value(each) for each in value) + "]"
    if isinstance(value, np.generic):
        value = value.item()
    if isinstance(value, float):
        return repr(value)
    return json.dumps(value, ensure_ascii=False)
