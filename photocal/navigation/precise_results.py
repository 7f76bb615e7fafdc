"""Files that others wrote: RINEX headers, CSRS-PPP's summary, SINEX positions, names of antennas."""

import datetime as dt
import difflib
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from re import compile as pattern

import numpy as np

from photocal.base.arrays import Floats
from photocal.base.errors import ConfigurationError, InputMalformedError, reading
from photocal.base.policy import policy
from photocal.geometry.realizations import Realization, known_realization
from photocal.navigation.time import GpsTime, exact_ns
from photocal.navigation.trajectory import enu_axes_at

_GPS_EPOCH = dt.date(1980, 1, 6)
_EPOCH_3 = pattern(r"> (\d{4}) ([ \d]\d) ([ \d]\d) ([ \d]\d) ([ \d]\d)([ \d]{2}\d\.\d+)")
_EPOCH_2 = pattern(r" (\d\d) ([ \d]\d) ([ \d]\d) ([ \d]\d) ([ \d]\d)([ \d]{2,3}\.\d{7})  [01]")
_EPHEMERIS = pattern(r"(?:[GRECJIS][ \d]\d|[ \d]\d) +\d{2,4} +\d{1,2} +\d{1,2} ")


@dataclass(frozen=True)
class ObservationFile:
    """A RINEX observation file.

    systems: letters of the satellite systems (G GPS, R GLONASS, E Galileo, J QZSS, C BeiDou).
    bands: digits of the carrier bands with phases.
    antenna, antenna_m: its type with radome, empty where not stated, and its reference point above the mark.
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
    malformed = InputMalformedError.at(path)
    if not lines or "RINEX VERSION" not in lines[0] or lines[0][20:21] != "O":
        raise malformed("is not a RINEX observation file", "name the observation file (.obs)")
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
            bands |= {code[1] for code in line[7:60].split() if code[0] == "L" and code[1:]}
        elif label == "ANT # / TYPE":
            antenna = " ".join(line[20:40].split())
        elif label == "ANTENNA: DELTA H/E/N":
            antenna_m = _height(line[:14], path)
        elif label == "# / TYPES OF OBSERV":
            bands |= {code[1] for code in line[6:60].split() if code[0] == "L" and code[1:]}
        elif label == "TIME OF FIRST OBS" and line[48:51].strip() not in ("", "GPS"):
            raise malformed(f"counts {line[48:51]} time", "convert it with GPS time")
    epoch = _EPOCH_2 if second else _EPOCH_3
    epochs = [match for line in lines[end:] if (match := epoch.match(line))]
    if second:
        systems = set("GR")
    if not epochs:
        raise malformed("has no epochs", "check the recording")
    try:
        time = GpsTime(np.array([_gps_ns(*match.groups()) for match in epochs], np.int64))
    except (ValueError, OverflowError) as failure:
        raise malformed(f"has an impossible date ({failure})", "was it damaged?") from failure
    return ObservationFile(path, time, frozenset(systems), frozenset(bands), antenna, antenna_m)


def _height(cell: str, path: Path) -> float:
    try:
        return float(cell.strip() or 0.0)
    except ValueError as failure:
        raise InputMalformedError(f"has the antenna height {cell.strip()!r}", where=path) from failure


def count_ephemerides(path: Path) -> int:
    """Return how many ephemerides a RINEX navigation file has; 0 also when it does not exist."""
    if not path.exists():
        return 0
    return sum(1 for line in _lines(path) if _EPHEMERIS.match(line))


def _lines(path: Path) -> list[str]:
    with reading(path):
        text = path.read_text("latin-1")
    return text.splitlines()


def _gps_ns(*fields: str) -> int:
    year, month, day, hour, minute = map(int, fields[:5])
    if year < 100:
        year += 1900 if year >= 80 else 2000
    days = (dt.date(year, month, day) - _GPS_EPOCH).days
    return (days * 1440 + hour * 60 + minute) * 60_000_000_000 + exact_ns(fields[5])


@dataclass(frozen=True)
class PreciseResult:
    """One position, earth-centred.

    position_m (3,), covariance_m2 (3, 3): X, Y, Z.
    frame: as the service names it, "IGS20"; empty where it does not.
    epoch: of the coordinates, years.
    """

    position_m: Floats
    covariance_m2: Floats
    frame: str
    epoch: float

    @property
    def sigma_enu_m(self) -> Floats:
        """Standard deviations east, north, up, shape (3,)."""
        turn = enu_axes_at(self.position_m)
        return np.asarray(np.sqrt(np.diag(turn @ self.covariance_m2 @ turn.T)))

    @property
    def realization(self) -> Realization | None:
        """Frame and epoch; None for a frame that is not stated, or stated without its version."""
        return known_realization(self.frame, self.epoch) if self.frame else None

    @property
    def description(self) -> str:
        """Frame and epoch for a person."""
        return f" ({self.frame or 'frame not stated'}, epoch {self.epoch:.4f})"


def read_precise_result(path: Path, site: str = "", name: str = "") -> PreciseResult:
    """Read the result of a service: the summary (.sum) of CSRS-PPP, or SINEX.

    site: code of the site in SINEX, such as the weekly solution of a network.
    name: its code where none is given and the file has several sites.

    raises ConfigurationError: when the file has no such site, or several and none is named.
    """
    lines = _lines(path)
    try:
        if any(line.startswith("POS CRD") for line in lines):
            if site:
                raise ConfigurationError("has no sites: it is a summary", "leave site out", where=path)
            return _of_csrs(lines)
        if lines and lines[0].startswith("%=SNX"):
            return _of_sinex(lines, path, site, name)
    except (ValueError, IndexError, KeyError) as refusal:
        raise InputMalformedError("is damaged", "fetch it again", where=path) from refusal
    raise InputMalformedError(
        "is not a known kind of result",
        "give the summary (.sum) of CSRS-PPP, the program of IBGE-PPP, a SINEX file, or LAT,LON,H",
        where=path,
    )


def _of_csrs(lines: list[str]) -> PreciseResult:
    head = next(line for line in lines if line.startswith("POS CRD")).split()
    rows = {cells[1]: cells for line in lines if (cells := line.split())[:1] == ["POS"]}
    position = np.array([float(rows[axis][5]) for axis in "XYZ"])
    # With a transformation to another epoch a second sigma follows, which has its uncertainty.
    total = any(word.startswith("SIG_TOT") for word in head)
    sigma, whole, correlation = np.zeros(3), np.zeros(3), np.eye(3)
    # Latitude and longitude stand in degrees, minutes and seconds.
    for row, (axis, first) in enumerate((("LAT", 11), ("LON", 11), ("HGT", 7))):
        cells = rows[axis]
        sigma[row], whole[row] = (float(cells[first + k * total]) / policy.times_95 for k in (0, 1))
        for column, text in enumerate(cells[first + 1 + total : first + 1 + total + row]):
            correlation[row, column] = correlation[column, row] = float(text)
    local = correlation * np.outer(sigma, sigma) + np.diag(whole**2 - sigma**2)
    north_east_up = enu_axes_at(position)[[1, 0, 2]]
    covariance = north_east_up.T @ local @ north_east_up
    return PreciseResult(position, covariance, rows["X"][2], _year(rows["X"][3]))


def _of_sinex(lines: list[str], path: Path, site: str, name: str) -> PreciseResult:
    first, last = (lines.index(f"{sign}SOLUTION/ESTIMATE") for sign in "+-")
    sites: dict[str, dict[str, list[str]]] = {}
    for line in lines[first + 1 : last]:
        cells = line.split()
        if len(cells) > 9 and cells[1] in ("STAX", "STAY", "STAZ"):
            # Of a site with several solutions the last one counts.
            sites.setdefault(cells[2], {})[cells[1]] = cells
    code = site or (name if len(sites) > 1 else "")
    wanted = [one for one in sites if not code or one.upper() == code.upper()]
    if len(wanted) != 1:
        # Sites that a message names.
        most_listed = 12
        near = difflib.get_close_matches(code.upper(), sites, most_listed, 0.0) if code else list(sites)
        listed = ", ".join(sorted(near[:most_listed])) or "none"
        more = "" if len(sites) <= most_listed else ", ..."
        raise ConfigurationError(
            f"has no site {code}" if code else f"has {len(sites)} sites ({listed}{more})",
            f"name one of {listed}{more}" if code else "name the site, give a file of one, or its LAT,LON,H",
            where=path,
        )
    rows = sites[wanted[0]]
    axes = [rows[f"STA{axis}"] for axis in "XYZ"]
    sigma = np.array([float(cells[9]) for cells in axes])
    position = np.array([float(cells[8]) for cells in axes])
    return PreciseResult(position, np.diag(sigma**2), "", _year(axes[0][5]))


def _year(text: str) -> float:
    """Year of an epoch as both write it: two digits, day of the year, seconds of the day."""
    year, day, second = (int(part) for part in text.split(":"))
    year += 1900 if year > 50 else 2000
    days = 366 if year % 4 == 0 and (year % 100 or year % 400 == 0) else 365
    return year + (day - 1 + second / 86_400) / days


def read_antennas(path: Path) -> tuple[str, ...]:
    """Read the names (type and radome) of the receiver antennas whose models an ANTEX file has."""
    with reading(path, "name an ANTEX file, such as igs20.atx of the IGS"):
        lines = path.read_text(encoding="latin-1").splitlines()
    if not any(line[60:].startswith("ANTEX VERSION") for line in lines[:5]):
        raise InputMalformedError("is not an ANTEX file", "name one, such as igs20.atx", where=path)
    names = []
    starts = [k for k, line in enumerate(lines) if line[60:].startswith("START OF ANTENNA")]
    for start, end in zip(starts, [*starts[1:], len(lines)], strict=True):
        try:
            name = _name(lines[start:end])
        except (ValueError, IndexError) as refusal:
            raise InputMalformedError(
                "is damaged", "fetch the file again", where=f"{path}, antenna of line {start + 1}"
            ) from refusal
        if name is not None:
            names.append(name)
    return tuple(names)


def _name(lines: list[str]) -> str | None:
    """Read one antenna, its numbers, too, which the engine uses; None for a satellite's."""
    name, frequency = "", ""
    for line in lines:
        label, cells = line[60:].strip(), line[:60].split()
        if label == "TYPE / SERIAL NO":
            # A satellite has its number where a receiver antenna has none or a serial number.
            if line[20:21] in set("GRECJIS") and line[21:23].isdigit():
                return None
            name = " ".join(line[:20].split())
        elif label == "START OF FREQUENCY":
            frequency = cells[0]
        elif label in ("ZEN1 / ZEN2 / DZEN", "NORTH / EAST / UP"):
            _ = [float(cell) for cell in cells]
        elif frequency and line[:8].strip() == "NOAZI":
            _ = [float(cell) for cell in line[8:].split()]
    return name


def antenna_named(antennas: Sequence[str], name: str, path: Path) -> str:
    """Give the name of an antenna's model; without its radome where the file knows it with NONE only."""
    wanted = " ".join(name.split())
    for key in (wanted, f"{wanted} NONE", f"{wanted.split(' ')[0]} NONE" if wanted else ""):
        if key in antennas:
            return key
    alike = difflib.get_close_matches(wanted, antennas, 3, 0.4)
    raise ConfigurationError(
        f"antenna {name!r} is not in {path.name}",
        f"give type and radome as the file has them: {', '.join(alike) or 'none is similar'}",
        where=path,
    )
