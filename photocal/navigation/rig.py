"""Camera, antenna and inertial unit beside each other: lever arm, boresight, camera axes."""

from collections.abc import Iterable
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from acquire.channels.mounting import CAMERA_PLACE_SIGMA_M, MOUNT_SIGMA_DEG, AutopilotMounting
from photocal.base.arrays import Floats
from photocal.base.errors import ConfigurationError
from photocal.block.camera_setup import Sigma, sigmas
from photocal.block.mounting import BODY_AXES
from photocal.block.setup import MountingKeys
from photocal.findings.finding import Finding
from photocal.geometry.rotation import NADIR


@dataclass(frozen=True)
class CameraOnBody:
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
    lever_sigma_m: Floats = field(default_factory=lambda: np.zeros(3))
    angle_sigma: Floats | None = None
    boresight: Floats = field(default_factory=lambda: np.zeros(3))
    boresight_sigma: Floats = field(default_factory=lambda: np.zeros(3))
    axes: Floats = field(default_factory=NADIR.copy)
    time_offset_s: float = 0.0
    time_offset_sigma_s: float = 0.0

    def __post_init__(self) -> None:
        if self.lever_m is not None and self.angle_sigma is None:
            raise ConfigurationError(
                "a lever arm needs the standard deviations of the attitude that turns it",
                "give --attitude-sigma ROLL,PITCH,YAW in degrees",
            )


def check_mounting(rig: CameraOnBody, mounting: AutopilotMounting) -> list[Finding]:
    """Compare lever arm and camera axes of a project with what the vehicle's parameters tell of its mounting.

    The parameters refer to the body's origin, the lever arm to the camera: the difference is where the
    camera would sit on the body. No check where the vehicle tells nothing.
    """
    findings = []
    code, antenna = "vehicle-antenna", mounting.camera_to_antenna_m
    if antenna is not None:
        figures: dict[str, Any] = {"numbers": _signed(antenna), "sigma_m": CAMERA_PLACE_SIGMA_M}
        if rig.lever_m is None:
            findings.append(Finding("vehicle-antenna-offered", "note", figures=figures))
        else:
            camera = np.asarray(antenna) - rig.lever_m
            figures |= {"stated": _signed(rig.lever_m), "difference": _signed(camera)}
            limit = 3.0 * np.hypot(CAMERA_PLACE_SIGMA_M, rig.lever_sigma_m)
            far = bool((np.abs(camera) > limit).any())
            turned = far and bool((np.abs(np.asarray(antenna) + rig.lever_m) < limit).all())
            clauses = ("lever-reversed",) if turned else ()
            findings.append(Finding(code, "doubtful" if far else "passed", figures=figures, clauses=clauses))
    if mounting.mount_deg is not None:
        # The mount's forward axis on the body (yaw, pitch, roll), and where the project has the camera look.
        roll, pitch, yaw = mounting.mount_deg
        ahead = Rotation.from_euler("ZYX", (yaw, pitch, roll), degrees=True).as_matrix()[:, 0]
        looks = -(Rotation.from_rotvec(rig.boresight).as_matrix() @ rig.axes)[2]
        apart = float(np.degrees(np.arccos(np.clip(ahead @ looks, -1.0, 1.0))))
        limit_deg = 3.0 * float(np.hypot(MOUNT_SIGMA_DEG, np.degrees(rig.boresight_sigma.max())))
        figures = {"numbers": _signed(mounting.mount_deg), "apart_deg": apart, "limit_deg": limit_deg}
        far = apart > limit_deg
        findings.append(Finding("vehicle-mount", "doubtful" if far else "passed", figures=figures))
    return findings


def camera_axes(directions: tuple[str, ...]) -> Floats:
    """Return the rotation from body to camera axes of the body directions of camera x, y and z.

    raises ConfigurationError: when a direction is unknown or the three are no right-handed system.
    """
    matrix = np.array([BODY_AXES[name] for name in directions if name in BODY_AXES])
    if matrix.shape != (3, 3) or not np.isclose(np.linalg.det(matrix), 1.0):
        raise ConfigurationError(
            f"{', '.join(directions)} are not the directions of a right-handed camera",
            "give those of x (right), y (up in the image), z (backwards): right,forward,up looks down",
        )
    return matrix


def rig_of_mounting(keys: MountingKeys, angle_sigma: Floats) -> CameraOnBody:
    """Return the rig of a block's or project's mounting."""
    return CameraOnBody(
        np.asarray(keys.lever_arm_m, np.float64),
        _sigma(keys.lever_arm_sigma_m, 1.0),
        angle_sigma,
        np.radians(np.asarray(keys.boresight_deg, np.float64)),
        np.radians(_sigma(keys.boresight_sigma_deg, 10.0)),
        camera_axes(tuple(keys.camera_axes)),
        keys.time_offset_s,
        float(_sigma(keys.time_offset_sigma_s, 0.05)[0]),
    )


def _signed(values: Iterable[float]) -> tuple[str, ...]:
    return tuple(f"{value:+.3f}" for value in values)


def _sigma(given: Sigma, unknown: float) -> Floats:
    """Return standard deviations; what an adjustment is to find is not known better than `unknown`."""
    stated = sigmas(given)
    return np.where(np.isinf(stated), unknown, stated)
