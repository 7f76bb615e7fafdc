"""How images move while a rolling shutter reads them: as given, by the flight, by neighbours, by a prior."""

from functools import partial

import numpy as np

from photocal.adjustment.mounting import Positions, body_to_camera
from photocal.adjustment.network import Network
from photocal.base.arrays import Flags, Floats, Integers
from photocal.base.errors import ConfigurationError
from photocal.base.text_tables import TextTable
from photocal.block.model import Block
from photocal.geometry.camera import SHAKE

VELOCITY, RATE = ("vX", "vY", "vZ"), ("wx", "wy", "wz")
SIGMAS_OF_MOTION = (*(f"s{c}" for c in VELOCITY), *(f"s{c}" for c in RATE))
MOTION_COLUMNS = (
    *VELOCITY,
    *SIGMAS_OF_MOTION[:3],
    *RATE,
    *SIGMAS_OF_MOTION[3:],
    "time_s",
    "temperature_c",
    *SHAKE,
)


def read_motion(table: TextTable) -> tuple[Floats, Floats, Floats, Floats]:
    """Velocity (m/s) and rate (rad/s), their sigmas, times (s) and temperatures (degC) of `images.csv`.

    NaN where nothing stands. A rate there is that of the camera about its own axes; inside it is the turn of
    what they see.
    """
    columns = partial(table.matrix, empty=np.nan)
    value = np.hstack([columns(VELOCITY), -np.radians(columns(RATE))])
    sigma = np.hstack([columns(SIGMAS_OF_MOTION[:3]), np.radians(columns(SIGMAS_OF_MOTION[3:]))])
    if any(map(table.has, SHAKE)):
        value = np.hstack([value, -np.radians(columns(SHAKE))])
    return value, sigma, *columns(("time_s", "temperature_c")).T


def motion_of(
    block: Block, centre: Floats, positions: Positions, turn: Floats
) -> tuple[Floats, Floats, Flags]:
    """Motion of every image and by how much it may depart from it, in local axes, each of shape (n, 6).

    Also of which images the velocity is known, shape (n,).
    """
    motion, sigma, known = observed_motion(block, centre, positions, turn)
    gust = np.array([camera.gust[1] for camera in block.cameras])[block.images.camera]
    motion[:, 3:6], sigma[:, 3:] = expected_rates(motion[:, 3:6], sigma[:, 3:], gust)
    sigma[:, 3:] = np.where(np.isnan(sigma[:, 3:]), gust[:, None], sigma[:, 3:])
    return np.nan_to_num(motion), sigma, known


def observed_motion(
    block: Block, centre: Floats, positions: Positions, turn: Floats
) -> tuple[Floats, Floats, Flags]:
    """As `motion_of`, with rates and their sigmas as observed; NaN where nobody did."""
    images, attitudes = block.images, block.attitudes
    motion, sigma = images.motion.copy(), images.motion_sigma.copy()
    motion[:, :3] = np.einsum("nab,nb->na", turn, motion[:, :3])
    gust = np.array([camera.gust for camera in block.cameras])[images.camera]
    of_flight = np.full(motion[:, :3].shape, np.nan)
    flown = positions.velocity.any(axis=1)
    of_flight[positions.image[flown]] = positions.velocity[flown]
    beside, unsteady = velocity_of_neighbours(images.camera, images.time, centre)
    spread = np.where(np.isfinite(of_flight).all(axis=1), gust[:, 0], np.hypot(gust[:, 0], unsteady))
    velocity = np.where(np.isnan(of_flight), beside, of_flight)
    unknown = np.isnan(motion[:, :3]) & np.isnan(velocity)
    motion[:, :3] = np.where(np.isnan(motion[:, :3]), np.nan_to_num(velocity), motion[:, :3])
    # By how much the velocity of an image may depart from zero when nothing at all is known of it, m/s.
    any_flight = 15.0
    usual = np.where(unknown, any_flight, spread[:, None])
    sigma[:, :3] = np.where(np.isnan(sigma[:, :3]), usual, sigma[:, :3])
    if attitudes.rate is not None and attitudes.rate_sigma is not None:
        to_camera = body_to_camera(block.mounting, block.mounting.values)
        rate, spread_of_rate = np.full((2, len(motion), 3), np.nan)
        # What a camera sees turns against it.
        rate[attitudes.image] = -attitudes.rate @ to_camera.T
        spread_of_rate[attitudes.image] = np.sqrt(attitudes.rate_sigma**2 @ (to_camera**2).T)
        motion[:, 3:6] = np.where(np.isnan(motion[:, 3:6]), rate, motion[:, 3:6])
        sigma[:, 3:] = np.where(np.isnan(sigma[:, 3:]), spread_of_rate, sigma[:, 3:])
    return motion, sigma, np.asarray(~unknown.any(axis=1))


def expected_rates(observed: Floats, sigma: Floats, gust: Floats) -> tuple[Floats, Floats]:
    """What rates are expected where they were observed with errors, and by how much they depart from it.

    A readout that is estimated along observed rates comes out too short by the share that their errors have
    of what they scatter (errors in variables; Fuller 1987, section 1.1). Rates expected of the observed ones
    have no such errors (regression calibration): each is drawn towards zero by its reliability. How much
    images really turn is what the observed rates scatter beyond their sigmas, at least half of these; of few
    images it is the gust.
    """
    seen = np.isfinite(observed) & np.isfinite(sigma)
    turning = np.broadcast_to(gust[:, None] ** 2, observed.shape).copy()
    # Fewer images say too little of how images turn.
    enough = 10
    for axis in range(observed.shape[1]):
        known = seen[:, axis]
        if known.sum() >= enough:
            noise = np.mean(sigma[known, axis] ** 2)
            beyond = np.mean(observed[known, axis] ** 2) - noise
            turning[known, axis] = max(beyond, noise / 4)
    share = turning / np.where(seen, turning + sigma**2, 1.0)
    reliability = np.where(seen, share, 1.0)
    return observed * reliability, sigma * np.sqrt(reliability)


def require_motion(block: Block, network: Network) -> None:
    """Refuse to estimate a readout where the speed of its images is unknown.

    raises ConfigurationError.
    """
    for given, taken in zip(block.cameras, network.cameras, strict=True):
        if given.rolling and given.estimated[-1] and not taken.estimated[-1]:
            raise ConfigurationError(
                f"the readout of camera {given.id} is estimated, but the speed of its images is unknown",
                "give vX, vY, vZ or time_s in images.csv, or vX, vY, vZ in positions.csv",
                where="images.csv",
            )


def velocity_of_neighbours(camera: Integers, time: Floats, centre: Floats) -> tuple[Floats, Floats]:
    """Velocity between the exposures before and after, and half of how much it changes; NaN without times."""
    velocity, change = np.full(centre.shape, np.nan), np.zeros(len(centre))
    # Exposures further apart than this many usual intervals are no neighbours.
    apart = 2.5
    for k in np.unique(camera):
        images = np.flatnonzero((camera == k) & np.isfinite(time))
        images = images[np.argsort(time[images], kind="stable")]
        interval = np.diff(time[images])
        if not (interval > 0).any():
            continue
        usual = float(np.median(interval[interval > 0]))
        near = (interval > 0) & (interval < apart * usual)
        with np.errstate(divide="ignore", invalid="ignore"):
            between = np.where(near[:, None], np.diff(centre[images], axis=0) / interval[:, None], np.nan)
        none = np.full((1, 3), np.nan)
        sides = np.stack([np.vstack([none, between]), np.vstack([between, none])])
        seen = np.isfinite(sides).all(axis=2)
        count = seen.sum(axis=0)
        total = np.where(seen[:, :, None], sides, 0.0).sum(axis=0)
        velocity[images] = np.where(count[:, None] > 0, total / np.maximum(count, 1)[:, None], np.nan)
        both = count == 2
        change[images[both]] = np.linalg.norm(sides[1] - sides[0], axis=1)[both] / 2
    return velocity, change
