"""Rotations of a body at instants: between recorded ones, with rate and covariance."""

from dataclasses import dataclass

import numpy as np
from scipy.spatial.transform import Rotation

from photocal.base.arrays import Flags, Floats
from photocal.geometry.rotation import TO_NED, object_to_body
from photocal.navigation.time import GpsTime
from photocal.navigation.trajectory import LARGEST_GAP_S, local_mean_square

# A camera's own axes when its body's forward axis is the line of sight: x right, y up, z backwards.
LINE_OF_SIGHT = np.array([[0.0, 1.0, 0.0], [0.0, 0.0, -1.0], [-1.0, 0.0, 0.0]])
# Turn of a vehicle between attitudes a second apart, off the steady turn, where it is not known.
_DEFAULT_WANDER = np.radians(3.0)


@dataclass(frozen=True)
class AttitudeSeries:
    """Rotations at instants.

    rotation (n, 3, 3): from east, north, up to body axes (forward, right, down); NaN where unknown.
    rate (n, 3): angular velocity about the body axes, rad/s; zero where it is not known.
    covariance (n, 3, 3): of small turns t about the body axes (true rotation = exp(-[t]x) rotation), rad^2,
        without the effect of an error of the time; NaN where unknown.
    """

    rotation: Floats
    rate: Floats
    covariance: Floats

    @property
    def known(self) -> Flags:
        """Where there is a rotation."""
        return np.asarray(np.isfinite(self.rotation).all(axis=(1, 2)))

    @property
    def angles(self) -> Floats:
        """Roll, pitch, yaw of the body in north, east, down; radians, NaN where unknown (n, 3)."""
        r = self.rotation @ TO_NED
        pitch = np.arcsin(np.clip(-r[:, 0, 2], -1.0, 1.0))
        return np.stack(
            [np.arctan2(r[:, 1, 2], r[:, 2, 2]), pitch, np.arctan2(r[:, 0, 1], r[:, 0, 0])], axis=1
        )

    def turned(self, matrix: Floats) -> "AttitudeSeries":
        """Return the rotations of other axes that are fixed to the body: matrix times rotation."""
        return AttitudeSeries(
            matrix @ self.rotation, self.rate @ matrix.T, matrix @ self.covariance @ matrix.T
        )


def no_attitudes(count: int) -> AttitudeSeries:
    """Return unknown rotations."""
    unknown = np.full((count, 3, 3), np.nan)
    return AttitudeSeries(unknown, np.zeros((count, 3)), unknown.copy())


def from_angles(angles: Floats, sigma: Floats | None) -> AttitudeSeries:
    """Return the rotations of roll, pitch, yaw with their standard deviations."""
    rotation, turn = object_to_body(angles)
    rate = np.zeros((len(angles), 3))
    if sigma is None:
        return AttitudeSeries(rotation, rate, np.full((len(angles), 3, 3), np.nan))
    spread = np.broadcast_to(np.asarray(sigma, np.float64), angles.shape)
    return AttitudeSeries(rotation, rate, turn @ (spread[:, :, None] ** 2 * np.swapaxes(turn, 1, 2)))


@dataclass(frozen=True)
class AttitudeTrack:
    """Recorded rotations in the order of time.

    time: by the clock of what measured them.
    rotation (n, 3, 3): from east, north, up to body axes.
    """

    time: GpsTime
    rotation: Floats

    def __len__(self) -> int:
        return len(self.time)


def rotations_of_quaternions(wxyz: Floats) -> Floats:
    """Return rotations from east, north, up to body axes of quaternions (n, 4), w first, body to NED."""
    from_ned = Rotation.from_quat(wxyz[:, [1, 2, 3, 0]]).inv()
    return np.asarray(from_ned.as_matrix() @ TO_NED)


def at_instants(track: AttitudeTrack, time: GpsTime, sigma: Floats | None) -> AttitudeSeries:
    """Return the rotations at instants by spherical interpolation (Shoemake 1985, section 3.3)."""
    n = len(time)
    if len(track) < 2:
        return no_attitudes(n)
    stamps = track.time.ns
    after = np.clip(np.searchsorted(stamps, time.ns, side="right"), 1, len(stamps) - 1)
    before = after - 1
    gap = (stamps[after] - stamps[before]) / 1e9
    near = (time.ns >= stamps[0]) & (time.ns <= stamps[-1]) & (gap <= LARGEST_GAP_S)
    attitudes = no_attitudes(n)
    if not near.any():
        return attitudes
    before, after, gap = before[near], after[near], gap[near]
    u = (time.ns[near] - stamps[before]) / (stamps[after] - stamps[before])
    start = track.rotation[before]
    turn = _turn(start, track.rotation[after])
    attitudes.rotation[near] = _turned(start, turn * u[:, None])
    attitudes.rate[near] = turn / gap[:, None]
    q = _wander(track, time[near])
    variance = q**2 * (4 * u * (1 - u) * gap)[:, None]
    if sigma is not None:
        part = AttitudeSeries(
            attitudes.rotation[near], attitudes.rate[near], np.zeros((int(near.sum()), 3, 3))
        )
        stated = from_angles(part.angles, sigma).covariance
        attitudes.covariance[near] = stated + variance[:, :, None] * np.eye(3)
    return attitudes


def left_out_turns(track: AttitudeTrack) -> tuple[GpsTime, Floats, Floats]:
    """Leave out every rotation in turn and interpolate it from its neighbours."""
    i = np.arange(1, len(track) - 1)
    stamps = track.time.ns
    gap = (stamps[i + 1] - stamps[i - 1]) / 1e9
    i = i[gap <= 2 * LARGEST_GAP_S]
    gap = (stamps[i + 1] - stamps[i - 1]) / 1e9
    u = (stamps[i] - stamps[i - 1]) / (stamps[i + 1] - stamps[i - 1])
    start = track.rotation[i - 1]
    middle = _turned(start, _turn(start, track.rotation[i + 1]) * u[:, None])
    error = _turn(middle, track.rotation[i])
    # Brought to the middle of the gap, where the bridge is widest.
    error = error / np.sqrt(np.maximum(4 * u * (1 - u), 0.05))[:, None]
    return track.time[i], error, np.asarray(gap, np.float64)


def _wander(track: AttitudeTrack, time: GpsTime) -> Floats:
    # Of fewer the error of interpolation is not known.
    least_trials = 20
    trial_time, error, gap = left_out_turns(track)
    if len(gap) < least_trials:
        return np.full((len(time), 3), _DEFAULT_WANDER)
    mean = local_mean_square(trial_time, (error / np.sqrt(gap)[:, None]) ** 2, time)
    return np.asarray(np.maximum(np.sqrt(mean), 1e-6))


def _turn(start: Floats, end: Floats) -> Floats:
    """Return t with end = exp(-[t]x) start."""
    return np.asarray(-Rotation.from_matrix(end @ np.swapaxes(start, 1, 2)).as_rotvec())


def _turned(start: Floats, turn: Floats) -> Floats:
    return np.asarray(Rotation.from_rotvec(-turn).as_matrix() @ start)
