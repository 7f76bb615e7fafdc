"""The system of the coordinates that another program has written, from the WKT beside them."""

from pathlib import Path
from typing import Any

import numpy as np

from photocal.base.arrays import Floats
from photocal.base.errors import ConfigurationError, InputMalformedError, PhotocalError
from photocal.exchange.source import read_text
from photocal.geometry.frames import UNSTATED, parsed, reference_frame


def output_system(file: Path | None, places: Floats) -> tuple[str, str, list[str]]:
    """Frame and kind of heights of a block, and what was assumed of them.

    places (n, 3): projection centres in that system.
    """
    if file is None:
        # Coordinates of a site grid are smaller than northings.
        of_a_map_m = 2e4
        large = bool((np.abs(np.nanmedian(places[:, :2], axis=0)) > of_a_map_m).all())
        told = ["no ..._wkt.prj names the system of the coordinates: taken as Cartesian"]
        return "local", "", told if large else []
    text = read_text(file).strip()
    if text.startswith(("LOCAL_CS", "ENGCRS", "LOCAL_DATUM")):
        return "local", "", []
    try:
        system = parsed(text)
        if system.is_geographic:
            raise ConfigurationError("is in degrees")
        for name, height in _kinds(system):
            frame = reference_frame(name, height, np.nanmedian(places, axis=0))
            try:
                frame.to_local(places[:1])
            except InputMalformedError:
                # The grid of its geoid is missing, or it does not hold here.
                continue
            return name, height, [] if height == "orthometric" else [HEIGHTS_UNSAID]
    except PhotocalError:
        return "local", "", [f"{file.name} names no map system in metres: coordinates are taken as Cartesian"]
    return "local", "", [f"{file.name}: {system.name} does not hold where the block lies: taken as Cartesian"]


def utm_zone_of(lonlat: Floats, places: Floats) -> tuple[str, tuple[str, ...]]:
    """UTM zone in which places (n, 3) lie where others say in degrees; "local" where they do not."""
    from pyproj import Transformer
    from pyproj.aoi import AreaOfInterest
    from pyproj.database import query_utm_crs_info

    longitude, latitude = np.median(lonlat, axis=0).tolist()
    if abs(longitude) <= 180 and abs(latitude) <= 84:
        here = AreaOfInterest(longitude, latitude, longitude, latitude)
        # Degrees of some digits and metres of one place differ by less, m.
        near_m = 5.0
        for zone in query_utm_crs_info("WGS 84", here):
            code = f"{zone.auth_name}:{zone.code}"
            way = Transformer.from_crs("EPSG:4326", code, always_xy=True)
            away = np.hypot(*(np.column_stack(way.transform(*lonlat.T)) - places[:, :2]).T)
            if np.nanmax(away) <= near_m:
                return code, (HEIGHTS_UNSAID,)
    return "local", ("the places are in no UTM zone: taken as Cartesian",)


HEIGHTS_UNSAID = "the files do not state the reference of their heights: they are used as given"


def _kinds(system: Any) -> list[tuple[str, str]]:
    """Names of a system with its heights, and of its plane alone."""
    plane = system.sub_crs_list[0] if system.is_compound else system
    names = [(_name(plane), UNSTATED)]
    return [(_name(system), "orthometric"), *names] if system.is_compound else names


def _name(system: Any) -> str:
    """Its code, if it is that of a register, else its whole text."""
    authority = system.to_authority(min_confidence=70)
    return ":".join(authority) if authority else str(system.to_wkt())
