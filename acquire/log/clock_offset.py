"""The clock of the host against the clock of the autopilot, over time."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from drivers.arrays import Bytes, Floats, Integers

EARLIEST_US = 946_684_800_000_000
_SAMPLES = 24
# A clock is wrong from 1 % on: good ones stay below 0.01 %.
_RATE_LIMIT = 0.01
_LEAST_SPAN_S = 10.0


@dataclass
class ClockOffset:
    """Collects the readings of the clocks of one link; the first system that tells the date counts."""

    system: int | None = None
    host: list[Integers] = field(default_factory=list)
    device: list[Integers] = field(default_factory=list)
    boot: list[Integers] = field(default_factory=list)

    def add(self, system: Bytes, fields: NDArray[Any], host_ns: Integers) -> None:
        """Take SYSTEM_TIME messages with their times of receipt."""
        good = fields["time_unix_usec"] > EARLIEST_US
        if self.system is None and good.any():
            self.system = int(system[np.argmax(good)])
        good &= system == (-1 if self.system is None else self.system)
        self.host.append(host_ns[good])
        self.device.append(fields["time_unix_usec"][good].astype(np.int64) * 1000)
        self.boot.append(fields["time_boot_ms"][good].astype(np.int64) * 1_000_000)

    def as_json(self) -> dict[str, Any] | None:
        """Return offset, rate and a verdict in words; None when no clock was told."""
        if self.system is None:
            return None
        host, device, boot = (np.concatenate(parts) for parts in (self.host, self.device, self.boot))
        offset = (host - device) / 1e9
        picked = np.unique(np.linspace(0, len(offset) - 1, _SAMPLES).astype(int))
        ratio = _ratio(host, boot)
        return {
            "system": self.system,
            "readings": len(offset),
            "host_minus_device_s": {
                "first": float(offset[0]),
                "last": float(offset[-1]),
                "least": float(offset.min()),
                "greatest": float(offset.max()),
            },
            "over_time": [[int(host[i]), float(offset[i])] for i in picked.tolist()],
            "device_seconds_per_host_second": ratio,
            "verdict": verdict(offset, ratio),
        }


def verdict(offset_s: Floats, ratio: float | None) -> str:
    """Say what the readings mean.

    ratio: seconds of the autopilot's clock per second of the host's.
    """
    span = f"host minus autopilot clock from {offset_s.min():+.2f} s to {offset_s.max():+.2f} s"
    if ratio is None or abs(ratio - 1) <= _RATE_LIMIT:
        return span
    factor, word = (ratio, "slower") if ratio > 1 else (1 / ratio, "faster")
    return (
        f"the host clock ran {factor:.1f} times {word} than the autopilot's: times of receipt are not those "
        f"of the flight, use the autopilot's times; {span}"
    )


def _ratio(host: Integers, boot: Integers) -> float | None:
    """Return the rate of the autopilot's clock over the longest stretch without a restart."""
    restarts = np.flatnonzero(np.diff(boot) < 0) + 1
    edges = np.concatenate([[0], restarts, [len(boot)]])
    longest = int(np.argmax(np.diff(edges)))
    first, last = int(edges[longest]), int(edges[longest + 1]) - 1
    elapsed = float(host[last] - host[first]) / 1e9
    return float(boot[last] - boot[first]) / 1e9 / elapsed if elapsed > _LEAST_SPAN_S else None
