"""Observation and navigation files as people have them, made ready for the engine.

Compressed (gz, Z, zip), Hatanaka's compact RINEX, RINEX 4, first epochs of 1980 of a receiver that did not
know the time yet, and raw files of receivers.
"""

import gzip
import io
import re
import zipfile
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from photocal.base.errors import ConfigurationError, InputMalformedError, reading
from photocal.base.time_scales import GPS_EPOCH_NS
from photocal.navigation.engine import Rtklib
from photocal.navigation.precise_results import read_observation_file
from photocal.navigation.receiver_files import form_of, intact, rtcm3_frames, rtcm3_time
from photocal.navigation.time import GpsTime

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


def observations_ready(
    path: Path, engine: Rtklib, stem: Path, today: GpsTime, other: Path | None = None
) -> ReadyFile:
    """Make observations ready for the engine: plain RINEX stays as it is.

    stem: where files are made, without an ending.
    today: see `rtcm3_time`.
    other: observations of the other receiver, by whose date the week of RTCM is told where nothing else does.
    raises InputMalformedError: for what is no file of observations.
    """
    with reading(path):
        given = path.read_bytes()
    data = unpacked(given, path)
    if b"RINEX VERSION" not in data[:200]:
        return _converted(data, path, engine, stem, today, other)
    kept, lost = _without_1980(data)
    if kept is given:
        return ReadyFile(path)
    made = stem.with_suffix(".obs")
    made.write_bytes(kept)
    remark = f"{path.name}: {lost} first epochs of 1980, when the receiver did not know the time, left out"
    return ReadyFile(made, (), (remark,) if lost else ())


def navigation_ready(path: Path, stem: Path) -> Path:
    """Make a navigation file ready for the engine: plain RINEX 2 and 3 stay as they are.

    raises InputMalformedError, InputNotFoundError: for what cannot be read.
    """
    with reading(path):
        given = path.read_bytes()
    data = unpacked(given, path)
    if data[:20].strip().startswith(b"4") and b"RINEX VERSION" in data[:80]:
        data = "".join(line + "\n" for line in _as_3(data.decode("latin-1").splitlines())).encode("latin-1")
    if data is given:
        return path
    made = stem.with_suffix(".nav")
    made.write_bytes(data)
    return made


def unpacked(data: bytes, path: Path) -> bytes:
    """Undo gz, zip and Z, and Hatanaka's compression; other bytes are given back as they are.

    raises InputMalformedError: for damaged files.
    raises ConfigurationError: where the package that reads them is not installed.
    """
    try:
        if data[:2] == b"\x1f\x8b":
            data = gzip.decompress(data)
        elif data[:4] == b"PK\x03\x04":
            data = _only_member(data, path)
        if data[:2] != b"\x1f\x9d" and b"CRINEX VERS" not in data[:100]:
            return data
        return _by_hatanaka(data, path)
    except (OSError, EOFError, ValueError, zipfile.BadZipFile) as refusal:
        raise InputMalformedError(
            f"cannot be unpacked ({refusal})", "fetch the file again", where=path
        ) from refusal


def _only_member(data: bytes, path: Path) -> bytes:
    with zipfile.ZipFile(io.BytesIO(data)) as archive:
        names = [name for name in archive.namelist() if not name.endswith("/")]
        if len(names) != 1:
            raise InputMalformedError(
                f"has {len(names)} files ({', '.join(names[:5])})",
                "unpack it and name the one with the observations",
                where=path,
            )
        return archive.read(names[0])


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
    # Receivers that do not know the time yet count from 1980; some from the last roll over of the weeks.
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


def _converted(
    data: bytes, path: Path, engine: Rtklib, stem: Path, today: GpsTime, other: Path | None
) -> ReadyFile:
    form = form_of(data, path)
    near = None
    if form.converter == "rtcm3":
        near = rtcm3_time(list(rtcm3_frames(data)), path, today, _first_epoch(other))
    observations, navigation = engine.convert(intact(data, form), form.converter, stem, near)
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
    ready = observations_ready(observations, engine, stem.with_name(f"{stem.name}-known"), today)
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
