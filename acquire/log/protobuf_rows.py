"""Protobuf messages of fixed size as rows of a structured array: thousands are encoded at once.

Every field of a message is always written and has a fixed width, so the tags and lengths between the values
are constants. Variable-length integers are padded to five bytes, which the encoding allows (protobuf.dev,
"Encoding", varints need not be minimal); every reader takes them.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from drivers.arrays import Bytes

_VARINT_BYTES = 5
_LENGTH_DELIMITED, _FIXED64, _VARINT = 2, 1, 0


@dataclass(frozen=True)
class Field:
    """A field of a message: its number and what it holds.

    number: the number in the definition.
    value: the name of a column of doubles (``"latitude"``) or, after ``"#"``, of non-negative integers below
        2^35 (``"#seconds"``); constant bytes; the fields of a message within; or how many columns of doubles
        a packed list holds, then `name` is that of the column.
    name: column of a packed list.
    """

    number: int
    value: str | bytes | int | list[Field]
    name: str = ""


class RowEncoder:
    """Encodes columns of numbers as messages of one type."""

    def __init__(self, fields: list[Field]) -> None:
        members: list[tuple[Any, ...]] = []
        constants: dict[str, bytes] = {}
        _lay_out(fields, members, constants)
        self._row = np.dtype(members)
        self._template = np.zeros(1, self._row)
        for name, value in constants.items():
            self._template[name] = np.frombuffer(value, f"V{len(value)}")

    def encode(self, columns: Mapping[str, NDArray[Any]], count: int) -> list[bytes]:
        """Return `count` messages with the values of the columns."""
        rows = np.repeat(self._template, count)
        for name in self._row.names or ():
            if name in columns:
                rows[name] = _varint(columns[name]) if name.startswith("#") else columns[name]
        data, width = rows.tobytes(), self._row.itemsize
        return [data[at : at + width] for at in range(0, len(data), width)]


def _lay_out(fields: list[Field], members: list[tuple[Any, ...]], constants: dict[str, bytes]) -> None:
    def constant(value: bytes) -> None:
        name = f"={len(constants)}"
        constants[name] = value
        members.append((name, f"V{len(value)}"))

    for field in fields:
        value = field.value
        if isinstance(value, bytes):
            constant(length_delimited(field.number, value))
        elif isinstance(value, list):
            inner: list[tuple[Any, ...]] = []
            _lay_out(value, inner, {})
            size = np.dtype(inner).itemsize
            constant(_tag(field.number, _LENGTH_DELIMITED) + _minimal(size))
            _lay_out(value, members, constants)
        elif isinstance(value, int):
            constant(_tag(field.number, _LENGTH_DELIMITED) + _minimal(8 * value))
            members.append((field.name, "<f8", (value,)))
        elif value.startswith("#"):
            constant(_tag(field.number, _VARINT))
            members.append((value, "u1", (_VARINT_BYTES,)))
        else:
            constant(_tag(field.number, _FIXED64))
            members.append((value, "<f8"))


def length_delimited(number: int, value: bytes) -> bytes:
    """Return a field that holds bytes, a text or a message: its tag, its length, its value."""
    return _tag(number, _LENGTH_DELIMITED) + _minimal(len(value)) + value


def _tag(number: int, wire_type: int) -> bytes:
    return _minimal(number << 3 | wire_type)


def _minimal(value: int) -> bytes:
    out = bytearray()
    while value > 0x7F:
        out.append(value & 0x7F | 0x80)
        value >>= 7
    out.append(value)
    return bytes(out)


def _varint(values: NDArray[Any]) -> Bytes:
    shifts = 7 * np.arange(_VARINT_BYTES)
    groups = (np.asarray(values, np.int64)[:, None] >> shifts & 0x7F).astype(np.uint8)
    groups[:, :-1] |= 0x80
    return groups
