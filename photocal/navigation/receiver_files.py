"""Raw files of receivers, by what stands in them: which converter reads them, and the week of RTCM 3.

DJI writes RTCM 3.2 into files of its own: `PPKRAW.bin` (Phantom 4 RTK, P1), `*.rtk` (Matrice 4, L2) and, from
the base D-RTK 2, `RTK*.DAT`; older ones of that base hold frames of NovAtel. What is in a file counts, and
not its ending.
"""

import re
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from drivers.checksums import crc24q
from photocal.base.errors import IllPosedError, InputMalformedError
from photocal.base.time_scales import GPS_EPOCH_NS, SECOND_NS
from photocal.navigation.time import GpsTime

_WEEK_S, _DAY_NS = 604_800, 86_400 * SECOND_NS
# GPS week of Galileo's first, and the weeks after which GPS counts anew.
_GALILEO_START, _ROLLOVER = 1024, 1024
# The first bytes tell what a file is; fewer frames are chance.
_LOOKED_AT, _FEWEST = 1 << 20, 3
_DATE = re.compile(r"(?<!\d)(20[0-4]\d)-?(0[1-9]|1[0-2])-?(0[1-9]|[12]\d|3[01])")


@dataclass(frozen=True)
class ReceiverForm:
    """A form of raw observations.

    converter: as RTKLIB's `convbin` calls it.
    endings: by which it is known where no frames of it are looked for.
    tried: whether it was tried here with recordings of receivers.
    """

    name: str
    converter: str
    frames: Callable[[bytes], Iterator[bytes]] | None = None
    endings: tuple[str, ...] = ()
    tried: bool = False


def rtcm3_frames(data: bytes) -> Iterator[bytes]:
    """Intact frames of RTCM 3, whatever stands between them."""
    at = data.find(b"\xd3")
    while 0 <= at <= len(data) - 6:
        end = at + 6 + ((data[at + 1] & 3) << 8 | data[at + 2])
        whole = data[at + 1] < 4 and end <= len(data)
        if whole and crc24q(data[at : end - 3]) == int.from_bytes(data[end - 3 : end], "big"):
            yield data[at:end]
            at = data.find(b"\xd3", end)
        else:
            at = data.find(b"\xd3", at + 1)


def ubx_frames(data: bytes) -> Iterator[bytes]:
    """Frames of u-blox by their head and length; the converter tests their sums."""
    return _chained(data, b"\xb5\x62", lambda at: 8 + int.from_bytes(data[at + 4 : at + 6], "little"))


def sbf_frames(data: bytes) -> Iterator[bytes]:
    """Blocks of Septentrio by their head and length, which is a multiple of four."""
    for frame in _chained(data, b"$@", lambda at: int.from_bytes(data[at + 6 : at + 8], "little")):
        if len(frame) % 4 == 0:
            yield frame


def novatel_frames(data: bytes) -> Iterator[bytes]:
    """Messages of NovAtel (OEM4, 6, 7) with a long head."""
    return _chained(
        data, b"\xaa\x44\x12", lambda at: data[at + 3] + int.from_bytes(data[at + 8 : at + 10], "little") + 4
    )


def hemisphere_frames(data: bytes) -> Iterator[bytes]:
    """Messages of Hemisphere."""
    return _chained(data, b"$BIN", lambda at: 12 + int.from_bytes(data[at + 6 : at + 8], "little"))


def _chained(data: bytes, sync: bytes, length: Callable[[int], int]) -> Iterator[bytes]:
    """Frames that are followed by another one, or by the end."""
    at = data.find(sync)
    while 0 <= at <= len(data) - 12:
        end = at + length(at)
        if end > at + len(sync) and (end == len(data) or data.startswith(sync, end)):
            yield data[at:end]
            at = end if end < len(data) else -1
        else:
            at = data.find(sync, at + 1)


FORMS = (
    ReceiverForm("RTCM 3", "rtcm3", rtcm3_frames, (".rtcm3", ".rtcm", ".rtk", ".dat"), tried=True),
    ReceiverForm("u-blox UBX", "ubx", ubx_frames, (".ubx",), tried=True),
    ReceiverForm("Septentrio SBF", "sbf", sbf_frames, (".sbf",)),
    ReceiverForm("NovAtel OEM4/6/7", "nov", novatel_frames, (".gps", ".nov")),
    ReceiverForm("Hemisphere", "hemis", hemisphere_frames),
    ReceiverForm("Trimble RT17", "rt17", endings=(".rt17",)),
    ReceiverForm("Javad GREIS", "javad", endings=(".jps",)),
    ReceiverForm("BINEX", "binex", endings=(".bnx", ".binex")),
)


def form_of(data: bytes, path: Path) -> ReceiverForm:
    """Tell the form of a raw file by the frames that its beginning is made of, else by its ending.

    raises InputMalformedError: for what is no raw file of a receiver.
    """
    head = data[:_LOOKED_AT]
    best, most = None, 0
    for form in FORMS:
        frames = [] if form.frames is None else [len(frame) for frame in form.frames(head)]
        if len(frames) >= _FEWEST and sum(frames) > most:
            best, most = form, sum(frames)
    if best is not None:
        return best
    for form in FORMS:
        if form.frames is None and path.suffix.lower() in form.endings:
            return form
    raise InputMalformedError(
        "is neither RINEX nor a known raw format",
        f"give RINEX, or one of {', '.join(form.name for form in FORMS)}; the receiver's own program makes "
        "RINEX of others",
        where=path,
    )


def intact(data: bytes, form: ReceiverForm) -> bytes:
    """What the converter is given: of RTCM 3 the intact frames, of others all."""
    return b"".join(rtcm3_frames(data)) if form.converter == "rtcm3" else data


def rtcm3_time(frames: list[bytes], path: Path, today: GpsTime, near: GpsTime | None) -> GpsTime:
    """Approximate time of RTCM 3, whose observations tell the time of the week only.

    The date stands in message 1013, the week in ephemerides; else the other receiver's file or a date in the
    name of the file or of its folder tells it.

    today: GPS counts its weeks anew every 1024; the week is not after this.
    near: of the other receiver, or None.
    raises IllPosedError: when nothing tells it.
    """
    ns = _date_told(frames)
    if ns is None:
        ns = _week_told(frames, int(today.ns[0]) // (_WEEK_S * SECOND_NS))
    if ns is None and near is not None:
        return near
    if ns is None:
        ns = _date_named(path)
    if ns is None:
        raise IllPosedError(
            "is RTCM 3 without a date, an ephemeris or a date in its name: its week is unknown",
            "name the file or its folder by the day, such as 20260518, or give the other receiver as RINEX",
            where=path,
        )
    return GpsTime(np.array([ns], np.int64))


def _bits(frame: bytes, at: int, width: int) -> int:
    """Read an unsigned number from the message of a frame."""
    whole = int.from_bytes(frame[3:-3], "big")
    return whole >> (8 * (len(frame) - 6) - at - width) & ((1 << width) - 1)


def _kind(frame: bytes) -> int:
    return frame[3] << 4 | frame[4] >> 4 if len(frame) >= 8 else 0


def _date_told(frames: list[bytes]) -> int | None:
    for frame in frames:
        # DF051, DF052: modified Julian day (44 244 is 1980-01-06) and second of the day, UTC.
        if _kind(frame) == 1013 and len(frame) >= 14:
            return (_bits(frame, 24, 16) - 44_244) * _DAY_NS + _bits(frame, 40, 17) * SECOND_NS
    return None


def _week_told(frames: list[bytes], today: int) -> int | None:
    for frame in frames:
        kind = _kind(frame)
        # DF289: week of Galileo, 12 bits, after number and satellite (6 bits); DF076: of GPS, 10 bits.
        if kind in (1045, 1046):
            return _middle_of(_bits(frame, 18, 12) + _GALILEO_START)
        if kind == 1019:
            week = _bits(frame, 18, 10)
            return _middle_of(week + (today - week) // _ROLLOVER * _ROLLOVER)
    return None


def _middle_of(week: int) -> int:
    # The converter takes the time of the week that is nearest.
    return week * _WEEK_S * SECOND_NS + _WEEK_S * SECOND_NS // 2


def _date_named(path: Path) -> int | None:
    for name in (path.name, path.resolve().parent.name):
        found = _DATE.search(name)
        if found is not None:
            day = np.datetime64("-".join(found.groups()), "D") - np.datetime64("1970-01-01", "D")
            return int(day.astype(np.int64)) * _DAY_NS - GPS_EPOCH_NS + _DAY_NS // 2
    return None
