"""The whole of a simulated flight before any device looks at it."""

import datetime as dt
from dataclasses import dataclass, replace

import numpy as np

from acquire.simulate.world import configuration
from acquire.simulate.world.camera import TrueCamera
from acquire.simulate.world.configuration import FlightConfiguration, SimulatedFault
from acquire.simulate.world.exposures import TrueExposures, TrueRig, make_exposures, make_rig
from acquire.simulate.world.motion import Motion, legs, make_motion, strips
from acquire.simulate.world.place import LEAP_S, Place
from acquire.simulate.world.terrain import HeightField, make_terrain
from photocal.base.arrays import Floats, Integers, spread
from photocal.base.errors import ConfigurationError
from photocal.base.time_scales import GPS_EPOCH_NS, SECOND_NS

# Parts of the truth that are drawn one by one, so that a change of one leaves the others as they are.
STREAMS = (
    "terrain", "targets", "rig", "motion", "exposures", "sky", "telemetry", "wires", "texture", "pictures",
    "observations", "faults",
)  # fmt: skip
LASTING = ("terrain", "targets", "rig", "texture")


@dataclass(frozen=True)
class Plates:
    """The plates.

    roles (n,): ``control`` or ``check``.
    codes (n,): identity in the dictionary.
    centre_m (n, 3): in the local frame.
    turn (n,): direction of the plate's upper edge, from east towards north, rad.
    surveyed_m (n, 3): what the survey says, in the local frame.
    """

    names: tuple[str, ...]
    roles: tuple[str, ...]
    codes: Integers
    centre_m: Floats
    turn: Floats
    surveyed_m: Floats


def make_targets(
    given: configuration.TargetKeys, area_m: Floats, terrain: HeightField, random: np.random.Generator
) -> Plates:
    """Lay the plates far from each other over the area; those that spread widest become control."""
    count = given.control + given.check
    places = spread_points(area_m, count, random)
    steps = np.linspace(-0.6, 0.6, 7) * given.side_m
    east, north = np.meshgrid(steps, steps)
    around = terrain.height(places[:, 0, None] + east.ravel(), places[:, 1, None] + north.ravel())
    # The plate lies on the highest ground beneath it, on stones of this height.
    above_ground_m = 0.03
    centre = np.column_stack([places, around.max(axis=1) + above_ground_m])
    control = np.isin(np.arange(count), spread(places, given.control, []))
    numbers = np.where(control, np.cumsum(control), np.cumsum(~control)).tolist()
    kinds = [("control", "GCP") if chosen else ("check", "CHK") for chosen in control.tolist()]
    surveyed = centre + random.standard_normal((count, 3)) * given.sigma_m
    return Plates(
        tuple(f"{letters}{number:02d}" for (_, letters), number in zip(kinds, numbers, strict=True)),
        tuple(role for role, _ in kinds),
        np.arange(1, count + 1),
        centre,
        random.uniform(0, 2 * np.pi, count),
        surveyed,
    )


def spread_points(area_m: Floats, count: int, random: np.random.Generator) -> Floats:
    """Draw points in a polygon, each far from those before (Mitchell 1991), shape (n, 2)."""
    from matplotlib.path import Path as Outline

    low, high = area_m.min(axis=0), area_m.max(axis=0)
    chosen = np.empty((0, 2))
    candidates = 60
    while len(chosen) < count:
        drawn = random.uniform(low, high, (candidates, 2))
        drawn = drawn[Outline(area_m).contains_points(drawn)]
        if not len(drawn):
            continue
        if len(chosen):
            apart = np.linalg.norm(drawn[:, None] - chosen, axis=2).min(axis=1)
            drawn = drawn[np.argmax(apart)][None]
        chosen = np.vstack([chosen, drawn[:1]])
    return chosen


@dataclass(frozen=True)
class World:
    """The truth.

    place: the local frame: all coordinates below are in it, m.
    base_m (3,): the base's mark.
    start_gps_ns: GPS time of the flight's second 0, since 1980-01-06.
    """

    configuration: FlightConfiguration
    place: Place
    terrain: HeightField
    targets: Plates
    camera: TrueCamera
    rig: TrueRig
    motion: Motion
    exposures: TrueExposures
    base_m: Floats
    start_gps_ns: int

    def random(self, part: str) -> np.random.Generator:
        """Give the random numbers of a part."""
        return generator(self.configuration, part)

    def has(self, fault: SimulatedFault) -> bool:
        """Tell whether a fault is switched on."""
        return fault in self.configuration.faults

    @property
    def base_antenna_m(self) -> Floats:
        """Antenna of the base, shape (3,)."""
        height = self.configuration.gnss.base_antenna_height_m
        return np.asarray(self.base_m + np.array([0.0, 0.0, height]))

    @property
    def base_error_m(self) -> Floats:
        """Announced place of the base less the true one, shape (3,)."""
        wrong = self.has("base_off")
        return np.array(self.configuration.fault_sizes.base_m) if wrong else np.zeros(3)

    @property
    def antenna_height_error_m(self) -> float:
        """By which the height of the base's antenna is noted too low."""
        return self.configuration.fault_sizes.antenna_height_m if self.has("wrong_antenna_height") else 0.0

    @property
    def noted_base_m(self) -> Floats:
        """Announced place of the base's mark, shape (3,)."""
        return np.asarray(self.base_m + self.base_error_m)

    @property
    def noted_antenna_height_m(self) -> float:
        """Height of the base's antenna above its mark as it is noted."""
        return self.configuration.gnss.base_antenna_height_m - self.antenna_height_error_m

    @property
    def noted_arm_m(self) -> Floats:
        """Lever arm from camera to antenna as the surveyor writes it down, shape (3,)."""
        arm = np.array(self.configuration.rig.camera_to_antenna_m)
        return arm[[2, 1, 0]] if self.has("lever_arm_axis") else arm

    def gps_ns(self, time_s: Floats) -> Integers:
        """Give GPS nanoseconds of seconds since the start."""
        return np.asarray(self.start_gps_ns + np.rint(np.asarray(time_s) * 1e9).astype(np.int64))

    def utc_ns(self, time_s: Floats) -> Integers:
        """Give UTC nanoseconds since 1970 of seconds since the start."""
        return np.asarray(self.gps_ns(time_s) + GPS_EPOCH_NS - LEAP_S * SECOND_NS)

    def seconds(self, gps_ns: Integers) -> Floats:
        """Give seconds since the start of GPS nanoseconds."""
        return np.asarray((gps_ns - self.start_gps_ns) / 1e9)


def generator(configuration: FlightConfiguration, part: str) -> np.random.Generator:
    """Give the random numbers of one part of a simulation, independent of the other parts."""
    lasting = configuration.field_seed if part in LASTING else None
    seed = configuration.seed if lasting is None else lasting
    return np.random.default_rng([seed, STREAMS.index(part)])


def make_world(configuration: FlightConfiguration) -> World:
    """Draw a world and fly through it."""
    area = np.array(configuration.plan.area_m)
    far = np.abs(area).max() + 1.3 * max(pass_.height_m for pass_ in configuration.plan.passes)
    half = max(float(far), float(np.abs(configuration.gnss.base_m).max()) + 5.0)
    terrain = make_terrain(configuration.terrain, half, generator(configuration, "terrain"))
    _require_room(configuration, terrain)
    targets = make_targets(configuration.targets, area, terrain, generator(configuration, "targets"))
    camera = configuration.camera
    rig = make_rig(configuration.rig, generator(configuration, "rig"))
    lines = strips(configuration.plan, configuration.camera)
    home = np.array(configuration.plan.take_off_m)
    ground = float(terrain.height(home[:1], home[1:])[0]) + 0.3
    start, way = legs(configuration.plan, lines, ground)
    motion = make_motion(start, way, configuration.vehicle, generator(configuration, "motion"))
    if "late_shutter" in configuration.faults:
        rig = replace(rig, time_offset_s=rig.time_offset_s + configuration.fault_sizes.late_s)
    passes = configuration.plan.passes
    zoomed = camera.zoomed(configuration.fault_sizes.zoom) if "zoom" in configuration.faults else camera
    cameras = (camera, *[zoomed] * (len(passes) - 1))
    spreads = tuple(pass_.spacing_spread for pass_ in passes)
    exposures = make_exposures(motion, rig, lines, spreads, cameras, generator(configuration, "exposures"))
    base = np.array([*configuration.gnss.base_m, 0.0])
    base[2] = float(terrain.height(base[:1], base[1:2])[0])
    start_utc_s = round(configuration.place.start_utc.timestamp())
    start_gps = (start_utc_s + LEAP_S) * SECOND_NS - GPS_EPOCH_NS
    return World(
        configuration,
        configuration.place,
        terrain,
        targets,
        camera,
        rig,
        motion,
        exposures,
        base,
        start_gps,
    )


def _require_room(configuration: FlightConfiguration, terrain: HeightField) -> None:
    """Refuse a flight into the ground."""
    # Below, trees and the start of a strip would be in the way.
    least_above_ground_m = 5.0
    area = np.array(configuration.plan.area_m)
    reach = np.linspace(1.3 * area.min(axis=0), 1.3 * area.max(axis=0), 40)
    top = float(terrain.height(*(axis.ravel() for axis in np.meshgrid(*reach.T))).max())
    lowest = min(pass_.height_m for pass_ in configuration.plan.passes)
    if lowest < top + least_above_ground_m:
        raise ConfigurationError(
            f"a pass at {lowest:g} m is too low: the ground reaches {top:.1f} m",
            where="[[plan.pass]]",
            remedy=f"fly at least {top + least_above_ground_m:.0f} m above the origin, or take less relief_m",
        )


def picture_stamps(world: World) -> list[dt.datetime]:
    """Give the time that the camera writes into each picture: offset, drift, jitter, cut to milliseconds."""
    given, random = world.configuration.pictures, world.random("pictures")
    event = world.exposures.event_s
    jitter = np.abs(random.standard_normal(len(event))) * given.clock_jitter_s
    written_s = event * (1 + given.clock_drift_ppm * 1e-6) + given.clock_offset_s + jitter
    unit_s = 1e-3 if given.subseconds else 1.0
    start = world.configuration.place.start_utc.astimezone(dt.UTC).replace(tzinfo=None)
    whole = np.floor(written_s / unit_s).astype(int).tolist()
    return [start + dt.timedelta(seconds=count * unit_s) for count in whole]
