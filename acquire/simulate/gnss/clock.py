"""The receiver's clock: a crystal with bias, drift and noise, set by whole milliseconds."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from acquire.simulate.gnss.settings import ReceiverModel
from drivers.arrays import Flags, Floats, Integers
from drivers.gnsstime import SECOND_NS


@dataclass(frozen=True)
class Clock:
    """Epochs of a receiver.

    tag_gps_ns (n,): what the receiver's clock shows at its measurements.
    bias_s (n,): receiver time minus GPS time at the measurements.
    rate (n,): derivative of the bias.
    step: whether the clock was set since the last epoch.
    """

    tag_gps_ns: Integers
    bias_s: Floats
    rate: Floats
    step: Flags

    def __len__(self) -> int:
        return len(self.tag_gps_ns)

    @property
    def true_gps_ns(self) -> Integers:
        """GPS time of the measurements to the nanosecond."""
        return np.asarray(self.tag_gps_ns - np.rint(self.bias_s * SECOND_NS).astype(np.int64))


def run(model: ReceiverModel, start_gps_ns: int, stop_gps_ns: int, rng: np.random.Generator) -> Clock:
    """Let a clock run through a session."""
    every = round(model.interval_s * SECOND_NS)
    tag = np.arange(-(-start_gps_ns // every) * every, stop_gps_ns + 1, every, dtype=np.int64)
    bias = rng.uniform(-4e-4, 4e-4) if model.clock_bias_s is None else model.clock_bias_s
    drift = rng.uniform(-5e-7, 5e-7) if model.clock_drift is None else model.clock_drift
    rate = drift + model.clock_noise / np.sqrt(model.interval_s) * rng.standard_normal(len(tag))
    total = bias + np.concatenate([[0.0], np.cumsum(rate[:-1])]) * model.interval_s
    steps = np.rint(total * 1e3) if model.clock_steps else np.zeros(len(tag))
    # The epoch after a step comes a millisecond later: the clock has gone on meanwhile.
    total[1:] += np.cumsum(rate[:-1] * np.diff(steps)) * 1e-3
    moved = np.concatenate([[False], np.diff(steps) != 0])
    return Clock(tag, total - steps * 1e-3, rate, moved)
