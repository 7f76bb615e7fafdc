"""A planned flight as files: mission items of MAVLink for two ground stations, tables, figures.

Heights of the items are relative to the take-off place (home), so the difference of ground and
take-off heights is part of them and both must be known.
"""

import json
import math
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from pymavlink.dialects.v20 import ardupilotmega as mavlink

from photocal.base.arrays import Floats
from photocal.base.errors import ConfigurationError
from photocal.base.files import output_folder, rows_text
from photocal.planning.flight import Layout, PlannedFlight

AUTOPILOTS = {"ardupilot": mavlink.MAV_AUTOPILOT_ARDUPILOTMEGA, "px4": mavlink.MAV_AUTOPILOT_PX4}
VEHICLES = {"fixed-wing": mavlink.MAV_TYPE_FIXED_WING, "quadrotor": mavlink.MAV_TYPE_QUADROTOR}


@dataclass(frozen=True)
class Home:
    """The take-off place.

    height_m: above mean sea level, m.
    """

    latitude_deg: float
    longitude_deg: float
    height_m: float


@dataclass(frozen=True)
class Item:
    """One mission item.

    command, frame: MAV_CMD and MAV_FRAME of MAVLink.
    parameters: the seven parameters; the last three are latitude, longitude (degrees) and height (m) where
        the command has a place; None leaves one to the autopilot.
    """

    command: int
    frame: int
    parameters: tuple[float | None, float | None, float | None, float | None, float, float, float]


def mission_items(flight: PlannedFlight, home: Home, ground_height_m: float) -> tuple[Item, ...]:
    """Turn a flight into mission items."""
    raise_m = ground_height_m - home.height_m
    lowest = min(strip.height_m for strip in flight.strips) + raise_m
    if not (math.isfinite(lowest) and lowest > 0.0):
        raise ConfigurationError(
            f"the flight would be {lowest:g} m above the take-off place",
            remedy="look at the heights of ground and take-off place above mean sea level",
        )
    first = flight.strips[0].height_m + raise_m
    over_ground = float(mavlink.SPEED_TYPE_GROUNDSPEED)
    items = [
        _at(mavlink.MAV_CMD_NAV_TAKEOFF, (home.latitude_deg, home.longitude_deg), first),
        _order(mavlink.MAV_CMD_DO_CHANGE_SPEED, over_ground, flight.request.speed_m_s, -1.0),
    ]
    for strip in flight.strips:
        height = strip.height_m + raise_m
        start, end = _places(flight, strip.exposures_m[[0, -1]])
        base = strip.length_m / (len(strip.exposures_m) - 1)
        items += [
            _at(mavlink.MAV_CMD_NAV_WAYPOINT, start, height),
            # The third parameter takes the first photo at once, where the strip begins.
            _order(mavlink.MAV_CMD_DO_SET_CAM_TRIGG_DIST, base, 0.0, 1.0),
            _at(mavlink.MAV_CMD_NAV_WAYPOINT, end, height),
            _order(mavlink.MAV_CMD_DO_SET_CAM_TRIGG_DIST, 0.0, 0.0, 0.0),
        ]
    return (*items, _order(mavlink.MAV_CMD_NAV_RETURN_TO_LAUNCH, 0.0, 0.0, 0.0))


def qgroundcontrol_plan(
    items: tuple[Item, ...], home: Home, speed_m_s: float, autopilot: str, vehicle: str
) -> dict[str, Any]:
    """Make the content of a QGroundControl `.plan` file."""
    return {
        "fileType": "Plan",
        "geoFence": {"circles": [], "polygons": [], "version": 2},
        "groundStation": "QGroundControl",
        "mission": {
            "cruiseSpeed": speed_m_s,
            "firmwareType": _known(AUTOPILOTS, autopilot, "autopilot"),
            "globalPlanAltitudeMode": 1,
            "hoverSpeed": speed_m_s,
            "items": [_plan_item(item, number) for number, item in enumerate(items, start=1)],
            "plannedHomePosition": [home.latitude_deg, home.longitude_deg, home.height_m],
            "vehicleType": _known(VEHICLES, vehicle, "vehicle"),
            "version": 2,
        },
        "rallyPoints": {"points": [], "version": 2},
        "version": 1,
    }


def waypoint_file(items: tuple[Item, ...], home: Home) -> str:
    """Make the content of a mission file of text lines (`QGC WPL 110`)."""
    first = Item(
        mavlink.MAV_CMD_NAV_WAYPOINT,
        mavlink.MAV_FRAME_GLOBAL,
        (0.0, 0.0, 0.0, 0.0, home.latitude_deg, home.longitude_deg, home.height_m),
    )
    lines = ["QGC WPL 110"]
    for number, item in enumerate((first, *items)):
        # The text format has no empty value; zero leaves the heading to the autopilot's own setting.
        *orders, latitude, longitude, height = (value or 0.0 for value in item.parameters)
        fields = [f"{number:d}", f"{number == 0:d}", f"{item.frame:d}", f"{item.command:d}"]
        fields += [f"{value:.8g}" for value in orders]
        fields += [f"{latitude:.8f}", f"{longitude:.8f}", f"{height:.3f}", "1"]
        lines.append("\t".join(fields))
    return "\n".join(lines) + "\n"


def _places(flight: PlannedFlight, points_m: Floats) -> list[tuple[float, float]]:
    places = np.round(np.column_stack(flight.plane.to_degrees(points_m)), 8)
    return [(latitude, longitude) for latitude, longitude in places.tolist()]


def _at(command: int, place: tuple[float, float], height_m: float) -> Item:
    return Item(command, mavlink.MAV_FRAME_GLOBAL_RELATIVE_ALT, (0.0, 0.0, 0.0, None, *place, height_m))


def _order(command: int, first: float, second: float, third: float) -> Item:
    return Item(command, mavlink.MAV_FRAME_MISSION, (first, second, third, 0.0, 0.0, 0.0, 0.0))


def _plan_item(item: Item, number: int) -> dict[str, Any]:
    content: dict[str, Any] = {
        "autoContinue": True,
        "command": item.command,
        "doJumpId": number,
        "frame": item.frame,
        "params": list(item.parameters),
        "type": "SimpleItem",
    }
    if item.frame == mavlink.MAV_FRAME_GLOBAL_RELATIVE_ALT:
        content |= {"AMSLAltAboveTerrain": None, "Altitude": item.parameters[6], "AltitudeMode": 1}
    return content


def _known(table: dict[str, int], name: str, what: str) -> int:
    if name not in table:
        raise ConfigurationError(f"unknown {what} {name!r}", remedy=f"take {' or '.join(table)}")
    return table[name]


def write_plan(
    folder: Path,
    flight: PlannedFlight,
    layout: Layout,
    takeoff: tuple[Home, float] | None,
    autopilot: str,
    vehicle: str,
    figures: dict[str, Any],
) -> tuple[str, ...]:
    """Write everything that a plan consists of.

    takeoff: tuple of Home and float, or None. The take-off place, and the height of the ground of the area
        above mean sea level, m.
    raises ConfigurationError: when the mission cannot be flown.
    raises OutputError: when the folder cannot be written.
    """
    contents = {
        "plan.json": json.dumps(figures, indent=2, allow_nan=False) + "\n",
        "exposures.csv": _exposures(flight),
        "plan.geojson": json.dumps(_map(flight, layout)) + "\n",
    }
    if takeoff is not None:
        home, ground_height = takeoff
        items = mission_items(flight, home, ground_height)
        plan = qgroundcontrol_plan(items, home, flight.request.speed_m_s, autopilot, vehicle)
        contents["flight.plan"] = json.dumps(plan, indent=4, allow_nan=False) + "\n"
        contents["flight.waypoints"] = waypoint_file(items, home)
    with output_folder(folder) as aside:
        for name, content in contents.items():
            (aside / name).write_text(content, encoding="utf-8")
    return tuple(contents)


def _exposures(flight: PlannedFlight) -> str:
    rows = [
        (number, exposure, f"{latitude:.8f}", f"{longitude:.8f}", f"{strip.height_m:.2f}")
        for number, strip in enumerate(flight.strips, start=1)
        for exposure, (latitude, longitude) in enumerate(_places(flight, strip.exposures_m), start=1)
    ]
    return rows_text(("strip", "exposure", "lat_deg", "lon_deg", "height_above_ground_m"), rows)


def _map(flight: PlannedFlight, layout: Layout) -> dict[str, Any]:
    """GeoJSON (RFC 7946) of area, strips and suggested points."""

    def positions(points_m: Floats) -> list[list[float]]:
        """Longitude and latitude, the order that GeoJSON has."""
        return [[longitude, latitude] for latitude, longitude in _places(flight, points_m)]

    def feature(geometry: str, coordinates: Any, **properties: Any) -> dict[str, Any]:
        """A feature of RFC 7946 with its properties."""
        shape = {"type": geometry, "coordinates": coordinates}
        return {"type": "Feature", "geometry": shape, "properties": properties}

    ring = positions(flight.corners_m)
    features = [feature("Polygon", [[*ring, ring[0]]], kind="area")]
    features += [
        feature(
            "LineString",
            positions(strip.exposures_m[[0, -1]]),
            kind="strip",
            strip=number,
            height_above_ground_m=strip.height_m,
            photos=len(strip.exposures_m),
        )
        for number, strip in enumerate(flight.strips, start=1)
    ]
    for role, points in zip(("control", "check"), layout, strict=True):
        features += [
            feature("Point", position, kind=role, name=f"{role[:2].upper()}{number:02d}")
            for number, position in enumerate(positions(points), start=1)
        ]
    return {"type": "FeatureCollection", "features": features}
