"""One way from objects to text and back: TOML and JSON values, degrees, and whether two objects are equal.

People's files (TOML) are pydantic tables (`photocal.base.checked_toml`): what reads them also writes them,
with tomlkit, which keeps the comments of a file that is written again. Our own JSON is read back by the
annotations of the dataclasses: they hold numpy arrays, and null stands for NaN where a number is expected,
which pydantic, msgspec and cattrs would each have to be taught for every class.
"""

import json
import math
from collections.abc import Callable, Mapping
from dataclasses import MISSING, fields, is_dataclass
from functools import cache
from pathlib import Path
from types import NoneType, UnionType
from typing import Annotated, Any, Literal, TypeVar, Union, get_args, get_origin, get_type_hints

import numpy as np
import tomlkit
from numpy.typing import ArrayLike, NDArray
from pydantic import BaseModel, TypeAdapter, ValidationError
from tomlkit.exceptions import TOMLKitError

from photocal.base.arrays import Floats
from photocal.base.checked_toml import read_checked_json
from photocal.base.errors import InputMalformedError, InputNotFoundError

Kind = TypeVar("Kind")
# Files of ours are no larger.
LARGEST_JSON = 1 << 28
# Where an array of a packed object stood, and the name of what is none.
_ARRAY, _ALL_ELSE = "<array>", "all else"
_JSON_KINDS = (float, int, str, bool, list, dict, NoneType)


def toml_document(path: Path) -> tomlkit.TOMLDocument:
    """Read TOML that is to be changed where it stands: comments and order stay.

    raises InputNotFoundError, InputMalformedError: when it cannot be read, or is no TOML.
    """
    try:
        return tomlkit.parse(path.read_text(encoding="utf-8-sig"))
    except OSError as refusal:
        raise InputNotFoundError("cannot be read", "check the folder first", where=path) from refusal
    except (TOMLKitError, UnicodeDecodeError) as refusal:
        raise InputMalformedError(f"is not TOML ({refusal})", "correct it", where=path) from refusal


def toml_text(content: BaseModel | Mapping[str, Any], comment: str = "") -> str:
    """Write tables as TOML: sections as tables, lists of sections as `[[..]]`, what is deeper in one line.

    content: a checked table, without what has its default value, or plain mappings; None is left out.
    """
    document = tomlkit.document()
    if comment:
        document.add(tomlkit.comment(comment))
    for name, value in _plain(content).items():
        document.add(name, _section(value))
    return tomlkit.dumps(document)


def _plain(content: BaseModel | Mapping[str, Any]) -> Mapping[str, Any]:
    dumped = content.model_dump(exclude_defaults=True) if isinstance(content, BaseModel) else content
    return {name: value for name, value in dumped.items() if value is not None}


def _section(value: Any) -> Any:
    if isinstance(value, Mapping):
        table = tomlkit.table()
        for name, entry in _plain(value).items():
            table.add(name, _line(entry))
        return table
    if isinstance(value, list | tuple) and value and all(isinstance(each, Mapping) for each in value):
        sections = tomlkit.aot()
        for each in value:
            sections.append(_section(each))
        return sections
    return _line(value)


def _line(value: Any) -> Any:
    """A value within one line."""
    if isinstance(value, Mapping):
        inline = tomlkit.inline_table()
        for name, entry in _plain(value).items():
            inline.add(name, _line(entry))
        return inline
    if isinstance(value, list | tuple):
        array = tomlkit.array()
        for each in value:
            array.append(_line(each))
        return array
    return tomlkit.item(value.item() if isinstance(value, np.generic) else value)


def kept_json(path: Path) -> dict[str, Any]:
    """What an earlier run or window kept as JSON; nothing where it is not there or damaged."""
    try:
        content = json.loads(path.read_bytes())
    except (OSError, ValueError, RecursionError):
        return {}
    return content if isinstance(content, dict) else {}


def parsed_json(path: Path, remedy: str) -> Any:
    """Read a file of JSON: what it holds, for `from_plain`.

    raises InputNotFoundError: when there is no such file, or it is empty.
    raises InputMalformedError: when it is not complete JSON, or a number is none.
    """
    if not path.is_file():
        raise InputNotFoundError("does not exist", remedy, where=path)
    if path.stat().st_size > LARGEST_JSON:
        raise InputMalformedError("is not a JSON file of photocal: it is too large", remedy, where=path)
    try:
        text = path.read_text(encoding="utf-8")
        if not text.strip():
            raise InputNotFoundError("the file is empty", remedy, where=path)
        return read_checked_json(text)
    except UnicodeDecodeError as broken:
        raise InputMalformedError("is not UTF-8 text", remedy, where=f"{path}, byte {broken.start}") from None
    except json.JSONDecodeError as broken:
        raise InputMalformedError(
            f"is not complete JSON ({broken.msg})", remedy, where=f"{path}, line {broken.lineno}"
        ) from None
    except (ValueError, RecursionError) as broken:
        raise InputMalformedError(str(broken), remedy, where=path) from None


def object_of(
    kind: type[Kind], content: Any, where: object, remedy: str, within: str = "", null: float | None = None
) -> Kind:
    """Make an object of JSON; parameters as of `from_plain`.

    raises InputMalformedError: names the key of what does not fit.
    """
    try:
        made: Kind = from_plain(kind, content, within, null)
    except ValueError as failure:
        raise InputMalformedError(str(failure), remedy, where=where) from None
    return made


def packed(value: Any) -> dict[str, NDArray[Any]]:
    """Take an object apart for `numpy.savez`: its arrays as they are, all else as JSON; see `unpacked`."""
    arrays: dict[str, NDArray[Any]] = {}
    text = json.dumps(_apart(value, arrays))
    return {_ALL_ELSE: np.frombuffer(text.encode(), dtype=np.uint8), **arrays}


# A function within another that calls itself would hold the arrays until the next search for garbage.
def _apart(part: Any, arrays: dict[str, NDArray[Any]]) -> Any:
    """A part as JSON has it; its arrays are added by number."""
    if isinstance(part, np.ndarray):
        # As they are read again: sums over rows depend on how they lie.
        arrays[str(len(arrays))] = np.asarray(part, order="C")
        return {_ARRAY: str(len(arrays) - 1), "kind": part.dtype.str, "shape": part.shape}
    if is_dataclass(part):
        return {field.name: _apart(getattr(part, field.name), arrays) for field in fields(part)}
    if isinstance(part, Mapping):
        return {key: _apart(each, arrays) for key, each in part.items()}
    if isinstance(part, list | tuple):
        return [_apart(each, arrays) for each in part]
    return part.item() if isinstance(part, np.generic) else part


def unpacked(kind: Any, arrays: Mapping[str, NDArray[Any]]) -> Any:
    """Make the object of a kind again that `packed` took apart."""
    return from_plain(kind, _whole(json.loads(arrays[_ALL_ELSE].tobytes()), arrays))


def _whole(part: Any, arrays: Mapping[str, NDArray[Any]]) -> Any:
    """A part of the JSON with its arrays."""
    if isinstance(part, dict):
        if _ARRAY in part:
            return arrays[part[_ARRAY]]
        return {key: _whole(each, arrays) for key, each in part.items()}
    # Figures of findings name several things by tuples.
    return tuple(_whole(each, arrays) for each in part) if isinstance(part, list) else part


def from_plain(kind: Any, value: Any, place: str = "", null: float | None = math.nan) -> Any:
    """Read back what `photocal.base.arrays.as_plain` gave, as its annotation says; unknown keys are left out.

    null: what null stands for where a number is expected; None: it may not stand there.

    raises ValueError: names the place of what does not fit.
    """
    origin, parts = get_origin(kind), get_args(kind)
    if hasattr(origin, "__value__"):
        # An alias with parameters, as NDArray is from numpy 2.5 on: read what it stands for.
        return from_plain(origin.__value__[parts], value, place, null)
    try:
        if origin is Literal and value in parts:
            return value
        if origin is Annotated:
            return _checked(kind, from_plain(parts[0], value, place, null), place)
        if origin in (UnionType, Union):
            return _one_of(parts, value, place, null)
        if origin is np.ndarray:
            return np.array(value, dtype=get_args(parts[1])[0])
        if isinstance(kind, type) and is_dataclass(kind):
            return _dataclass(kind, value, place, null)
        if origin is tuple:
            each = [parts[0]] * len(value) if parts[-1] is ... else parts
            rows = enumerate(zip(each, value, strict=True))
            return tuple(from_plain(member, row, f"{place}[{k}]", null) for k, (member, row) in rows)
        if origin in (dict, Mapping):
            return {key: from_plain(parts[1], each, f"{place}.{key}", null) for key, each in value.items()}
    except (TypeError, AttributeError) as failure:
        raise ValueError(f"{place.lstrip('.')}: {failure}") from None
    return _scalar(kind, value, place, null)


def _scalar(kind: Any, value: Any, place: str, null: float | None) -> Any:
    if kind is float and (value is None or type(value) is int):
        value = null if value is None else float(value)
    if kind is Any or type(value) is kind:
        return value
    if isinstance(kind, type) and kind not in _JSON_KINDS:
        return _checked(kind, value, place)
    raise ValueError(f"{place.lstrip('.')}: {str(value)[:40]!r} found where {_expected(kind)} is expected")


def _checked(kind: Any, value: Any, place: str) -> Any:
    """What pydantic makes of a value: within its limits, or of a kind that JSON has as text."""
    try:
        return _adapter(kind).validate_json(json.dumps(value), strict=True)
    except ValidationError as failure:
        raise ValueError(f"{place.lstrip('.')}: {failure.errors()[0]['msg']}") from None


@cache
def _adapter(kind: Any) -> TypeAdapter[Any]:
    return TypeAdapter(kind)


def _expected(kind: Any) -> str:
    names = {float: "a number", int: "a whole number", str: "a text", bool: "true or false"}
    return names.get(kind) or (" or ".join(map(repr, get_args(kind))) if get_args(kind) else str(kind))


def _one_of(parts: tuple[Any, ...], value: Any, place: str, null: float | None) -> Any:
    if value is None and NoneType in parts:
        return None
    refusals = []
    for part in parts:
        if part is not NoneType:
            try:
                return from_plain(part, value, place, null)
            except ValueError as refusal:
                refusals.append(refusal)
    raise refusals[0]


def _dataclass(kind: Any, value: Any, place: str, null: float | None) -> Any:
    hints, members = hints_of(kind), [field for field in fields(kind) if field.init]
    for field in members:
        if field.name not in value and field.default is field.default_factory is MISSING:
            raise ValueError(f"{place}.{field.name} is missing".lstrip("."))
    make: Callable[..., Any] = kind
    known = [field.name for field in members if field.name in value]
    return make(**{n: from_plain(hints[n], value[n], f"{place}.{n}", null) for n in known})


@cache
def hints_of(kind: Any) -> dict[str, Any]:
    """Annotations of the members of a class."""
    return get_type_hints(kind, include_extras=True)


def as_degrees(radians: ArrayLike) -> Floats:
    """Degrees that `numpy.radians` turns back into the very same numbers, the shortest of them.

    A number of radians that is not that of any degrees gets the nearest: it differs in the last place then.
    """
    given = np.asarray(radians, dtype=float)
    rough = np.degrees(given)
    tried, low, high = [rough], rough, rough
    # Degrees that belong to a number of radians are no farther from the quotient, units in the last place.
    near = 4
    for _ in range(near):
        low, high = np.nextafter(low, -np.inf), np.nextafter(high, np.inf)
        tried += [low, high]
    tried += [np.round(rough, digits) for digits in (12, 9, 6)]
    found = rough
    for each in tried:
        found = np.where(np.radians(each) == given, each, found)
    return np.asarray(found)


def same(one: Any, other: Any, but: tuple[str, ...] = ()) -> bool:
    """Whether two objects are equal to the last bit, arrays within them too; NaN is equal to NaN.

    but: members that do not count, wherever they stand.
    """
    if is_dataclass(one) and not isinstance(one, type):
        names = [field.name for field in fields(one) if field.name not in but]
        return type(one) is type(other) and all(
            same(getattr(one, name), getattr(other, name), but) for name in names
        )
    if isinstance(one, np.ndarray) and isinstance(other, np.ndarray):
        return one.shape == other.shape and bool(
            np.array_equal(one, other, equal_nan=one.dtype.kind == other.dtype.kind == "f")
        )
    if isinstance(one, Mapping) and isinstance(other, Mapping):
        return one.keys() == other.keys() and all(same(one[key], other[key], but) for key in one)
    if isinstance(one, list | tuple) and isinstance(other, list | tuple):
        return len(one) == len(other) and all(map(lambda a, b: same(a, b, but), one, other))
    return bool(one == other or (one != one and other != other))
