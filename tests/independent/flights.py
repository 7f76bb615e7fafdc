"""Flights with a known truth: what is flown, what is wrong with it, and what is measured.

Strips there and back, others across and a quarter higher; GNSS, attitudes, control and check points. Every
observation has the error that its stated sigma promises, unless the design or the errors say otherwise.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np

from tests.independent.optics import (
    LOOKS_DOWN,
    SIZE,
    Floats,
    Integers,
    Lens,
    body_axes,
    omega_phi_kappa,
    pixels,
    rodrigues,
)

HEIGHT_M, BASE_M, LINE_M, SPEED = 100.0, 20.0, 42.0, 10.0
LEVER_M = (0.30, 0.05, -0.15)
BORESIGHT_DEG, BORESIGHT_SIGMA_DEG = (0.4, -0.3, 0.6), 0.02
GNSS_M, CONTROL_M, CHECK_M = (0.02, 0.02, 0.03), (0.010, 0.010, 0.015), (0.010, 0.010, 0.015)
ATTITUDE_DEG = 0.05
USUAL = ("c", "x0", "y0", "K1", "K2", "P1", "P2")
# The frame's numbers are those of a survey: nobody measures at its origin.
ORIGIN = np.array([1000.0, 2000.0, 50.0])
# Mean radius of the earth (IUGG).
EARTH_M = 6_371_008.8
# How far a flight departs from its plan: turns of the body, gusts (m/s).
TILT_DEG, GUST = 2.0, 0.3
# Gross rays scatter by so many sigmas.
GROSS = 20.0


@dataclass(frozen=True)
class Design:
    """What is flown and what is claimed of it.

    Attributes
    ----------
    cross
        Whether strips across and higher are flown; without them heights and c hang on the positions.
    tails
        "normal", "t3", "t4" or "mixture" (a tenth of the rays three times as bad): of the stated sigma all.
    memory
        Correlation of the GNSS errors from exposure to exposure.
    boresight
        "free" (stated as zero), "stated" (with 0.02 deg), or "held" (at its true value).
    rays_worse, gnss_worse, control_worse
        True sigma over the stated one.
    height_m
        Over ground; bases, strips and relief grow with it.
    gnss
        Whether positions and attitudes were recorded.
    """

    name: str
    images: int = 30
    cross: bool = True
    control: int = 6
    check: int = 12
    sigma_px: float = 0.5
    per_image: int = 100
    tails: str = "normal"
    memory: float = 0.0
    boresight: str = "free"
    rays_worse: float = 1.0
    gnss_worse: float = 1.0
    control_worse: float = 1.0
    gnss: bool = True
    estimate: tuple[str, ...] = USUAL
    shutter: str = "global"
    readout_s: float = 0.0
    height_m: float = HEIGHT_M


@dataclass(frozen=True)
class Errors:
    """What is wrong although the block states otherwise; zero is as stated.

    Attributes
    ----------
    lever_arm_m, datum_m
        Of all exposures, m: body axes; east, north, up.
    stated_lever_m
        What the block states in place of the true lever arm.
    plane_scale
        Scale of the positions in plane, about the middle of the flight.
    control_scale
        Scale of the surveyed control in plane, about its first point.
    c_step
        Share by which c of the second half of the images differs.
    c_stated
        Share by which the stated c is wrong.
    lens
        What the camera has and the block does not estimate.
    control
        Number of a control point and what its surveyed coordinates are wrong by, m.
    swapped
        Numbers of control points whose coordinates are exchanged.
    slip
        Number of a control point with two digits exchanged.
    position
        Number of an exposure and what its position is wrong by, m.
    gross
        Share of the rays that are `GROSS` times as bad.
    refraction
        Coefficient of the air that bends the rays: ratio of the radii of earth and ray.
    curved
        Whether the ground is a sphere, and plane coordinates are distances along it.
    """

    lever_arm_m: tuple[float, float, float] = (0.0, 0.0, 0.0)
    stated_lever_m: tuple[float, float, float] = LEVER_M
    time_offset_s: float = 0.0
    datum_m: tuple[float, float, float] = (0.0, 0.0, 0.0)
    plane_scale: float = 0.0
    control_scale: float = 0.0
    c_step: float = 0.0
    c_stated: float = 0.0
    readout_s: float = 0.0
    lens: tuple[tuple[str, float], ...] = ()
    control: tuple[tuple[int, tuple[float, float, float]], ...] = ()
    swapped: tuple[int, ...] = ()
    slip: int | None = None
    position: tuple[tuple[int, tuple[float, float, float]], ...] = ()
    gross: float = 0.0
    refraction: float = 0.0
    curved: bool = False


@dataclass(frozen=True)
class World:
    """The truth: poses of the body (roll, pitch, yaw, rad), places, and who sees whom."""

    angles: Floats
    centre: Floats
    velocity: Floats
    time: Floats
    strip: Integers
    points: Floats
    role: tuple[str, ...]
    image: Integers
    point: Integers
    lens: Lens = field(default_factory=Lens)
    boresight_deg: tuple[float, float, float] = BORESIGHT_DEG

    def of_role(self, role: str) -> Integers:
        """Numbers of the points with a role."""
        return np.flatnonzero(np.array(self.role) == role)

    @property
    def camera_axes(self) -> Floats:
        """Object to camera axes of every exposure, (n, 3, 3)."""
        bore = rodrigues(np.radians([self.boresight_deg]))[0]
        return np.asarray(bore @ LOOKS_DOWN @ body_axes(self.angles))


@dataclass(frozen=True)
class Observed:
    """Pixels of the rays, antenna positions (m), attitudes (roll, pitch, yaw, rad), surveyed points (m)."""

    pixels: Floats
    antenna: Floats
    angles: Floats
    surveyed: Floats


def world(design: Design, rng: np.random.Generator) -> World:
    """Fly the plan over points on hilly ground."""
    centre, heading, time, strip = _strips(design)
    n = len(centre)
    size = design.height_m / HEIGHT_M
    centre = size * (centre + rng.normal(0.0, [1.0, 1.0, 0.7], (n, 3)))
    yaw = heading + np.radians(rng.normal(0.0, TILT_DEG, n))
    angles = np.column_stack([*np.radians(rng.normal(0.0, TILT_DEG, (2, n))), yaw])
    along = np.column_stack([np.sin(heading), np.cos(heading), np.zeros(n)])
    velocity = SPEED * along + rng.normal(0.0, GUST, (n, 3))
    plane, role = _ground(design, centre, rng)
    x, y = (plane / size).T
    relief = 6.0 * np.sin(x / 27.0) * np.cos(y / 19.0) + 2.0 * np.sin(y / 7.0)
    points = np.column_stack([plane, size * relief]) + ORIGIN
    made = World(angles, centre + ORIGIN, velocity, time, strip, points, role, *_NOBODY)
    if design.boresight == "stated":
        turned = BORESIGHT_DEG + BORESIGHT_SIGMA_DEG * rng.normal(size=3)
        made = replace(made, boresight_deg=tuple(turned.tolist()))
    image, point = (grid.ravel() for grid in np.indices((n, len(points))))
    near = np.abs(points[point, :2] - made.centre[image, :2]).max(axis=1) < 1.3 * design.height_m
    image, point = image[near], point[near]
    seen = pixels(made.lens, made.camera_axes[image], made.centre[image], points[point])
    middle = (np.array(SIZE) - 1) / 2.0
    inside = np.all(np.abs(seen - middle) < middle - 15.0, axis=1)
    image, point = image[inside], point[inside]
    count = np.bincount(point, minlength=len(points))
    enough = count[point] >= 2
    return replace(made, image=image[enough], point=point[enough])


def expected(truth: World, design: Design, errors: Errors) -> Observed:
    """Give what would be measured without noise."""
    axes = truth.camera_axes
    lens = replace(truth.lens, **dict(errors.lens))
    late = np.arange(len(axes)) >= len(axes) // 2
    scale = np.where(late, 1.0 + errors.c_step, 1.0)[truth.image]
    readout = design.readout_s + errors.readout_s
    line, seen = np.zeros(len(truth.image)), np.zeros((len(truth.image), 2))
    for _ in range(6 if readout else 1):
        centre = truth.centre[truth.image] + (readout * line)[:, None] * truth.velocity[truth.image]
        seen = _seen(lens, axes[truth.image], centre, truth.points[truth.point], scale, errors)
        line = (seen[:, 1] - (SIZE[1] - 1) / 2.0) / SIZE[1]
    body = body_axes(truth.angles)
    arm = np.array(LEVER_M) + errors.lever_arm_m
    antenna = truth.centre + np.einsum("nji,j->ni", body, arm) - errors.time_offset_s * truth.velocity
    antenna = antenna + errors.datum_m
    middle = truth.centre.mean(axis=0)
    antenna[:, :2] += errors.plane_scale * (antenna - middle)[:, :2]
    for number, wrong in errors.position:
        antenna[number] += wrong
    surveyed, control = truth.points.copy(), truth.of_role("control")
    apart = surveyed[control] - surveyed[control[:1]]
    surveyed[control] += errors.control_scale * apart * [1.0, 1.0, 0.0]
    for number, wrong in errors.control:
        surveyed[control[number]] += wrong
    if errors.swapped:
        pair = control[list(errors.swapped)]
        surveyed[pair] = surveyed[pair[::-1]]
    return Observed(seen, antenna, truth.angles.copy(), surveyed)


def _seen(lens: Lens, axes: Floats, centre: Floats, points: Floats, scale: Floats, errors: Errors) -> Floats:
    """Pixels of points that the air raises, over a plane or a sphere: each ray as it leaves its camera."""
    away = points - centre
    if errors.curved:
        # The vertical of the camera is the axis of its attitude; along the sphere lies the plane distance.
        level = np.linalg.norm(away[:, :2], axis=1)
        way = np.divide(
            away[:, :2], level[:, None], where=level[:, None] > 0.0, out=np.zeros((len(level), 2))
        )
        angle, radius = level / EARTH_M, EARTH_M + points[:, 2] - ORIGIN[2]
        up = radius * np.cos(angle) - (EARTH_M + centre[:, 2] - ORIGIN[2])
        away = np.column_stack([way * (radius * np.sin(angle))[:, None], up])
    if errors.refraction:
        # An arc of the earth's radius over the coefficient leaves its chord by half the angle that it spans.
        level = np.linalg.norm(away[:, :2], axis=1)
        raised = np.arctan2(away[:, 2], level) + errors.refraction * level / EARTH_M / 2.0
        length = np.linalg.norm(away, axis=1)
        way = np.divide(
            away[:, :2], level[:, None], where=level[:, None] > 0.0, out=np.zeros((len(level), 2))
        )
        away = np.column_stack([way * (length * np.cos(raised))[:, None], length * np.sin(raised)])
    return pixels(lens, axes, np.zeros(3), away, scale)


def measured(truth: World, design: Design, errors: Errors, rng: np.random.Generator) -> Observed:
    """Give what is measured, with its noise."""
    true = expected(truth, design, errors)
    noise = _tailed(design.tails, true.pixels.shape, rng) * design.sigma_px * design.rays_worse
    noise[rng.random(len(noise)) < errors.gross] *= GROSS
    n = len(true.antenna)
    gnss = _remembered(rng.normal(size=(n, 3)), design.memory) * GNSS_M * design.gnss_worse
    sigma = np.zeros((len(truth.role), 3))
    sigma[truth.of_role("control")] = np.array(CONTROL_M) * design.control_worse
    sigma[truth.of_role("check")] = CHECK_M
    surveyed = np.round(true.surveyed + sigma * rng.normal(size=sigma.shape), 3)
    if errors.slip is not None:
        row = truth.of_role("control")[errors.slip]
        surveyed[row] = _slipped(surveyed[row])
    turn = np.radians(ATTITUDE_DEG) * rng.normal(size=(n, 3))
    return Observed(true.pixels + noise, true.antenna + gnss, true.angles + turn, surveyed)


def start_angles(observed: Observed) -> Floats:
    """Omega, phi, kappa (rad) as the recorded attitudes have them, without the boresight."""
    return omega_phi_kappa(LOOKS_DOWN @ body_axes(observed.angles))


_NOBODY: tuple[Integers, Integers] = (np.zeros(0, dtype=np.int64), np.zeros(0, dtype=np.int64))


def _strips(design: Design) -> tuple[Floats, Floats, Floats, Integers]:
    """Centres about the middle of the flight (m), headings (rad), times (s) and strips of the plan."""
    across = design.images // 3 if design.cross else 0
    main = design.images - across
    lines = max(2, round(float(np.sqrt(main * BASE_M / LINE_M))))
    each = -(-main // lines)
    rows = [(k // each, (k % each - (each - 1) / 2.0) * BASE_M) for k in range(main)]
    places = [(step, (line - (lines - 1) / 2.0) * LINE_M, 0.0, line % 2, line) for line, step in rows]
    if across:
        base = 1.25 * BASE_M
        column = max(3, round(((lines - 1) * LINE_M + 30.0) / base))
        columns = -(-across // column)
        spread = (each - 1) * BASE_M / max(columns, 2)
        for k in range(across):
            line, step = k // column, (k % column - (column - 1) / 2.0) * base
            places.append(((line - (columns - 1) / 2.0) * spread, step, 1.0, line % 2, lines + line))
    x, y, higher, back, strip = np.array(places).T
    heading = np.where(higher > 0.0, 0.0, np.pi / 2.0) + np.pi * back
    # Back is flown the other way: the strip's exposures follow each other in time.
    order = np.lexsort((x * np.sin(heading) + y * np.cos(heading), strip))
    x, y, higher, heading, strip = (part[order] for part in (x, y, higher, heading, strip))
    along = x * np.sin(heading) + y * np.cos(heading)
    step_s = np.abs(np.diff(along, prepend=along[0])) / SPEED
    new = np.diff(strip, prepend=strip[0]) != 0
    time = np.cumsum(np.where(new, 30.0, step_s))
    z = HEIGHT_M * np.where(higher > 0.0, 1.25, 1.0)
    return np.column_stack([x, y, z]), heading, time, strip.astype(np.int64)


def _ground(design: Design, centre: Floats, rng: np.random.Generator) -> tuple[Floats, tuple[str, ...]]:
    """Places in plane and roles: control apart from each other, check points between, ties beyond."""
    low, high = centre[:, :2].min(axis=0), centre[:, :2].max(axis=0)
    inner = rng.uniform(low, high, (400, 2))
    chosen = [int(np.argmin(inner.sum(axis=1)))]
    for _ in range(1, design.control):
        apart = np.linalg.norm(inner[:, None] - inner[chosen], axis=2).min(axis=1)
        chosen.append(int(np.argmax(apart)))
    control, check = inner[chosen[: design.control]], rng.uniform(low, high, (design.check, 2))
    margin = np.array([0.45, 0.35]) * design.height_m
    area = float(np.prod(high - low + 2.0 * margin))
    footprint = SIZE[0] * SIZE[1] * (design.height_m / Lens().c) ** 2
    ties = rng.uniform(low - margin, high + margin, (round(design.per_image * area / footprint), 2))
    roles = ["control"] * len(control) + ["check"] * len(check) + ["tie"] * len(ties)
    return np.vstack([control, check, ties]), tuple(roles)


def _tailed(tails: str, shape: tuple[int, ...], rng: np.random.Generator) -> Floats:
    """Noise of unit variance."""
    if tails.startswith("t"):
        degrees = int(tails[1:])
        return np.asarray(rng.standard_t(degrees, shape) / np.sqrt(degrees / (degrees - 2.0)))
    noise = rng.normal(size=shape)
    if tails == "mixture":
        bad = rng.random(shape[0]) < 0.1
        noise[bad] *= 3.0
        noise /= np.sqrt(0.9 + 0.1 * 9.0)
    return noise


def _remembered(white: Floats, memory: float) -> Floats:
    """An autoregressive series of unit variance, each column its own."""
    series = white.copy()
    for k in range(1, len(series)):
        series[k] = memory * series[k - 1] + np.sqrt(1.0 - memory**2) * white[k]
    return series


def _slipped(place: Floats) -> Floats:
    """A point whose decimetre and centimetre were exchanged, in the coordinate where it shows most."""
    whole = np.round(place * 1000.0).astype(np.int64)
    tenth, hundredth = whole // 100 % 10, whole // 10 % 10
    axis = int(np.argmax(np.abs(tenth - hundredth)))
    slipped = place.copy()
    slipped[axis] += 0.09 * float(hundredth[axis] - tenth[axis])
    return slipped
