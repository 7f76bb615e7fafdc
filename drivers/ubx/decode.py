"""UBX payloads to arrays: all messages of one kind at once.

Layouts after u-blox's interface descriptions (M8 protocol 15 to 23.01, F9 HPG 1.32). A raw view keeps the
units of the wire; only what needs scaling before it has a meaning is scaled here, and says so in its name.
"""

from functools import cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from drivers.frames import Batch, Messages, Wire, gather
from drivers.receiver import BASE_UTC, TimeMarks
from photocal.base.arrays import Floats, Integers
from photocal.base.time_scales import GPS_EPOCH_NS, SECOND_NS, utc_date_ns, utc_to_gps_ns, week_to_ns

NAV_POSLLH, NAV_PVT, NAV_HPPOSLLH, NAV_TIMEGPS, NAV_TIMEUTC, NAV_SVIN = (
    0x0102, 0x0107, 0x0114, 0x0120, 0x0121, 0x013B,
)  # fmt: skip
RXM_SFRBX, RXM_RAWX, TIM_TM2 = 0x0213, 0x0215, 0x0D03
ACK_NAK, ACK_ACK = 0x0500, 0x0501
# Longest age of each class, seconds; 0 is unknown, from 12 on the age is 120 s or more.
_AGES_S = np.array([np.nan, 1, 2, 5, 10, 15, 20, 30, 45, 60, 90, 120, *[np.inf] * 4])
# TIM-TM2: its flags.
_NEW_FALLING, _TIME_VALID, _NEW_RISING, _BASE_SHIFT = 0x04, 0x40, 0x80, 3


_TYPES = {"U": "u", "I": "i", "X": "u", "R": "f", "E": "u", "L": "u"}
# Where pyubx2 departs from the names of the interface description.
_NAMES = {"second": "sec"}


@cache
def layout(kind: int) -> np.dtype[Any]:
    """Return the layout of a message by the table of pyubx2: of one with a repeated group its head.

    pyubx2 calls parts that it adds to other fields ``_HPlon`` and the like.
    """
    from pyubx2.ubxtypes_get import UBX_PAYLOADS_GET

    return _row(UBX_PAYLOADS_GET[kind_name(kind)])


@cache
def signal_layout() -> np.dtype[Any]:
    """Return the layout of one signal of RXM-RAWX."""
    from pyubx2.ubxtypes_get import UBX_PAYLOADS_GET

    return _row(UBX_PAYLOADS_GET["RXM-RAWX"]["meas_grp"][1])


def _row(table: dict[str, Any]) -> np.dtype[Any]:
    members: list[tuple[str, str]] = []
    for name, form in table.items():
        if name.endswith("_grp"):
            continue
        text = form if isinstance(form, str) else form[0]
        letter, size = text[0], int(text[1:])
        whole = size in (1, 2, 4, 8) and letter in _TYPES
        ours = _NAMES.get(name, name.removesuffix("_bit"))
        members.append((ours, f"<{_TYPES[letter]}{size}" if whole else f"V{size}"))
    return np.dtype(members)


@cache
def kind_name(kind: int) -> str:
    """Return the name of a message, or its class and id in hexadecimal digits."""
    from pyubx2 import UBX_MSGIDS

    return str(UBX_MSGIDS.get(kind.to_bytes(2, "big"), f"{kind >> 8:02X}-{kind & 0xFF:02X}"))


def correction_age_s(pvt: NDArray[Any]) -> Floats:
    """Return the age of the last differential correction that NAV-PVT tells, seconds.

    The receiver tells classes (`lastCorrectionAge`, bits 1 to 4 of `flags3`): the result is the longest age
    of each, infinite for 120 s or more, NaN where it tells none.
    """
    return np.asarray(_AGES_S[pvt["flags3"] >> 1 & 0x0F])


def civil_utc_ns(fields: Any) -> Integers:
    """Return UTC, nanoseconds since 1970, of calendar date and time as NAV-PVT and NAV-TIMEUTC tell them."""
    hours, minutes = fields["hour"].astype(np.int64), fields["min"].astype(np.int64)
    seconds = hours * 3600 + minutes * 60 + fields["sec"]
    date_ns = utc_date_ns(fields["year"], fields["month"], fields["day"])
    return np.asarray(date_ns + seconds * SECOND_NS + fields["nano"])


def decode(batch: Batch, kind: int) -> Messages:
    """Decode all messages of a kind of fixed size; polls and shorter versions are left out.

    Fields are those of the interface description, of RXM-SFRBX the header only.
    """
    row = layout(kind)
    index = batch.where(Wire.UBX, kind)
    payload = batch.length[index] - 8
    # NAV-PVT had 84 bytes before protocol 15: what it lacks reads as zero.
    index = index[payload >= (84 if kind == NAV_PVT else row.itemsize)]
    return Messages(index, gather(batch.data, batch.start[index] + 6, batch.length[index] - 8, row))


def time_marks(fields: NDArray[Any]) -> TimeMarks:
    """Return the new edges from the fields of TIM-TM2: each message brings at most one of either kind."""
    rising, falling = _edges(fields, "R", _NEW_RISING), _edges(fields, "F", _NEW_FALLING)
    both = TimeMarks(*map(np.concatenate, zip(rising, falling, strict=True)))
    return both.rows(np.argsort(both.index, kind="stable"))


def _edges(fields: NDArray[Any], letter: str, bit: int) -> tuple[NDArray[Any], ...]:
    index = np.flatnonzero(fields["flags"] & bit)
    new = fields[index]
    base = (new["flags"] >> _BASE_SHIFT & 3).astype(np.int64)
    of_week_ns = new[f"towMs{letter}"].astype(np.int64) * 1_000_000 + new[f"towSubMs{letter}"]
    told_ns = week_to_ns(new[f"wn{letter}"], 0.0) + of_week_ns
    # Weeks and milliseconds count UTC from the GPS epoch: the leap seconds are missing in them.
    gps_ns = np.where(base == BASE_UTC, utc_to_gps_ns(told_ns + GPS_EPOCH_NS), told_ns)
    return (
        index,
        np.full(len(index), letter == "R"),
        new["count"].astype(np.int64),
        gps_ns,
        base,
        ((new["flags"] & _TIME_VALID) != 0) & (new[f"wn{letter}"] > 0),
        new["accEst"].astype(np.int64),
    )


def decode_rawx(batch: Batch) -> Messages:
    """Decode the epochs of all RXM-RAWX messages whose length agrees with their number of signals.

    Their fields are receiver time (`rcvTow` in seconds of `week`), leap seconds and number of signals.
    """
    messages = decode(batch, RXM_RAWX)
    count = messages.fields["numMeas"].astype(np.int64)
    whole = batch.length[messages.index] == 24 + signal_layout().itemsize * count
    return Messages(messages.index[whole], messages.fields[whole])
