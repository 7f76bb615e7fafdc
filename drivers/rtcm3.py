"""RTCM 3: framing, reference station position and encoding.

Source: RTCM standard 10403; field positions of 1005/1006 after its table for message type 1005.
"""

from collections.abc import Mapping

import numpy as np

from drivers.checksums import crc24q
from drivers.frames import Batch, Wire, numbers_at
from drivers.logged import Records
from drivers.receiver import ReceiverProtocol
from photocal.base.arrays import Integers
from photocal.base.time_scales import DAY_NS, SECOND_NS

# Length of the frame of a 1013 up to its second of the day.
DATE_BYTES = 6 + 8


def encode(payload: bytes) -> bytes:
    """Return the frame of a message whose first 12 bits are its number."""
    body = b"\xd3" + len(payload).to_bytes(2, "big") + payload
    return body + crc24q(body).to_bytes(3, "big")


def decode_stations(batch: Batch) -> Records:
    """Decode the reference station messages 1005 and 1006 of a batch: antenna reference points of stations.

    returns: station (n,): its number; ecef_m (n, 3): Earth-centred, earth-fixed coordinates of the antenna
        reference point; antenna_height_m (n,): height of the antenna above the mark; NaN for 1005, which has
        none.
    """
    index = np.sort(np.concatenate([batch.where(Wire.RTCM3, 1005), batch.where(Wire.RTCM3, 1006)]))
    index = index[batch.length[index] >= np.where(batch.kind[index] == 1006, 27, 25)]
    station, ecef, height = [], [], []
    for i in index.tolist():
        message = batch.frame(i).data
        station.append(number_in(message, 12, 12))
        # DF025, DF026, DF027: 38 bits each in units of 0.1 mm, between them flags of 2 bits.
        ecef.append([_signed(message, at, 38) * 1e-4 for at in (34, 74, 114)])
        height.append(number_in(message, 152, 16) * 1e-4 if batch.kind[i] == 1006 else np.nan)
    columns = {
        "station": np.array(station, np.int64),
        "ecef_m": np.array(ecef, float).reshape(-1, 3),
        "antenna_height_m": np.array(height, float),
    }
    return Records(index, columns)


def decode_dates(batch: Batch) -> tuple[Integers, Integers]:
    """Decode the date and time of the system parameter messages (1013).

    returns utc_ns (n,): UTC, nanoseconds since 1970, to the second.
    """
    index = batch.where(Wire.RTCM3, 1013)
    index = index[batch.length[index] >= DATE_BYTES]
    return index, np.array([date_ns(batch.frame(i).data) for i in index.tolist()], np.int64)


def date_ns(frame: bytes) -> int:
    """Return the UTC that the frame of a 1013 of at least `DATE_BYTES` tells, nanoseconds since 1970."""
    # DF051, DF052: modified Julian day (40 587 is 1970-01-01) and second of the day.
    return (number_in(frame, 24, 16) - 40_587) * DAY_NS + number_in(frame, 40, 17) * SECOND_NS


def decode_epochs(batch: Batch) -> tuple[Integers, Integers]:
    """Decode the GPS time of week of observations (1001 to 1004, 1071 to 1077, 1091 to 1097).

    returns time_of_week_ns (n,): GPS time of week; Galileo's system time counts the same.
    """
    kinds = [*range(1001, 1005), *range(1071, 1078), *range(1091, 1098)]
    chosen = (batch.wire == Wire.RTCM3) & np.isin(batch.kind, kinds) & (batch.length >= 6 + 8)
    index = np.flatnonzero(chosen)
    # DF004, DF248: 30 bits of milliseconds after message number and station.
    milliseconds = numbers_at(batch.data, batch.start[index] + 6, ">u4") >> 2
    return index, milliseconds.astype(np.int64) * 1_000_000


def number_in(frame: bytes, at: int, width: int) -> int:
    """Return the unsigned number of so many bits that stands at a bit of the message in a frame."""
    message = frame[3:-3]
    return int.from_bytes(message, "big") >> (8 * len(message) - at - width) & ((1 << width) - 1)


def _signed(frame: bytes, at: int, width: int) -> int:
    value = number_in(frame, at, width)
    return value - (1 << width) if value >> (width - 1) else value


class Rtcm3Protocol(ReceiverProtocol):
    """Corrections of base stations, and the observations of receivers that speak it."""

    wire, name, converter = Wire.RTCM3, "RTCM3", "rtcm3"

    def kinds(self, data: bytes, start: Integers, length: Integers) -> Integers:
        """Return the number of each message."""
        octets = np.frombuffer(data, np.uint8)
        kind = octets[start + 3].astype(np.int64) << 4 | octets[start + 4] >> 4
        return np.where(length < 8, 0, kind)

    def utc(self, batch: Batch) -> Mapping[str, tuple[Integers, Integers]]:
        """Return the times of 1013."""
        return {"RTCM 1013": decode_dates(batch)}


PROTOCOL = Rtcm3Protocol()
