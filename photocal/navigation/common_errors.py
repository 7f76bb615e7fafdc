"""Errors that all exposures of a flight share: base, lasting multipath, air between base and rover."""

from dataclasses import dataclass
from typing import Any

import numpy as np

from photocal.base.arrays import Floats, as_plain, picked
from photocal.base.geodesy import geodetic
from photocal.findings.texts import Catalogue, catalogue
from photocal.navigation.engine_output import (
    PER_METRE,
    SatelliteResiduals,
    correlation_time_s,
    shift_by_zenith_delay,
)
from photocal.navigation.time import GpsTime
from photocal.navigation.trajectory import Trajectory
from photocal.navigation.troposphere import DelayLapse, remaining_lapse
from photocal.project import AirAtBase


@dataclass(frozen=True)
class CommonErrors:
    """What the covariances of single positions do not contain: parts that no average over the flight removes.

    base_sigma_m (3,): standard deviations of the base's coordinates, east, north, up; None: nobody stated
        them.
    correlation_time_s: how long errors of positions last (see `satellite_residuals.correlation_time_s`).
    lasting_sigma_m (3,): of the mean over the flight of errors that last, with those that grow with the
        distance.
    base_height_m: ellipsoidal.
    lapse: what the engine leaves of the air between base and rover.
    shift_by_zenith_delay (3,): shift of a position for each metre of zenith delay, east, north, up.
    """

    base_sigma_m: Floats | None
    correlation_time_s: float | None
    lasting_sigma_m: Floats
    base_height_m: float
    lapse: DelayLapse
    shift_by_zenith_delay: Floats | None

    @property
    def shift_sigma_m(self) -> Floats:
        """Standard deviations of a shift common to all positions, east, north, up (3,)."""
        base = np.zeros(3) if self.base_sigma_m is None else self.base_sigma_m
        return np.asarray(np.hypot(base, self.lasting_sigma_m))

    @property
    def zenith_scale_sigma(self) -> float:
        """Standard deviation of an error of heights that grows with the height above the base, m per m."""
        moved = self.shift_by_zenith_delay
        return 0.0 if moved is None else float(abs(moved[2]) * self.lapse.sigma)

    @property
    def correction_per_metre(self) -> Floats:
        """Shift to add to positions for each metre above the base, east, north, up (3,)."""
        moved = self.shift_by_zenith_delay
        return np.zeros(3) if moved is None else moved * self.lapse.value

    def as_json(self) -> dict[str, Any]:
        """Give them as a JSON value, which `photocal.base.codec.from_plain` reads back."""
        return {
            **as_plain(self),
            **picked(self, "shift_sigma_m", "zenith_scale_sigma", "correction_per_metre"),
        }

    def corrected(self, trajectory: Trajectory) -> Trajectory:
        """Return a trajectory with the expected effect of the air between base and rover taken out.

        The rover above the base has less air above it than the engine believes: its lowest satellites seem
        too near, which puts it too low.
        """
        if not self.correction_per_metre.any():
            return trajectory
        above = trajectory.height_m - self.base_height_m
        return trajectory.moved(above[:, None] * self.correction_per_metre)


def common_errors(
    trajectory: Trajectory,
    satellites: SatelliteResiduals,
    base_m: Floats,
    base_sigma_m: Floats | None = None,
    weather: AirAtBase | None = None,
) -> CommonErrors:
    """Estimate what all positions of a flight share."""
    t = trajectory
    lat, _, height = geodetic(base_m)
    lapse = remaining_lapse(float(lat), float(height), day_of_year(t.time), weather)
    lasts = correlation_time_s(satellites)
    moved = shift_by_zenith_delay(satellites)
    good = t.status == "fixed" if (t.status == "fixed").any() else np.ones(len(t), bool)
    sigma = np.sqrt(np.median(np.diagonal(t.covariance_m2[good], axis1=1, axis2=2), axis=0))
    duration = max(float(t.time.ns[-1] - t.time.ns[0]) / 1e9, 1e-9)
    # Errors of which it is not known how long they last are taken to last for the whole flight.
    share = min(float(np.nan_to_num(2 * lasts / duration, nan=1.0)), 1.0)
    away = np.linalg.norm(t.xyz_m - base_m, axis=1)
    return CommonErrors(
        base_sigma_m,
        lasts if np.isfinite(lasts) else None,
        np.hypot(sigma * np.sqrt(share), PER_METRE * float(np.median(away))),
        float(height),
        lapse,
        moved if np.isfinite(moved).all() else None,
    )


def day_of_year(time: GpsTime) -> float:
    """Return the day of the year (1 to 366) of the first instant."""
    moment = np.datetime64("1980-01-06T00:00:00", "ns") + np.timedelta64(int(time.ns[0]), "ns")
    return float((moment - moment.astype("datetime64[Y]")) / np.timedelta64(1, "D")) + 1


def common_text(figures: dict[str, Any], say: Catalogue | None = None) -> list[str]:
    """Return what `CommonErrors.as_json` gave in words, in English when no language is given."""
    say = say or catalogue("en")
    lasts = figures["correlation_time_s"]
    told = {
        "sigma": " ".join(say.fixed(v, 3) for v in figures["shift_sigma_m"]),
        "base": "" if figures["base_sigma_m"] else say("trajectory.base_unstated"),
        "lasting": "" if lasts is None else say("trajectory.lasting", seconds=say.fixed(lasts, 0)),
    }
    lines = [say("trajectory.common", **told)]
    if figures["shift_by_zenith_delay"] is not None:
        height = f"{1e3 * figures['correction_per_metre'][2]:+.2f}".replace(".", say.mark)
        sigma = say.fixed(1e3 * figures["zenith_scale_sigma"], 2)
        source = figures["lapse"]["source"]
        lines.append(say("trajectory.air", source=source, height=height, sigma=sigma))
    return lines
