"""Clock models on simulated clocks with known errors, and on recorded ones."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

from drivers.frames import Wire
from drivers.mavlink.decode import decode
from drivers.mavlink.dialect import ardupilotmega
from drivers.tlog import TlogFramer
from photocal.base.errors import IllPosedError
from photocal.navigation.device_clocks import converted, fit_clock, jumps_s

SECOND = 1_000_000_000


def readings(
    rng: np.random.Generator, n: int, offset_s: float, ppm: float, noise_s: float
) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    device = (np.arange(n) * SECOND + 5 * SECOND).astype(np.int64)
    truth = device / 1e9 * ppm * 1e-6 + offset_s
    late = rng.normal(0, noise_s, n)
    return device, device + np.rint((truth + late) * 1e9).astype(np.int64) + 1_500_000_000 * SECOND


def test_offset_and_drift_within_their_sigmas() -> None:
    rng = np.random.default_rng(7)
    errors = []
    for _ in range(200):
        device, reference = readings(rng, 120, -3.2, 40.0, 0.02)
        segment = fit_clock(device, reference)[0]
        errors.append((segment.rate - 1 - 40e-6) / segment.rate_sigma)
    assert 0.8 < np.std(errors) < 1.25
    assert abs(np.mean(errors)) < 0.3


def test_a_quarter_of_wild_readings_does_no_harm() -> None:
    rng = np.random.default_rng(8)
    device, reference = readings(rng, 400, 12.0, 20.0, 0.005)
    wild = rng.random(400) < 0.25
    reference[wild] += rng.integers(0, 3 * SECOND, int(wild.sum()))
    model = fit_clock(device, reference)
    time, _ = converted(model, device[200:201])
    expected = device[200] / 1e9 * (1 + 20e-6) + 12.0
    assert abs((time[0] - 1_500_000_000 * SECOND) / 1e9 - expected) < 0.01


def test_a_jump_is_found_with_its_size() -> None:
    rng = np.random.default_rng(9)
    device, reference = readings(rng, 300, 0.0, 15.0, 0.004)
    reference[140:] += 2 * SECOND
    model = fit_clock(device, reference)
    assert len(model) == 2
    assert model[1].first_ns == device[140]
    assert jumps_s(model)[0] == pytest.approx(2.0, abs=0.01)


def test_a_restart_begins_a_new_stretch() -> None:
    rng = np.random.default_rng(10)
    device, reference = readings(rng, 200, 0.0, 0.0, 0.002)
    device[100:] -= device[100]
    assert len(fit_clock(device, reference)) == 2


def test_too_few_readings_are_refused() -> None:
    with pytest.raises(IllPosedError, match="at least 4"):
        fit_clock(np.arange(3), np.arange(3))


@pytest.mark.shared
def test_playback_at_another_speed(shared: Path) -> None:
    dialect = ardupilotmega()
    framer = TlogFramer(dialect)
    batch = framer.feed((shared / "data/mavlink-tlog-cuav-images/flight.tlog").read_bytes())
    found = decode(batch, dialect.number("SYSTEM_TIME"), dialect)
    assert batch.host_ns is not None
    assert batch.wire[found.index[0]] == Wire.MAVLINK
    boot = found.fields["time_boot_ms"].astype(np.int64) * 1_000_000
    utc = found.fields["time_unix_usec"].astype(np.int64) * 1000
    good = utc > 0
    # The host's clock against the autopilot's: 128 s of receipt for 588 s of flight (README of the data).
    host = fit_clock(batch.host_ns[found.index][good], boot[good])
    assert any(s.played_back for s in host)
    # The playback was uneven: 4.6 on the whole, 4.3 most of the time.
    assert (boot[-1] - boot[0]) / (batch.host_ns[-1] - batch.host_ns[0]) == pytest.approx(4.6, abs=0.2)
    assert 4.2 < max(host, key=lambda s: s.readings).rate < 4.7
    # Autopilot's UTC against its boot time: real time.
    clock = fit_clock(boot[good], utc[good])
    assert all(abs(s.rate - 1) < 1e-3 for s in clock)
