"""Satellites of the engine: positions against zenith delay, and how long errors last."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from scipy.optimize import least_squares

from photocal.navigation.satellite_residuals import (
    SatelliteResiduals,
    correlation_time_s,
    read_satellite_residuals,
    shift_by_zenith_delay,
)
from photocal.navigation.time import GpsTime

SKY = [("G", 20, 70), ("G", 95, 35), ("G", 170, 20), ("G", 250, 50), ("G", 310, 25), ("E", 60, 40),
       ("E", 220, 65), ("E", 290, 18)]  # fmt: skip


def satellite_residuals(epochs: int, residual_m: np.ndarray) -> SatelliteResiduals:
    """The same sky at every epoch, a second apart."""
    n = len(SKY)
    return SatelliteResiduals(
        GpsTime(np.repeat(np.arange(epochs, dtype=np.int64) * 1_000_000_000, n)),
        np.tile([f"{letter}{k:02d}" for k, (letter, _, _) in enumerate(SKY)], epochs),
        np.ones(n * epochs, np.int64),
        np.radians(np.tile([float(a) for _, a, _ in SKY], epochs)),
        np.radians(np.tile([float(e) for _, _, e in SKY], epochs)),
        residual_m.ravel(),
        np.zeros(n * epochs),
    )


def test_zenith_delay_moves_a_position_as_ranges_say() -> None:
    """Ranges to far satellites lengthened by 10 mm / sin(elevation), solved for place and clocks.

    Those below 20 degrees have no whole cycles, and place no fix.
    """
    sky = [each for each in SKY if each[2] >= 20]
    letters = np.array([letter for letter, _, _ in sky])
    azimuth, elevation = np.radians([[a, e] for _, a, e in sky]).T
    towards = np.stack(
        [np.sin(azimuth) * np.cos(elevation), np.cos(azimuth) * np.cos(elevation), np.sin(elevation)], axis=1
    )
    far = 2.2e7 * towards
    measured = np.linalg.norm(far, axis=1) + 0.010 / np.sin(elevation)
    root = 1 / np.sqrt(1 + 1 / np.sin(elevation) ** 2)

    def misfit(x: np.ndarray) -> np.ndarray:
        clock = np.where(letters == "G", x[3], x[4])
        return np.asarray((np.linalg.norm(far - x[:3], axis=1) + clock - measured) * root)

    # Steps of metres: a double holds 4 nm of these distances.
    found = least_squares(misfit, np.zeros(5), jac="3-point", diff_step=[1.0] * 5, x_scale=1.0, xtol=1e-15).x[
        :3
    ]
    assert found[2] > 0.02
    assert 0.010 * shift_by_zenith_delay(satellite_residuals(3, np.zeros((3, len(SKY))))) == pytest.approx(
        found, abs=1e-5
    )


@pytest.mark.parametrize("lasting_s", [0.2, 10.0, 40.0])
def test_how_long_errors_last(lasting_s: float) -> None:
    """Autoregressive errors: their integral time is (1 + f) / (1 - f) / 2 steps."""
    rng = np.random.default_rng(5)
    factor = np.exp(-1 / lasting_s)
    errors = np.zeros((6000, len(SKY)))
    for row in range(1, len(errors)):
        errors[row] = factor * errors[row - 1] + rng.normal(0, 0.003, len(SKY))
    # Double differences: the first satellite of each system is the reference.
    differenced = errors - errors[:, [0, 0, 0, 0, 0, 5, 5, 5]]
    wanted = (1 + factor) / (1 - factor) / 2
    # Relative standard deviation of such an estimate: about sqrt(2 (2 M + 1) / n) (Sokal 1997, eq. 3.19).
    assert correlation_time_s(satellite_residuals(len(errors), differenced)) == pytest.approx(
        wanted, rel=0.25
    )


def test_too_little_tells_nothing(tmp_path: Path) -> None:
    empty = tmp_path / "empty.pos.stat"
    empty.write_text("$POS,2300,100.000,1,1,2,3,0,0,0\n$SAT,2300,100.000,G05,1,20.0,45.0,0.1,0.002,0,45\n")
    none = read_satellite_residuals(empty)
    assert len(none) == 0
    assert len(read_satellite_residuals(tmp_path / "missing.pos.stat")) == 0
    assert np.isnan(shift_by_zenith_delay(none)).all()
    assert np.isnan(correlation_time_s(none))


def test_a_status_file(tmp_path: Path) -> None:
    path = tmp_path / "one.pos.stat"
    path.write_text(
        "$SAT,2300,100.200,G05,1,20.0,45.0,0.1234,0.0021,1,45,1,0,99,0,0,0\n"
        "$SAT,2300,100.200,G07,1,90.0,30.0,0.1234,-0.0040,0,45,0,0,99,0,0,0\n"
        "$CLK,2300,100.200,1,1,0.0,0.0,0.0,0.0\n"
    )
    found = read_satellite_residuals(path)
    assert found.satellite.tolist() == ["G05"]
    assert found.time.ns.tolist() == [2300 * 604_800 * 10**9 + 100_200_000_000]
    assert np.degrees(found.azimuth).tolist() == pytest.approx([20.0])
    assert found.residual_m.tolist() == [0.0021]
    assert found.code_m.tolist() == [0.1234]
