"""What wind and the range of the radio link make of a planned flight."""

import math
from dataclasses import dataclass, replace

import numpy as np

from drivers.errors import ConfigurationError
from photocal.planning.flight import Flight
from photocal.planning.mission import Home


@dataclass(frozen=True)
class Wind:
    """Steady wind: its speed, and where it comes from, clockwise from north."""

    speed_m_s: float
    from_rad: float


@dataclass(frozen=True)
class InWind:
    """A flight in wind; m, s, rad.

    ground_m_s: slowest and fastest speed over ground on the strips; a multirotor keeps the planned one.
    air_m_s: largest speed through the air.
    crab_rad: largest angle between where the nose points and where a fixed wing flies.
    interval_s: shortest time between two photos.
    overlap: smallest and largest forward overlap where the interval of still air is kept.
    duration_s: on strips, with turns as in still air.
    """

    ground_m_s: tuple[float, float]
    air_m_s: float
    crab_rad: float
    interval_s: float
    overlap: tuple[float, float]
    duration_s: float


def in_wind(flight: Flight, wind: Wind, vehicle: str) -> InWind:
    """Fly the strips in a wind, by the triangle of velocities.

    raises ConfigurationError: for a fixed wing that the wind holds or carries off its strips.
    """
    wish, blown = flight.wish, wind.from_rad + math.pi
    interval = min(level.exposure_interval_s for level in flight.levels)
    ground, air, crab, lengths = [], [], [], []
    for strip in flight.strips:
        way = strip.exposures_m[-1] - strip.exposures_m[0]
        off = blown - math.atan2(way[0], way[1])
        along, across = wind.speed_m_s * math.cos(off), wind.speed_m_s * math.sin(off)
        own = wish.speed_m_s**2 - across**2
        fast = wish.speed_m_s if vehicle == "quadrotor" else math.sqrt(max(own, 0.0)) + along
        if fast <= 0.0 or (vehicle != "quadrotor" and own <= 0.0):
            raise ConfigurationError(
                f"at {wish.speed_m_s:g} m/s through the air no strip can be held in a wind of "
                f"{wind.speed_m_s:g} m/s",
                remedy="fly faster, in less wind, or along it (--azimuth-deg)",
            )
        ground.append(fast)
        air.append(math.hypot(fast - along, across))
        crab.append(0.0 if vehicle == "quadrotor" else math.asin(min(1.0, abs(across) / wish.speed_m_s)))
        lengths.append(strip.length_m)
    low, high = min(ground), max(ground)
    turns = flight.duration_s - sum(lengths) / wish.speed_m_s
    kept = [1.0 - (1.0 - wish.forward_overlap) * speed / wish.speed_m_s for speed in (high, low)]
    return InWind(
        (low, high),
        max(air),
        max(crab),
        interval * wish.speed_m_s / high,
        (kept[0], kept[1]),
        turns + float(np.sum(np.array(lengths) / ground)),
    )


def fastest(flight: Flight, found: InWind) -> Flight:
    """Give the flight with the intervals and the speed of its fastest strip, for what limits a camera."""
    speed = found.ground_m_s[1]
    share = flight.wish.speed_m_s / speed
    levels = (
        replace(level, exposure_interval_s=level.exposure_interval_s * share) for level in flight.levels
    )
    return replace(flight, wish=replace(flight.wish, speed_m_s=speed), levels=tuple(levels))


def farthest_m(flight: Flight, home: Home, ground_height_m: float) -> float:
    """Give the slant distance from the take-off place to the farthest exposure, m."""
    place = flight.plane.to_plane(np.array([home.latitude_deg]), np.array([home.longitude_deg]))[0]
    raised = ground_height_m - home.height_m
    return max(
        float(np.max(np.hypot(np.hypot(*(strip.exposures_m - place).T), strip.height_m + raised)))
        for strip in flight.strips
    )


def text(found: InWind) -> str:
    """Say it in a line."""
    low, high = found.ground_m_s
    return (
        f"in the wind: {low:.1f} to {high:.1f} m/s over ground, up to {found.air_m_s:.1f} through the air, "
        f"crab up to {math.degrees(found.crab_rad):.0f} deg, a photo every {found.interval_s:.2f} s, "
        f"{found.duration_s / 60.0:.1f} min; with a fixed interval forward overlap {found.overlap[0]:.0%} to "
        f"{found.overlap[1]:.0%}; take off and land against the wind"
    )
