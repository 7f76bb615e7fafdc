"""From events to exposures: where the camera was, how it was turned, and how sure that is."""

import json
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.spatial.transform import Rotation

from photocal.base.arrays import Floats, Integers
from photocal.base.errors import ConfigurationError
from photocal.base.tables import TableColumns
from photocal.geometry.rotation import angles_from_matrix, left_jacobian, skew, turn_per_angle
from photocal.navigation.attitude import AttitudeSeries
from photocal.navigation.events import Events
from photocal.navigation.rig import CameraOnBody
from photocal.navigation.time import GpsTime
from photocal.navigation.trajectory import LARGEST_GAP_S, InterpolatedPositions


def names_cell(names: Sequence[str]) -> str:
    """Names of the images of one event as a cell: one as it is, several as a JSON list; empty for none."""
    plain = len(names) < 2 and not "".join(names).startswith("[")
    return "".join(names) if plain else json.dumps(names, ensure_ascii=False)


@dataclass(frozen=True, repr=False)
class Exposures(TableColumns):
    """Exposures of a flight, one row per event.

    Attributes
    ----------
    time
        GPS time of each.
    number
        Count of the device, shape (n,).
    placed
        Position (of the antenna, or of the camera, once `at_camera` was applied), velocity, covariance,
        status.
    attitude
        Of the body that carries the camera, with the effect of errors of the time in the covariance.
    cross
        Covariance of position (east, north, up, m) and turn of the body (rad), shape (n, 3, 3); NaN where
        unknown.
    images
        Names of the images, one for each camera that took one; none where none matched.
    height_kind
        Kind of the heights.
    carrier
        Of the body that the antenna is fixed to, where the camera is in a gimbal with its own attitude; None:
        the same body.
    above_take_off_m
        Height above the take-off point, where the images state it, shape (n,).
    """

    time: GpsTime
    number: Integers
    placed: InterpolatedPositions
    attitude: AttitudeSeries
    cross: Floats
    images: Sequence[tuple[str, ...]]
    height_kind: str
    carrier: AttitudeSeries | None = None
    above_take_off_m: Floats | None = None

    def __len__(self) -> int:
        return len(self.time)

    def __repr__(self) -> str:
        """Say in one line how many there are, and what is known of them."""
        placed, named = int(self.placed.placed.sum()), sum(map(bool, self.images))
        known = f"{placed} with position, {int(self.attitude.known.sum())} with attitude, {named} with images"
        return f"Exposures: {len(self)} events, {known}; heights {self.height_kind}"

    @property
    def first_images(self) -> list[str]:
        """The image of each event, that of the first camera where several took one; empty without."""
        return [names[0] if names else "" for names in self.images]

    @property
    def angles(self) -> Floats:
        """Roll, pitch, yaw of the body that carries the camera, rad (n, 3); NaN where unknown."""
        return self.attitude.angles

    @property
    def angle_sigma(self) -> Floats:
        """Standard deviations of roll, pitch, yaw, rad (n, 3); NaN where unknown."""
        (sr, sp, _), (cr, cp, _) = np.sin(self.angles).T, np.cos(self.angles).T
        ones, zeros = np.ones_like(sp), np.zeros_like(sp)
        # The inverse of the turn per angle of the aerospace sequence (Diebel 2006, eq. 292).
        rows = [[ones, sr * sp / cp, cr * sp / cp], [zeros, cr, -sr], [zeros, sr / cp, cr / cp]]
        inverse = np.moveaxis(np.array(rows), (0, 1), (1, 2))
        covariance = inverse @ self.attitude.covariance @ np.swapaxes(inverse, 1, 2)
        return np.asarray(np.sqrt(np.maximum(np.diagonal(covariance, axis1=1, axis2=2), 0.0)))

    def reason(self, row: int) -> str:
        """Return why an event has no position, empty where it has one."""
        if self.placed.placed[row]:
            return ""
        gap = float(self.placed.gap_s[row])
        if not np.isfinite(gap):
            return "outside the trajectory"
        return f"epochs around it are {gap:.1f} s apart (at most {LARGEST_GAP_S:g} s)"


def at_events(
    events: Events,
    placed: InterpolatedPositions,
    attitude: AttitudeSeries,
    time_sigma_s: Floats,
    images: Sequence[tuple[str, ...]],
    height_kind: str,
) -> Exposures:
    """Put positions and attitudes of the same instants together."""
    w = attitude.rate
    s2 = (time_sigma_s**2)[:, None, None]
    velocity = np.where(np.isfinite(placed.velocity_m_s), placed.velocity_m_s, 0.0)
    # An instant or an attitude of infinite sigma leaves what depends on it unknown: not a number.
    with np.errstate(invalid="ignore"):
        covariance = attitude.covariance + s2 * w[:, :, None] * w[:, None, :]
        cross = s2 * velocity[:, :, None] * w[:, None, :] + 0.0 * attitude.covariance
    timed = replace(attitude, covariance=covariance)
    return Exposures(events.time, events.number, placed, timed, cross, images, height_kind)


def at_camera(exposures: Exposures, rig: CameraOnBody) -> Exposures:
    """Return the exposures at the camera instead of the antenna."""
    if rig.lever_m is None:
        return exposures
    there = exposures.placed.placed
    correlated = exposures.carrier is None
    body = exposures.carrier if exposures.carrier is not None else exposures.attitude
    lacking = there & ~body.known
    if lacking.any():
        raise ConfigurationError(
            f"{int(lacking.sum())} exposures have no attitude to turn the lever arm with",
            "record ATTITUDE, or leave out the lever arm",
        )
    back = np.swapaxes(np.where(body.known[:, None, None], body.rotation, np.eye(3)), 1, 2)
    p = exposures.placed
    offset = -np.einsum("nij,j->ni", back, rig.lever_m)
    # The body turns by exp(-[t]x): -R' l changes by -R' [t]x l = R' [l]x t.
    jacobian = back @ skew(rig.lever_m)
    transposed = np.swapaxes(jacobian, 1, 2)
    covariance = p.covariance_m2 + back @ np.diag(rig.lever_sigma_m**2) @ np.swapaxes(back, 1, 2)
    covariance = covariance + jacobian @ body.covariance @ transposed
    cross = exposures.cross
    if correlated:
        both = cross @ transposed
        covariance = covariance + both + np.swapaxes(both, 1, 2)
        cross = cross + jacobian @ body.covariance
    placed = replace(p.moved(offset), covariance_m2=covariance)
    return replace(exposures, placed=placed, cross=cross)


def orientations(exposures: Exposures, rig: CameraOnBody) -> tuple[Floats, Floats]:
    """Return the exterior orientations: the body's attitude through camera axes and boresight.

    The boresight b turns the nominal camera axes A by exp([b]x); its own error and that of the attitude add,
    t = J s - exp([b]x) A t_body with J the left Jacobian of the rotation group at b (Chirikjian 2012, 10.86).

    returns: rotations (n, 3, 3) from east, north, up at each exposure to camera axes, boresight included, NaN
        where unknown; covariances (n, 6, 6) of east, north, up (m) and the turns t about the camera axes,
        rad: true = exp([t]x) rotation.
    """
    to_camera = np.asarray(Rotation.from_rotvec(rig.boresight).as_matrix() @ rig.axes)
    jacobian = left_jacobian(rig.boresight)
    of_boresight = jacobian @ np.diag(rig.boresight_sigma**2) @ jacobian.T
    covariance = np.empty((len(exposures), 6, 6))
    covariance[:, :3, :3] = exposures.placed.covariance_m2
    covariance[:, 3:, 3:] = to_camera @ exposures.attitude.covariance @ to_camera.T + of_boresight
    covariance[:, :3, 3:] = -exposures.cross @ to_camera.T
    covariance[:, 3:, :3] = np.swapaxes(covariance[:, :3, 3:], 1, 2)
    return to_camera @ exposures.attitude.rotation, covariance


def orientations_in_frame(rotation: Floats, covariance: Floats, turn: Floats) -> tuple[Floats, Floats]:
    """Return omega, phi, kappa (rad) and the covariance of position and angles in other axes.

    rotation, covariance: of `orientations`; turn (n, 3, 3): from east, north, up to those axes.
    """
    angles = angles_from_matrix(rotation @ np.swapaxes(turn, 1, 2))
    safe = np.where(np.isfinite(angles), angles, 0.0)
    parts = (slice(0, 3), turn), (slice(3, 6), np.linalg.inv(turn_per_angle(safe)))
    turned = np.empty_like(covariance)
    # Block by block: where angles are unknown the positions are not.
    for rows, left in parts:
        for columns, right in parts:
            turned[:, rows, columns] = left @ covariance[:, rows, columns] @ np.swapaxes(right, 1, 2)
    return angles, turned
