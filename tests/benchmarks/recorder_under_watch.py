"""A recorder that measures itself: delays of frames to the writer and to the disk, memory, processor time.

Run as a process: `python -m tests.benchmarks.recorder_under_watch CONFIG.toml`. It ends when its input does
and prints its figures as JSON.
"""

from __future__ import annotations

import io
import json
import os
import resource
import sys
import threading
import time
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from acquire.log.chunk import Channel, Payloads
from acquire.recording.configuration import read_configuration
from acquire.recording.files import LogFiles, Notice
from acquire.recording.log_file import WholeWrites
from acquire.recording.recorder import Host, record

# Delays are counted by the tenth of a millisecond: so the measuring needs no memory.
_STEP_NS, _STEPS = 100_000, 100_000


class Watch:
    """Delays of frames from arrival to the writer and to the disk."""

    def __init__(self) -> None:
        self.counts = np.zeros(_STEPS, np.int64)
        self.worst_disk_ns = 0
        # The oldest frame that is not in the file, and the oldest that the disk is busy with; 0: none.
        self._oldest_ns = 0
        self._busy_with_ns = 0

    def written(self, log_ns: NDArray[np.int64]) -> None:
        """Take note of frames that the writer was given."""
        delay = np.clip((time.time_ns() - log_ns) // _STEP_NS, 0, _STEPS - 1)
        self.counts += np.bincount(delay, minlength=_STEPS)
        self._oldest_ns = self._oldest_ns or int(log_ns.min())

    def in_file(self) -> None:
        """Take note that everything goes to the disk now, unless that is busy with the last part."""
        if not self._busy_with_ns:
            self._busy_with_ns, self._oldest_ns = self._oldest_ns, 0

    def safe(self) -> None:
        """Take note that the disk has what it was busy with."""
        if self._busy_with_ns:
            self.worst_disk_ns = max(self.worst_disk_ns, time.time_ns() - self._busy_with_ns)
        self._busy_with_ns = 0

    def quantile_ms(self, share: float) -> float:
        """Return the delay that a share of all frames did not exceed."""
        total = np.cumsum(self.counts)
        return float(np.searchsorted(total, share * total[-1]) + 1) * _STEP_NS / 1e6


class WatchedFiles(LogFiles):
    """Log files that tell a watch what they take and when it is safe."""

    watch: Watch

    def messages(
        self,
        channel: Channel,
        payloads: Payloads,
        log_ns: NDArray[np.int64],
        publish_ns: NDArray[np.int64],
        sequence: NDArray[np.int64],
    ) -> None:
        """Write messages."""
        super().messages(channel, payloads, log_ns, publish_ns, sequence)
        if channel.topic.endswith("/raw") and len(log_ns):
            self.watch.written(log_ns)

    def make_safe(self) -> list[Notice]:
        """Make everything safe."""
        self.watch.in_file()
        return super().make_safe()


class WatchedWrites(WholeWrites):
    """A file that tells a watch when the disk has everything."""

    watch: Watch

    def make_safe(self) -> None:
        """Wait for the disk."""
        super().make_safe()
        self.watch.safe()


def _new_file(path: Path) -> WholeWrites:
    return WatchedWrites(io.FileIO(path, "xb"))


def _resident_mb() -> float:
    pages = int(Path("/proc/self/statm").read_text(encoding="ascii").split()[1])
    return pages * resource.getpagesize() / 1e6


def main() -> None:
    """Record until the standard input ends, then print the figures."""
    from acquire.recording import recorder

    WatchedFiles.watch = WatchedWrites.watch = watch = Watch()
    vars(recorder)["LogFiles"] = WatchedFiles
    stop = threading.Event()
    memory: list[float] = []
    begun, began_cpu = time.monotonic(), time.process_time()

    def look() -> None:
        while not stop.wait(1.0):
            memory.append(_resident_mb())

    def wait() -> None:
        sys.stdin.read()
        stop.set()

    for work in (look, wait):
        threading.Thread(target=work, daemon=True).start()
    path = Path(sys.argv[1])
    host = Host(make=_new_file)
    done = record(
        read_configuration(path), path.parent, stop, lambda text: print(text, file=sys.stderr), host
    )
    settled = memory[len(memory) // 5 :] or [_resident_mb()]
    sys.stdout.write(
        json.dumps(
            {
                "frames": {name: tally.frames for name, tally in done.tallies.items()},
                "damage": sum(tally.damage_bytes for tally in done.tallies.values()),
                "alarms": [str(alarm) for alarm in done.alarms if alarm.kind != "note"],
                "p50_ms": watch.quantile_ms(0.5),
                "p99_ms": watch.quantile_ms(0.99),
                "worst_disk_s": watch.worst_disk_ns / 1e9,
                "memory_mb": [settled[0], max(settled), settled[-1]],
                "core_share": (time.process_time() - began_cpu) / (time.monotonic() - begun),
                "load": os.getloadavg()[0],
            }
        )
    )


if __name__ == "__main__":
    main()
