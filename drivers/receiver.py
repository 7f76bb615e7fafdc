"""What a GNSS receiver's protocol is to the rest of the house, and what its messages tell, by arrays."""

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any, ClassVar, Self

import numpy as np
from numpy.typing import NDArray

from drivers.frames import Batch, Wire
from photocal.base.arrays import Columns, Flags, Floats, Integers

# Time bases of pulses, by their names in the flight log.
TIME_BASES = ("receiver", "gnss", "utc", "reserved")
BASE_RECEIVER, BASE_GNSS, BASE_UTC, _ = range(4)


@dataclass(frozen=True)
class Fixes(Columns):
    """Positions of one kind of message.

    index (n,): the frame of each in the batch.
    latitude_deg, longitude_deg, height_m (n,): height above the ellipsoid.
    horizontal_m, vertical_m, hdop, age_s (n,): as the receiver claims them; NaN where it claims none.
    satellites (n,): number used; -1 where it is not stated.
    valid: whether there is a position.
    fix: names of the status channel, such as ``3d`` or ``rtk_fixed``.
    geoid_m (n,): height above the ellipsoid minus height above sea level; NaN where it is not stated.
    """

    index: Integers
    latitude_deg: Floats
    longitude_deg: Floats
    height_m: Floats
    horizontal_m: Floats
    vertical_m: Floats
    hdop: Floats
    age_s: Floats
    satellites: Integers
    valid: Flags
    fix: NDArray[np.str_]
    geoid_m: Floats

    @classmethod
    def of(cls, index: Integers, **told: Any) -> Self:
        """Return positions from what a message tells: the columns that it has, under their names."""
        unknown = np.full(len(index), np.nan)
        floats = ("horizontal_m", "vertical_m", "hdop", "age_s", "geoid_m")
        known: dict[str, Any] = {
            **dict.fromkeys(floats, unknown),
            "satellites": np.full(len(index), -1),
            "valid": np.ones(len(index), bool),
            **told,
            "fix": np.asarray(told.get("fix", ["3d"] * len(index)), "U16"),
        }
        return cls(index, **known)


@dataclass(frozen=True)
class TimeMarks(Columns):
    """Edges on a time mark input.

    index (n,): the message of each: a frame of the batch, or its number in the stream of a flight log.
    rising: whether the edge is a rising one.
    count (n,): the receiver's count of rising edges.
    gps_ns (n,): GPS time, nanoseconds since its epoch, whatever the time base; without meaning where that is
        the receiver's own or the time is none.
    base (n,): in which the receiver told it: `BASE_RECEIVER`, `BASE_GNSS` or `BASE_UTC`.
    valid: whether the time is one: the first message of a recording may bring an edge of week 0.
    accuracy_ns (n,): accuracy as the receiver claims it.
    """

    index: Integers
    rising: Flags
    count: Integers
    gps_ns: Integers
    base: Integers
    valid: Flags
    accuracy_ns: Integers

    def at(self, index: Integers) -> Self:
        """Return the marks with the frames of their messages, given the frame of each message."""
        return replace(self, index=index[self.index])


class ReceiverProtocol:
    """A protocol of GNSS receivers: a message without a decoder is kept raw and named all the same.

    wire: its frames in a batch and in the flight log.
    name: what a person calls it.
    converter: what RTKLIB's `convbin` calls it; empty: it cannot be converted to RINEX.
    """

    wire: ClassVar[Wire]
    name: ClassVar[str]
    converter: ClassVar[str] = ""

    def kinds(self, data: bytes, start: Integers, length: Integers) -> Integers:
        """Return what frames carry that were cut out of their stream already."""
        framing = self.wire.framing
        assert framing is not None  # noqa: S101
        cut = zip(start.tolist(), length.tolist(), strict=True)
        return np.array([framing.kind(data[at : at + size]) for at, size in cut], np.int64)

    def kind_name(self, kind: int) -> str:
        """Return what the makers call a message."""
        return str(kind)

    def fixes(self, batch: Batch) -> Mapping[str, Fixes]:  # noqa: ARG002
        """Return the positions in a batch by the messages that tell them, the best first."""
        return {}

    def told_status(self) -> tuple[str, ...]:
        """Return which of these messages tell the quality of the fix too."""
        return ()

    def time_marks(self, batch: Batch) -> Mapping[str, TimeMarks]:  # noqa: ARG002
        """Return the edges on time mark inputs by the messages that tell them; indices are frames."""
        return {}

    def utc(self, batch: Batch) -> Mapping[str, tuple[Integers, Integers]]:  # noqa: ARG002
        """Return which frames tell date and time, and UTC (ns since 1970), by the messages that tell them."""
        return {}
