"""Delays of the atmosphere: an ionospheric layer with waves, and a standard troposphere."""

from dataclasses import dataclass
from typing import Self

import numpy as np

from acquire.simulate.gnss.constellation import AntennaTrack
from acquire.simulate.gnss.settings import L1CA, LIGHT_M_S, SkySettings
from photocal.base.arrays import Floats, Integers
from photocal.base.time_scales import DAY_NS

_LAYER_M, _EARTH_M = 350e3, 6371e3
_SCALES = 2.0 ** np.array([-30, -27, -24, -24, 11, 14, 16, 16])


@dataclass(frozen=True)
class Atmosphere:
    """One weather for all receivers of a session.

    waves (k, 4): of the ionosphere: wave numbers to the north and the east (rad/m), angular frequency
        (rad/s), phase.
    wet_m: zenith wet delay beyond the standard one.
    longitude: of the receivers, rad: half a turn from there the waves may break, where nobody looks.
    """

    settings: SkySettings
    waves: Floats
    wet_m: float
    longitude: float = 0.0

    @classmethod
    def by_chance(cls, settings: SkySettings, rng: np.random.Generator, longitude: float = 0.0) -> Self:
        """Draw the waves and the wet delay around a longitude (rad)."""
        length = rng.uniform(150e3, 400e3, 3)
        course = rng.uniform(0, 2 * np.pi, 3)
        period = rng.uniform(900, 2400, 3)
        k = 2 * np.pi / length
        waves = [k * np.cos(course), k * np.sin(course), 2 * np.pi / period, rng.uniform(0, 2 * np.pi, 3)]
        return cls(settings, np.stack(waves, axis=1), float(rng.normal(0, settings.wet_sigma_m)), longitude)

    def ionosphere_m(self, at: AntennaTrack, azimuth: Floats, elevation: Floats, gps_ns: Integers) -> Floats:
        """Return the delay of codes on L1, float64 (n,); it grows with the inverse square of the frequency.

        A thin layer at 350 km whose vertical delay is the broadcast model's (IS-GPS-200N, 20.3.3.5.2.5, there
        with a slant factor of its own), scaled, and the waves.

        azimuth, elevation (n,): of a satellite, radians.
        """
        zenith = np.arcsin(_EARTH_M / (_EARTH_M + _LAYER_M) * np.cos(elevation))
        angle = np.pi / 2 - elevation - zenith
        lat = np.arcsin(np.sin(at.lat) * np.cos(angle) + np.cos(at.lat) * np.sin(angle) * np.cos(azimuth))
        lon = at.lon + np.arcsin(np.sin(angle) * np.sin(azimuth) / np.cos(lat))
        beyond = np.round((lon - self.longitude) / (2 * np.pi)) * 2 * np.pi
        north, east = lat * _EARTH_M, (lon - beyond) * _EARTH_M * np.cos(at.lat)
        time = (gps_ns % DAY_NS) / 1e9
        vertical = self.settings.ionosphere_scale * self._broadcast_m(lat, lon, time)
        for to_north, to_east, frequency, phase in self.waves:
            wave = to_north * north + to_east * east - frequency * time + phase
            vertical = vertical + self.settings.wave_m * (1 + np.sin(wave)) / len(self.waves)
        return np.asarray(vertical / np.cos(zenith))

    def _broadcast_m(self, lat: Floats, lon: Floats, time: Floats) -> Floats:
        """Return the vertical delay of the Klobuchar model at points of the layer."""
        values = np.array(self.settings.klobuchar) * _SCALES
        magnetic = lat / np.pi + 0.064 * np.cos(lon - 1.617 * np.pi)
        powers = magnetic[:, None] ** np.arange(4)
        amplitude = np.maximum(powers @ values[:4], 0)
        period = np.maximum(powers @ values[4:], 72_000)
        local = (43_200 * lon / np.pi + time) % 86_400
        phase = 2 * np.pi * (local - 50_400) / period
        day = np.where(np.abs(phase) < np.pi / 2, amplitude * np.cos(phase), 0.0)
        return np.asarray(LIGHT_M_S * (5e-9 + day))

    def troposphere_m(self, at: AntennaTrack, elevation: Floats) -> Floats:
        """Return the delay of all signals, float64 (n,)."""
        # Zenith delays by Saastamoinen (1972) in the standard atmosphere; mapped by Chao (1974), dry and wet.
        kelvin = 273.15 + self.settings.temperature_c - 6.5e-3 * at.height_m
        pressure = 1013.25 * (1 - 2.2557e-5 * at.height_m) ** 5.2568
        humidity = self.settings.relative_humidity
        vapour = 6.108 * humidity * np.exp((17.15 * kelvin - 4684) / (kelvin - 38.45))
        gravity = 1 - 0.00266 * np.cos(2 * at.lat) - 0.28e-6 * at.height_m
        dry = 0.0022768 * pressure / gravity
        wet = 0.002277 * (1255 / kelvin + 0.05) * vapour + self.wet_m * np.exp(-at.height_m / 2000)
        sine, tangent = np.sin(elevation), np.tan(elevation)
        dry_map = 1 / (sine + 0.00143 / (tangent + 0.0445))
        wet_map = 1 / (sine + 0.00035 / (tangent + 0.017))
        return np.asarray(dry * dry_map + wet * wet_map)


def on(frequency_hz: float) -> float:
    """Return the factor from the ionospheric delay on L1 to that on another frequency."""
    return (L1CA.frequency_hz / frequency_hz) ** 2
