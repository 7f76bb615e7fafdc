"""Observation and navigation files as people have them, made ready for the engine.

Compressed (gz, Z, zip), Hatanaka's compact RINEX, RINEX 4, first epochs of 1980 of a receiver that did not
know the time yet, and raw files of receivers.

Raw files of receivers, by what stands in them: which converter reads them, and the week of RTCM 3.

DJI writes RTCM 3.2 into files of its own: `PPKRAW.bin` (Phantom 4 RTK, P1), `*.rtk` (Matrice 4, L2) and, from
the base D-RTK 2, `RTK*.DAT`; older ones of that base hold frames of NovAtel. What is in a file counts, and
not its ending.
"""

import re
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from drivers.frames import Frame, StreamFramer, Wire
from drivers.rtcm3 import DATE_BYTES, date_ns, number_in
from photocal.base.archives import DAMAGES, gunzipped, unzipped
from photocal.base.errors import ConfigurationError, IllPosedError, InputMalformedError, reading
from photocal.base.time_scales import GPS_EPOCH_NS, SECOND_NS
from photocal.navigation.engine import to_rinex
from photocal.navigation.precise_results import read_observation_file
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


def frames_of(data: bytes, wire: Wire) -> Iterator[Frame]:
    """Intact frames of a protocol of ours, whatever stands between them."""
    framer = StreamFramer((wire,))
    for at in range(0, len(data), _LOOKED_AT):
        yield from framer.feed(data[at : at + _LOOKED_AT])
    yield from framer.close()


def _octets_of(wire: Wire) -> Callable[[bytes], Iterator[bytes]]:
    return lambda data: (frame.data for frame in frames_of(data, wire))


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
    ReceiverForm("RTCM 3", "rtcm3", _octets_of(Wire.RTCM3), (".rtcm3", ".rtcm", ".rtk", ".dat"), tried=True),
    ReceiverForm("u-blox UBX", "ubx", _octets_of(Wire.UBX), (".ubx",), tried=True),
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


def rtcm3_time(frames: list[Frame], path: Path, today: GpsTime, near: GpsTime | None) -> GpsTime:
    """Approximate time of RTCM 3, whose observations tell the time of the week only.

    The date stands in message 1013, the week in ephemerides; else the other receiver's file or a date in the
    name of the file or of its folder tells it.

    today: GPS counts its weeks anew every 1024; the week is not after this.
    near: of the other receiver, or None.
    raises IllPosedError: when it cannot be determined.
    """
    dated = (f.data for f in frames if f.kind == 1013 and len(f.data) >= DATE_BYTES)
    # The difference of GPS time and UTC does not matter here.
    ns = next((date_ns(data) - GPS_EPOCH_NS for data in dated), None)
    if ns is None:
        ns = _week_told(frames, int(today.ns[0]) // (_WEEK_S * SECOND_NS))
    if ns is None and near is not None:
        return near
    if ns is None:
        ns = _date_named(path)
    if ns is None:
        raise IllPosedError(
            "is RTCM 3 without a date, an ephemeris or a date in its name: its week is unknown",
            "put the day into the name of file or folder, as 20260518, or give the other receiver as RINEX",
            where=path,
        )
    return GpsTime(np.array([ns], np.int64))


def _week_told(frames: list[Frame], today: int) -> int | None:
    # Head, the message up to its week, and the check sum.
    shortest = 3 + 4 + 3
    for frame in (one for one in frames if len(one.data) >= shortest):
        # DF289: week of Galileo, 12 bits, after number and satellite (6 bits); DF076: of GPS, 10 bits.
        if frame.kind in (1045, 1046):
            return _middle_of(number_in(frame.data, 18, 12) + _GALILEO_START)
        if frame.kind == 1019:
            week = number_in(frame.data, 18, 10)
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


# A station's day of 10 Hz is shorter.
_MOST_BYTES = 4 << 30
_EPOCH_3 = re.compile(rb"> (\d{4}) ")
_EPOCH_2 = re.compile(rb" (\d\d) [ \d]\d [ \d]\d [ \d]\d [ \d]\d[ \d]{2,3}\.\d{7}  \d")
# Messages of RINEX 4 that older RINEX has, and how many lines of a record it has; 0: all.
_OF_3 = {"LNAV": 0, "FDMA": 4, "INAV": 0, "FNAV": 0, "D1": 0, "D2": 0, "D1D2": 0, "SBAS": 0}


@dataclass(frozen=True)
class ReadyFile:
    """What the engine is given.

    navigation: ephemerides that a raw file has.
    remarks: what was done.
    """

    path: Path
    navigation: tuple[Path, ...] = ()
    remarks: tuple[str, ...] = ()


def observations_ready(path: Path, stem: Path, today: GpsTime, other: Path | None = None) -> ReadyFile:
    """Make observations ready for the engine: plain RINEX stays as it is.

    stem: where files are made, without an ending.
    today: see `rtcm3_time`.
    other: observations of the other receiver, whose date gives the week of RTCM where no other source does.
    raises InputMalformedError: for what is not a file of observations.
    """
    with reading(path):
        given = path.read_bytes()
    members = _members(given, path)
    observed = members if len(members) == 1 else {k: v for k, v in members.items() if _kind(v) == "O"}
    if len(observed) != 1:
        raise InputMalformedError(
            f"has {len(members)} files ({', '.join(list(members)[:5])})",
            "unpack it and name the one with the observations",
            where=path,
        )
    ((name, data),) = observed.items()
    rest = [other for other in members if other != name and _is_navigation(members[other])]
    navigation = tuple(
        _written(_navigation_3(members[one]), stem.with_name(f"{stem.name}-{k}.nav"))
        for k, one in enumerate(rest)
    )
    if b"RINEX VERSION" not in data[:200]:
        return _converted(data, path, stem, today, other)
    kept, lost = _without_1980(data)
    if kept is given:
        return ReadyFile(path)
    remark = f"{path.name}: {lost} first epochs of 1980, when the receiver did not know the time, left out"
    return ReadyFile(_written(kept, stem.with_suffix(".obs")), navigation, (remark,) if lost else ())


def navigation_ready(path: Path, stem: Path) -> tuple[Path, ...]:
    """Make navigation files ready for the engine: plain RINEX 2 and 3 stay as they are.

    returns: one, or those of an archive, in which observations may stand, too.
    raises InputMalformedError, InputNotFoundError: for what cannot be read.
    """
    with reading(path):
        given = path.read_bytes()
    members = _members(given, path)
    found = [data for data in members.values() if len(members) == 1 or _is_navigation(data)]
    if not found:
        raise IllPosedError("has no ephemerides", "give a RINEX navigation file", where=path)
    made = [_navigation_3(one) for one in found]
    if made[0] is given:
        return (path,)
    return tuple(_written(one, stem.with_name(f"{stem.name}-{k}.nav")) for k, one in enumerate(made))


def _written(data: bytes, path: Path) -> Path:
    path.write_bytes(data)
    return path


def _kind(data: bytes) -> str:
    """Kind of a RINEX file by its head: O for observations; empty for what is none."""
    return data[20:21].decode("latin-1") if b"RINEX VERSION" in data[:80] else ""


def _is_navigation(data: bytes) -> bool:
    # Version 2 has files of their own for GLONASS and for what is geostationary.
    return _kind(data) in ("N", "G", "H")


def _navigation_3(data: bytes) -> bytes:
    """Ephemerides of RINEX 4 as RINEX 3 has them; others as they are."""
    if not (data[:20].strip().startswith(b"4") and b"RINEX VERSION" in data[:80]):
        return data
    return "".join(line + "\n" for line in _as_3(data.decode("latin-1").splitlines())).encode("latin-1")


def _members(data: bytes, path: Path) -> dict[str, bytes]:
    """Files of an archive by their names, each unpacked; of another file itself.

    errors as of `unpacked`.
    """
    if data[:4] != b"PK\x03\x04":
        return {path.name: unpacked(data, path, _MOST_BYTES)}
    try:
        packed = unzipped(data, _MOST_BYTES)
    except DAMAGES as refusal:
        raise InputMalformedError(
            f"cannot be unpacked ({refusal})", "fetch the file again", where=path
        ) from refusal
    most, members = _MOST_BYTES, dict[str, bytes]()
    for name, content in packed.items():
        members[name] = unpacked(content, path, most)
        most -= len(members[name])
    return members


def unpacked(data: bytes, path: Path, most: int = _MOST_BYTES) -> bytes:
    """Undo gz and Z, and Hatanaka's compression; other bytes are given back as they are.

    most: bytes that a gz file may become.

    raises InputMalformedError: for damaged files.
    raises ConfigurationError: where the package that reads them is not installed.
    """
    try:
        if data[:2] == b"\x1f\x8b":
            data = gunzipped(data, most)
        if data[:2] != b"\x1f\x9d" and b"CRINEX VERS" not in data[:100]:
            return data
        return _by_hatanaka(data, path)
    except DAMAGES as refusal:
        raise InputMalformedError(
            f"cannot be unpacked ({refusal})", "fetch the file again", where=path
        ) from refusal


def _by_hatanaka(data: bytes, path: Path) -> bytes:
    try:
        import hatanaka
    except ImportError as refusal:
        raise ConfigurationError(
            "is compressed by Hatanaka's method, or by compress (.Z), which the package hatanaka reads",
            'install it: pip install "photocal[rinex]"; or unpack the file with crx2rnx',
            where=path,
        ) from refusal
    try:
        plain: bytes = hatanaka.decompress(data)
    except Exception as refusal:
        # The package raises what its programs say as several classes.
        raise ValueError(
            str(refusal).strip().splitlines()[-1] if str(refusal).strip() else "damaged"
        ) from refusal
    return plain


def _without_1980(data: bytes) -> tuple[bytes, int]:
    """Observations without first epochs of 1980, and how many those were."""
    end = data.find(b"END OF HEADER")
    body = data.find(b"\n", end) + 1
    epoch = _EPOCH_2 if data.lstrip()[:1] == b"2" else _EPOCH_3
    lost, at = 0, body
    # Receivers that do not know the time yet start at 1980; some from the last roll over of the weeks.
    before_gnss = 1990
    for match in epoch.finditer(data, body):
        year = int(match[1])
        year += 0 if year > 99 else 1900 if year >= 80 else 2000
        at = match.start()
        if year >= before_gnss:
            break
        lost += 1
    if not lost or end < 0:
        return data, 0
    return data[:body] + data[at:], lost


def _as_3(lines: list[str]) -> Iterator[str]:
    """Ephemerides and the ionosphere of GPS of a RINEX 4 navigation file, as RINEX 3 has them."""
    yield f"{'     3.04           N: GNSS NAV DATA    M: MIXED':60}RINEX VERSION / TYPE"
    starts = [k for k, line in enumerate(lines) if line.startswith("> ")]
    records = [lines[a:b] for a, b in zip(starts, [*starts[1:], len(lines)], strict=True)]
    for head, *body in records:
        if head.split()[1:] == ["ION", *head.split()[2:3], "LNAV"] and head.split()[2][0] == "G":
            # Four and four parameters follow the time, which takes 23 columns.
            values = [
                body[0][23:42],
                body[0][42:61],
                body[0][61:80],
                *(body[1][4 + 19 * k : 23 + 19 * k] for k in range(4)),
            ]
            values.append(body[2][4:23])
            for name, four in (("GPSA", values[:4]), ("GPSB", values[4:])):
                numbers = "".join(f"{float(value.replace('D', 'E')):12.4E}" for value in four)
                yield f"{name} {numbers}".ljust(60) + "IONOSPHERIC CORR"
            break
    yield " " * 60 + "END OF HEADER"
    for head, *body in records:
        words = head.split()
        if words[1] == "EPH" and words[3] in _OF_3:
            yield from body[: _OF_3[words[3]] or None]


def _converted(data: bytes, path: Path, stem: Path, today: GpsTime, other: Path | None) -> ReadyFile:
    form = form_of(data, path)
    near = None
    if form.converter == "rtcm3":
        # The converter is given the intact frames of RTCM 3, of others all.
        frames = list(frames_of(data, Wire.RTCM3))
        data = b"".join(frame.data for frame in frames)
        near = rtcm3_time(frames, path, today, _first_epoch(other))
    observations, navigation = to_rinex(data, form.converter, stem, near)
    if not observations.exists():
        raise InputMalformedError(
            f"is {form.name}, from which the converter gets no observations",
            "check that raw observations were recorded; or convert it with the receiver's own program",
            where=path,
        )
    remark = f"{path.name} is {form.name}, read by RTKLIB's convbin"
    untried = (
        "" if form.tried else ": not tested here, no recording was available; compare with the maker's RINEX"
    )
    ready = observations_ready(observations, stem.with_name(f"{stem.name}-known"), today)
    ephemerides = (navigation,) if navigation.exists() else ()
    return ReadyFile(ready.path, ephemerides, (remark + untried, *ready.remarks))


def _first_epoch(other: Path | None) -> GpsTime | None:
    """First epoch of the other receiver where it is RINEX."""
    if other is None or not other.is_file():
        return None
    with reading(other), other.open("rb") as stream:
        if b"RINEX VERSION" not in stream.read(200):
            return None
    return read_observation_file(other).time[[0]]


def now() -> GpsTime:
    """Today, by the clock of this computer, to some seconds."""
    import time

    return GpsTime(np.array([time.time_ns() - GPS_EPOCH_NS], np.int64))
