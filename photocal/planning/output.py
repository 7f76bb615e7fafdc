"""The files of a plan: missions for the ground station, tables and a map for QGIS."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

from acquire.outputs import output_folder
from drivers.arrays import Floats
from photocal.planning.control_layout import Layout
from photocal.planning.flight import Flight
from photocal.planning.mission import Home, mission_items, qgroundcontrol_plan, waypoint_file


def write_plan(
    folder: Path,
    flight: Flight,
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
        plan = qgroundcontrol_plan(items, home, flight.wish.speed_m_s, autopilot, vehicle)
        contents["flight.plan"] = json.dumps(plan, indent=4, allow_nan=False) + "\n"
        contents["flight.waypoints"] = waypoint_file(items, home)
    with output_folder(folder) as aside:
        for name, content in contents.items():
            (aside / name).write_text(content, encoding="utf-8")
    return tuple(contents)


def _exposures(flight: Flight) -> str:
    lines = ["strip,exposure,lat_deg,lon_deg,height_above_ground_m"]
    for number, strip in enumerate(flight.strips, start=1):
        latitude, longitude = flight.plane.to_degrees(strip.exposures_m)
        lines += [
            f"{number},{exposure},{lat:.8f},{lon:.8f},{strip.height_m:.2f}"
            for exposure, (lat, lon) in enumerate(zip(latitude, longitude, strict=True), start=1)
        ]
    return "\n".join(lines) + "\n"


def _map(flight: Flight, layout: Layout) -> dict[str, Any]:
    """GeoJSON (RFC 7946) of area, strips and suggested points."""

    def positions(points_m: Floats) -> list[list[float]]:
        latitude, longitude = flight.plane.to_degrees(points_m)
        return [
            [round(float(lon), 8), round(float(lat), 8)] for lat, lon in zip(latitude, longitude, strict=True)
        ]

    def feature(geometry: str, coordinates: Any, **properties: Any) -> dict[str, Any]:
        return {
            "type": "Feature",
            "geometry": {"type": geometry, "coordinates": coordinates},
            "properties": properties,
        }

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
