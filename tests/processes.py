"""What processes at work take."""

from __future__ import annotations

from pathlib import Path


def memory_mib(process: int, kind: str) -> list[float]:
    """Memory of a process and of those that it has begun, MiB.

    kind: as Linux names it, VmRSS for what is resident, VmHWM for the peak of that. What a process that has
        ended tells (`wait4`) is no less than what its parent took when it began.
    """
    found = []
    for status in Path("/proc").glob("[0-9]*/status"):
        try:
            told = dict(line.split(":", 1) for line in status.read_text(encoding="ascii").splitlines())
        except (OSError, ValueError):
            # It has ended meanwhile.
            continue
        if process in (int(told["Pid"]), int(told["PPid"])) and kind in told:
            found.append(float(told[kind].split()[0]) / 1024)
    return found
