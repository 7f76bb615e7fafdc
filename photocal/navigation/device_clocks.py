"""The clocks of a flight against each other: autopilot, recording computer, GNSS receiver."""

import itertools
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from photocal.base.arrays import Floats, Integers, picked
from photocal.base.errors import IllPosedError
from photocal.base.policy import policy

_LEAST_READINGS = 4


@dataclass(frozen=True)
class ClockSegment:
    """A stretch without a jump: reference = origin + offset + rate * (device - first device reading).

    first_ns, last_ns: first and last reading of the device's clock.
    origin_ns: reading of the reference at `first_ns`; whole nanoseconds, so that nothing is lost.
    offset_s, rate: correction of the origin, and seconds of the reference per second of the device.
    correlation: between the two.
    scatter_s: robust standard deviation of one reading.
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
        # A quartz clock is right to 0.01 %; from 1 % on the recording was played back at another speed.
        playback_limit = 0.01
        return abs(self.rate - 1) > playback_limit


# The stretches of a clock, in the order of the readings.
Stretches = tuple[ClockSegment, ...]


def jumps_s(stretches: Stretches) -> list[float]:
    """Return the steps between stretches, seconds of the reference."""
    steps = []
    for a, b in itertools.pairwise(stretches):
        expected = a.offset_s + a.rate * (b.first_ns - a.first_ns) / 1e9
        steps.append((b.origin_ns - a.origin_ns) / 1e9 + b.offset_s - expected)
    return steps


def converted(stretches: Stretches, device_ns: Integers) -> tuple[Integers, Floats]:
    """Return the reference's time of readings of the device and its standard deviation (s).

    Of several stretches with the same readings of the device (a restart) the first counts; between
    stretches the nearer one is extended.
    """
    distance = [np.maximum(np.maximum(s.first_ns - device_ns, device_ns - s.last_ns), 0) for s in stretches]
    chosen = np.argmin(np.stack(distance), axis=0)
    time = np.zeros(len(device_ns), np.int64)
    sigma = np.zeros(len(device_ns))
    for number, s in enumerate(stretches):
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
    device_ns: Integers, reference_ns: Integers, resolution_s: float = 1e-3, least_jump_s: float = 0.05
) -> Stretches:
    """Fit offset and rate between two clocks from simultaneous readings."""
    if len(device_ns) < _LEAST_READINGS:
        raise IllPosedError(
            f"{len(device_ns)} clock readings, at least {_LEAST_READINGS} are needed", "record SYSTEM_TIME"
        )
    edges = [0, *(np.flatnonzero(np.diff(device_ns) < 0) + 1).tolist(), len(device_ns)]
    pieces = [(a, b) for a, b in itertools.pairwise(edges) if b - a >= _LEAST_READINGS]
    segments: list[tuple[int, int]] = []
    while pieces:
        start, stop = pieces.pop(0)
        cut = _jump(device_ns[start:stop], reference_ns[start:stop], least_jump_s)
        if cut is None:
            segments.append((start, stop))
        else:
            halves = [(start, start + cut), (start + cut, stop)]
            pieces = [h for h in halves if h[1] - h[0] >= _LEAST_READINGS] + pieces
    if not segments:
        raise IllPosedError("the clock restarts too often to be followed", "check the recording")
    return tuple(_fit(device_ns[a:b], reference_ns[a:b], resolution_s) for a, b in segments)


def _seconds(ns: Integers) -> Floats:
    return np.asarray((ns - ns[0]) / 1e9)


def _slope(x: Floats, y: Floats) -> float:
    """Median of the slopes over half the stretch (Theil-Sen with pairs half a stretch apart)."""
    half = len(x) // 2
    run = x[half:] - x[: len(x) - half]
    rise = y[half:] - y[: len(y) - half]
    good = run > 0
    if not good.any():
        raise IllPosedError("the clock does not advance", "check the recording of SYSTEM_TIME")
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
    window = 12
    width = min(window, n // 2)
    step = np.zeros(n)
    for i in range(_LEAST_READINGS, n - _LEAST_READINGS + 1):
        low, high = max(0, i - width), min(n, i + width)
        trend = float(np.median(np.diff(residual[low:high]))) * (high - low) / 2
        step[i] = np.median(residual[i:high]) - np.median(residual[low:i]) - trend
    noise = policy.mad_to_sigma * float(np.median(np.abs(np.diff(residual) - np.median(np.diff(residual)))))
    jump_sigmas = 8.0
    limit = max(jump_sigmas * noise, least_s)
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
        scale = max(policy.mad_to_sigma * float(np.median(np.abs(residual - np.median(residual)))), floor)
        weight = np.minimum(1.0, 1.345 * scale / np.maximum(np.abs(residual), 1e-12))
        root = np.sqrt(weight)
        (offset, rate), *_ = np.linalg.lstsq(design * root[:, None], y * root, rcond=None)
    residual = np.clip(y - offset - rate * x, -3 * scale, 3 * scale)
    cofactor = np.linalg.inv(design.T @ (design * weight[:, None]))
    # Delays of a link come in bursts; n (1 - r) / (1 + r) readings are worth as much as n independent ones.
    spread = max(float(residual @ residual), 1e-300)
    r = min(max(float(residual[1:] @ residual[:-1]) / spread, 0.0), 0.98)
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


@dataclass(frozen=True)
class ComparedClocks:
    """One clock against another.

    name: which two, and what told it.
    cycles: the stretches of each time that the device was switched on.
    constant_sigma_s: standard deviation of an error that all readings share.
    start_host_ns (cycles,): arrival of the first reading of each cycle; empty where there is one.
    """

    name: str
    cycles: tuple[Stretches, ...]
    constant_sigma_s: float = 0.0
    start_host_ns: Integers = field(default_factory=lambda: np.zeros(0, np.int64))

    @property
    def scatter_s(self) -> float:
        """Robust standard deviation of one reading, the largest of all stretches."""
        return max(s.scatter_s for stretches in self.cycles for s in stretches)

    @property
    def sigma_s(self) -> float:
        """Standard deviation of one reading, with what all readings share."""
        return float(np.hypot(self.scatter_s, self.constant_sigma_s))

    def convert(self, device_ns: Integers, host_ns: Integers) -> tuple[Integers, Floats]:
        """Return the reference's time of readings that arrived at `host_ns`, and the standard deviation (s).

        The scatter of single readings is part of it: an autopilot's clock is pulled to and fro by as much.
        """
        cycle = np.clip(np.searchsorted(self.start_host_ns, host_ns, side="right") - 1, 0, None)
        time, sigma = np.zeros(len(device_ns), np.int64), np.zeros(len(device_ns))
        for number, stretches in enumerate(self.cycles):
            rows = cycle == number
            time[rows], sigma[rows] = converted(stretches, device_ns[rows])
        return time, np.hypot(sigma, self.sigma_s)

    @property
    def played_back(self) -> bool:
        """Whether the two cannot both have run in real time."""
        return any(s.played_back for stretches in self.cycles for s in stretches)

    def figures(self) -> dict[str, Any]:
        """Return the figures for a summary."""
        return {
            **picked(self, "played_back", "constant_sigma_s", clocks="name"),
            "restarts": len(self.cycles) - 1,
            "jumps_s": [jump for stretches in self.cycles for jump in jumps_s(stretches)],
            "stretches": [
                {
                    **picked(s, "readings", "offset_sigma_s", "rate", "drift_ppm", "scatter_s"),
                    "seconds": (s.last_ns - s.first_ns) / 1e9,
                    "drift_sigma_ppm": s.rate_sigma * 1e6,
                }
                for stretches in self.cycles
                for s in stretches
            ],
        }


def autopilot_clock(boot_ns: Integers, utc_ns: Integers, host_ns: Integers) -> ComparedClocks | None:
    """Fit an autopilot's UTC to its time since boot, also over restarts."""
    # Telemetry overtakes itself by fractions of a second; a clock that goes back by more was started anew.
    restart_ns = 5_000_000_000
    # An autopilot switched on anew starts at zero: its stretches must not be mixed.
    starts = np.concatenate([[0], np.flatnonzero(np.diff(boot_ns) < -restart_ns) + 1, [len(boot_ns)]])
    cycles, begins = [], []
    for a, b in zip(starts[:-1].tolist(), starts[1:].tolist(), strict=True):
        order = a + np.argsort(boot_ns[a:b], kind="stable")
        try:
            cycles.append(fit_clock(boot_ns[order], utc_ns[order]))
        except IllPosedError:
            continue
        begins.append(int(host_ns[a]))
    if not cycles:
        return None
    name = "autopilot's UTC by its time since boot (SYSTEM_TIME)"
    return ComparedClocks(name, tuple(cycles), start_host_ns=np.array(begins, np.int64))


def device_by_arrival(name: str, device_ns: Integers, host_ns: Integers) -> ComparedClocks | None:
    """Fit a device's clock to that of the recording computer by arrivals, which transmission delays.

    This way round an uneven playback keeps its stretches: the host's clock is the even one.
    """
    try:
        return ComparedClocks(name, (fit_clock(host_ns, device_ns),))
    except IllPosedError:
        return None


def clock_sentences(clocks: list[ComparedClocks]) -> list[str]:
    """Return what a person should know of the clocks: restarts, jumps, wrong speeds."""
    sentences = []
    for clock in clocks:
        if len(clock.cycles) > 1:
            sentences.append(f"{clock.name}: started anew {len(clock.cycles) - 1} times")
        jumps = [jump for stretches in clock.cycles for jump in jumps_s(stretches)]
        if jumps:
            listed = ", ".join(f"{jump:+.3f} s" for jump in jumps[:5])
            sentences.append(f"{clock.name}: {len(jumps)} jumps, {listed}{', ...' if len(jumps) > 5 else ''}")
        if clock.played_back:
            longest = max(itertools.chain(*clock.cycles), key=lambda stretch: stretch.readings)
            sentences.append(
                f"{clock.name}: not in real time, mostly at {longest.rate:.2f} times the speed: "
                "times of arrival are not used"
            )
    return sentences
