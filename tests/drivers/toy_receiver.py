"""A receiver's protocol as a stranger would bring it: one file, and one entry point.

A frame is ``!T``, the length of the payload, its kind, the payload, and the CRC-32 of all that. Kind 1 is a
position: UTC (ns since 1970), latitude, longitude (deg) and height (m). Kind 2 is a pulse: the GPS time of a
rising edge (ns since 1980) and its count.
"""

import struct
import zlib
from collections.abc import Mapping

import numpy as np

from drivers.frames import Batch, Framing, Wire, numbers_at
from drivers.receiver import BASE_GNSS, Fixes, ReceiverProtocol, TimeMarks
from photocal.base.arrays import Integers

POSITION, PULSE = 1, 2


def encode(kind: int, payload: bytes) -> bytes:
    body = b"!T" + bytes((len(payload), kind)) + payload
    return body + zlib.crc32(body).to_bytes(4, "little")


def position(utc_ns: int, latitude_deg: float, longitude_deg: float, height_m: float) -> bytes:
    return encode(POSITION, struct.pack("<q3d", utc_ns, latitude_deg, longitude_deg, height_m))


def pulse(gps_ns: int, count: int) -> bytes:
    return encode(PULSE, struct.pack("<qq", gps_ns, count))


class ToyProtocol(ReceiverProtocol):
    wire = Wire.named(
        "toy",
        framing=Framing(
            start=b"!T",
            longest=263,
            length=lambda data: data[2] + 8 if len(data) > 2 else -3,
            intact=lambda frame: zlib.crc32(frame[:-4]) == int.from_bytes(frame[-4:], "little"),
            kind=lambda frame: frame[3],
        ),
    )
    name = "toy"

    def kind_name(self, kind: int) -> str:
        return {POSITION: "TOY-POSITION", PULSE: "TOY-PULSE"}.get(kind, f"TOY-{kind}")

    def fixes(self, batch: Batch) -> Mapping[str, Fixes]:
        index = batch.where(self.wire, POSITION)
        lat, lon, up = (numbers_at(batch.data, batch.start[index] + at, "<f8") for at in (12, 20, 28))
        return {"TOY-POSITION": Fixes.of(index, latitude_deg=lat, longitude_deg=lon, height_m=up)}

    def time_marks(self, batch: Batch) -> Mapping[str, TimeMarks]:
        index = batch.where(self.wire, PULSE)
        time, count = (numbers_at(batch.data, batch.start[index] + at, "<i8") for at in (4, 12))
        sure, zeros = np.ones(len(index), bool), np.zeros(len(index), np.int64)
        return {"TOY-PULSE": TimeMarks(index, sure, count, time, zeros + BASE_GNSS, sure, zeros + 50)}

    def utc(self, batch: Batch) -> Mapping[str, tuple[Integers, Integers]]:
        index = batch.where(self.wire, POSITION)
        return {"TOY-POSITION": (index, numbers_at(batch.data, batch.start[index] + 4, "<i8"))}


PROTOCOL = ToyProtocol()
