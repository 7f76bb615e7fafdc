"""Positions and attitudes in Foxglove's published schemas (protobuf)."""

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from acquire.log.records import Schema
from drivers.arrays import Bytes, Floats, Integers

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
    value: "str | bytes | int | list[Field]"
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


SECOND_NS = 1_000_000_000

# LocationFix.PositionCovarianceType
COVARIANCE_UNKNOWN, COVARIANCE_APPROXIMATED = 0, 1

_TIMESTAMP = [Field(1, "#seconds"), Field(2, "#nanoseconds")]


@cache
def schema(name: str) -> Schema:
    """Return the published schema of a message type, for example ``foxglove.LocationFix``."""
    from importlib import import_module

    short = name.split(".")[-1]
    files: list[bytes] = []
    seen: set[str] = set()

    def add(file: Any) -> None:
        if file.name not in seen:
            seen.add(file.name)
            for dependency in file.dependencies:
                add(dependency)
            files.append(file.serialized_pb)

    add(import_module(f"foxglove_schemas_protobuf.{short}_pb2").DESCRIPTOR)
    # A FileDescriptorSet has one field, repeated: the files as they are, each behind those that it needs.
    return Schema(name, "protobuf", b"".join(length_delimited(1, file) for file in files))


@cache
def _location_encoder(frame: str) -> RowEncoder:
    return RowEncoder(
        [
            Field(6, _TIMESTAMP),
            Field(7, frame.encode()),
            Field(1, "latitude"),
            Field(2, "longitude"),
            Field(3, "altitude"),
            Field(4, 9, "covariance"),
            Field(5, "#covariance_type"),
        ]
    )


def location_fixes(
    frame: str,
    time_ns: Integers,
    latitude_deg: Floats,
    longitude_deg: Floats,
    height_m: Floats,
    horizontal_m: Floats,
    vertical_m: Floats,
) -> list[bytes]:
    """Return `foxglove.LocationFix` messages.

    time_ns (n,): time of validity, UTC, nanoseconds since 1970.
    horizontal_m, vertical_m (n,): accuracy that the device claims: radius in the plane, standard deviation of
        the height. NaN: unknown. The variance of each horizontal component is taken as half of the radius
        squared.
    """
    count = len(time_ns)
    known = np.isfinite(horizontal_m) & np.isfinite(vertical_m)
    covariance = np.zeros((count, 9))
    covariance[:, 0] = covariance[:, 4] = np.where(known, horizontal_m, 0.0) ** 2 / 2
    covariance[:, 8] = np.where(known, vertical_m, 0.0) ** 2
    columns = {
        "#seconds": time_ns // SECOND_NS,
        "#nanoseconds": time_ns % SECOND_NS,
        "latitude": latitude_deg,
        "longitude": longitude_deg,
        "altitude": height_m,
        "covariance": covariance,
        "#covariance_type": np.where(known, COVARIANCE_APPROXIMATED, COVARIANCE_UNKNOWN),
    }
    return _location_encoder(frame).encode(columns, count)


@cache
def _transform_encoder(parent: str, child: str) -> RowEncoder:
    return RowEncoder(
        [
            Field(1, _TIMESTAMP),
            Field(2, parent.encode()),
            Field(3, child.encode()),
            Field(4, [Field(1, "tx"), Field(2, "ty"), Field(3, "tz")]),
            Field(5, [Field(1, "x"), Field(2, "y"), Field(3, "z"), Field(4, "w")]),
        ]
    )


def frame_transforms(parent: str, child: str, time_ns: Integers, quaternion: Floats) -> list[bytes]:
    """Return `foxglove.FrameTransform` messages of a pure rotation.

    time_ns (n,): time of validity, UTC, nanoseconds since 1970.
    """
    columns = {
        "#seconds": time_ns // SECOND_NS,
        "#nanoseconds": time_ns % SECOND_NS,
        "x": quaternion[:, 0],
        "y": quaternion[:, 1],
        "z": quaternion[:, 2],
        "w": quaternion[:, 3],
    }
    return _transform_encoder(parent, child).encode(columns, len(time_ns))


def quaternion_from_euler(roll: Floats, pitch: Floats, yaw: Floats) -> Floats:
    """Return the rotation from body (forward, right, down) to north, east, down."""
    (sr, cr), (sp, cp), (sy, cy) = ((np.sin(a / 2), np.cos(a / 2)) for a in (roll, pitch, yaw))
    return np.stack(
        [
            sr * cp * cy - cr * sp * sy,
            cr * sp * cy + sr * cp * sy,
            cr * cp * sy - sr * sp * cy,
            cr * cp * cy + sr * sp * sy,
        ],
        axis=1,
    )
