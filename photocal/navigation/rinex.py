"""What a RINEX file covers, read without computing anything: epochs, systems, frequencies, ephemerides."""

from __future__ import annotations

import datetime as dt
from dataclasses import dataclass
from pathlib import Path
from re import compile as pattern

import numpy as np

from drivers.errors import InputMalformedError, InputNotFoundError
from photocal.navigation.time import GpsTime

_GPS_EPOCH = dt.date(1980, 1, 6)
_EPOCH_3 = pattern(r"> (\d{4}) ([ \d]\d) ([ \d]\d) ([ \d]\d) ([ \d]\d)([ \d]{2}\d\.\d+)")
_EPOCH_2 = pattern(r" (\d\d) ([ \d]\d) ([ \d]\d) ([ \d]\d) ([ \d]\d)([ \d]{2,3}\.\d{7})  [01]")
_EPHEMERIS = pattern(r"(?:[GRECJIS][ \d]\d|[ \d]\d) +\d{2,4} +\d{1,2} +\d{1,2} ")


@dataclass(frozen=True)
class ObservationFile:
    """A RINEX observation file.

    path: the file.
    time: its epochs.
    systems: letters of the satellite systems (G GPS, R GLONASS, E Galileo, J QZSS, C BeiDou).
    bands: digits of the carrier bands with phases.
    antenna, antenna_m: its type with radome, empty where not told, and its reference point above the mark.
    """

    path: Path
    time: GpsTime
    systems: frozenset[str]
    bands: frozenset[str]
    antenna: str = ""
    antenna_m: float = 0.0

    @property
    def interval_s(self) -> float:
        """Median distance of the epochs."""
        return float(np.median(np.diff(self.time.ns))) / 1e9 if len(self.time) > 1 else 0.0


def read_observation_file(path: Path) -> ObservationFile:
    """Read the epochs of a RINEX 2 or 3 observation file."""
    lines = _lines(path)
    if not lines or "RINEX VERSION" not in lines[0] or lines[0][20:21] != "O":
        raise InputMalformedError(
            "is no RINEX observation file", where=path, remedy="give the file with ending .obs"
        )
    second = lines[0].lstrip().startswith("2")
    systems, bands, end = set(), set(), len(lines)
    letter, antenna, antenna_m = "", "", 0.0
    for number, line in enumerate(lines):
        label = line[60:].strip()
        if label == "END OF HEADER":
            end = number + 1
            break
        if label == "SYS / # / OBS TYPES":
            letter = line[0] if line[0] != " " else letter
            systems.add(letter)
            bands |= {code[1] for code in line[7:60].split() if code[0] == "L"}
        elif label == "ANT # / TYPE":
            antenna = " ".join(line[20:40].split())
        elif label == "ANTENNA: DELTA H/E/N":
            antenna_m = float(line[:14].strip() or 0.0)
        elif label == "# / TYPES OF OBSERV":
            bands |= {code[1] for code in line[6:60].split() if code[0] == "L"}
        elif label == "TIME OF FIRST OBS" and line[48:51].strip() not in ("", "GPS"):
            raise InputMalformedError(
                f"counts {line[48:51]} time", where=path, remedy="convert it with GPS time"
            )
    epoch = _EPOCH_2 if second else _EPOCH_3
    found = [match for line in lines[end:] if (match := epoch.match(line))]
    if second:
        systems = set("GR")
    if not found:
        raise InputMalformedError("has no epochs", where=path, remedy="check the recording")
    return ObservationFile(
        path,
        GpsTime(np.array([_gps_ns(*match.groups()) for match in found], np.int64)),
        frozenset(systems),
        frozenset(bands),
        antenna,
        antenna_m,
    )


def count_ephemerides(path: Path) -> int:
    """Return how many ephemerides a RINEX navigation file has; 0 also when it does not exist."""
    if not path.exists():
        return 0
    return sum(1 for line in _lines(path) if _EPHEMERIS.match(line))


def _lines(path: Path) -> list[str]:
    try:
        return path.read_text("latin-1").splitlines()
    except OSError as refusal:
        reason = (refusal.strerror or str(refusal)).lower()
        raise InputNotFoundError(
            f"cannot be read ({reason})", where=path, remedy="check name and rights"
        ) from refusal


def _gps_ns(*fields: str) -> int:
    year, month, day, hour, minute = map(int, fields[:5])
    if year < 100:
        year += 1900 if year >= 80 else 2000
    whole, part = fields[5].split(".")
    days = (dt.date(year, month, day) - _GPS_EPOCH).days
    seconds = days * 86_400 + hour * 3600 + minute * 60 + int(whole)
    return seconds * 1_000_000_000 + int(part.ljust(9, "0")[:9])
