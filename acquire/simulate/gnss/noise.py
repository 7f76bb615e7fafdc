"""Thermal noise of the tracking loops, and noise that remembers."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from acquire.simulate.gnss.settings import ReceiverModel
from acquire.simulate.gnss.signals import Signal
from drivers.arrays import Floats

# A code loop of 0.5 Hz with correlators 0.2 chips apart, a phase loop of 10 Hz over 20 ms.
_CODE_LOOP_HZ, _SPACING, _PHASE_LOOP_HZ, _INTEGRATION_S = 0.5, 0.2, 10.0, 0.02
_FADING_DB, _FADING_S = 0.7, 3.0
_LOW_GAIN_DB = 13.0


@dataclass(frozen=True)
class Noise:
    """Signal strength and standard deviations at the epochs, float64 (n,) each."""

    cn0_dbhz: Floats
    code_m: Floats
    phase_cycles: Floats
    doppler_hz: Floats


def thermal(signal: Signal, elevation: Floats, model: ReceiverModel, rng: np.random.Generator) -> Noise:
    """Return strength and noise of a signal.

    Sources: Kaplan and Hegarty (2006), Understanding GPS, equations 5.15 (code, early minus late power) and
    5.8 (phase); the Doppler is the phase's change within the integration.
    """
    gain = _LOW_GAIN_DB * (1 - np.sin(np.maximum(elevation, 0.0)) ** 0.7)
    fading = correlated(len(elevation), model.interval_s / _FADING_S, 1, rng)[0]
    cn0 = model.cn0_dbhz - signal.weaker_db - gain + _FADING_DB * fading
    power = 10 ** (cn0 / 10)
    squaring = 1 + 2 / (power * _INTEGRATION_S * (2 - _SPACING))
    code = signal.chip_m * np.sqrt(_CODE_LOOP_HZ * _SPACING / (2 * power) * squaring)
    radians = np.sqrt(_PHASE_LOOP_HZ / power * (1 + 1 / (2 * _INTEGRATION_S * power)))
    phase = radians / (2 * np.pi)
    return Noise(cn0, code, phase, np.sqrt(2) * phase / (2 * np.pi * _INTEGRATION_S))


def correlated(count: int, step: float, rows: int, rng: np.random.Generator) -> Floats:
    """Return Gauss-Markov sequences of unit variance, float64 (rows, count)."""
    from scipy.signal import lfilter

    keep = np.exp(-step)
    white = rng.standard_normal((rows, count))
    white[:, 1:] *= np.sqrt(1 - keep**2)
    return np.asarray(lfilter([1.0], [1.0, -keep], white, axis=1))
