"""Frame and epoch of positions: by how much those of one count apart from those of another.

In frames of the world (ITRF, IGS) the ground moves by centimetres a year; systems of countries are fixed to
their plate. PROJ has the way between the frames, and from them to most systems that are fixed to a plate; for
those that it takes for equal to a frame of the world, `realizations.toml` has frame, epoch and plate.
"""

import difflib
import math
import re
import tomllib
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cache
from importlib import resources
from typing import TYPE_CHECKING

import numpy as np

from photocal.base.arrays import Floats
from photocal.base.errors import ConfigurationError
from photocal.base.geodesy import enu_axes, geodetic
from photocal.geometry.frames import system_of

if TYPE_CHECKING:
    from pyproj import Transformer

# The frame that every way goes through; its plate model is that of Altamimi et al. (2023,
# doi:10.1029/2023GL106373), with the rate of its origin, as PROJ ships it.
_HUB, _PLATES = "ITRF2020", "ITRF2020"
_KNOWN = tomllib.loads(resources.files("photocal.geometry").joinpath("realizations.toml").read_text("utf-8"))


@dataclass(frozen=True)
class Realization:
    """A frame with the epoch of its coordinates.

    frame: as PROJ calls it, "IGS20", "SIRGAS 2000".
    epoch: years; None for what is fixed to a plate, and where it is unknown.
    """

    frame: str
    epoch: float | None = None

    def __str__(self) -> str:
        epoch = FIXED[self.frame][0].epoch if self.frame in FIXED else self.epoch
        return self.frame + ("" if epoch is None else f", epoch {epoch:.10g}")

    @property
    def moves(self) -> bool:
        """Whether the ground moves in it: its coordinates need an epoch."""
        return _is_dynamic(self.frame)


# National systems that are a frame of the world, stopped at an epoch: that frame, and the plate since.
FIXED: Mapping[str, tuple[Realization, str]] = {
    name: (Realization(one["frame"], one["epoch"]), one["plate"]) for name, one in _KNOWN["fixed"].items()
}


@dataclass(frozen=True)
class FrameShift:
    """What is to be added to a position in one realization for its position in another.

    shift_m (3,): earth-centred.
    shift_enu_m (3,): the same, east, north, up.
    sigma_m: of each axis.
    way: how it was computed, in words.
    """

    source: Realization
    target: Realization
    shift_m: Floats
    shift_enu_m: Floats
    sigma_m: float
    way: str

    @property
    def size_m(self) -> float:
        """Length of the shift."""
        return float(np.linalg.norm(self.shift_m))

    def as_json(self) -> dict[str, object]:
        """Figures for JSON."""
        return {
            "from": str(self.source),
            "to": str(self.target),
            "shift_enu_m": self.shift_enu_m.tolist(),
            "sigma_m": self.sigma_m,
            "way": self.way,
        }


def realization(text: str) -> Realization:
    """Read `FRAME[@EPOCH]`, as "IGS20@2026.9", "SIRGAS2000" or "EPSG:31982".

    raises ConfigurationError: for a frame that is not known, or an epoch that is no year.
    """
    name, _, epoch = text.partition("@")
    found = known_realization(name)
    if found is None:
        alike = difflib.get_close_matches(_plain(name), list(_frames()), 3, 0.5)
        raise ConfigurationError(
            f"there is no frame {name.strip()!r}",
            f"name one with its epoch, such as IGS20@2026.9 or SIRGAS2000"
            f"{'; alike: ' + ', '.join(_frames()[one] for one in alike) if alike else ''}",
        )
    if not epoch:
        return found
    try:
        year = float(epoch)
    except ValueError:
        year = math.nan
    if not 1980 <= year <= 2100:
        raise ConfigurationError(f"{epoch!r} is not an epoch", "give it in years, such as IGS20@2026.9")
    return Realization(found.frame, year)


def known_realization(name: str, epoch: float | None = None) -> Realization | None:
    """Realization of a frame by its name, or of a coordinate system by its code; None for others.

    WGS 84 and NAD83 without a version are of unknown realization.
    """
    from pyproj.exceptions import CRSError

    frame = _frames().get(_plain(name))
    if frame is None and ":" in name:
        try:
            geodetic_system = system_of(name).geodetic_crs
        except CRSError:
            return None
        frame = None if geodetic_system is None else _frames().get(_plain(geodetic_system.name))
    return None if frame is None else Realization(frame, epoch)


def frame_shift(place_m: Floats, source: Realization, target: Realization) -> FrameShift | None:
    """Give the shift of a place from one realization to another.

    place_m (3,): earth-centred.
    returns: None where no transformation between them is known, where an epoch is missing, or where both are
        moving frames of different epochs and the plate is unknown.
    """
    start, here = FIXED.get(source.frame, (source, None))
    end, there = FIXED.get(target.frame, (target, None))
    # What is fixed to a plate is the same at every epoch: it is met at that of the other.
    first = start.epoch if start.moves else end.epoch
    last = end.epoch if end.moves else first
    plate = there or here
    if first is None or last is None or (first != last and plate is None):
        return None
    place = np.asarray(place_m, np.float64)
    between = _between_frames(_of_itrf(start.frame), _HUB, place, first)
    if between is None:
        return None
    place, variance, ways = between
    if first != last:
        place = np.array(_plate_motion(plate or "", first).transform(place[0], place[1], place[2], last)[:3])
        # Stations on rigid ground scatter about the model by 0.25 mm a year (there, table 2). Others, and
        # their heights, which it leaves out, may move by more: cautious.
        plate_sigma_m_a = 0.001
        variance += (plate_sigma_m_a * (last - first)) ** 2
        ways += (f"the plate model of {_PLATES}, {plate}, over {abs(last - first):.1f} years",)
    between = _between_frames(_HUB, _of_itrf(end.frame), place, last)
    if between is None:
        return None
    place, ways = between[0], (*ways, *between[2])
    variance += between[1]
    latitude, longitude, _ = geodetic(np.asarray(place_m))
    shift = place - place_m
    local = enu_axes(float(latitude), float(longitude)) @ shift
    return FrameShift(source, target, shift, local, math.sqrt(variance), "; ".join(ways) or "identity")


def _between_frames(
    one: str, other: str, place: Floats, epoch: float
) -> tuple[Floats, float, tuple[str, ...]] | None:
    """Place in another frame at the same epoch, variance of the way, and its words; None without a way."""
    if one == other:
        return place, 0.0, ()
    way = _way(one, other)
    if way is None:
        return None
    moved = np.array(way.transform(place[0], place[1], place[2], epoch)[:3])
    # Which of several ways is taken shows after its use.
    accuracy = way.get_last_used_operation().accuracy if way.accuracy < 0 else way.accuracy
    # Of two realizations of the world's frame, where PROJ tells none.
    way_sigma_m = 0.01
    return moved, (accuracy if accuracy > 0 else way_sigma_m) ** 2, (f"{one} to {other}",)


def _of_itrf(frame: str) -> str:
    known: dict[str, str] = _KNOWN["of_igs"]
    return known.get(frame, frame)


def _plain(name: str) -> str:
    """Letters and digits alone; two digits of a year are four."""
    plain = re.sub(r"[^a-z0-9]", "", name.lower())
    short = re.fullmatch(r"(itrf|etrf)(\d\d)", plain)
    if short is not None and int(short[2]) < 80:
        plain = f"{short[1]}20{short[2]}"
    alike: dict[str, str] = _KNOWN["alike"]
    return alike.get(plain, plain)


@cache
def _frames() -> Mapping[str, str]:
    """Names of the geocentric systems of the register, by their letters and digits."""
    from pyproj.database import query_crs_info
    from pyproj.enums import PJType

    return {
        re.sub(r"[^a-z0-9]", "", info.name.lower()): info.name
        for info in query_crs_info("EPSG", PJType.GEOCENTRIC_CRS)
        if info.name != "WGS 84"
    }


@cache
def _code(frame: str) -> str:
    from pyproj.database import query_crs_info
    from pyproj.enums import PJType

    infos = query_crs_info("EPSG", PJType.GEOCENTRIC_CRS)
    return next(f"EPSG:{info.code}" for info in infos if info.name == frame)


@cache
def _is_dynamic(frame: str) -> bool:
    datum = system_of(_code(frame)).to_json_dict().get("datum", {})
    return bool(datum.get("type") == "DynamicGeodeticReferenceFrame")


@cache
def _way(one: str, other: str) -> "Transformer | None":
    """Transformation between two frames of the register; None where PROJ would only equate them."""
    from pyproj import Transformer
    from pyproj.exceptions import ProjError

    try:
        return Transformer.from_crs(_code(one), _code(other), always_xy=True, allow_ballpark=False)
    except ProjError:
        return None


@cache
def _plate_motion(plate: str, from_epoch: float) -> "Transformer":
    from pyproj import Transformer

    return Transformer.from_pipeline(
        f"+proj=pipeline +step +init={_PLATES}:{plate}_T +t_epoch={from_epoch!r}"
    )
