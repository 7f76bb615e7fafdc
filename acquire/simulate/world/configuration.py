"""The configuration of a simulated flight (TOML)."""

from pathlib import Path
from typing import Annotated, Any, Literal, Self

import numpy as np
from pydantic import Field, FiniteFloat, PositiveFloat, model_validator

from acquire.simulate.world.camera import TrueCamera
from acquire.simulate.world.place import Place
from photocal.base.checked_toml import Table, checked_tables, read_tables

Pair = tuple[FiniteFloat, FiniteFloat]
Triple = tuple[FiniteFloat, FiniteFloat, FiniteFloat]
NonNegative = Annotated[FiniteFloat, Field(ge=0)]
Sigmas = tuple[NonNegative, NonNegative, NonNegative]
PositiveSigmas = tuple[PositiveFloat, PositiveFloat, PositiveFloat]
Share = Annotated[float, Field(ge=0, lt=1)]
# Flights that are known by name.
FLIGHTS = Path(__file__).parents[1] / "flights"


# What can be made wrong; each is one mistake that people or devices make.
SimulatedFault = Literal[
    "wrong_antenna_height", "base_off", "event_time_base", "late_shutter", "lever_arm_axis", "zoom",
    "control_digits", "missing_images", "telemetry_gap", "cycle_slips",
]  # fmt: skip
# How far a flight is simulated. pictures: streams of the devices and rendered images. observations: streams,
# and image observations instead of images. block: a block folder whose positions and attitudes carry the
# noise they state. card: what a drone that keeps its log to itself gives: rendered images, control points and
# their marks.
Level = Literal["pictures", "observations", "block", "card"]


class FaultSizes(Table):
    """`[fault_sizes]`: how large the faults are that are switched on.

    antenna_height_m: by which the height of the base's antenna is noted too low: a slant height taken for a
        vertical one, or a mark confused with its tripod's plate.
    base_m: east, north, up: announced place of the base less the true one.
    late_s: by which exposures happen later after their events than anybody knows.
    zoom: principal distance of the later passes over that of the first.
    control_m: what is typed too much; with zeros two neighbouring digits change places.
    missing_share: part of the images, all in a row.
    slips_per_hour: of every signal; with 360 a new ambiguity has hardly been fixed when the next slip comes.
    """

    antenna_height_m: FiniteFloat = 0.2
    base_m: Triple = (0.7, -0.5, 0.5)
    late_s: FiniteFloat = 0.1
    zoom: PositiveFloat = 1.004
    control_m: Triple = (0.0, 0.0, 0.0)
    missing_share: Annotated[float, Field(gt=0, le=0.5)] = 0.1
    gap_s: PositiveFloat = 30.0
    slips_per_hour: PositiveFloat = 360.0


class TerrainKeys(Table):
    """Fractal relief: standard deviation, longest wave, and how power falls with the wave number."""

    relief_m: NonNegative = 3.0
    longest_m: PositiveFloat = 120.0
    exponent: Annotated[float, Field(ge=2, le=6)] = 3.4


class Pass(Table):
    """One coverage of the area by parallel strips."""

    height_m: PositiveFloat
    course_deg: FiniteFloat
    speed_m_s: PositiveFloat
    forward_overlap: Share = 0.75
    side_overlap: Share = 0.6
    spacing_spread: Annotated[float, Field(ge=0, le=0.15)] = 0.04


class PlanKeys(Table):
    """The flight: corners of the area (east, north), and its passes."""

    area_m: Annotated[tuple[Pair, ...], Field(min_length=3)]
    passes: Annotated[tuple[Pass, ...], Field(min_length=1)] = Field(alias="pass")
    on_ground_s: Annotated[float, Field(ge=2)] = 40.0
    take_off_m: Pair = (0.0, 0.0)

    @model_validator(mode="after")
    def _has_area(self) -> Self:
        east, north = np.array(self.area_m).T
        if abs(east @ np.roll(north, -1) - np.roll(east, -1) @ north) < 2.0:
            raise ValueError("area_m encloses less than a square metre")
        return self


class VehicleKeys(Table):
    """Motion beside the plan: wind, gusts and vibration of a multirotor."""

    wind_m_s: NonNegative = 2.0
    wind_from_deg: FiniteFloat = 120.0
    sway_m: NonNegative = 0.05
    shake_deg: NonNegative = 0.6
    vibration_deg: NonNegative = 0.01


class RigKeys(Table):
    """What the surveyor believes of the rig; the truth is drawn around it with the stated sigmas."""

    camera_to_antenna_m: Triple
    camera_to_antenna_sigma_m: Sigmas = (0.01, 0.01, 0.01)
    boresight_deg: Triple = (0.0, 0.0, 0.0)
    boresight_sigma_deg: Sigmas = (1.0, 1.0, 1.0)
    time_offset_s: FiniteFloat = 0.0
    time_offset_sigma_s: NonNegative = 0.005
    position_sigma_m: PositiveSigmas = (0.012, 0.012, 0.025)
    attitude_sigma_deg: PositiveSigmas = (0.3, 0.3, 0.6)


class TargetKeys(Table):
    """Surveyed plates: how many, their coded pattern, and how well their centres are known."""

    control: Annotated[int, Field(ge=0)] = 8
    check: Annotated[int, Field(ge=0)] = 12
    dictionary: str = "apriltag_36h11"
    side_m: PositiveFloat = 1.0
    sigma_m: PositiveSigmas = (0.008, 0.008, 0.012)


class Pictures(Table):
    """What befalls a picture: blur, noise, vignetting, and the camera's clock."""

    texel_m: PositiveFloat = 0.028
    blur_px: NonNegative = 0.55
    noise_grey: NonNegative = 1.5
    vignetting: Share = 0.25
    quality: Annotated[int, Field(ge=50, le=100)] = 92
    clock_offset_s: FiniteFloat = 7.3
    clock_drift_ppm: FiniteFloat = 8.0
    clock_jitter_s: NonNegative = 0.003
    subseconds: bool = True
    gimbal_xmp: bool = False


class Observing(Table):
    """Image observations of the levels without pictures."""

    ties: Annotated[int, Field(ge=0)] = 800
    sigma_px: PositiveFloat = 0.4
    target_sigma_px: PositiveFloat = 0.1


class Gnss(Table):
    """Receivers: rates, and the base's place (east, north) and antenna height above its mark."""

    rover_interval_s: PositiveFloat = 0.2
    base_interval_s: PositiveFloat = 1.0
    base_m: Pair = (-60.0, -40.0)
    base_antenna_height_m: NonNegative = 1.652
    base_protocol: Literal["ubx", "rtcm3"] = "ubx"


class Air(Table):
    """Temperature at sea level, and humidity at all heights."""

    temperature_c: Annotated[float, Field(ge=-40, le=50)] = 15.0
    relative_humidity: Annotated[float, Field(ge=0, le=1)] = 0.5


class Telemetry(Table):
    """The autopilot's stream: rates, and how its filter differs from the truth."""

    attitude_hz: PositiveFloat = 20.0
    position_hz: PositiveFloat = 5.0
    lag_s: NonNegative = 0.01
    boot_s: NonNegative = 87.0
    clock_drift_ppm: FiniteFloat = 12.0
    latency_s: NonNegative = 0.04


class Wires(Table):
    """Losses (whole frames) and damage (single bits) on the way to the recording."""

    vehicle_loss: Share = 0.0
    vehicle_damage: Share = 0.0
    rover_loss: Share = 0.0
    rover_damage: Share = 0.0


class SimulatedJudgement(Table):
    """What the project file asks the check points to be judged against."""

    scale: str = ""
    standards: tuple[str, ...] = ()


class FlightConfiguration(Table):
    """The whole file.

    `seed` draws everything; with `field_seed` ground, targets, their survey and the rig stay the same for all
    seeds, as when one vehicle flies over one test field again.
    """

    name: str = "simulated flight"
    seed: Annotated[int, Field(ge=0)] = 1
    field_seed: Annotated[int, Field(ge=0)] | None = None
    level: Level = "pictures"
    place: Place
    terrain: TerrainKeys = TerrainKeys()
    plan: PlanKeys
    vehicle: VehicleKeys = VehicleKeys()
    camera: TrueCamera
    rig: RigKeys
    targets: TargetKeys = TargetKeys()
    pictures: Pictures = Pictures()
    observing: Observing = Observing()
    gnss: Gnss = Gnss()
    air: Air = Air()
    telemetry: Telemetry = Telemetry()
    wires: Wires = Wires()
    faults: frozenset[SimulatedFault] = frozenset()
    fault_sizes: FaultSizes = FaultSizes()
    judgement: SimulatedJudgement = SimulatedJudgement()


def read_configuration(path: Path, instead: dict[str, Any] | None = None) -> FlightConfiguration:
    """Read the configuration of a simulated flight.

    raises InputNotFoundError: when the file cannot be read.
    raises ConfigurationError: when it is no TOML, has an unknown key or an impossible value.
    """
    known = FLIGHTS / f"{path}.toml"
    path = known if not path.exists() and known.is_file() else path
    return checked_tables({**read_tables(path), **(instead or {})}, FlightConfiguration, path)
