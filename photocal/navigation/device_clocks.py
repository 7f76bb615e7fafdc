"""The clocks of a flight against each other: autopilot, recording computer, GNSS receiver."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from drivers.arrays import Floats, Integers
from drivers.errors import IllPosedError
from photocal.navigation.clock_model import ClockModel, fit_clock

# Telemetry overtakes itself by fractions of a second; a clock that goes back by more was started anew.
_RESTART_NS = 5_000_000_000


@dataclass(frozen=True)
class ComparedClocks:
    """One clock against another.

    name: which two, and what told it.
    cycles: one model for each time that the device was switched on.
    constant_sigma_s: standard deviation of an error that all readings share.
    """

    name: str
    cycles: tuple[ClockModel, ...]
    constant_sigma_s: float = 0.0

    @property
    def scatter_s(self) -> float:
        """Robust standard deviation of one reading, the largest of all stretches."""
        return max(s.scatter_s for model in self.cycles for s in model.segments)

    @property
    def played_back(self) -> bool:
        """Whether the two cannot both have run in real time."""
        return any(s.played_back for model in self.cycles for s in model.segments)

    def figures(self) -> dict[str, Any]:
        """Return the figures for a summary."""
        return {
            "clocks": self.name,
            "restarts": len(self.cycles) - 1,
            "jumps_s": [jump for model in self.cycles for jump in model.jumps_s],
            "played_back": self.played_back,
            "constant_sigma_s": self.constant_sigma_s,
            "stretches": [
                {
                    "readings": s.readings,
                    "seconds": (s.last_ns - s.first_ns) / 1e9,
                    "offset_sigma_s": s.offset_sigma_s,
                    "rate": s.rate,
                    "drift_ppm": s.drift_ppm,
                    "drift_sigma_ppm": s.rate_sigma * 1e6,
                    "scatter_s": s.scatter_s,
                }
                for model in self.cycles
                for s in model.segments
            ],
        }


@dataclass(frozen=True)
class AutopilotClock:
    """UTC of an autopilot's time since boot, also over restarts.

    compared: UTC by boot time, from SYSTEM_TIME, or through the recording computer.
    start_host_ns (k,): arrival of the first reading of each cycle.
    """

    compared: ComparedClocks
    start_host_ns: Integers

    def utc(self, boot_ns: Integers, host_ns: Integers) -> tuple[Integers, Floats]:
        """Return UTC (ns since 1970) of boot times that arrived at `host_ns`, and the standard deviation (s).

        The scatter of single readings is part of it: an autopilot's clock is pulled to and fro by as much.
        """
        cycle = np.clip(np.searchsorted(self.start_host_ns, host_ns, side="right") - 1, 0, None)
        time, sigma = np.zeros(len(boot_ns), np.int64), np.zeros(len(boot_ns))
        for number, model in enumerate(self.compared.cycles):
            rows = cycle == number
            time[rows], sigma[rows] = model.convert(boot_ns[rows])
        return time, np.hypot(sigma, self.sigma_s)

    @property
    def sigma_s(self) -> float:
        """Standard deviation of one reading, with what all readings share."""
        return float(np.hypot(self.compared.scatter_s, self.compared.constant_sigma_s))


def autopilot_clock(boot_ns: Integers, utc_ns: Integers, host_ns: Integers) -> AutopilotClock | None:
    """Fit an autopilot's UTC to its time since boot."""
    # An autopilot switched on anew counts from zero: its stretches must not be mixed.
    starts = np.concatenate([[0], np.flatnonzero(np.diff(boot_ns) < -_RESTART_NS) + 1, [len(boot_ns)]])
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
    compared = ComparedClocks("autopilot's UTC by its time since boot (SYSTEM_TIME)", tuple(cycles))
    return AutopilotClock(compared, np.array(begins, np.int64))


def device_by_arrival(name: str, device_ns: Integers, host_ns: Integers) -> ComparedClocks | None:
    """Fit a device's clock to that of the recording computer by arrivals, which are late by the way.

    This way round an uneven playback keeps its stretches: the host's clock is the even one.
    """
    try:
        return ComparedClocks(name, (fit_clock(host_ns, device_ns),))
    except IllPosedError:
        return None


def _typical_rate(clock: ComparedClocks) -> float:
    stretches = [s for model in clock.cycles for s in model.segments]
    return max(stretches, key=lambda s: s.readings).rate


def clock_sentences(clocks: list[ComparedClocks]) -> list[str]:
    """Return what a person should know of the clocks: restarts, jumps, wrong speeds."""
    found = []
    for clock in clocks:
        if len(clock.cycles) > 1:
            found.append(f"{clock.name}: started anew {len(clock.cycles) - 1} times")
        jumps = [jump for model in clock.cycles for jump in model.jumps_s]
        if jumps:
            told = ", ".join(f"{jump:+.3f} s" for jump in jumps[:5])
            found.append(f"{clock.name}: {len(jumps)} jumps, {told}{', ...' if len(jumps) > 5 else ''}")
        if clock.played_back:
            # The median of the stretches, by their readings.
            speed = _typical_rate(clock)
            found.append(
                f"{clock.name}: not real time, mostly {speed:.2f} times the speed: "
                "times of arrival are not used"
            )
    return found
