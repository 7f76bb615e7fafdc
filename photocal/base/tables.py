"""Objects of columns as Arrow tables and Parquet files; what is written and read again is equal to the bit.

Each array of n rows becomes n cells, of matrices one column for each element; members of members have the
names of both. What is no column (a text, a number, the shapes) stands in the metadata of the table.
"""

import json
import sys
from collections.abc import Iterator, Mapping
from dataclasses import fields, is_dataclass
from importlib import import_module
from importlib.abc import MetaPathFinder
from pathlib import Path
from types import NoneType, UnionType
from typing import Any, Self, TypeVar, Union, get_args, get_origin

import numpy as np

from photocal.base.codec import from_plain, hints_of
from photocal.base.errors import InputMalformedError, InputNotFoundError, ProgramMissingError
from photocal.base.files import output_file

_KEY = b"photocal"
_AGAIN = "make it again with this version of photocal"
Kind = TypeVar("Kind")


class TableColumns:
    """Columns that are written as a Parquet file and shown as a table."""

    @classmethod
    def read(cls, path: str | Path) -> Self:
        """Read what `write` wrote.

        Parameters
        ----------
        path
            Parquet file.

        Returns
        -------
        same type
            As it was when it was written.

        Raises
        ------
        InputNotFoundError
            When there is no such file.
        InputMalformedError
            When it is damaged, or holds something else.
        """
        return object_of_file(cls, Path(path))

    def write(self, path: str | Path) -> None:
        """Write a Parquet file, whole or not at all.

        Parameters
        ----------
        path
            File that takes the place of an older one.

        Raises
        ------
        OutputError
            When it cannot be written.
        """
        parquet = package("pyarrow.parquet")
        with output_file(Path(path)) as aside:
            parquet.write_table(self.to_arrow(), aside)

    def to_arrow(self) -> Any:
        """Give a `pyarrow.Table` with all columns.

        Raises
        ------
        ProgramMissingError
            When pyarrow is not installed.
        """
        return arrow_table(self)

    def to_pandas(self) -> Any:
        """Give a `pandas.DataFrame` with all columns.

        Raises
        ------
        ProgramMissingError
            When pandas is not installed.
        """
        package("pandas")
        return self.to_arrow().to_pandas()


def package(name: str) -> Any:
    """Load a package that only some need; ProgramMissingError says how to install it."""
    try:
        return import_module(name)
    except ModuleNotFoundError as missing:
        name = name.partition(".")[0]
        raise ProgramMissingError(f"{name} is not installed", f"run: pip install {name}") from missing


class _Absent(MetaPathFinder):
    """Finds no pandas, as where it is not installed."""

    def find_spec(self, fullname: str, *_: Any) -> None:
        """Refuse pandas; others look for all else."""
        if fullname == "pandas":
            raise ModuleNotFoundError(fullname, name=fullname)


def leave_pandas() -> None:
    """Keep Arrow from loading pandas, which it looks for with its first value: a command shows no frames.

    Who asks Arrow for a frame gets it nevertheless.
    """
    if "pandas" in sys.modules:
        return
    absent = _Absent()
    sys.meta_path.insert(0, absent)
    try:
        package("pyarrow").scalar("")
    finally:
        sys.meta_path.remove(absent)


def arrow_table(shown: Any) -> Any:
    """Give a dataclass of columns as an Arrow table."""
    pa = package("pyarrow")
    columns: dict[str, Any] = {}
    shapes: dict[str, list[int]] = {}
    single: dict[str, Any] = {}
    for name, value in _members(shown):
        if isinstance(value, np.ndarray):
            shapes[name] = list(value.shape[1:])
            flat = value.reshape(len(value), int(np.prod(value.shape[1:])))
            names = _element_names(name, value.shape[1:])
            kind = pa.string() if value.dtype.kind == "U" else None
            columns |= {column: pa.array(flat[:, k], kind) for k, column in enumerate(names)}
        elif isinstance(value, _Names):
            columns[name] = pa.array(map(list, value), pa.list_(pa.string()))
        else:
            single[name] = value
    content = {"schema": _schema(type(shown)), "shapes": shapes, "single": single}
    return pa.table(columns).replace_schema_metadata({_KEY: json.dumps(content)})


class _Names(list[tuple[str, ...]]):
    """A column of several names in each row."""


def _members(value: Any, prefix: str = "") -> Iterator[tuple[str, Any]]:
    kind: Any = type(value)
    hints = hints_of(kind)
    for field in fields(value):
        name, member = f"{prefix}{field.name}", getattr(value, field.name)
        if is_dataclass(member):
            yield from _members(member, f"{name}.")
        elif _is_names(hints[field.name]):
            yield name, _Names(map(tuple, member))
        elif member is not None:
            yield name, member


def _element_names(name: str, shape: tuple[int, ...]) -> list[str]:
    """Names of the elements of each row, counted from 1: `covariance_12` is the second of the first row."""
    if not shape:
        return [name]
    return [f"{name}_{''.join(str(k + 1) for k in place)}" for place in np.ndindex(shape)]


def object_of_file(kind: type[Kind], path: Path) -> Kind:
    """Read an object of a Parquet file; errors as of `TableColumns.read`."""
    if not path.is_file():
        raise InputNotFoundError("does not exist", _AGAIN, where=path)
    pa, parquet = package("pyarrow"), package("pyarrow.parquet")
    try:
        table = parquet.read_table(path)
        content = json.loads((table.schema.metadata or {})[_KEY])
        if content["schema"] != _schema(kind):
            what = f"holds {content['schema']!r}, {_schema(kind)!r} was expected"
            raise InputMalformedError(what, _AGAIN, where=path)
        made: Kind = _made(kind, table, content, "")
    except (pa.ArrowException, OSError, ValueError, LookupError, TypeError) as damage:
        reason = (str(damage).splitlines() or [type(damage).__name__])[0]
        raise InputMalformedError(f"is not a table of photocal ({reason})", _AGAIN, where=path) from damage
    return made


def _made(kind: Any, table: Any, content: Mapping[str, Any], prefix: str) -> Any:
    hints, members = hints_of(kind), dict[str, Any]()
    for field in fields(kind):
        name, wanted = f"{prefix}{field.name}", hints[field.name]
        part, optional = _without_none(wanted)
        if isinstance(part, type) and is_dataclass(part):
            known = any(key.startswith(f"{name}.") for key in (*content["shapes"], *content["single"]))
            members[field.name] = _made(part, table, content, f"{name}.") if known or not optional else None
        elif name in content["shapes"]:
            members[field.name] = _array(table, name, tuple(content["shapes"][name]))
        elif _is_names(wanted):
            members[field.name] = [tuple(names) for names in table[name].to_pylist()]
        elif name in content["single"]:
            members[field.name] = from_plain(part, content["single"][name], name)
        elif optional:
            members[field.name] = None
        else:
            raise KeyError(name)
    return kind(**members)


def _array(table: Any, name: str, shape: tuple[int, ...]) -> Any:
    columns = [table[column] for column in _element_names(name, shape)]
    arrays = [
        np.array(column.to_pylist(), str) if str(column.type) == "string" else column.to_numpy()
        for column in columns
    ]
    whole = np.stack(arrays, axis=1) if arrays else np.empty((table.num_rows, 0))
    return whole.reshape(table.num_rows, *shape)


def _schema(kind: type[Any]) -> str:
    return f"photocal.{kind.__name__}/1"


def _is_names(wanted: Any) -> bool:
    """Whether a column holds several names in each row."""
    return get_origin(wanted) is not None and get_args(wanted) == (tuple[str, ...],)


def _without_none(wanted: Any) -> tuple[Any, bool]:
    parts = get_args(wanted) if get_origin(wanted) in (UnionType, Union) else (wanted,)
    kept = [part for part in parts if part is not NoneType]
    return kept[0], NoneType in parts
