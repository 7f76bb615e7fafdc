"""Antenna positions, attitudes and mounting of a block folder."""

from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike

from photocal.adjustment import mounting
from photocal.adjustment.network import covariance_matrices
from photocal.base.arrays import Floats
from photocal.base.codec import as_degrees
from photocal.base.errors import ConfigurationError, OutputError
from photocal.base.text_tables import TextTable, known_rows, named_columns, read_table, refuse
from photocal.block.camera_setup import sigma_keys, sigmas
from photocal.block.setup import BodyAxis, MountingKeys
from photocal.geometry.rotation import TO_NED, object_to_body

POSITION_COLUMNS = ("image", "X", "Y", "Z", "sX", "sY", "sZ")
POSITION_EXTRAS = ("sXY", "sXZ", "sYZ", "vX", "vY", "vZ", "strip", "time_s")
ATTITUDE_COLUMNS = ("image", "roll", "pitch", "yaw", "sroll", "spitch", "syaw")
RATE_COLUMNS = ("p", "q", "r", "sp", "sq", "sr")
BODY_AXES: dict[BodyAxis, tuple[float, float, float]] = {
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


def mounting_keys(given: mounting.Mounting, positions: mounting.Positions) -> MountingKeys:
    """Say a mounting in the keys of `[mounting]`, the inverse of `make_mounting`.

    raises OutputError: for what those keys cannot say.
    """
    names = {axis: name for name, axis in BODY_AXES.items()}
    x, y, z = (names.get((float(row[0]), float(row[1]), float(row[2]))) for row in given.rotation)
    strips = given.sigma[mounting.STRIPS :].reshape(-1, 2, 3)
    cannot = OutputError.at("[mounting]")
    if x is None or y is None or z is None:
        raise cannot("the camera's axes are not along those of the body", "put the rest into the boresight")
    if given.values[mounting.OF_FLIGHT].any() or given.values[mounting.STRIPS :].any():
        raise cannot(
            "a shift of the flight or of a strip does not begin at zero", "subtract it from the positions"
        )
    if len(strips) and (strips != strips[0]).any():
        raise cannot("strips have different sigmas", "give all strips the same")
    scale = float(given.sigma[mounting.HEIGHT_SCALE])
    shift, drift = strips[0] if len(strips) else np.zeros((2, 3))
    lever, boresight = given.values[mounting.LEVER], as_degrees(given.values[mounting.BORESIGHT])
    return MountingKeys(
        lever_arm_m=tuple(lever.tolist()),
        lever_arm_sigma_m=sigma_keys(given.sigma[mounting.LEVER]),
        boresight_deg=tuple(boresight.tolist()),
        boresight_sigma_deg=sigma_keys(as_degrees(given.sigma[mounting.BORESIGHT])),
        time_offset_s=float(given.values[mounting.TIME]),
        time_offset_sigma_s=sigma_keys(given.sigma[mounting.TIME]),
        flight_shift_sigma_m=sigma_keys(given.sigma[mounting.SHIFT]),
        height_scale_sigma=scale,
        height_scale_from_m=_from_m(positions, needed=scale > 0),
        strip_shift_sigma_m=sigma_keys(shift),
        strip_drift_sigma_m_s=sigma_keys(drift),
        camera_axes=(x, y, z),
    )


def _from_m(positions: mounting.Positions, *, needed: bool) -> float | None:
    """The height from which those above the base station count; None where it is 0 and not needed."""
    height, above = positions.values[:, 2], positions.above
    if not len(height) or np.array_equal(height, above):
        return 0.0 if needed else None
    rough = float(np.median(height - above))
    for tried in (round(rough, 6), round(rough, 9), rough):
        if np.array_equal(height - tried, above):
            return tried
    if np.allclose(height - rough, above, rtol=0.0, atol=1e-6):
        return rough
    if needed:
        what = "heights above the base station do not differ from those of the positions by a constant"
        raise OutputError(what, "give the height of the base station's antenna", where="[mounting]")
    return None


def position_columns(positions: mounting.Positions) -> dict[str, ArrayLike]:
    """The columns of `positions.csv` beside `image`; strips are numbered."""
    a, b = [0, 0, 1], [1, 2, 2]
    covariance, strip = positions.covariance, positions.strip
    more = {"sXY sXZ sYZ": covariance[:, a, b], "vX vY vZ": positions.velocity}
    columns = {
        **named_columns("X Y Z", positions.values),
        **named_columns("sX sY sZ", np.sqrt(np.diagonal(covariance, axis1=1, axis2=2))),
        **{
            k: v
            for names, values in more.items()
            if values.any()
            for k, v in named_columns(names, values).items()
        },
    }
    if strip.any():
        columns["strip"] = [f"strip {k + 1}" for k in strip.tolist()]
    return columns | ({"time_s": positions.time} if positions.time.any() else {})


def attitude_columns(attitudes: mounting.Attitudes) -> dict[str, ArrayLike]:
    """The columns of `attitudes.csv` beside `image`.

    Angles have as many decimals as give the same rotation when they are read again, or all.

    raises OutputError: where errors of roll, pitch and yaw are correlated, which the table cannot say.
    """
    r = attitudes.rotation @ TO_NED
    sp = -r[:, 0, 2]
    roll, yaw = np.arctan2(r[:, 1, 2], r[:, 2, 2]), np.arctan2(r[:, 0, 1], r[:, 0, 0])
    pitch = np.arctan2(sp, np.hypot(r[:, 0, 0], r[:, 0, 1]))
    # In the order of memory in which tables are read: sines of other orders may differ in the last place.
    rough = np.degrees(np.column_stack([roll, pitch, yaw]))
    full = rough + np.where(rough < 0, [0.0, 0.0, 360.0], 0.0)
    angles = rough.copy()
    for tried in (np.round(whole, digits) for digits in (12, 9, 6) for whole in (rough, full)):
        fits = (object_to_body(np.radians(tried))[0] == attitudes.rotation).all(axis=(1, 2))
        angles[fits] = tried[fits]
    per_angle = object_to_body(np.radians(angles))[1]
    back = np.linalg.inv(per_angle)
    covariance = back @ attitudes.covariance @ np.swapaxes(back, 1, 2)
    sigma = np.sqrt(np.diagonal(covariance, axis1=1, axis2=2))
    # Correlations that are rounding.
    uncorrelated = 1e-6
    if (np.abs(covariance / (sigma[:, :, None] * sigma[:, None]) - np.eye(3)) > uncorrelated).any():
        raise OutputError(
            "errors of roll, pitch and yaw are correlated: attitudes.csv has sigmas only",
            "leave the attitudes out, or give them sigmas about the axes of the angles",
        )
    stated = np.degrees(sigma)
    for tried in (np.round(stated, digits) for digits in (12, 9, 6)):
        again = per_angle @ (np.radians(tried)[:, :, None] ** 2 * np.swapaxes(per_angle, 1, 2))
        fits = (again == attitudes.covariance).all(axis=(1, 2))
        stated[fits] = tried[fits]
    columns = named_columns("roll pitch yaw", angles) | named_columns("sroll spitch syaw", stated)
    rates = (("p q r", attitudes.rate), ("sp sq sr", attitudes.rate_sigma))
    known = [(names, as_degrees(values)) for names, values in rates if values is not None]
    return columns | {k: v for names, values in known for k, v in named_columns(names, values).items()}


def _sigmas(table: TextTable, columns: tuple[str, ...]) -> Floats:
    sigma = table.matrix(columns)
    refuse(table, (sigma <= 0).any(axis=1), "a sigma is not positive", "give a standard deviation")
    return sigma
