"""Coordinate systems as people call them: by name, alias or country, compared with coordinates and places.

Geoid and datum grids of PROJ: which are here, which a reference system needs, and how they come here.
"""

import os
import re
import sqlite3
import tomllib
import unicodedata
import warnings
from collections.abc import Iterable, Iterator, Mapping
from contextlib import closing
from dataclasses import dataclass
from functools import cache
from importlib import resources
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from photocal.base.arrays import Floats
from photocal.base.errors import ConfigurationError, OutputError
from photocal.geometry.frames import system_of

if TYPE_CHECKING:
    from pyproj.transformer import TransformerGroup


# Systems that are offered where a name leaves more than one.
MOST = 5
# What national systems are called at home, in the words of the register.
_AT_HOME: dict[str, str] = tomllib.loads(
    resources.files("photocal.geometry").joinpath("systems.toml").read_text("utf-8")
)["at_home"]
# Words that say nothing of which system it is.
_EMPTY = {"zone", "fuso", "huso", "zona", "crs", "coordinate", "system", "the", "of", "and", "e", "de"}
_WORDS = re.compile(r"[a-z]+|\d+")


@dataclass(frozen=True)
class MapSystem:
    """A map system of the register.

    code: as "EPSG:2180".
    area: name of its area of use.
    bounds: west, south, east, north of it, deg.
    """

    code: str
    name: str
    area: str
    bounds: tuple[float, float, float, float]

    def __str__(self) -> str:
        return f"{self.code} ({self.name}; {self.area.split('.')[0][:60].strip()})"


def called(text: str, places: Floats | None = None, most: int = MOST) -> tuple[MapSystem, ...]:
    """Map systems that a text may mean, the likeliest first; one alone where the text leaves no doubt.

    places (n, 2): coordinates in it, east and north, or exchanged; a system is not meant in whose area of use
        they do not lie.
    """
    wanted = _words(_translated(text))
    if not wanted:
        return ()
    ranked = sorted(_ranked(wanted), key=lambda found: found[0])
    shown: list[MapSystem] = []
    best: tuple[int, int] | None = None
    for rank, system in ranked:
        # What fits fewer of the words is offered only where nothing fits more.
        if best is not None and rank[:2] > best:
            break
        if places is not None and not covers(system, places):
            continue
        best = best or rank[:2]
        shown.append(system)
        if len(shown) == most:
            break
    official = [system for system in shown if system.code.startswith("EPSG:")]
    return tuple(official or shown)


def is_meant(text: str, system: MapSystem) -> bool:
    """Whether every word of a text stands in one of the names of a system."""
    wanted = _words(_translated(text))
    return any(wanted <= _words(name) for name in (system.name, *_aliases().get(system.code, ())))


def at_place(latitude: float, longitude: float, places: Floats) -> tuple[MapSystem, ...]:
    """Map systems in which coordinates, shape (n, 2), lie near a place that is known in degrees."""
    middle, found = np.median(places, axis=0), list[tuple[float, MapSystem]]()
    # How far control may lie from what pictures say of their place, m.
    near_m = 5_000.0
    for system in _register():
        west, south, east, north = system.bounds
        if not (south <= latitude <= north and west <= longitude <= east and "EPSG:" in system.code):
            continue
        way = _to_degrees(system.code)
        if way is None:
            continue
        away = float(
            np.linalg.norm(np.array(way.transform(longitude, latitude, direction="INVERSE")) - middle)
        )
        if away <= near_m:
            # Of systems that are all near the smaller area is the likelier.
            found.append(((east - west) * (north - south), system))
    return tuple(system for _, system in sorted(found, key=lambda one: one[0])[:MOST])


def exchanged_in(crs: str, places: Floats) -> bool:
    """Whether places (n, 2) lie in the area of use of a map system only with east and north exchanged."""
    if crs in ("", "local") or not system_of(crs).is_projected:
        return False
    known = places[np.isfinite(places).all(axis=1)]
    way, outside = _to_degrees(crs), list[bool]()
    for x, y in (known.T, known.T[::-1]) if way is not None else ():
        longitude, latitude = (np.asarray(value, dtype=np.float64) for value in way.transform(x, y))
        on_earth = np.isfinite(longitude) & np.isfinite(latitude)
        away = degrees_outside(crs, np.where(on_earth, latitude, 90.0), np.where(on_earth, longitude, 0.0))
        # A site at the edge of the area is none elsewhere, deg.
        outside.append(bool(np.median(np.where(on_earth, away, np.inf)) > 1.0))
    return outside == [True, False]


def covers(system: MapSystem, places: Floats) -> bool:
    """Whether most coordinates lie in the area of use, as they are or east and north exchanged."""
    west, south, east, north = system.bounds
    way = _to_degrees(system.code)
    if way is None:
        return False
    for x, y in (places.T, places.T[::-1]):
        longitude, latitude = (np.asarray(v, dtype=np.float64) for v in way.transform(x, y))
        with np.errstate(invalid="ignore"):
            inside = (longitude >= west) & (longitude <= east) & (latitude >= south) & (latitude <= north)
        if 2 * inside.sum() > len(places):
            return True
    return False


@cache
def _to_degrees(code: str) -> Any:
    """The way from a map system to longitude and latitude; None where there is none."""
    from pyproj import Transformer
    from pyproj.exceptions import ProjError

    try:
        return Transformer.from_crs(code, "EPSG:4326", always_xy=True)
    except ProjError:
        return None


def degrees_outside(crs: str, latitude: Floats, longitude: Floats) -> Floats:
    """By how many degrees places lie outside the area of use of a system; 0 inside, and where it has none."""
    area = system_of(crs).area_of_use
    if area is None:
        return np.zeros(len(latitude))
    beside = np.maximum(np.maximum(area.south - latitude, latitude - area.north), 0.0)
    # An area may lie over the meridian of 180 degrees.
    width = (area.east - area.west) % 360.0 or 360.0
    off = (longitude - area.west) % 360.0
    aside = np.where(off <= width, 0.0, np.minimum(off - width, 360.0 - off))
    return np.asarray(np.hypot(beside, aside))


def heights_at(latitude: float, longitude: float) -> tuple[tuple[str, str], ...]:
    """Vertical systems of a place, codes and names: those of the smaller areas first, the world's last."""
    from pyproj.aoi import AreaOfInterest
    from pyproj.database import query_crs_info
    from pyproj.enums import PJType

    here = AreaOfInterest(longitude, latitude, longitude, latitude)
    found = [
        (_extent(info.area_of_use), info.code, info.name)
        for info in query_crs_info("EPSG", PJType.VERTICAL_CRS, here, contains=True)
        if "depth" not in info.name and "(ft" not in info.name
    ]
    world = [one for one in found if one[1] in ("5773", "3855")]
    national = sorted(one for one in found if one not in world and one[0] < 10_000)
    return tuple((code, name) for _, code, name in (*national[: MOST - len(world)], *world))


def _extent(area: Any) -> float:
    return float((area.east - area.west) * (area.north - area.south))


def _translated(text: str) -> str:
    plain = " ".join(_WORDS.findall(_folded(text)))
    for home, register in _AT_HOME.items():
        plain = re.sub(rf"\b{home}\b", register, plain)
    return plain


def _folded(text: str) -> str:
    text = text.replace("ł", "l").replace("Ł", "L")
    return unicodedata.normalize("NFKD", text).encode("ascii", "ignore").decode().lower()


def _words(text: str) -> frozenset[str]:
    return frozenset(_WORDS.findall(_folded(text))) - _EMPTY


def _ranked(wanted: frozenset[str]) -> Iterator[tuple[tuple[int, int, int, int, str], MapSystem]]:
    """Systems with at least half of the words: those that lack fewer first, then by words nobody has said."""
    for system, country, names in _indexed():
        lacks, more = min((len(wanted - words - country), len(words - wanted)) for words in names)
        by_country = min(len(wanted - words) for words in names)
        if 2 * lacks < len(wanted) or (lacks == 0 and by_country):
            foreign = not system.code.startswith("EPSG:")
            yield (lacks, int(foreign), by_country, more, system.code), system


@cache
def _indexed() -> tuple[tuple[MapSystem, frozenset[str], tuple[frozenset[str], ...]], ...]:
    """Every system with the words of its area of use, and those of each of its names."""
    return tuple(
        (
            system,
            _words(system.area),
            tuple(_words(name) for name in (system.name, *_aliases().get(system.code, ()))),
        )
        for system in _register()
    )


@cache
def _register() -> tuple[MapSystem, ...]:
    """Every map system in metres that is in use."""
    from pyproj.database import query_crs_info
    from pyproj.enums import PJType

    # A system of several areas stands there once for each.
    systems: dict[str, MapSystem] = {}
    for info in query_crs_info(pj_types=PJType.PROJECTED_CRS):
        area, code = info.area_of_use, f"{info.auth_name}:{info.code}"
        if area is not None and info.auth_name in ("EPSG", "ESRI") and "(ft" not in info.name:
            bounds = (area.west, area.south, area.east, area.north)
            systems.setdefault(code, MapSystem(code, info.name, area.name or "", bounds))
    return tuple(systems.values())


@cache
def _aliases() -> Mapping[str, tuple[str, ...]]:
    """Other names of map systems, of the register's own file; none where it is not to be read."""
    from pyproj.datadir import get_data_dir

    found: dict[str, list[str]] = {}
    for folder in get_data_dir().split(os.pathsep):
        path = Path(folder) / "proj.db"
        if path.is_file():
            for auth, code, name in _rows(path):
                found.setdefault(f"{auth}:{code}", []).append(name)
    return {code: tuple(names) for code, names in found.items()}


def _rows(path: Path) -> Iterable[tuple[str, str, str]]:
    query = "SELECT auth_name, code, alt_name FROM alias_name WHERE table_name = 'projected_crs'"
    try:
        with closing(sqlite3.connect(f"{path.resolve().as_uri()}?mode=ro", uri=True)) as database:
            return list(database.execute(query))
    except sqlite3.Error:
        return []


Area = tuple[float, float, float, float]


def grids_here() -> list[str]:
    """Names of the grids that PROJ finds on this machine."""
    from pyproj import datadir

    folders = {*datadir.get_data_dir().split(os.pathsep), _user_folder()}
    paths = (path for folder in folders for path in Path(folder).glob("*"))
    return sorted({path.name for path in paths if path.suffix in (".tif", ".gtx")})


def _user_folder(*, create: bool = False) -> str:
    from pyproj import _context

    return str(_context.get_user_data_dir(create=create))


def missing_grids(crs: str, area: Area | None = None) -> list[str]:
    """Name the grids that the best way from GNSS coordinates to a system needs and that are not here.

    area: west, south, east, north, degrees; the whole area of the system when not given.
    raises ConfigurationError: when there is no such system.
    """
    group = _ways(crs, area)
    best = [operation for operation in group.unavailable_operations[:1] if not group.best_available]
    return sorted({grid.short_name for operation in best for grid in operation.grids if not grid.available})


def fetch_grids(crs: str, area: Area | None = None) -> tuple[str, ...]:
    """Download the missing grids of a system into the user's folder of PROJ, and name them.

    raises OutputError: when the network or the folder refuses.
    """
    missing = missing_grids(crs, area)
    if missing:
        folder = Path(_user_folder(create=True))
        try:
            _ways(crs, area).download_grids(folder, open_license=True)
        except OSError as refusal:
            raise OutputError(
                f"{', '.join(missing)} cannot be fetched ({refusal})",
                "connect to the network, or copy these files of the PROJ data there",
                where=folder,
            ) from None
    return tuple(missing)


def _ways(crs: str, area: Area | None) -> "TransformerGroup":
    from pyproj.aoi import AreaOfInterest
    from pyproj.exceptions import CRSError
    from pyproj.transformer import TransformerGroup

    interest: Any = None if area is None else AreaOfInterest(*area)
    with warnings.catch_warnings():
        # It warns of what is missing: that is the question here.
        warnings.simplefilter("ignore", UserWarning)
        try:
            return TransformerGroup(
                "EPSG:4979", crs, always_xy=True, area_of_interest=interest, allow_ballpark=False
            )
        except CRSError as refusal:
            raise ConfigurationError(
                f"there is no reference system {crs!r}", "name one such as EPSG:31982+5773"
            ) from refusal
