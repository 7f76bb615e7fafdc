"""From devices to the recording: latency, lost frames, damaged bits."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from drivers.arrays import Floats


@dataclass(frozen=True)
class Wire:
    """What arrived over one link.

    arrival_s (n,): when each frame had arrived, s since the start; never decreasing.
    frames (n,): as they arrived.
    sent, lost, damaged: frames that were sent, that did not arrive, that arrived with a wrong bit.
    """

    arrival_s: Floats
    frames: tuple[bytes, ...]
    sent: int
    lost: int
    damaged: int

    @property
    def data(self) -> bytes:
        """All bytes one after another."""
        return b"".join(self.frames)


def carry(
    time_s: Floats,
    frames: list[bytes],
    random: np.random.Generator,
    *,
    latency_s: float = 0.0,
    loss: float = 0.0,
    damage: float = 0.0,
    gap_s: tuple[float, float] = (np.inf, np.inf),
) -> Wire:
    """Carry frames from a device to the recording.

    time_s (n,): when they are sent.
    """
    count = len(frames)
    late = latency_s * (0.6 + 0.4 * random.exponential(size=count))
    arrival = np.maximum.accumulate(np.asarray(time_s) + late)
    kept = (random.random(count) >= loss) & ~((time_s >= gap_s[0]) & (time_s < gap_s[1]))
    hurt = kept & (random.random(count) < damage)
    arrived = list(frames)
    for number in np.flatnonzero(hurt).tolist():
        arrived[number] = _turned(frames[number], random)
    rows = np.flatnonzero(kept)
    return Wire(
        arrival[rows],
        tuple(arrived[row] for row in rows.tolist()),
        count,
        count - len(rows),
        int(hurt.sum()),
    )


def _turned(frame: bytes, random: np.random.Generator) -> bytes:
    bit = int(random.integers(8 * len(frame)))
    octets = bytearray(frame)
    octets[bit // 8] ^= 1 << bit % 8
    return bytes(octets)


def telemetry_log(wire: Wire, utc_start_us: int) -> bytes:
    """Give the bytes of a `.tlog`: each frame after the UTC of its arrival, microseconds, big-endian."""
    stamps = utc_start_us + np.rint(wire.arrival_s * 1e6).astype(np.int64)
    pairs = zip(stamps.tolist(), wire.frames, strict=True)
    return b"".join(stamp.to_bytes(8, "big") + frame for stamp, frame in pairs)
