"""Where the vehicle is and how it is turned at any moment: smooth, with wind, gusts and vibration."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from scipy.interpolate import BSpline
from scipy.spatial.transform import Rotation

from acquire.simulate.world import configuration
from acquire.simulate.world.camera import TrueCamera
from photocal.base.arrays import Floats

GRAVITY_M_S2 = 9.80665
# Control points of the way: a spline of degree 5 turns a corner within six of these intervals, its curvature
# and even the change of its curvature continuous.
KNOT_S = 1.0
DEGREE = 5
# East, north, up to north, east, down.
TO_NED = np.array([[0.0, 1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, -1.0]])


@dataclass(frozen=True)
class FlownStrip:
    """A straight line of exposures.

    begin_m, end_m (3,): where its first and its last exposure are wanted.
    """

    covers: int
    begin_m: Floats
    end_m: Floats
    exposures: int
    speed_m_s: float


@dataclass(frozen=True)
class Leg:
    """A straight piece of the way at one speed; of no length: a wait.

    to_m (3,).
    strip: index of the strip, -1 where nothing is taken.
    """

    to_m: Floats
    duration_s: float
    strip: int = -1


def strips(plan: configuration.PlanKeys, camera: TrueCamera) -> tuple[FlownStrip, ...]:
    """Lay strips over the area, pass after pass, each next to the one before and flown the other way."""
    area = np.array(plan.area_m)
    lines: list[FlownStrip] = []
    for number, pass_ in enumerate(plan.passes):
        course = np.radians(pass_.course_deg)
        along = np.array([np.sin(course), np.cos(course)])
        right = np.array([along[1], -along[0]])
        height_m = pass_.height_m
        width, height = (side * camera.pitch_mm / camera.nominal_mm * height_m for side in camera.size_px)
        low, high = (area @ right).min(), (area @ right).max()
        count = max(2, int(np.ceil((high - low) / (width * (1 - pass_.side_overlap)))))
        for index in range(count):
            across = low + (high - low) * (index + 0.5) / count
            first, last = _crossing(area, right, along, across)
            shots = max(2, int(np.ceil((last - first) / (height * (1 - pass_.forward_overlap)))) + 1)
            ends = [np.append(across * right + at * along, height_m) for at in (first, last)]
            begin, end = ends if index % 2 == 0 else ends[::-1]
            lines.append(FlownStrip(number, begin, end, shots, pass_.speed_m_s))
    return tuple(lines)


def _crossing(area: Floats, right: Floats, along: Floats, across: float) -> tuple[float, float]:
    """Give where a line parallel to `along` enters the polygon and leaves it for good."""
    side = area @ right - across
    following = np.roll(side, -1)
    cut = (side > 0) != (following > 0)
    share = side[cut] / (side[cut] - following[cut])
    points = area[cut] + share[:, None] * (np.roll(area, -1, axis=0) - area)[cut]
    places = points @ along
    return float(places.min()), float(places.max())


def legs(
    plan: configuration.PlanKeys, lines: tuple[FlownStrip, ...], ground_m: float
) -> tuple[Floats, list[Leg]]:
    """Join the strips to one way, from the ground to the ground."""
    # As multicopters are set to climb and sink.
    climb_m_s = 4.0
    home = np.array([*plan.take_off_m, ground_m])
    way = [Leg(home, plan.on_ground_s)]

    def go(to_m: Floats, speed_m_s: float, strip: int = -1) -> None:
        """Add a leg to a place at a speed."""
        length = float(np.linalg.norm(to_m - way[-1].to_m))
        way.append(Leg(to_m, length / speed_m_s, strip))

    for number, line in enumerate(lines):
        ahead = line.end_m - line.begin_m
        ahead = ahead / np.linalg.norm(ahead)
        # Corners are rounded within three seconds: the strip itself is straight.
        run_up = 3.0 * line.speed_m_s
        here = way[-1].to_m
        if abs(here[2] - line.begin_m[2]) > 1.0:
            go(np.array([*here[:2], line.begin_m[2]]), climb_m_s)
        go(line.begin_m - run_up * ahead, line.speed_m_s)
        go(line.begin_m, line.speed_m_s)
        go(line.end_m, line.speed_m_s, number)
        go(line.end_m + run_up * ahead, line.speed_m_s)
    go(np.array([*home[:2], way[-1].to_m[2]]), lines[-1].speed_m_s)
    go(home, climb_m_s)
    return home, [*way, Leg(home, plan.on_ground_s)]


@dataclass(frozen=True)
class Waves:
    """A smooth random motion: a sum of sines, one triple of amplitudes for each frequency.

    frequency_hz (k,).
    amplitude, phase (k, 3).
    """

    frequency_hz: Floats
    amplitude: Floats
    phase: Floats

    def at(self, time_s: Floats, derivative: int = 0) -> Floats:
        """Give the motion or its derivative, shape (n, 3)."""
        turn = 2 * np.pi * self.frequency_hz
        angle = np.asarray(time_s)[:, None, None] * turn[:, None] + self.phase + derivative * np.pi / 2
        return np.asarray(np.sum(self.amplitude * turn[:, None] ** derivative * np.sin(angle), axis=1))


def make_waves(spread: Floats, low_hz: float, high_hz: float, random: np.random.Generator) -> Waves:
    """Draw a motion with the standard deviations `spread` (3,) and frequencies between two bounds."""
    count = 7
    frequency = np.exp(random.uniform(np.log(low_hz), np.log(high_hz), count))
    weight = random.uniform(0.5, 1.0, (count, 3))
    amplitude = weight / np.sqrt(np.sum(weight**2, axis=0) / 2) * spread
    return Waves(frequency, amplitude, random.uniform(0, 2 * np.pi, (count, 3)))


@dataclass(frozen=True)
class Motion:
    """The true motion of the vehicle's reference point (its inertial unit).

    way: position in the local frame over time.
    ground_m: height of the take-off place: on it nothing moves.
    sway, shake, vibration: of position (m), attitude (rad) slowly and attitude fast.
    wind_m_s (2,): velocity of the air, east and north.
    course: direction of the nose over time, radians from north towards east, continuous.
    strip: strips by number: when they begin and end, s.
    """

    way: BSpline[np.float64]
    duration_s: float
    ground_m: float
    sway: Waves
    shake: Waves
    vibration: Waves
    wind_m_s: Floats
    course: BSpline[np.float64]
    strip: tuple[tuple[int, float, float], ...]

    def position(self, time_s: Floats, derivative: int = 0) -> Floats:
        """Give positions in the local frame, or their first or second derivatives, shape (n, 3)."""
        time = np.clip(np.asarray(time_s, dtype=float), 0.0, self.duration_s)
        share, orders = self._airborne(time), range(derivative + 1)
        # Leibniz: derivatives of the product of share and sway.
        swayed = (math.comb(derivative, k) * share[k] * self.sway.at(time, derivative - k) for k in orders)
        return np.asarray(self.way(time, nu=derivative) + sum(swayed))

    def _airborne(self, time: Floats) -> tuple[Floats, Floats, Floats]:
        """Give how far the vehicle is in the air, 0 to 1, with its first two derivatives, shape (n, 1)."""
        # Wind takes hold within the first metres above the ground.
        airborne_m = 2.0
        rise = (self.way(time)[:, 2] - self.ground_m) / airborne_m
        rate, curve = (self.way(time, nu=k)[:, 2] / airborne_m for k in (1, 2))
        squared = rise**2
        share = squared / (1 + squared)
        slope = 2 * rise / (1 + squared) ** 2
        bend = (2 - 6 * squared) / (1 + squared) ** 3
        return share[:, None], (slope * rate)[:, None], (bend * rate**2 + slope * curve)[:, None]

    def angles(self, time_s: Floats) -> Floats:
        """Give roll, pitch, yaw of the body (forward, right, down) in north, east, down; rad, shape (n, 3).

        A multirotor leans so that its thrust carries weight, drag and acceleration.
        """
        time = np.clip(np.asarray(time_s, dtype=float), 0.0, self.duration_s)
        share = self._airborne(time)[0]
        air = self.way(time, nu=1)
        air[:, :2] -= self.wind_m_s
        # Specific drag of a small multirotor, 1/s: at 10 m/s of air it leans by about 12 degrees.
        drag_per_s = 0.21
        # The hull damps what is faster than the spline: sway does not tilt.
        thrust = share * (self.way(time, nu=2) + drag_per_s * air) + [0.0, 0.0, GRAVITY_M_S2]
        yaw = self.course(time)
        ahead = np.column_stack([np.sin(yaw), np.cos(yaw)])
        right = np.column_stack([np.cos(yaw), -np.sin(yaw)])
        pitch = -np.arctan2(np.sum(thrust[:, :2] * ahead, axis=1), thrust[:, 2])
        aside = np.sum(thrust[:, :2] * right, axis=1)
        roll = np.arctan2(aside * np.cos(pitch), thrust[:, 2])
        steady = np.column_stack([roll, pitch, yaw])
        return np.asarray(steady + share * (self.shake.at(time) + self.vibration.at(time)))

    def to_body(self, time_s: Floats) -> Floats:
        """Give rotations from the local frame to body axes, shape (n, 3, 3)."""
        return body_of(self.angles(time_s))


def body_of(angles: Floats) -> Floats:
    """Give rotations from east, north, up to body axes of roll, pitch, yaw (rad), shape (n, 3, 3)."""
    to_ned = Rotation.from_euler("ZYX", angles[:, ::-1]).as_matrix()
    return np.asarray(np.swapaxes(to_ned, 1, 2) @ TO_NED)


def make_motion(
    start_m: Floats, legs: list[Leg], given: configuration.VehicleKeys, random: np.random.Generator
) -> Motion:
    """Make the motion along a way."""
    ends = np.cumsum([0.0, *(leg.duration_s for leg in legs)])
    corners = np.vstack([start_m, *(leg.to_m for leg in legs)])
    duration = float(ends[-1])
    times = np.arange(-DEGREE, duration / KNOT_S + DEGREE) * KNOT_S
    points = np.column_stack([np.interp(times, ends, axis) for axis in corners.T])
    way = _spline(points, times)
    wind_to = np.radians(given.wind_from_deg + 180)
    wind = given.wind_m_s * np.array([np.sin(wind_to), np.cos(wind_to)])
    strip = tuple(
        (leg.strip, float(ends[k]), float(ends[k + 1])) for k, leg in enumerate(legs) if leg.strip >= 0
    )
    return Motion(
        way,
        duration,
        float(start_m[2]),
        make_waves(np.full(3, given.sway_m), 0.08, 0.5, random),
        make_waves(np.radians(given.shake_deg) * np.array([1.0, 1.0, 1.5]), 0.1, 0.8, random),
        make_waves(np.full(3, np.radians(given.vibration_deg)), 20.0, 60.0, random),
        wind,
        _course(points, times, wind),
        strip,
    )


def _spline(points: Floats, times: Floats) -> BSpline[np.float64]:
    """Give the uniform spline whose control points are passed at `times` on straight even pieces."""
    middle = (DEGREE + 1) / 2
    knots = times[0] + (np.arange(len(points) + DEGREE + 1) - middle) * KNOT_S
    return BSpline(knots, points, DEGREE)


def _course(points: Floats, times: Floats, wind: Floats) -> BSpline[np.float64]:
    """Point the nose into the relative air while the vehicle moves; elsewhere it stays."""
    air = np.gradient(points[:, :2], KNOT_S, axis=0)
    moving = np.hypot(*air.T) > 1.0
    air = air - wind
    course = np.arctan2(air[:, 0], air[:, 1])
    held = np.maximum.accumulate(np.where(moving, np.arange(len(times)), -1))
    held[held < 0] = int(np.argmax(moving))
    return _spline(np.unwrap(course[held]), times)
