"""Atmosphere and noise against closed forms and published values."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from acquire.simulate.gnss.atmosphere import Atmosphere
from acquire.simulate.gnss.constellation import AntennaTrack
from acquire.simulate.gnss.ephemeris import Field
from acquire.simulate.gnss.observations import correlated, thermal
from acquire.simulate.gnss.settings import E5BQ, L1CA, L2CL, ReceiverModel, SkySettings
from tests.acquire.simulate.gnss.flights import Floats, gps_ns

QUIET = SkySettings(ionosphere_scale=1.0, wave_m=0.0, wet_sigma_m=0.0)


def antenna(count: int, height_m: float = 0.0, lat_deg: float = 45.0, lon: float = 0.0) -> AntennaTrack:
    full, nowhere = np.ones(count), np.zeros((count, 3))
    return AntennaTrack(nowhere, nowhere, np.radians(lat_deg) * full, lon * full, height_m * full)


def ionosphere_m(
    air: Atmosphere, elevation_deg: list[float], time: int = 0, lat_deg: float = 45.0, lon: float = 0.0
) -> Floats:
    n = len(elevation_deg)
    at = antenna(n, lat_deg=lat_deg, lon=lon)
    return air.ionosphere_m(at, np.zeros(n), np.radians(elevation_deg), np.full(n, time, np.int64))


def troposphere_m(air: Atmosphere, elevation_deg: list[float], height_m: float = 0.0) -> Floats:
    return air.troposphere_m(antenna(len(elevation_deg), height_m), np.radians(elevation_deg))


def test_night_has_five_nanoseconds() -> None:
    """Klobuchar's model by night: 5 ns in the zenith; a layer at 350 km has 1/sin at 71.3 deg for 20 deg."""
    air = Atmosphere.by_chance(QUIET, np.random.default_rng(0))
    found = ionosphere_m(air, [90.0, 20.0], gps_ns(2025, 6, 15, 2, 0, 0))
    zenith = np.arcsin(6371 / 6721 * np.cos(np.radians(20)))
    assert found == pytest.approx(299_792_458.0 * 5e-9 / np.cos([0.0, zenith]), rel=1e-9)


def test_day_has_its_maximum_at_two() -> None:
    air = Atmosphere.by_chance(QUIET, np.random.default_rng(0))
    hours = np.arange(24)
    delay = [ionosphere_m(air, [90.0], gps_ns(2025, 6, 15, h, 0, 0))[0] for h in hours.tolist()]
    assert np.argmax(delay) == 14
    # A zenith at 45 deg: geomagnetic latitude 0.25 + 0.064 cos(-1.617 pi) semicircles.
    magnetic = 0.25 + 0.064 * np.cos(1.617 * np.pi)
    alpha = np.array([12, 2, -1, -1]) * 2.0 ** np.array([-30, -27, -24, -24])
    amplitude = float(np.polynomial.Polynomial(alpha)(magnetic))
    assert delay[14] == pytest.approx(299_792_458.0 * (5e-9 + amplitude), rel=1e-6)


def test_short_baselines_share_the_ionosphere() -> None:
    air = Atmosphere.by_chance(SkySettings(), np.random.default_rng(1))
    time = gps_ns(2025, 6, 15, 13, 0, 0)
    elevation = [20.0, 45.0, 80.0]
    here, near, far = (ionosphere_m(air, elevation, time, 45 + d) for d in (0.0, 0.009, 0.9))
    # 1 km and 100 km.
    assert np.abs(near - here).max() < 0.01
    assert np.abs(far - here).max() > 0.05


def test_waves_do_not_break_at_the_date_line() -> None:
    air = Atmosphere.by_chance(SkySettings(), np.random.default_rng(1), np.pi)
    west, east = (ionosphere_m(air, [60.0], lon=side * (np.pi - 1e-7))[0] for side in (1.0, -1.0))
    assert abs(west - east) < 1e-4


def test_troposphere_has_published_sizes() -> None:
    """Dry zenith delay 2.31 m at sea level; mapped to 10 deg as by Niell (1996) at 45 deg latitude."""
    dry = Atmosphere.by_chance(SkySettings(relative_humidity=0.0, wet_sigma_m=0.0), np.random.default_rng(0))
    zenith, low = troposphere_m(dry, [90.0, 10.0])
    assert zenith == pytest.approx(2.307, abs=0.005)
    a, b, c, sine = 1.2683230e-3, 2.9152299e-3, 62.837393e-3, np.sin(np.radians(10.0))
    niell = (1 + a / (1 + b / (1 + c))) / (sine + a / (sine + b / (sine + c)))
    assert low / zenith == pytest.approx(niell, rel=0.002)
    wet = Atmosphere.by_chance(QUIET, np.random.default_rng(0))
    ground, above = (troposphere_m(wet, [90.0], h)[0] for h in (0.0, 100.0))
    # Saastamoinen's wet part with 8.5 hPa at 15 deg C: 0.002277 (1255 / 288.15 + 0.05) 8.5 m.
    assert ground - zenith == pytest.approx(0.085, abs=0.003)
    assert ground - above == pytest.approx(0.032, abs=0.004)
    # The same with 90 % of the 56.2 hPa that saturate air of 35 deg C.
    sultry = replace(QUIET, temperature_c=35.0, relative_humidity=0.9)
    hot = troposphere_m(Atmosphere.by_chance(sultry, np.random.default_rng(0)), [90.0])[0]
    assert hot - zenith == pytest.approx(0.002277 * (1255 / 308.15 + 0.05) * 0.9 * 56.2, abs=0.006)


def test_noise_grows_as_the_signal_weakens() -> None:
    model = ReceiverModel()
    rng = np.random.default_rng(2)
    low, high = (thermal(L1CA, np.full(4000, np.radians(e)), model, rng) for e in (10.0, 80.0))
    assert high["cn0_dbhz"].mean() == pytest.approx(50, abs=0.5)
    assert 38 < low["cn0_dbhz"].mean() < 42
    # A phase loop of 10 Hz at 50 dBHz: sqrt(10 / 1e5) rad.
    assert high["phase_sigma_cycles"].mean() == pytest.approx(0.01 / (2 * np.pi), rel=0.05)
    assert low["code_sigma_m"].mean() / high["code_sigma_m"].mean() == pytest.approx(
        10 ** ((50 - low["cn0_dbhz"].mean()) / 20), rel=0.1
    )
    second = thermal(L2CL, np.full(4000, np.radians(80.0)), model, rng)
    assert second["cn0_dbhz"].mean() == pytest.approx(46, abs=0.5)
    assert (
        thermal(E5BQ, np.full(10, 1.4), model, rng)["code_sigma_m"].max() < 0.2 * high["code_sigma_m"].min()
    )


def test_correlated_noise_forgets_at_its_rate() -> None:
    values = correlated(np.random.default_rng(3).standard_normal((2, 200_000)), 0.1)
    assert values.std(axis=1) == pytest.approx([1, 1], abs=0.03)
    for lag in (1, 10, 20):
        found = [np.mean(row[lag:] * row[:-lag]) for row in values]
        assert found == pytest.approx([np.exp(-0.1 * lag)] * 2, abs=0.03)
    assert abs(np.mean(values[0] * values[1])) < 0.03


def test_a_field_holds_what_it_can() -> None:
    assert Field(8, 0.5).quantise(-64.0) == -128
    assert Field(8, 0.5, signed=False).quantise(127.5) == 255
    for field, value in ((Field(8, 0.5), 64.0), (Field(8, 0.5, signed=False), -0.5)):
        with pytest.raises(OverflowError, match="8 bits"):
            field.quantise(value)
