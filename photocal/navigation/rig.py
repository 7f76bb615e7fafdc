"""Camera, antenna and inertial unit beside each other: lever arm, boresight, camera axes."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Literal

import numpy as np

from drivers.arrays import Floats
from drivers.errors import ConfigurationError
from photocal.adjustment.mounting import NADIR
from photocal.block.mounting import BODY_AXES
from photocal.block.setup import MountingKeys


def _none() -> Floats:
    return np.zeros(3)


@dataclass(frozen=True)
class Rig:
    """How the camera sits on the body (forward, right, down) whose attitude is recorded.

    lever_m (3,): from the camera's projection centre to the antenna, body axes, m; None: unknown, positions
        stay at the antenna.
    lever_sigma_m (3,): its standard deviations.
    angle_sigma (3,): standard deviations of the recorded roll, pitch, yaw, rad; None: unknown.
    boresight, boresight_sigma (3,): turn from the nominal to the true camera axes, a rotation vector in
        camera axes, rad.
    axes (3, 3): nominal rotation from body to camera axes (x right, y up in the image, z backwards).
    time_offset_s, time_offset_sigma_s: by which the exposures come later than their events, beyond the stated
        delay.
    """

    lever_m: Floats | None = None
    lever_sigma_m: Floats = field(default_factory=_none)
    angle_sigma: Floats | None = None
    boresight: Floats = field(default_factory=_none)
    boresight_sigma: Floats = field(default_factory=_none)
    axes: Floats = field(default_factory=NADIR.copy)
    time_offset_s: float = 0.0
    time_offset_sigma_s: float = 0.0

    def __post_init__(self) -> None:
        if self.lever_m is not None and self.angle_sigma is None:
            raise ConfigurationError(
                "a lever arm needs the standard deviations of the attitude that turns it",
                remedy="give --attitude-sigma ROLL,PITCH,YAW in degrees",
            )


def camera_axes(directions: tuple[str, ...]) -> Floats:
    """Return the rotation from body to camera axes of the body directions of camera x, y and z.

    Raises
    ------
    ConfigurationError
        When a direction is unknown or the three are no right-handed system.
    """
    known = [BODY_AXES[name] for name in directions if name in BODY_AXES]
    matrix = np.array(known)
    if matrix.shape != (3, 3) or not np.isclose(np.linalg.det(matrix), 1.0):
        raise ConfigurationError(
            f"{', '.join(directions)} are not the directions of a right-handed camera",
            remedy="give those of x (right), y (up in the image), z (backwards): right,forward,up looks down",
        )
    return matrix


def rig_of_mounting(keys: MountingKeys, angle_sigma: Floats) -> Rig:
    """Return the rig of a block's or project's mounting."""
    return Rig(
        np.asarray(keys.lever_arm_m, np.float64),
        _sigma(keys.lever_arm_sigma_m, 1.0),
        angle_sigma,
        np.radians(np.asarray(keys.boresight_deg, np.float64)),
        np.radians(_sigma(keys.boresight_sigma_deg, 10.0)),
        camera_axes(tuple(keys.camera_axes)),
        keys.time_offset_s,
        float(_sigma(keys.time_offset_sigma_s, 0.05)[0]),
    )


def _sigma(given: float | tuple[float, ...] | Literal["free"], unknown: float) -> Floats:
    """Return standard deviations; what an adjustment is to find is not known better than `unknown`."""
    value = unknown if isinstance(given, str) else given
    return np.array(np.broadcast_to(np.asarray(value, np.float64), 3))
