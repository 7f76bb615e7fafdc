"""Positions and attitudes in Foxglove's published schemas (protobuf)."""

from functools import cache
from importlib import import_module
from typing import Any

import numpy as np

from acquire.log.chunk import Schema
from photocal.base.arrays import Floats, Integers
from photocal.base.time_scales import SECOND_NS


def _message(name: str) -> Any:
    return getattr(import_module(f"foxglove_schemas_protobuf.{name}_pb2"), name)


@cache
def schema(name: str) -> Schema:
    """Return the published schema of a message type, for example ``foxglove.LocationFix``."""
    from google.protobuf.descriptor_pb2 import FileDescriptorSet

    files, seen = FileDescriptorSet(), set[str]()

    def add(file: Any) -> None:
        """Add a file of definitions behind those that it needs."""
        # Each file stands behind those that it needs.
        if file.name not in seen:
            seen.add(file.name)
            for dependency in file.dependencies:
                add(dependency)
            files.file.add().ParseFromString(file.serialized_pb)

    add(_message(name.split(".")[-1]).DESCRIPTOR.file)
    return Schema(name, "protobuf", files.SerializeToString())


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
    horizontal_m, vertical_m (n,): accuracy reported by the device: radius in the plane, standard deviation of
        the height. NaN: unknown. The variance of each horizontal component is taken as half of the radius
        squared.
    """
    known = np.isfinite(horizontal_m) & np.isfinite(vertical_m)
    plane = np.where(known, horizontal_m, 0.0) ** 2 / 2
    up = np.where(known, vertical_m, 0.0) ** 2
    # One message is filled again and again: making one takes three times as long.
    fix = _message("LocationFix")(frame_id=frame, position_covariance=[0.0] * 9)
    stamp, covariance = fix.timestamp, fix.position_covariance
    payloads = []
    columns = (time_ns, latitude_deg, longitude_deg, height_m, plane, up, known)
    for time, *place, variance, up_variance, has_accuracy in zip(*(c.tolist() for c in columns), strict=True):
        stamp.seconds, stamp.nanos = divmod(time, SECOND_NS)
        fix.latitude, fix.longitude, fix.altitude = place
        covariance[0] = covariance[4] = variance
        covariance[8] = up_variance
        fix.position_covariance_type = fix.APPROXIMATED if has_accuracy else fix.UNKNOWN
        payloads.append(fix.SerializeToString())
    return payloads


def frame_transforms(parent: str, child: str, time_ns: Integers, quaternion: Floats) -> list[bytes]:
    """Return `foxglove.FrameTransform` messages of a pure rotation.

    time_ns (n,): time of validity, UTC, nanoseconds since 1970.
    """
    transform = _message("FrameTransform")(parent_frame_id=parent, child_frame_id=child, translation={})
    stamp, turn = transform.timestamp, transform.rotation
    payloads = []
    for time, components in zip(time_ns.tolist(), quaternion.tolist(), strict=True):
        stamp.seconds, stamp.nanos = divmod(time, SECOND_NS)
        turn.x, turn.y, turn.z, turn.w = components
        payloads.append(transform.SerializeToString())
    return payloads


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
