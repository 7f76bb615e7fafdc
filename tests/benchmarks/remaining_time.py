"""Whether the remaining time of a bar was right: told over real, at a third, a half and two thirds of a run.

Usage: python -m tests.benchmarks.remaining_time PROJECT.toml: brings the project up to date and prints a row.
"""

from __future__ import annotations

import datetime as dt
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

from photocal.base.progress import Standing, quiet
from photocal.block.project import read_project
from photocal.run.campaign import run_project

PARTS = (1 / 3, 1 / 2, 2 / 3)


def told(project: Path) -> list[Standing]:
    """Run a project and give what its bar was told, the last when it had ended."""
    seen: list[Standing] = []

    @contextmanager
    def bar() -> Iterator[Callable[[Standing], None]]:
        yield seen.append

    run_project(read_project(project), dt.datetime.now().astimezone().date(), quiet, bar=bar)
    return seen


def ratios(seen: list[Standing]) -> list[float]:
    """Remaining time as it was told over what it turned out to be, at parts of the way."""
    whole = seen[-1].elapsed_s
    at = [min(seen, key=lambda now: abs(now.elapsed_s - part * whole)) for part in PARTS]
    return [now.left_s / (whole - now.elapsed_s) for now in at]


def main() -> None:
    """Measure the run that the command line names."""
    seen = told(Path(sys.argv[1]))
    cells = (f"{ratio:.2f}" for ratio in ratios(seen))
    print(f"| {seen[-1].elapsed_s:.1f} | {' | '.join(cells)} |", flush=True)


if __name__ == "__main__":
    main()
