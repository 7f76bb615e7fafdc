"""How far an adoption is: the step of how many, and an estimate of the time that is left from the start."""

import time
from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, contextmanager
from pathlib import Path

from photocal.base.progress import Progress

Step = Callable[[str], AbstractContextManager[None]]
# Share of the whole time that each step takes, of 581 images of one camera and of 1420 of five heads.
SHARES = {
    "reading the project": 0.10, "gross errors of the rays": 0.15, "weights of the image coordinates": 0.20,
    "adjustment": 0.15, "analysis": 0.30, "sigmas of control and positions": 0.05, "certificate": 0.05,
}  # fmt: skip
# A project before it is read: seconds that its start takes, and each MB of its largest text.
START_S, PER_MB_S = 8.0, 4.0


def steps(progress: Progress, path: Path) -> Step:
    """Make what tells each step: the first estimate goes by the size of the files, others by the time so far.

    path: folder or file of the project.
    """
    began, done = time.monotonic(), 0.0
    names = list(SHARES)
    largest = max((file.stat().st_size for file in _files(path)), default=0)
    whole_s = START_S + PER_MB_S * largest / 1e6

    @contextmanager
    def step(name: str) -> Iterator[None]:
        """Tell a step, with what is left of the whole."""
        nonlocal done
        passed = time.monotonic() - began
        left = whole_s if done == 0.0 else passed * (1 - done) / done
        at = f"{names.index(name) + 1} of {len(names)}"
        with progress(f"{at}, {name} (about {_rounded(left)} left in all)", None):
            yield
        done = sum(SHARES[each] for each in names[: names.index(name) + 1])

    return step


def _files(path: Path) -> list[Path]:
    if path.is_file():
        return [path]
    return [
        file for file in path.rglob("*") if file.suffix.lower() in (".txt", ".json", ".csv", ".bin", ".xml")
    ]


def _rounded(seconds: float) -> str:
    return f"{seconds / 60:.0f} min" if seconds > 90 else f"{max(seconds, 1):.0f} s"
