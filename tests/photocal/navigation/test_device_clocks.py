"""Clocks of autopilot, recording computer and receiver against each other."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray

from photocal.navigation.device_clocks import (
    autopilot_clock,
    clock_sentences,
    device_by_arrival,
)

Integers = NDArray[np.int64]
SECOND = 1_000_000_000
UTC = 1_750_000_000 * SECOND
BOOT = np.arange(20, 320, dtype=np.int64) * SECOND


def nanoseconds(seconds: NDArray[np.float64]) -> Integers:
    return np.rint(seconds * 1e9).astype(np.int64)


def test_utc_of_boot_times_over_a_restart() -> None:
    rng = np.random.default_rng(1)
    utc = UTC + BOOT + nanoseconds(BOOT / 1e9 * 30e-6 + rng.normal(0, 0.003, 300))
    # Switched off for ten minutes; counts from zero again.
    boot = np.concatenate([BOOT, BOOT])
    utc = np.concatenate([utc, utc + 900 * SECOND])
    host = utc + 50_000_000
    clock = autopilot_clock(boot, utc, host)
    assert clock is not None
    assert len(clock.cycles) == 2
    at = np.array([100 * SECOND + 500_000_000] * 2, np.int64)
    found, sigma = clock.convert(at, np.array([host[80], host[380]]))
    expected = UTC + 100.5 * 1e9 * (1 + 30e-6)
    assert (found - np.array([expected, expected + 900e9])) / 1e9 == pytest.approx([0, 0], abs=0.001)
    assert 0.002 < sigma[0] < 0.005
    assert any("started anew 1 times" in line for line in clock_sentences([clock]))


def test_playback_and_jumps_are_told() -> None:
    rng = np.random.default_rng(3)
    arrival = UTC + BOOT // 5 + nanoseconds(rng.normal(0, 0.002, 300))
    fast = device_by_arrival("autopilot by arrival", BOOT, arrival)
    assert fast is not None
    assert fast.played_back
    assert "5.00 times the speed" in clock_sentences([fast])[0]
    jumped = UTC + BOOT + nanoseconds(rng.normal(0, 0.002, 300))
    jumped[150:] += 3 * SECOND
    found = device_by_arrival("GNSS by arrival", BOOT, jumped)
    assert found is not None
    assert found.figures()["jumps_s"] == pytest.approx([-3.0], abs=0.01)
    assert "1 jumps, -3.00" in clock_sentences([found])[0]


def test_too_few_readings_say_nothing() -> None:
    assert autopilot_clock(BOOT[:2], BOOT[:2] + UTC, BOOT[:2] + UTC) is None
