"""What an autopilot's parameters say of antennas, inertial units, camera mount and board on the vehicle.

Sources: ArduPilot, AP_GPS_Params.cpp (`GPS1_POS_*` since 4.6, `GPS_POS1_*` before: antenna from the body's
origin, forward, right, down, m), AP_InertialSensor.cpp (`INS_POS*`, m), AP_Mount_Params.cpp (`MNT1_*`, deg),
AP_AHRS.cpp (`AHRS_TRIM_*`, rad); PX4 (`SENS_GPS0_OFF*` since 1.18, `EKF2_GPS_POS_*` before, m;
`SENS_BOARD_*_OFF`, deg). Both apply trims and board turns to the attitude that they tell.
"""

import tomllib
from collections.abc import Mapping
from dataclasses import dataclass
from importlib import resources
from typing import Any

from photocal.base.sentences import Texts

# Where the camera sits on the body no parameter tells: taken at its origin, give or take, per axis.
CAMERA_PLACE_SIGMA_M = 0.1
# Alignment of a camera with the axes of the body, and of a mount with its commanded angle.
MOUNT_SIGMA_DEG = 2.0
# Each value, its unit and the parameters that contain it: of several sets the first one present.
ANTENNA = "antenna 1"
NEUTRAL = "camera mount, neutral (roll, pitch, yaw)"
THINGS: dict[str, dict[str, Any]] = tomllib.loads(
    resources.files(__package__).joinpath("mounting.toml").read_text(encoding="utf-8")
)
# What a recorder asks an autopilot for.
NAMES = tuple(name for thing in THINGS.values() for names in thing["ways"] for name in names)


@dataclass(frozen=True)
class AutopilotMounting:
    """What an autopilot tells of its mounting, and what follows for the camera.

    values: of each thing its name, its unit, and its parameters by their names.
    camera_to_antenna_m: lever arm, body axes, m, of a camera at the body's origin, `CAMERA_PLACE_SIGMA_M`
        off on each axis; None where no antenna is stated: zeros are what nobody measured.
    mount_deg: roll, pitch and yaw of the camera mount against the body, `MOUNT_SIGMA_DEG` off; None where the
        camera is fixed, or the mount is turned in flight.
    """

    values: tuple[dict[str, Any], ...]
    camera_to_antenna_m: tuple[float, float, float] | None = None
    mount_deg: tuple[float, float, float] | None = None

    def as_json(self) -> dict[str, Any]:
        """Return the values and what is offered for `[rig]` of a project."""
        offered: dict[str, Any] = {}
        if self.camera_to_antenna_m is not None:
            offered["camera_to_antenna_m"] = list(self.camera_to_antenna_m)
            offered["camera_to_antenna_sigma_m"] = [CAMERA_PLACE_SIGMA_M] * 3
        if self.mount_deg is not None:
            offered["mount_deg"] = list(self.mount_deg)
        if self.values:
            # The attitude is that of the body already, whatever turn and trim the board has.
            offered["boresight_sigma_deg"] = [MOUNT_SIGMA_DEG] * 3
        return {"values": list(self.values), "rig": offered}


def mounting_of(parameters: Mapping[str, float]) -> AutopilotMounting:
    """Return what parameters of an autopilot, by their names, tell of its mounting."""
    # MAV_MOUNT_MODE_NEUTRAL: the mount holds its neutral angles.
    neutral_mode = 1.0
    values, by_thing = [], dict[str, tuple[float, ...]]()
    for thing, said in THINGS.items():
        names = next((names for names in said["ways"] if all(name in parameters for name in names)), None)
        if names is not None:
            own = {name: parameters[name] for name in names}
            values.append({"thing": thing, "unit": said["unit"], **own})
            by_thing[thing] = tuple(own.values())
    x, y, z = by_thing.get(ANTENNA, (0.0, 0.0, 0.0))
    kind = by_thing.get("camera mount, type", (0.0,))[0]
    held = kind > 0 and by_thing.get("camera mount, mode at start", (0.0,))[0] == neutral_mode
    roll, pitch, yaw = by_thing.get(NEUTRAL, (0.0, 0.0, 0.0))
    return AutopilotMounting(
        tuple(values),
        (x, y, z) if x or y or z else None,
        (roll, pitch, yaw) if held and NEUTRAL in by_thing else None,
    )


def mounting_lines(told: dict[str, Any], say: Texts) -> list[str]:
    """Say in words what `AutopilotMounting.as_json` tells."""
    # Between numbers with a decimal comma stands a semicolon; `[rig]` is written as a project has it.
    joint = ", " if say.mark == "." else "; "
    lines, rig = [], told["rig"]
    for value in told["values"]:
        parameters = {name: number for name, number in value.items() if name not in ("thing", "unit")}
        numbers = say.row(parameters.values(), ".6g", joint)
        thing = say.stored(value["thing"])
        lines.append(f"{thing}: {numbers} {value['unit']}".rstrip() + f" ({', '.join(parameters)})")
    if "camera_to_antenna_m" in rig:
        arm = ", ".join(f"{number:.6g}" for number in rig["camera_to_antenna_m"])
        lines.append(say("mounting.arm", arm=arm, sigma=say.row([CAMERA_PLACE_SIGMA_M], "g")))
    elif any(value["thing"] == ANTENNA for value in told["values"]):
        lines.append(say("mounting.no_arm"))
    if "mount_deg" in rig:
        angles = say.row(rig["mount_deg"], ".6g", joint)
        lines.append(say("mounting.turned", angles=angles, sigma=say.row([MOUNT_SIGMA_DEG], "g")))
    return [f"  {line}" for line in lines]
