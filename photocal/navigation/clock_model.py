"""How one clock runs against another: offset and rate, robustly, with jumps and wrong playback speeds."""

from __future__ import annotations

import itertools
from dataclasses import dataclass

import numpy as np

from drivers.arrays import Floats, Integers
from drivers.errors import IllPosedError

_WINDOW = 12
_LEAST_READINGS = 4
_JUMP_SIGMAS = 8.0
# A quartz clock is right to 0.01 %; from 1 % on the recording was played back at another speed.
PLAYBACK_LIMIT = 0.01


@dataclass(frozen=True)
class ClockSegment:
    """A stretch without a jump: reference = origin + offset + rate * (device - first device reading).

    first_ns, last_ns: first and last reading of the device's clock.
    origin_ns: reading of the reference at `first_ns`; whole nanoseconds, so that nothing is lost.
    offset_s, rate: correction of the origin, and seconds of the reference per second of the device.
    offset_sigma_s, rate_sigma: their standard deviations.
    correlation: between the two.
    scatter_s: robust standard deviation of one reading.
    readings: number of readings in the stretch.
    """

    first_ns: int
    last_ns: int
    origin_ns: int
    offset_s: float
    rate: float
    offset_sigma_s: float
    rate_sigma: float
    correlation: float
    scatter_s: float
    readings: int

    @property
    def drift_ppm(self) -> float:
        """Rate of the reference against the device, less one, in parts per million."""
        return (self.rate - 1) * 1e6

    @property
    def played_back(self) -> bool:
        """Whether the two clocks cannot both be real time."""
        return abs(self.rate - 1) > PLAYBACK_LIMIT


@dataclass(frozen=True)
class ClockModel:
    """The stretches of a clock, in the order of the readings."""

    segments: tuple[ClockSegment, ...]

    @property
    def jumps_s(self) -> list[float]:
        """Steps between the stretches, seconds of the reference."""
        steps = []
        for a, b in itertools.pairwise(self.segments):
            expected = a.offset_s + a.rate * (b.first_ns - a.first_ns) / 1e9
            steps.append((b.origin_ns - a.origin_ns) / 1e9 + b.offset_s - expected)
        return steps

    def convert(self, device_ns: Integers) -> tuple[Integers, Floats]:
        """Return the reference's time of readings of the device and its standard deviation (s).

        Of several stretches with the same readings of the device (a restart) the first counts; between
        stretches the nearer one is extended.
        """
        distance = [
            np.maximum(np.maximum(s.first_ns - device_ns, device_ns - s.last_ns), 0) for s in self.segments
        ]
        chosen = np.argmin(np.stack(distance), axis=0)
        time = np.zeros(len(device_ns), np.int64)
        sigma = np.zeros(len(device_ns))
        for number, s in enumerate(self.segments):
            rows = chosen == number
            elapsed = (device_ns[rows] - s.first_ns) / 1e9
            # The whole part of the elapsed time stays an integer: a double holds only 100 ns over years.
            part = s.offset_s + (s.rate - 1) * elapsed
            time[rows] = s.origin_ns + (device_ns[rows] - s.first_ns) + np.rint(part * 1e9).astype(np.int64)
            cross = 2 * elapsed * s.correlation * s.offset_sigma_s * s.rate_sigma
            variance = s.offset_sigma_s**2 + (elapsed * s.rate_sigma) ** 2 + cross
            sigma[rows] = np.sqrt(np.maximum(variance, 0.0))
        return time, sigma


def fit_clock(
    device_ns: Integers,
    reference_ns: Integers,
    resolution_s: float = 1e-3,
    least_jump_s: float = 0.05,
) -> ClockModel:
    """Fit offset and rate between two clocks from simultaneous readings."""
    if len(device_ns) < _LEAST_READINGS:
        raise IllPosedError(
            f"{len(device_ns)} clock readings, at least {_LEAST_READINGS} are needed",
            remedy="record SYSTEM_TIME",
        )
    edges = [0, *(np.flatnonzero(np.diff(device_ns) < 0) + 1).tolist(), len(device_ns)]
    pieces = [(a, b) for a, b in itertools.pairwise(edges) if b - a >= _LEAST_READINGS]
    found: list[tuple[int, int]] = []
    while pieces:
        start, stop = pieces.pop(0)
        cut = _jump(device_ns[start:stop], reference_ns[start:stop], least_jump_s)
        if cut is None:
            found.append((start, stop))
        else:
            halves = [(start, start + cut), (start + cut, stop)]
            pieces = [h for h in halves if h[1] - h[0] >= _LEAST_READINGS] + pieces
    if not found:
        raise IllPosedError("the clock restarts too often to be followed", remedy="check the recording")
    return ClockModel(tuple(_fit(device_ns[a:b], reference_ns[a:b], resolution_s) for a, b in found))


def _seconds(ns: Integers) -> Floats:
    return np.asarray((ns - ns[0]) / 1e9)


def _slope(x: Floats, y: Floats) -> float:
    """Median of the slopes over half the stretch (Theil-Sen with pairs half a stretch apart)."""
    half = len(x) // 2
    run = x[half:] - x[: len(x) - half]
    rise = y[half:] - y[: len(y) - half]
    good = run > 0
    if not good.any():
        raise IllPosedError("the clock stands still", remedy="check the recording of SYSTEM_TIME")
    return float(np.median(rise[good] / run[good]))


def _jump(device: Integers, reference: Integers, least_s: float) -> int | None:
    """Return where the residuals step, None when they do not."""
    n = len(device)
    if n < 2 * _LEAST_READINGS:
        return None
    x, y = _seconds(device), _seconds(reference)
    # Rates of neighbours tell a step from a drift: a step changes one difference, a drift all of them.
    run, rise = np.diff(x), np.diff(y)
    wide = run > 0
    rate = float(np.median(rise[wide] / run[wide])) if wide.any() else 1.0
    residual = y - rate * x
    width = min(_WINDOW, n // 2)
    step = np.zeros(n)
    for i in range(_LEAST_READINGS, n - _LEAST_READINGS + 1):
        before, after = residual[max(0, i - width) : i], residual[i : i + width]
        low, high = max(0, i - width), min(len(residual), i + width)
        steps = np.diff(residual[low:high])
        trend = float(np.median(steps)) * (high - low) / 2
        step[i] = np.median(after) - np.median(before) - trend
    noise = 1.4826 * float(np.median(np.abs(np.diff(residual) - np.median(np.diff(residual)))))
    limit = max(_JUMP_SIGMAS * noise, least_s)
    worst = int(np.argmax(np.abs(step)))
    if abs(step[worst]) <= limit:
        return None
    near = slice(max(worst - width, 1), min(worst + width, n))
    change = np.abs(np.diff(residual)[near.start - 1 : near.stop - 1])
    sharp = near.start + int(np.argmax(change))
    # A drift that was not removed gives many small steps, a jump one that is as large as the whole.
    return sharp if change.max() > 0.5 * abs(step[worst]) else None


def _fit(device: Integers, reference: Integers, resolution_s: float) -> ClockSegment:
    x, y = _seconds(device), _seconds(reference)
    rate = _slope(x, y)
    offset = float(np.median(y - rate * x))
    floor = resolution_s / np.sqrt(12)
    design = np.stack([np.ones_like(x), x], axis=1)
    scale = floor
    for _ in range(30):
        residual = y - offset - rate * x
        scale = max(1.4826 * float(np.median(np.abs(residual - np.median(residual)))), floor)
        weight = np.minimum(1.0, 1.345 * scale / np.maximum(np.abs(residual), 1e-12))
        root = np.sqrt(weight)
        (offset, rate), *_ = np.linalg.lstsq(design * root[:, None], y * root, rcond=None)
    residual = np.clip(y - offset - rate * x, -3 * scale, 3 * scale)
    cofactor = np.linalg.inv(design.T @ (design * weight[:, None]))
    # Delays of a link come in bursts; n (1 - r) / (1 + r) readings are worth as much as n independent ones.
    spread = float(residual @ residual)
    r = float(residual[1:] @ residual[:-1]) / spread if spread > 0 else 0.0
    r = min(max(r, 0.0), 0.98)
    variance = scale**2 * (1 + r) / (1 - r) * cofactor
    sigmas = np.sqrt(np.diag(variance))
    return ClockSegment(
        first_ns=int(device[0]),
        last_ns=int(device[-1]),
        origin_ns=int(reference[0]),
        offset_s=float(offset),
        rate=float(rate),
        offset_sigma_s=float(sigmas[0]),
        rate_sigma=float(sigmas[1]),
        correlation=float(variance[0, 1] / (sigmas[0] * sigmas[1])),
        scatter_s=scale,
        readings=len(x),
    )
