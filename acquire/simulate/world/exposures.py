"""When and from where the pictures are taken: events, exposures, the rig between body, camera and antenna."""

from dataclasses import dataclass

import numpy as np
from scipy.spatial.transform import Rotation

from acquire.simulate.world import configuration
from acquire.simulate.world.camera import TrueCamera
from acquire.simulate.world.motion import FlownStrip, Motion
from photocal.base.arrays import Floats, Integers

# Camera axes (x right, y up in the image, z backwards) in body axes (forward, right, down), the upper edge of
# the image forward.
NADIR = np.array([[0.0, 1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, -1.0]])
# The same axes as OpenCV has them: y down, z forward.
TO_OPENCV = np.diag([1.0, -1.0, -1.0])
# Where the camera sits below the inertial unit, body axes, m.
CAMERA_FROM_IMU_M = np.array([0.04, 0.0, 0.06])


@dataclass(frozen=True)
class TrueRig:
    """The true mounting.

    camera_to_antenna_m (3,): from the projection centre to the antenna's phase centre, body axes.
    boresight (3,): rotation vector in camera axes, rad: body to camera is exp([b]x) NADIR.
    time_offset_s: from the event to the middle of the exposure.
    """

    camera_to_antenna_m: Floats
    boresight: Floats
    time_offset_s: float

    @property
    def body_to_camera(self) -> Floats:
        """Rotation from body to camera axes, shape (3, 3)."""
        return np.asarray(Rotation.from_rotvec(self.boresight).as_matrix() @ NADIR)


def make_rig(given: configuration.RigKeys, random: np.random.Generator) -> TrueRig:
    """Draw the true rig around what the surveyor believes of it, with the sigmas that he states."""
    arm = given.camera_to_antenna_m + random.standard_normal(3) * given.camera_to_antenna_sigma_m
    turn = np.radians(given.boresight_deg + random.standard_normal(3) * given.boresight_sigma_deg)
    late = given.time_offset_s + random.standard_normal() * given.time_offset_sigma_s
    return TrueRig(arm, turn, float(late))


@dataclass(frozen=True)
class Pose:
    """Projection centres and rotations of many moments.

    centre_m (n, 3): in the local frame.
    rotation (n, 3, 3): M, from the local frame to camera axes.
    """

    centre_m: Floats
    rotation: Floats


def pose_at(motion: Motion, rig: TrueRig, time_s: Floats) -> Pose:
    """Give where the camera is and how it is turned."""
    body = motion.to_body(time_s)
    centre = motion.position(time_s) + np.swapaxes(body, 1, 2) @ CAMERA_FROM_IMU_M
    return Pose(centre, rig.body_to_camera @ body)


def antenna_at(motion: Motion, rig: TrueRig, time_s: Floats) -> Floats:
    """Give positions of the antenna in the local frame, shape (n, 3)."""
    body = motion.to_body(time_s)
    return np.asarray(
        motion.position(time_s) + np.swapaxes(body, 1, 2) @ (CAMERA_FROM_IMU_M + rig.camera_to_antenna_m)
    )


def antenna_velocity(motion: Motion, rig: TrueRig, time_s: Floats) -> Floats:
    """Give velocities of the antenna by central differences, shape (n, 3)."""
    # Over 1 ms the third derivative of a motion of 60 Hz and millimetres leaves an error far below 1 mm/s.
    step_s = 1e-3
    after, before = (antenna_at(motion, rig, time_s + side * step_s) for side in (1.0, -1.0))
    return np.asarray((after - before) / (2 * step_s))


def omega_phi_kappa(rotation: Floats) -> Floats:
    """Give omega, phi, kappa (rad) of M = R3(kappa) R2(phi) R1(omega), shape (n, 3)."""
    # Source: Kraus (2007), Photogrammetry, section 4.1.
    m = rotation
    phi = np.arcsin(np.clip(m[:, 2, 0], -1, 1))
    omega = np.arctan2(-m[:, 2, 1], m[:, 2, 2])
    kappa = np.arctan2(-m[:, 1, 0], m[:, 0, 0])
    return np.column_stack([omega, phi, kappa])


@dataclass(frozen=True)
class TrueExposures:
    """All pictures of a flight in the order of time.

    names (n,): of the files.
    covers, strip (n,): number of the pass and of the strip.
    event_s (n,): when the camera told the receiver, seconds since the start of the flight.
    middle_s (n,): middle of the exposure of the middle row.
    cameras (n,): the true camera of each picture; it changes when somebody zooms.
    """

    names: tuple[str, ...]
    covers: Integers
    strip: Integers
    event_s: Floats
    middle_s: Floats
    pose: Pose
    cameras: tuple[TrueCamera, ...]

    def __len__(self) -> int:
        return len(self.names)


def make_exposures(
    motion: Motion,
    rig: TrueRig,
    lines: tuple[FlownStrip, ...],
    spreads: tuple[float, ...],
    cameras: tuple[TrueCamera, ...],
    random: np.random.Generator,
) -> TrueExposures:
    """Take the pictures of a flight."""
    event, covers, strip = [], [], []
    for number, begin, end in motion.strip:
        line = lines[number]
        even = np.linspace(begin, end, line.exposures)
        step = (end - begin) / (line.exposures - 1)
        event.append(even + spreads[line.covers] * step * random.standard_normal(line.exposures))
        covers.append(np.full(line.exposures, line.covers))
        strip.append(np.full(line.exposures, number))
    moment, passes = np.concatenate(event), np.concatenate(covers)
    # Clocks of receivers count whole nanoseconds.
    moment = np.round(moment, 9)
    middle = moment + rig.time_offset_s
    names = tuple(f"IMG_{number:04d}.JPG" for number in range(1, len(moment) + 1))
    return TrueExposures(
        names,
        passes,
        np.concatenate(strip),
        moment,
        middle,
        pose_at(motion, rig, middle),
        tuple(cameras[k] for k in passes.tolist()),
    )
