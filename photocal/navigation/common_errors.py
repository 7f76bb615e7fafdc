"""Errors that all exposures of a flight share: base, lasting multipath, air between base and rover.

Tropospheric delay that the engine's model leaves between two heights: humidity, temperature, pressure.
"""

from dataclasses import dataclass
from typing import Any

import numpy as np

from photocal.base.arrays import Floats, as_plain, picked
from photocal.base.errors import ConfigurationError
from photocal.base.geodesy import geodetic
from photocal.block.project import AirAtBase
from photocal.findings.texts import Catalogue
from photocal.navigation.engine import PER_METRE
from photocal.navigation.satellite_residuals import (
    SatelliteResiduals,
    correlation_time_s,
    shift_by_zenith_delay,
)
from photocal.navigation.time import GpsTime
from photocal.navigation.trajectory import Trajectory

# Means and seasonal amplitudes at 15, 30, 45, 60 and 75 degrees: pressure (hPa), temperature (K), vapour
# pressure (hPa), lapse rate (K/m), exponent of the vapour (RTCA DO-229D, table A-2; Collins and Langley
# 1997).
_LATITUDES = np.array([15.0, 30.0, 45.0, 60.0, 75.0])
_MEAN = np.array(
    [
        [1013.25, 299.65, 26.31, 6.30e-3, 2.77],
        [1017.25, 294.15, 21.79, 6.05e-3, 3.15],
        [1015.75, 283.15, 11.66, 5.58e-3, 2.57],
        [1011.75, 272.15, 6.78, 5.39e-3, 1.81],
        [1013.00, 263.65, 4.11, 4.53e-3, 1.55],
    ]
)
_SEASON = np.array(
    [
        [0.00, 0.00, 0.00, 0.00, 0.00],
        [-3.75, 7.00, 8.85, 0.25e-3, 0.33],
        [-2.25, 11.00, 7.24, 0.32e-3, 0.46],
        [-1.75, 15.00, 5.36, 0.81e-3, 0.74],
        [-0.50, 14.50, 3.39, 0.62e-3, 0.30],
    ]
)
_COLDEST_DAY = {"north": 28.0, "south": 211.0}
_GRAVITY, _GAS = 9.80665, 287.054
# Refractivity of dry air and vapour, K/hPa and K^2/hPa (Rueger 2002, "best average").
_K1, _K2, _K3 = 77.6890, 71.2952, 375_463.0
# Vapour 30 % about its mean from day to day (zenith delays of 5 cm against soundings: Collins and Langley
# 1997) and as much from place to place on a latitude; pressure 1 %, temperature 8 K.
_CLIMATE_VAPOUR, _CLIMATE_DRY = 0.42, 0.03
# Measured near the ground: the air above it is not the same.
_MEASURED_VAPOUR, _MEASURED_DRY = 0.12, 0.01


def parse_weather(text: str, option: str) -> AirAtBase:
    """Return the weather of ``TEMPERATURE,HUMIDITY[,PRESSURE]``: degrees Celsius, percent, hPa there."""
    try:
        values = [float(part) for part in text.split(",")]
        names = list(AirAtBase.model_fields)[: len(values)]
        return AirAtBase.model_validate(dict(zip(names, values, strict=True)))
    except ValueError as refusal:
        raise ConfigurationError(
            f"{text!r} is not a weather reading",
            "give TEMPERATURE,HUMIDITY[,PRESSURE]: degrees Celsius, percent, hPa at the place",
            where=option,
        ) from refusal


@dataclass(frozen=True)
class DelayLapse:
    """By how much the zenith delay falls with height beyond what the engine takes into account, m per m.

    source: what told it.
    """

    value: float
    sigma: float
    source: str


def remaining_lapse(
    lat_deg: float, height_m: float, day_of_year: float, weather: AirAtBase | None = None
) -> DelayLapse:
    """Return what the engine leaves of the fall of the zenith delay with height."""
    # Over a difference in height the zenith delay changes by the refractivity of the air between (Davis et
    # al. 1985, eq. 1). The engine's model of differential positions is Saastamoinen's (1972) for dry air in
    # the standard atmosphere.
    if weather is None:
        pressure, kelvin, vapour = climate(lat_deg, height_m, day_of_year)
        vapour_share, dry_share, source = _CLIMATE_VAPOUR, _CLIMATE_DRY, "climate of latitude and season"
    else:
        kelvin = weather.temperature_c + 273.15
        standard = 1013.25 * (1 - 2.2557e-5 * height_m) ** 5.2568
        pressure = standard if weather.pressure_hpa is None else weather.pressure_hpa
        vapour = weather.relative_humidity_percent / 100 * saturation_hpa(weather.temperature_c)
        vapour_share, dry_share, source = _MEASURED_VAPOUR, _MEASURED_DRY, "weather at the base"
    dry, moist = refractivity(pressure, kelvin, vapour)
    value = 1e-6 * (dry + moist) - _engine_lapse(lat_deg, height_m)
    sigma = 1e-6 * float(np.hypot(vapour_share * moist, dry_share * dry))
    return DelayLapse(value, sigma, source)


def climate(lat_deg: float, height_m: float, day_of_year: float) -> tuple[float, float, float]:
    """Return the mean pressure (hPa), temperature (K) and vapour pressure (hPa) of a place and season."""
    # Profiles of RTCA DO-229D, A.4.2.4.
    season = np.cos(2 * np.pi * (day_of_year - _COLDEST_DAY["north" if lat_deg >= 0 else "south"]) / 365.25)
    lat = abs(lat_deg)
    mean, swing = (
        np.array([np.interp(lat, _LATITUDES, column) for column in table.T]) for table in (_MEAN, _SEASON)
    )
    pressure, kelvin, vapour, lapse, exponent = (mean - swing * season).tolist()
    cooled = 1 - lapse * height_m / kelvin
    power = _GRAVITY / (_GAS * lapse)
    return pressure * cooled**power, kelvin * cooled, vapour * cooled ** ((exponent + 1) * power)


def refractivity(pressure_hpa: float, kelvin: float, vapour_hpa: float) -> tuple[float, float]:
    """Return the refractivity of the dry air and of the vapour, parts per million (Rueger 2002)."""
    dry = _K1 * (pressure_hpa - vapour_hpa) / kelvin
    return dry, _K2 * vapour_hpa / kelvin + _K3 * vapour_hpa / kelvin**2


def saturation_hpa(celsius: float) -> float:
    """Return the pressure of saturated vapour over water (Buck 1981, eq. 8)."""
    return float(6.1121 * np.exp(17.502 * celsius / (240.97 + celsius)))


def _engine_lapse(lat_deg: float, height_m: float) -> float:
    """Return the fall of the engine's zenith delay with height, m per m."""

    def delay(height: float) -> float:
        """Hydrostatic zenith delay at a height in the standard atmosphere, m (Saastamoinen)."""
        pressure = 1013.25 * (1 - 2.2557e-5 * height) ** 5.2568
        return float(0.0022768 * pressure / (1 - 0.00266 * np.cos(2 * np.radians(lat_deg)) - 2.8e-7 * height))

    return (delay(height_m - 50) - delay(height_m + 50)) / 100


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


def common_text(figures: dict[str, Any], say: Catalogue) -> list[str]:
    """Return what `CommonErrors.as_json` gave in words."""
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
