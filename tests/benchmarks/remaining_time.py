"""Whether a run tells how long it will take: told over real from a third of the way on, the longest silence.

Each project runs as a person runs it, `photocal run PROJECT.toml --json`, with a cache of its own, and its
lines are read as they come. A row of the table for each; `--pieces`: how long each piece of work took, too.

Usage: python -m tests.benchmarks.remaining_time [--pieces] PROJECT.toml ...
"""

from __future__ import annotations

import json
import math
import os
import subprocess
import sys
import tempfile
import time
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path

from tests.processes import memory_mib

PARTS = (1 / 3, 1 / 2, 2 / 3)
# From a third of the way on the remaining time must be right; a last second cannot be.
FROM, SHORT_S = 1 / 3, 2.0
HEAD = (
    "| run | s | at 1/3 | at 1/2 | at 2/3 | least, most from 1/3 on | share of the time within 30 % "
    "| longest silence, s | peak, MiB |"
)


@dataclass(frozen=True)
class Told:
    """What a line of progress said, and when it came, s after the start."""

    at_s: float
    left_s: float
    stage: str
    title: str


def told(project: Path) -> tuple[list[Told], float, float]:
    """Run a project; give what was told, seconds of the whole run, and its peak, MiB."""
    lines, peak = [], 0.0
    with tempfile.TemporaryDirectory() as cache:
        given = {name: value for name, value in os.environ.items() if name != "PYTHONDONTWRITEBYTECODE"}
        given["XDG_CACHE_HOME"] = cache
        command = [sys.executable, "-m", "photocal", "run", str(project), "--json"]
        began = time.monotonic()
        process = subprocess.Popen(
            command, env=given, stdout=subprocess.DEVNULL, stderr=subprocess.PIPE, text=True
        )
        assert process.stderr is not None
        with process.stderr as said:
            for line in said:
                at_s, peak = time.monotonic() - began, max([peak, *memory_mib(process.pid, "VmHWM")])
                now = json.loads(line).get("progress") if line.startswith("{") else None
                if now:
                    # While it starts it knows of no time.
                    left_s = math.nan if now["left_s"] is None else now["left_s"]
                    lines.append(Told(at_s, left_s, now["stage"], now["title"]))
        if process.wait():
            raise SystemExit(f"{project}: the run ended with {process.returncode}")
        whole = time.monotonic() - began
    return lines, whole, peak


def row(name: str, lines: list[Told], whole: float, peak: float) -> str:
    """Give the row of a run."""
    late = [now for now in lines if FROM * whole <= now.at_s <= whole - SHORT_S]
    ratios = [now.left_s / (whole - now.at_s) for now in late]
    within = sum(0.7 <= ratio <= 1.3 for ratio in ratios) / max(len(ratios), 1)
    at = [min(lines, key=lambda now: abs(now.at_s - part * whole)) for part in PARTS]
    # From the start on; the last one is until the end.
    said = [Told(0.0, 0.0, "", "start"), *lines, Told(whole, 0.0, "", "")]
    silence, where = max((b.at_s - a.at_s, a.title or a.stage) for a, b in pairwise(said))
    cells = [
        name,
        f"{whole:.0f}",
        *(f"{now.left_s / (whole - now.at_s):.2f}" for now in at),
        f"{min(ratios):.2f}, {max(ratios):.2f}" if ratios else "",
        f"{within:.2f}",
        f"{silence:.1f} ({where})",
        f"{peak:.0f}",
    ]
    return f"| {' | '.join(cells)} |"


def pieces(lines: list[Told], whole: float) -> str:
    """Write how long each piece of work took, to the second between two lines."""
    begins: dict[str, float] = {}
    for now in lines:
        begins.setdefault(f"{now.stage}: {now.title}", now.at_s)
    ends = [*list(begins.values())[1:], whole]
    return "\n".join(
        f"    {name:50} {end - begin:6.1f}" for (name, begin), end in zip(begins.items(), ends, strict=True)
    )


def main() -> None:
    """Measure the runs of the projects that the command line names."""
    given = sys.argv[1:]
    print(HEAD, flush=True)
    for project in (Path(text) for text in given if text != "--pieces"):
        lines, whole, peak = told(project)
        print(row(project.resolve().parent.name, lines, whole, peak), flush=True)
        if "--pieces" in given:
            print(pieces(lines, whole), flush=True)


if __name__ == "__main__":
    main()
