"""What can be made wrong in a simulated flight, and by how much."""

from __future__ import annotations

from enum import StrEnum
from typing import Annotated

from pydantic import Field, FiniteFloat, PositiveFloat

from acquire.checked_toml import Table

Pair = tuple[FiniteFloat, FiniteFloat]
Triple = tuple[FiniteFloat, FiniteFloat, FiniteFloat]
NonNegative = Annotated[FiniteFloat, Field(ge=0)]
Sigmas = tuple[NonNegative, NonNegative, NonNegative]
PositiveSigmas = tuple[PositiveFloat, PositiveFloat, PositiveFloat]
Share = Annotated[float, Field(ge=0, lt=1)]


class Fault(StrEnum):
    """What can be made wrong; each is one mistake that people or devices make."""

    ANTENNA_HEIGHT = "wrong_antenna_height"
    BASE_OFF = "base_off"
    EVENT_TIME_BASE = "event_time_base"
    LATE_SHUTTER = "late_shutter"
    LEVER_ARM_AXIS = "lever_arm_axis"
    ZOOM = "zoom"
    CONTROL_DIGITS = "control_digits"
    MISSING_IMAGES = "missing_images"
    TELEMETRY_GAP = "telemetry_gap"
    CYCLE_SLIPS = "cycle_slips"


class FaultSizes(Table):
    """`[fault_sizes]`: how large the faults are that are switched on.

    antenna_height_m: by which the height of the base's antenna is noted too low: a slant height taken for a
        vertical one, or a mark confused with its tripod's plate.
    base_m: east, north, up: announced place of the base less the true one.
    late_s: by which exposures happen later after their events than anybody knows.
    zoom: principal distance of the later passes over that of the first.
    control_m: what is typed too much; with zeros two neighbouring digits change places.
    missing_share: part of the images, all in a row.
    gap_s: without telemetry.
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
