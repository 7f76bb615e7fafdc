"""Antenna positions, attitudes and mounting of a block folder."""

from pathlib import Path

import numpy as np

from photocal.adjustment import mounting
from photocal.adjustment.network import covariance_matrices
from photocal.base.arrays import Floats
from photocal.base.errors import ConfigurationError
from photocal.block.camera_setup import sigmas
from photocal.block.setup import MountingKeys
from photocal.block.table import Table, known_rows, read_table, refuse
from photocal.geometry.rotation import object_to_body

POSITION_COLUMNS = ("image", "X", "Y", "Z", "sX", "sY", "sZ")
POSITION_EXTRAS = ("sXY", "sXZ", "sYZ", "vX", "vY", "vZ", "strip", "time_s")
ATTITUDE_COLUMNS = ("image", "roll", "pitch", "yaw", "sroll", "spitch", "syaw")
RATE_COLUMNS = ("p", "q", "r", "sp", "sq", "sr")
BODY_AXES = {
    "forward": (1.0, 0.0, 0.0),
    "backward": (-1.0, 0.0, 0.0),
    "right": (0.0, 1.0, 0.0),
    "left": (0.0, -1.0, 0.0),
    "down": (0.0, 0.0, 1.0),
    "up": (0.0, 0.0, -1.0),
}


def read_positions(path: Path, images: tuple[str, ...], from_m: float) -> mounting.Positions:
    """Read `positions.csv`: antenna positions in the block's frame."""
    if not path.exists():
        return mounting.NO_POSITIONS
    table = read_table(path, POSITION_COLUMNS, POSITION_EXTRAS)
    image = known_rows(table, "image", images, "images.csv")
    sigma = _sigmas(table, ("sX", "sY", "sZ"))
    covariance = covariance_matrices(sigma, table.matrix(("sXY", "sXZ", "sYZ"), empty=0.0))
    bad = np.linalg.eigvalsh(covariance)[:, 0] <= 0
    refuse(table, bad, "the covariance is not positive definite", "check sXY, sXZ and sYZ (m^2)")
    velocity = table.matrix(("vX", "vY", "vZ"), empty=0.0)
    strip = table.names("strip")[0] if table.has("strip") else np.zeros(len(table), dtype=np.int64)
    values = table.matrix("XYZ")
    time = table.numbers("time_s", empty=0.0)
    return mounting.Positions(image, values, covariance, velocity, strip, time, values[:, 2] - from_m)


def read_attitudes(path: Path, images: tuple[str, ...]) -> mounting.Attitudes:
    """Read `attitudes.csv`: roll, pitch, yaw of the body (deg), its rates (deg/s), and their sigmas."""
    if not path.exists():
        return mounting.NO_ATTITUDES
    table = read_table(path, ATTITUDE_COLUMNS, RATE_COLUMNS)
    image = known_rows(table, "image", images, "images.csv")
    angles = np.radians(table.matrix(("roll", "pitch", "yaw")))
    sigma = np.radians(_sigmas(table, ("sroll", "spitch", "syaw")))
    rotation, turn_per_angle = object_to_body(angles)
    covariance = turn_per_angle @ (sigma[:, :, None] ** 2 * np.swapaxes(turn_per_angle, 1, 2))
    rates = np.radians(table.matrix(RATE_COLUMNS, empty=np.nan))
    rate, rate_sigma = rates.reshape(len(image), 2, 3).swapaxes(0, 1)
    return mounting.Attitudes(image, rotation, covariance, rate, rate_sigma)


def make_mounting(keys: MountingKeys, strips: int) -> mounting.Mounting:
    """Make the mounting that `[mounting]` describes."""
    wrong = ConfigurationError.at("block.toml, [mounting]")
    if keys.height_scale_sigma and keys.height_scale_from_m is None:
        raise wrong(
            "height_scale_sigma needs height_scale_from_m", "give the height of the base station's antenna"
        )
    rotation = np.array([BODY_AXES[axis] for axis in keys.camera_axes])
    if not np.isclose(np.linalg.det(rotation), 1.0):
        raise wrong(
            f"camera_axes {list(keys.camera_axes)} are not a right-handed system",
            "give the body directions of x (right), y (up in the image) and z (backwards)",
        )
    values, sigma = np.zeros(mounting.STRIPS + 6 * strips), np.zeros(mounting.STRIPS + 6 * strips)
    values[mounting.LEVER], values[mounting.BORESIGHT] = keys.lever_arm_m, np.radians(keys.boresight_deg)
    values[mounting.TIME] = keys.time_offset_s
    sigma[mounting.LEVER] = sigmas(keys.lever_arm_sigma_m)
    sigma[mounting.BORESIGHT] = np.radians(sigmas(keys.boresight_sigma_deg))
    sigma[mounting.TIME] = sigmas(keys.time_offset_sigma_s)[0]
    sigma[mounting.SHIFT] = sigmas(keys.flight_shift_sigma_m)
    sigma[mounting.HEIGHT_SCALE] = keys.height_scale_sigma
    for strip in range(strips):
        at = mounting.STRIPS + 6 * strip
        sigma[at : at + 3] = sigmas(keys.strip_shift_sigma_m)
        sigma[at + 3 : at + 6] = sigmas(keys.strip_drift_sigma_m_s)
    return mounting.Mounting(rotation, values, sigma)


def _sigmas(table: Table, columns: tuple[str, ...]) -> Floats:
    sigma = table.matrix(columns)
    refuse(table, (sigma <= 0).any(axis=1), "a sigma is not positive", "give a standard deviation")
    return sigma
