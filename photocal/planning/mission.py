"""A planned flight as files: mission items of MAVLink for two ground stations, tables, figures.

Heights of the items are relative to the take-off place (home), so the difference of ground and
take-off heights is part of them and both must be known.

What wind and the range of the radio link make of a planned flight.
"""

import json
import math
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from pymavlink.dialects.v20 import ardupilotmega as mavlink

from photocal.base.arrays import Floats
from photocal.base.errors import ConfigurationError
from photocal.base.files import output_folder, rows_text
from photocal.base.geodesy import GeodeticPlace
from photocal.planning.flight import Layout, PlannedFlight

AUTOPILOTS = {"ardupilot": mavlink.MAV_AUTOPILOT_ARDUPILOTMEGA, "px4": mavlink.MAV_AUTOPILOT_PX4}
VEHICLES = {"fixed-wing": mavlink.MAV_TYPE_FIXED_WING, "quadrotor": mavlink.MAV_TYPE_QUADROTOR}


# A mission item: MAV_CMD and MAV_FRAME of MAVLink, and the seven parameters; the last three are latitude,
# longitude (degrees) and height (m) where the command has a place; None leaves one to the autopilot.
Item = tuple[int, int, tuple[float | None, float | None, float | None, float | None, float, float, float]]


def mission_items(flight: PlannedFlight, home: GeodeticPlace, ground_height_m: float) -> tuple[Item, ...]:
    """Turn a flight into mission items."""
    raise_m = ground_height_m - home.height_m
    lowest = min(strip.height_m for strip in flight.strips) + raise_m
    if not (math.isfinite(lowest) and lowest > 0.0):
        raise ConfigurationError(
            f"the flight would be {lowest:g} m above the take-off place",
            remedy="check the heights of ground and take-off place above mean sea level",
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
    items: tuple[Item, ...], home: GeodeticPlace, speed_m_s: float, autopilot: str, vehicle: str
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
            "plannedHomePosition": list(home),
            "vehicleType": _known(VEHICLES, vehicle, "vehicle"),
            "version": 2,
        },
        "rallyPoints": {"points": [], "version": 2},
        "version": 1,
    }


def waypoint_file(items: tuple[Item, ...], home: GeodeticPlace) -> str:
    """Make the content of a mission file of text lines (`QGC WPL 110`)."""
    first: Item = (mavlink.MAV_CMD_NAV_WAYPOINT, mavlink.MAV_FRAME_GLOBAL, (0.0, 0.0, 0.0, 0.0, *home))
    lines = ["QGC WPL 110"]
    for number, (command, frame, parameters) in enumerate((first, *items)):
        # The text format has no empty value; zero leaves the heading to the autopilot's own setting.
        *orders, latitude, longitude, height = (value or 0.0 for value in parameters)
        fields = [f"{number:d}", f"{number == 0:d}", f"{frame:d}", f"{command:d}"]
        fields += [f"{value:.8g}" for value in orders]
        fields += [f"{latitude:.8f}", f"{longitude:.8f}", f"{height:.3f}", "1"]
        lines.append("\t".join(fields))
    return "\n".join(lines) + "\n"


def _places(flight: PlannedFlight, points_m: Floats) -> list[tuple[float, float]]:
    places = np.round(np.column_stack(flight.plane.to_degrees(points_m)), 8)
    return [(latitude, longitude) for latitude, longitude in places.tolist()]


def _at(command: int, place: tuple[float, float], height_m: float) -> Item:
    return command, mavlink.MAV_FRAME_GLOBAL_RELATIVE_ALT, (0.0, 0.0, 0.0, None, *place, height_m)


def _order(command: int, first: float, second: float, third: float) -> Item:
    return command, mavlink.MAV_FRAME_MISSION, (first, second, third, 0.0, 0.0, 0.0, 0.0)


def _plan_item(item: Item, number: int) -> dict[str, Any]:
    command, frame, parameters = item
    content: dict[str, Any] = {
        "autoContinue": True,
        "command": command,
        "doJumpId": number,
        "frame": frame,
        "params": list(parameters),
        "type": "SimpleItem",
    }
    if frame == mavlink.MAV_FRAME_GLOBAL_RELATIVE_ALT:
        content |= {"AMSLAltAboveTerrain": None, "Altitude": parameters[6], "AltitudeMode": 1}
    return content


def _known(table: dict[str, int], name: str, what: str) -> int:
    if name not in table:
        raise ConfigurationError(f"unknown {what} {name!r}", remedy=f"take {' or '.join(table)}")
    return table[name]


def write_plan(
    folder: Path,
    flight: PlannedFlight,
    layout: Layout,
    takeoff: tuple[GeodeticPlace, float] | None,
    autopilot: str,
    vehicle: str,
    figures: dict[str, Any],
) -> tuple[str, ...]:
    """Write everything that a plan consists of.

    takeoff: the take-off place, and the height of the ground of the area above mean sea level, m; or None.
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


def in_wind(flight: PlannedFlight, wind_m_s: float, from_rad: float, vehicle: str) -> dict[str, float]:
    """Fly the strips in a wind, by the triangle of velocities.

    from_rad: where the wind comes from, clockwise from north.
    vehicle: a quadrotor keeps its speed over ground, a fixed wing that through the air.
    returns: slowest and fastest speed over ground, largest speed through the air, largest angle between nose
        and strip, shortest time between photos, smallest and largest forward overlap where the interval of
        still air is kept, and the duration with turns as in still air.
    raises ConfigurationError: for a fixed wing that the wind holds or carries off its strips.
    """
    request, keeps = flight.request, vehicle == "quadrotor"
    speed, ground, air, crab, longer = request.speed_m_s, [], [], 0.0, 0.0
    for strip in flight.strips:
        way = strip.exposures_m[-1] - strip.exposures_m[0]
        off = from_rad + math.pi - math.atan2(way[0], way[1])
        along, across = wind_m_s * math.cos(off), wind_m_s * math.sin(off)
        fast = speed if keeps else math.sqrt(max(speed**2 - across**2, 0.0)) + along
        if not keeps and (fast <= 0.0 or abs(across) >= speed):
            raise ConfigurationError(
                f"at {speed:g} m/s through the air no strip can be held in a wind of {wind_m_s:g} m/s",
                remedy="fly faster, in less wind, or along it (--azimuth-deg)",
            )
        ground.append(fast)
        air.append(math.hypot(fast - along, across))
        crab = crab if keeps else max(crab, math.asin(abs(across) / speed))
        longer += strip.length_m * (1.0 / fast - 1.0 / speed)
    low, high = min(ground), max(ground)
    return {
        "slowest_m_s": low,
        "fastest_m_s": high,
        "air_m_s": max(air),
        "crab_deg": math.degrees(crab),
        "interval_s": min(level.exposure_interval_s for level in flight.levels) * speed / high,
        "overlap_least": 1.0 - (1.0 - request.forward_overlap) * high / speed,
        "overlap_most": 1.0 - (1.0 - request.forward_overlap) * low / speed,
        "duration_s": flight.duration_s + longer,
    }


def at_speed(flight: PlannedFlight, speed_m_s: float) -> PlannedFlight:
    """Give a flight with another speed over ground, and the intervals of its photos at that."""
    share = flight.request.speed_m_s / speed_m_s
    intervals = (level.exposure_interval_s * share for level in flight.levels)
    levels = (
        replace(level, exposure_interval_s=s) for level, s in zip(flight.levels, intervals, strict=True)
    )
    return replace(flight, request=replace(flight.request, speed_m_s=speed_m_s), levels=tuple(levels))


def farthest_m(flight: PlannedFlight, home: GeodeticPlace, ground_height_m: float) -> float:
    """Give the slant distance from the take-off place to the farthest exposure, m."""
    place = flight.plane.to_plane(np.array([home.latitude_deg]), np.array([home.longitude_deg]))[0]
    raised = ground_height_m - home.height_m
    return max(
        float(np.max(np.hypot(np.hypot(*(strip.exposures_m - place).T), strip.height_m + raised)))
        for strip in flight.strips
    )
