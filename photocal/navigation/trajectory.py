"""Positions of an antenna, and between two epochs, with what the interpolation adds to their uncertainty."""

from dataclasses import dataclass, replace
from pathlib import Path
from typing import Self

import numpy as np
from numpy.typing import ArrayLike, NDArray

from photocal.base.arrays import Columns, Flags, Floats, Integers
from photocal.base.files import write_rows
from photocal.base.geodesy import enu_axes, enu_offsets, geocentric, geodetic
from photocal.base.tables import TableColumns
from photocal.navigation.time import GpsTime

COLUMNS = (
    "time_gps_ns", "lat_deg", "lon_deg", "height_m", "status", "se", "sn", "su", "sen", "seu", "snu",
)  # fmt: skip
LARGEST_GAP_S = 1.5


class Geodetic(TableColumns, Columns):
    """Columns of which three are positions on WGS 84: latitude, longitude, ellipsoidal height.

    covariance_m2 (n, 3, 3): east, north, up.
    """

    lat_deg: Floats
    lon_deg: Floats
    height_m: Floats
    covariance_m2: Floats

    @property
    def sigma_m(self) -> Floats:
        """Standard deviations (n, 3), east, north, up; NaN where unknown."""
        variance = np.diagonal(self.covariance_m2, axis1=1, axis2=2)
        return np.asarray(np.sqrt(np.maximum(variance, 0.0)))

    @property
    def xyz_m(self) -> Floats:
        """Earth-centred coordinates (n, 3)."""
        return geocentric(self.lat_deg, self.lon_deg, self.height_m)

    @property
    def place(self) -> Floats:
        """Latitude, longitude and height (n, 3)."""
        return np.stack([self.lat_deg, self.lon_deg, self.height_m], axis=1)

    def placed_at(self, xyz_m: Floats) -> Self:
        """Return the same at other places, earth-centred (n, 3)."""
        lat, lon, height = geodetic(xyz_m)
        return replace(self, lat_deg=lat, lon_deg=lon, height_m=height)  # type: ignore[type-var]

    def moved(self, offset_enu_m: Floats) -> Self:
        """Return the same moved by offsets east, north, up (n, 3): from the antenna to the camera."""
        turn = enu_axes(self.lat_deg, self.lon_deg)
        return self.placed_at(self.xyz_m + np.einsum("nji,nj->ni", turn, offset_enu_m))

    def offsets(self, origin: Floats) -> Floats:
        """Return topocentric east, north, up (n, 3) about a place (latitude, longitude, height)."""
        return enu_offsets(self.lat_deg, self.lon_deg, self.height_m, origin)


@dataclass(frozen=True, repr=False)
class Trajectory(Geodetic):
    """Positions of the rover's antenna reference point.

    Attributes
    ----------
    time
        GPS time.
    lat_deg, lon_deg, height_m
        Geodetic position (n,), ellipsoidal height.
    status
        Of each, ``fixed``, ``float`` or ``single``.
    covariance_m2
        East, north, up, shape (n, 3, 3).
    velocity_m_s
        East, north, up from Doppler, shape (n, 3); NaN where it is not known.
    velocity_sigma_m_s
        Standard deviation of a component of the velocity.
    """

    time: GpsTime
    lat_deg: Floats
    lon_deg: Floats
    height_m: Floats
    status: NDArray[np.str_]
    covariance_m2: Floats
    velocity_m_s: Floats
    velocity_sigma_m_s: float

    def __len__(self) -> int:
        return len(self.time)

    def __repr__(self) -> str:
        """Say in one line when it was, how long, and how good."""
        if not len(self):
            return "Trajectory: no epochs"
        counts = ", ".join(f"{int((self.status == s).sum())} {s}" for s in ("fixed", "float", "single"))
        seconds = float(self.time.ns[-1] - self.time.ns[0]) / 1e9
        return f"Trajectory from {self.time[[0]].iso()[0]} GPS, {seconds:.1f} s: {len(self)} epochs, {counts}"


def position_cells(p: "Trajectory | InterpolatedPositions", row: int) -> list[str]:
    """Return what `COLUMNS` name of one epoch, but for its time."""
    place = [f"{p.lat_deg[row]:.10f}", f"{p.lon_deg[row]:.10f}", f"{p.height_m[row]:.4f}"]
    return [*place, str(p.status[row]), *_covariance_cells(p.covariance_m2[row])]


def _covariance_cells(covariance_m2: Floats) -> list[str]:
    """Return se, sn, su (standard deviations, m) and sen, seu, snu; blanks where they are not known."""
    if not np.isfinite(covariance_m2).all():
        return [""] * 6
    # The last three are roots of the covariances with the covariances' signs, in metres, as RTKLIB writes
    # them (RTKLIB manual 2.4.2, appendix B.1).
    c = covariance_m2
    roots = [np.sign(c[i, j]) * np.sqrt(abs(c[i, j])) for i, j in ((0, 1), (0, 2), (1, 2))]
    return [f"{v:.5f}" for v in (*np.sqrt(np.diag(c)), *roots)]


def write_trajectory(path: Path, trajectory: Trajectory) -> None:
    """Write the trajectory as CSV with `COLUMNS`."""
    times = trajectory.time.ns.tolist()
    write_rows(path, COLUMNS, [[ns, *position_cells(trajectory, i)] for i, ns in enumerate(times)])


def enu_axes_at(xyz_m: Floats) -> Floats:
    """Return the rotations (..., 3, 3) to east, north, up at earth-centred places (..., 3)."""
    return enu_axes(*geodetic(xyz_m)[:2])


@dataclass(frozen=True)
class InterpolatedPositions(Geodetic):
    """Positions at given instants.

    placed: whether there are epochs close enough on both sides; the other columns are NaN where not.
    gap_s (n,): distance of the epochs around each instant; infinite outside the trajectory.
    lat_deg, lon_deg, height_m (n,): position, ellipsoidal height.
    velocity_m_s (n, 3): east, north, up.
    covariance_m2 (n, 3, 3): east, north, up; of the epochs, the interpolation and the time.
    status: the worse one of the two epochs.
    """

    placed: Flags
    gap_s: Floats
    lat_deg: Floats
    lon_deg: Floats
    height_m: Floats
    velocity_m_s: Floats
    covariance_m2: Floats
    status: NDArray[np.str_]

    @classmethod
    def stated(cls, place: Floats, sigma_m: Floats, status: ArrayLike) -> Self:
        """Positions that somebody tells: latitude, longitude, height (n, 3), their sigmas east, north, up."""
        there, (lat, lon, height) = np.isfinite(place.sum(axis=1)), place.T
        gap, velocity = np.where(there, 0.0, np.inf), np.full(place.shape, np.nan)
        covariance = sigma_m[:, :, None] ** 2 * np.eye(3)
        return cls(there, gap, lat, lon, height, velocity, covariance, np.asarray(status, "U6"))


def left_out(trajectory: Trajectory) -> tuple[GpsTime, Floats, Floats]:
    """Leave out every fix between two fixes in turn and interpolate it from its neighbours.

    Only fixes are used: the step between a fix and a float position is no motion.

    returns: times, errors (n, 3), measured less interpolated, east, north, up, and distances of the
        neighbours (n,), s.
    """
    i = np.arange(1, len(trajectory) - 1)
    time = trajectory.time.ns
    gap = (time[i + 1] - time[i - 1]) / 1e9
    fixed = trajectory.status == "fixed"
    i = i[fixed[i] & fixed[i - 1] & fixed[i + 1] & (gap <= 2 * LARGEST_GAP_S)]
    gap = (time[i + 1] - time[i - 1]) / 1e9
    local, _ = _local(trajectory)
    u = (time[i] - time[i - 1]) / (time[i + 1] - time[i - 1])
    position, _ = _hermite(local, trajectory.velocity_m_s, i - 1, i + 1, gap, u)
    return trajectory.time[i], local[i] - position, np.asarray(gap, np.float64)


def roughness(trials: tuple[GpsTime, Floats, Floats], time: GpsTime) -> Floats:
    """Return how far the path strays from its interpolation around instants, by trials of `left_out`."""
    least_trials = 20
    trial_time, error_m, gap_s = trials
    if len(gap_s) < least_trials:
        # Acceleration of a vehicle that is not known better, per component (small multirotors manoeuvre below
        # it).
        default_roughness = 0.5
        return np.full((len(time), 3), default_roughness)
    square = (error_m / gap_s[:, None] ** 1.5) ** 2
    return np.asarray(np.maximum(np.sqrt(local_mean_square(trial_time, square, time)), 1e-4))


def local_mean_square(trial: GpsTime, square: Floats, time: GpsTime) -> Floats:
    """Return the mean of squares (n, 3) of trials within 30 s of instants, drawn to that of all."""
    # The mean of the flight counts as this many trials beside those near by.
    prior_trials = 10
    # Motion is alike within this time.
    window_ns = 30_000_000_000
    total = np.mean(square, axis=0)
    sums = np.vstack([np.zeros(3), np.cumsum(square, axis=0)])
    low = np.searchsorted(trial.ns, time.ns - window_ns)
    high = np.searchsorted(trial.ns, time.ns + window_ns, side="right")
    number = (high - low)[:, None]
    return np.asarray((sums[high] - sums[low] + prior_trials * total) / (number + prior_trials))


def interpolate(
    trajectory: Trajectory, time: GpsTime, time_sigma_s: Floats, rough: Floats | None = None
) -> InterpolatedPositions:
    """Return positions at instants by cubic interpolation with the Doppler velocities."""
    q = roughness(left_out(trajectory), time) if rough is None else rough
    stamps = trajectory.time.ns
    after = np.searchsorted(stamps, time.ns, side="right")
    inside = (after > 0) & (after < len(stamps))
    # An instant exactly at the last epoch lies on it.
    last = time.ns == stamps[-1]
    after = np.clip(np.where(last, len(stamps) - 1, after), 1, max(len(stamps) - 1, 1))
    inside |= last
    before = after - 1
    gap = (stamps[after] - stamps[before]) / 1e9
    placed = inside & (gap <= LARGEST_GAP_S)
    u = np.clip((time.ns - stamps[before]) / (stamps[after] - stamps[before]), 0.0, 1.0)
    local, origin = _local(trajectory)
    position, velocity = _hermite(local, trajectory.velocity_m_s, before, after, gap, u)
    # Errors of neighbouring epochs are nearly the same: their mean is no better than either of them.
    w = u[:, None, None]
    covariance = (1 - w) * trajectory.covariance_m2[before] + w * trajectory.covariance_m2[after]
    sigma = q * (gap**1.5 * (4 * u * (1 - u)) ** 1.5)[:, None]
    covariance = covariance + sigma[:, :, None] ** 2 * np.eye(3)
    covariance = covariance + time_sigma_s[:, None, None] ** 2 * velocity[:, :, None] * velocity[:, None, :]
    lat, lon, height = geodetic(position @ enu_axes(*origin[:2]) + geocentric(*origin))
    rank = np.array([{"fixed": 0, "float": 1}.get(s, 2) for s in trajectory.status.tolist()])
    worse = np.maximum(rank[before], rank[after])
    blank = np.where(placed, 1.0, np.nan)
    return InterpolatedPositions(
        placed,
        np.where(inside, gap, np.inf),
        lat * blank,
        lon * blank,
        height * blank,
        velocity * blank[:, None],
        covariance * blank[:, None, None],
        np.array(["fixed", "float", "single"])[worse],
    )


def plainly(trajectory: Trajectory, time: GpsTime) -> InterpolatedPositions:
    """Return positions at instants whose uncertainty is not asked for."""
    return interpolate(trajectory, time, np.zeros(len(time)), np.zeros((len(time), 3)))


def _local(trajectory: Trajectory) -> tuple[Floats, Floats]:
    origin = np.median(trajectory.place, axis=0)
    return trajectory.offsets(origin), origin


def _hermite(
    local: Floats, velocity: Floats, before: Integers, after: Integers, gap: Floats, u: Floats
) -> tuple[Floats, Floats]:
    """Return position and velocity of the cubic through two positions with two velocities."""
    # Where a velocity is missing the chord takes its place (Fritsch and Carlson 1980, eq. 2).
    p0, p1 = local[before], local[after]
    chord = (p1 - p0) / gap[:, None]
    v0 = np.where(np.isfinite(velocity[before]), velocity[before], chord)
    v1 = np.where(np.isfinite(velocity[after]), velocity[after], chord)
    u, h = u[:, None], gap[:, None]
    position = (
        (1 + 2 * u) * (1 - u) ** 2 * p0
        + u * (1 - u) ** 2 * h * v0
        + u**2 * (3 - 2 * u) * p1
        + u**2 * (u - 1) * h * v1
    )
    rate = 6 * u * (u - 1) * (p0 - p1) / h + (1 - u) * (1 - 3 * u) * v0 + u * (3 * u - 2) * v1
    return np.asarray(position), np.asarray(rate)
