"""RXM-RAWX: the raw observations of u-blox.

Source: u-blox F9 HPG 1.32 interface description, RXM-RAWX version 1.
"""

from __future__ import annotations

import struct
from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

from acquire.simulate.gnss.observations import Observations
from acquire.simulate.gnss.signals import SIGNALS, UBX_SYSTEM
from drivers.arrays import Floats
from drivers.gnsstime import SECOND_NS, WEEK_S

KIND = 0x0215
# From the measurement until the message is complete on a fast line.
_LATENCY_NS = 60_000_000
_LEAP_KNOWN, _CLOCK_RESET, _VERSION = 0x01, 0x02, 1
_LONGEST_LOCK_MS = 64_500
_SIGNAL = np.dtype(
    [
        *[("code", "<f8"), ("phase", "<f8"), ("doppler", "<f4"), ("system", "u1"), ("satellite", "u1")],
        *[("signal", "u1"), ("slot", "u1"), ("lock", "<u2"), ("cn0", "u1"), ("code_sigma", "u1")],
        *[("phase_sigma", "u1"), ("doppler_sigma", "u1"), ("status", "u1"), ("reserved", "u1")],
    ]
)


def messages(observations: Observations, leap_s: int) -> Iterator[tuple[int, bytes]]:
    """Yield time of sending (GPS ns) and payload, one per epoch that has signals."""
    rows = observations.rows
    records = _records(observations).tobytes()
    clock = observations.clock
    bounds = np.searchsorted(rows["epoch"], np.arange(len(clock) + 1))
    true_ns = clock.true_gps_ns
    for epoch, (first, after) in enumerate(zip(bounds[:-1].tolist(), bounds[1:].tolist(), strict=True)):
        if first == after:
            continue
        week, of_week = divmod(int(clock.tag_gps_ns[epoch]), WEEK_S * SECOND_NS)
        status = _LEAP_KNOWN | (_CLOCK_RESET if clock.step[epoch] else 0)
        head = struct.pack("<dHbBBB2x", of_week / SECOND_NS, week, leap_s, after - first, status, _VERSION)
        yield int(true_ns[epoch]) + _LATENCY_NS, head + records[first * 32 : after * 32]


def _records(observations: Observations) -> NDArray[np.void]:
    rows = observations.rows
    satellites = observations.satellites
    out = np.zeros(len(rows), _SIGNAL)
    systems = np.array([UBX_SYSTEM[s.system] for s in satellites], np.uint8)
    numbers = np.array([s.truth.number for s in satellites], np.uint8)
    signals = np.array([[signal.ubx for signal in SIGNALS[s.system]] for s in satellites], np.uint8)
    out["code"], out["phase"], out["doppler"] = rows["code_m"], rows["phase_cycles"], rows["doppler_hz"]
    out["system"], out["satellite"] = systems[rows["satellite"]], numbers[rows["satellite"]]
    out["signal"] = signals[rows["satellite"], rows["signal"]]
    out["lock"] = np.minimum(np.floor(rows["lock_s"] * 1e3), _LONGEST_LOCK_MS)
    out["cn0"] = np.rint(rows["cn0_dbhz"])
    out["code_sigma"] = _power_of_two(rows["code_sigma_m"], 0.01)
    phase_sigma = np.clip(np.ceil(rows["phase_sigma_cycles"] / 0.004), 1, 15)
    out["phase_sigma"] = np.where(rows["has_phase"], phase_sigma, 15)
    out["doppler_sigma"] = _power_of_two(rows["doppler_sigma_hz"], 0.002)
    out["status"] = (
        1 + 2 * rows["has_phase"].astype(np.uint8) + 4 * rows["half_valid"] + 8 * rows["half_subtracted"]
    )
    return out


def _power_of_two(sigma: Floats, unit: float) -> Floats:
    return np.clip(np.ceil(np.log2(np.maximum(sigma, unit) / unit)), 0, 15)
