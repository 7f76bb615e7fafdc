"""What wind and the range of the radio link make of a planned flight."""

import math
from dataclasses import replace

import numpy as np

from photocal.base.errors import ConfigurationError
from photocal.planning.flight import PlannedFlight
from photocal.planning.mission import Home


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


def farthest_m(flight: PlannedFlight, home: Home, ground_height_m: float) -> float:
    """Give the slant distance from the take-off place to the farthest exposure, m."""
    place = flight.plane.to_plane(np.array([home.latitude_deg]), np.array([home.longitude_deg]))[0]
    raised = ground_height_m - home.height_m
    return max(
        float(np.max(np.hypot(np.hypot(*(strip.exposures_m - place).T), strip.height_m + raised)))
        for strip in flight.strips
    )


# What `in_wind` found, for people.
WIND_TEXT = (
    "in the wind: {slowest_m_s:.1f} to {fastest_m_s:.1f} m/s over ground, up to {air_m_s:.1f} through the "
    "air, crab up to {crab_deg:.0f} deg, a photo every {interval_s:.2f} s, {duration_s:.0f} s in all; with a "
    "fixed interval forward overlap {overlap_least:.0%} to {overlap_most:.0%}; take off and land against it"
)
