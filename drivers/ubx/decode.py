"""UBX payloads to arrays: all messages of one kind at once.

Layouts after u-blox's interface descriptions (M8 protocol 15 to 23.01, F9 HPG 1.32). A raw view keeps the
units of the wire; only what needs scaling before it has a meaning is scaled here, and says so in its name.
"""

from dataclasses import dataclass
from functools import cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from drivers.arrays import Flags, Floats, Integers
from drivers.frames import Batch, Wire, gather
from drivers.gnsstime import week_to_ns

NAV_POSLLH, NAV_PVT, NAV_HPPOSLLH, NAV_TIMEGPS, NAV_TIMEUTC, NAV_SVIN = (
    0x0102, 0x0107, 0x0114, 0x0120, 0x0121, 0x013B,
)  # fmt: skip
RXM_SFRBX, RXM_RAWX, TIM_TM2 = 0x0213, 0x0215, 0x0D03
ACK_NAK, ACK_ACK = 0x0500, 0x0501
# Longest age of each class, seconds; 0 is unknown, from 12 on the age is 120 s or more.
_AGES_S = np.array([np.nan, 1, 2, 5, 10, 15, 20, 30, 45, 60, 90, 120, *[np.inf] * 4])
# TIM-TM2: its flags, and the time bases.
_NEW_FALLING, _TIME_VALID, _NEW_RISING, _BASE_SHIFT = 0x04, 0x40, 0x80, 3
BASE_RECEIVER, BASE_GNSS, BASE_UTC = 0, 1, 2


def _layout(*members: tuple[str, str] | tuple[str, str, int]) -> np.dtype[Any]:
    return np.dtype([(m[0], "<" + m[1], *m[2:]) for m in members])


_PVT = _layout(
    ("iTOW", "u4"), ("year", "u2"), ("month", "u1"), ("day", "u1"), ("hour", "u1"), ("min", "u1"), ("sec",
    "u1"), ("valid", "u1"), ("tAcc", "u4"), ("nano", "i4"), ("fixType", "u1"), ("flags", "u1"), ("flags2",
    "u1"), ("numSV", "u1"), ("lon", "i4"), ("lat", "i4"), ("height", "i4"), ("hMSL", "i4"), ("hAcc", "u4"),
    ("vAcc", "u4"), ("velN", "i4"), ("velE", "i4"), ("velD", "i4"), ("gSpeed", "i4"), ("headMot", "i4"),
    ("sAcc", "u4"), ("headAcc", "u4"), ("pDOP", "u2"), ("flags3", "u1"), ("reserved1", "u1", 5), ("headVeh",
    "i4"), ("magDec", "i2"), ("magAcc", "u2"),
)  # fmt: skip
_TM2 = _layout(
    ("ch", "u1"), ("flags", "u1"), ("count", "u2"), ("wnR", "u2"), ("wnF", "u2"), ("towMsR", "u4"),
    ("towSubMsR", "u4"), ("towMsF", "u4"), ("towSubMsF", "u4"), ("accEst", "u4"),
)  # fmt: skip
_SFRBX = _layout(
    ("gnssId", "u1"), ("svId", "u1"), ("reserved1", "u1"), ("freqId", "u1"), ("numWords", "u1"), ("chn",
    "u1"), ("version", "u1"), ("reserved2", "u1"),
)  # fmt: skip
_RAWX = _layout(
    ("rcvTow", "f8"), ("week", "u2"), ("leapS", "i1"), ("numMeas", "u1"), ("recStat", "u1"), ("version",
    "u1"), ("reserved1", "u1", 2),
)  # fmt: skip
_SIGNAL = _layout(
    ("prMes", "f8"), ("cpMes", "f8"), ("doMes", "f4"), ("gnssId", "u1"), ("svId", "u1"), ("sigId", "u1"),
    ("freqId", "u1"), ("locktime", "u2"), ("cno", "u1"), ("prStdev", "u1"), ("cpStdev", "u1"), ("doStdev",
    "u1"), ("trkStat", "u1"), ("reserved2", "u1"),
)  # fmt: skip
# The messages that come at high rates, or of which more is needed than the table of pyubx2 has.
_HOT = {NAV_PVT: _PVT, TIM_TM2: _TM2, RXM_SFRBX: _SFRBX, RXM_RAWX: _RAWX}
_TYPES = {"U": "u", "I": "i", "X": "u", "R": "f", "E": "u", "L": "u"}


@cache
def layout(kind: int) -> np.dtype[Any]:
    """Return the layout of a message of fixed size: of hot ones ours, of all others that of pyubx2.

    pyubx2 calls parts that it adds to other fields and fields of flags ``_HPlon`` and ``valid_bit``.
    """
    if kind in _HOT:
        return _HOT[kind]
    from pyubx2.ubxtypes_get import UBX_PAYLOADS_GET

    members: list[tuple[str, str]] = []
    for name, form in UBX_PAYLOADS_GET[kind_name(kind)].items():
        text = form if isinstance(form, str) else form[0]
        letter, size = text[0], int(text[1:])
        whole = size in (1, 2, 4, 8)
        members.append((name, f"<{_TYPES[letter]}{size}" if whole and letter in _TYPES else f"V{size}"))
    return np.dtype(members)


@cache
def kind_name(kind: int) -> str:
    """Return the name of a message, or its class and id in hexadecimal digits."""
    from pyubx2 import UBX_MSGIDS

    return str(UBX_MSGIDS.get(kind.to_bytes(2, "big"), f"{kind >> 8:02X}-{kind & 0xFF:02X}"))


@dataclass(frozen=True, slots=True)
class Messages:
    """Messages of one kind.

    index (n,): position of each message in the batch.
    fields (n,): the fields by the names and in the units of the interface description (of RXM-SFRBX the
        header only).
    """

    index: Integers
    fields: NDArray[Any]

    def __len__(self) -> int:
        return len(self.index)


def correction_age_s(pvt: NDArray[Any]) -> Floats:
    """Return the age of the last differential correction that NAV-PVT tells, seconds.

    The receiver tells classes (`lastCorrectionAge`, bits 1 to 4 of `flags3`): the result is the longest age
    of each, infinite for 120 s or more, NaN where it tells none.
    """
    return np.asarray(_AGES_S[pvt["flags3"] >> 1 & 0x0F])


def decode(batch: Batch, kind: int) -> Messages:
    """Decode all messages of a kind of fixed size; polls and shorter versions are left out."""
    row = layout(kind)
    index = batch.where(Wire.UBX, kind)
    payload = batch.length[index] - 8
    # NAV-PVT had 84 bytes before protocol 15: what it lacks reads as zero.
    index = index[payload >= (84 if kind == NAV_PVT else row.itemsize)]
    return Messages(index, gather(batch.data, batch.start[index] + 6, batch.length[index] - 8, row))


@dataclass(frozen=True, slots=True)
class TimeMarks:
    """New edges of one kind in TIM-TM2 messages.

    index (n,): the message of each.
    count (n,): the receiver's count of rising edges.
    time_ns (n,): in the time base, since the GPS epoch, nanoseconds.
    base (n,): `BASE_RECEIVER`, `BASE_GNSS` or `BASE_UTC`: UTC is counted in weeks since the GPS epoch as
        well.
    valid: whether the time is one: the first message of a recording may bring an edge of week 0.
    accuracy_ns (n,): accuracy as the receiver claims it.
    """

    index: Integers
    count: Integers
    time_ns: Integers
    base: Integers
    valid: Flags
    accuracy_ns: Integers


def time_marks(fields: NDArray[Any], *, rising: bool) -> TimeMarks:
    """Return the new edges of one kind from the fields of TIM-TM2: each message brings at most one."""
    letter, bit = ("R", _NEW_RISING) if rising else ("F", _NEW_FALLING)
    index = np.flatnonzero(fields["flags"] & bit)
    new = fields[index]
    time_ns = week_to_ns(new[f"wn{letter}"], 0.0)
    time_ns = time_ns + new[f"towMs{letter}"].astype(np.int64) * 1_000_000 + new[f"towSubMs{letter}"]
    return TimeMarks(
        index,
        new["count"].astype(np.int64),
        time_ns,
        (new["flags"] >> _BASE_SHIFT & 3).astype(np.int64),
        ((new["flags"] & _TIME_VALID) != 0) & (new[f"wn{letter}"] > 0),
        new["accEst"].astype(np.int64),
    )


@dataclass(frozen=True, slots=True)
class RawObservations:
    """RXM-RAWX: one row per epoch and one per signal.

    epochs: receiver time (`rcvTow` in seconds of `week`), leap seconds and number of signals of each epoch.
    epoch (m,): row of `epochs` that each signal belongs to.
    signals (m,): pseudorange `prMes` (m), carrier phase `cpMes` (cycles), Doppler `doMes` (Hz), satellite and
        quality, in the units and names of the interface description.
    """

    epochs: Messages
    epoch: Integers
    signals: NDArray[Any]


def decode_rawx(batch: Batch) -> RawObservations:
    """Decode all RXM-RAWX messages whose length agrees with their number of signals."""
    found = decode(batch, RXM_RAWX)
    count = found.fields["numMeas"].astype(np.int64)
    whole = batch.length[found.index] == 24 + _SIGNAL.itemsize * count
    epochs = Messages(found.index[whole], found.fields[whole])
    count = count[whole]
    epoch = np.repeat(np.arange(len(count)), count)
    within = np.arange(len(epoch)) - (np.cumsum(count) - count)[epoch]
    start = batch.start[epochs.index][epoch] + 22 + _SIGNAL.itemsize * within
    signals = gather(batch.data, start, np.full(len(start), _SIGNAL.itemsize), _SIGNAL)
    return RawObservations(epochs, epoch, signals)
