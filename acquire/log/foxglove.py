"""Positions and attitudes in Foxglove's published schemas (protobuf)."""

from __future__ import annotations

from functools import cache
from typing import Any

import numpy as np

from acquire.log.protobuf_rows import Field, RowEncoder, length_delimited
from acquire.log.records import Schema
from drivers.arrays import Floats, Integers

SECOND_NS = 1_000_000_000

# LocationFix.PositionCovarianceType
COVARIANCE_UNKNOWN, COVARIANCE_APPROXIMATED, COVARIANCE_DIAGONAL_KNOWN, COVARIANCE_KNOWN = range(4)

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
