"""How far a whole run is: one share and one remaining time over all of its stages."""

import math
import time
from collections.abc import Callable, Iterable, Iterator, Mapping
from contextlib import contextmanager, suppress
from pathlib import Path
from threading import Event, Thread

from photocal.base.errors import OutputError
from photocal.base.files import output_file, write_json
from photocal.base.progress import Progress, Standing

# What stands before the stages where the program has just been installed.
COMPILING = "compiling"
# Seconds that a stage takes at first, for each picture, each megapixel and each thousand rays, on two cores.
_USUAL = {
    COMPILING: (50.0, 0.0, 0.0, 0.0),
    "ppk": (10.0, 0.0, 0.0, 0.0),
    "exposures": (1.0, 0.01, 0.0, 0.0),
    "measurements": (5.0, 0.1, 0.13, 0.0),
    "block": (0.05, 0.01, 0.0, 0.003),
    "calibration": (0.7, 0.0, 0.0, 0.016),
    "flown": (0.3, 0.01, 0.0, 0.0),
    "georeferencing": (2.0, 0.0, 0.0, 0.035),
    "analysis": (0.3, 0.0, 0.0, 0.022),
    "certificate": (0.9, 0.0, 0.0, 0.002),
}
_OTHER = (5.0, 0.0, 0.0, 0.0)
# Pieces of work of a stage in their order, and the share of its time that has passed when each ends.
_PIECES = {
    "measurements": {
        "detecting features": 0.2,
        "matching pairs of images": 0.45,
        "matching tie points precisely": 0.95,
    }
}
# Of a ray in the files of a block.
_OCTETS = {"observations.csv": 45.0, "observations.parquet": 20.0}
# Before a block tells.
RAYS_OF_A_PICTURE = 200.0


# How much a run has before it: pictures, the megapixels of all of them, thousands of rays.
Workload = tuple[float, float, float]


def about_rays(block: Path) -> float:
    """How many rays a block folder has, by the size of its file; 0 without one."""
    files = ((block / name, octets) for name, octets in _OCTETS.items())
    return sum(path.stat().st_size / octets for path, octets in files if path.is_file())


def expected(last: Mapping[str, float], stages: Iterable[str], size: Workload) -> dict[str, float]:
    """Seconds that each stage will take: as last time, else what is usual for so much work."""

    def usual(name: str) -> float:
        """Seconds of a stage that was never made."""
        first, *each = _USUAL.get(name, _OTHER)
        return first + sum(seconds * amount for seconds, amount in zip(each, size, strict=True))

    return {name: last.get(name) or usual(name) for name in stages}


class Course:
    """What a run has done, is doing and has before it; it is asked from beside the work."""

    def __init__(
        self,
        expected_s: Mapping[str, float],
        progress: Progress,
        clock: Callable[[], float] = time.monotonic,
        seen_s: float = 0.0,
    ) -> None:
        """Begin; `seen_s` of what is expected is what a run before took."""
        self._ahead, self._progress, self._clock = dict(expected_s), progress, clock
        self._began = self._stage_began = self._piece_began = clock()
        self._stage, self._title, self._expected, self._reached = "", "", 0.0, 0.0
        self._done, self._total = 0.0, float("nan")
        self._share = 0.0
        # What is seen of the pace is weighed against so many seconds as expected, and what a run before took.
        as_expected_s = 0.5
        self._took = self._meant = as_expected_s + seen_s
        # What is usual for a stage is wrong as often as the speed of the machine: of a stage that takes four
        # times as long, half is held against those after it. What a run before took is another matter.
        self._trust = 1.0 if seen_s else 0.5

    def begin(self, stage: str, expected_s: float = 0.0) -> None:
        """Begin with a stage; `expected_s` is of one that was not expected."""
        self._stage, self._title, self._stage_began = stage, "", self._clock()
        self._expected = self._ahead.pop(stage, expected_s)
        self._done, self._total, self._piece_began = 0.0, math.nan, self._stage_began
        self._reached = 0.0

    def revise(self, expected_s: Mapping[str, float]) -> None:
        """Expect otherwise of what has not begun: the run itself has told how much work there is."""
        self._ahead |= {name: seconds for name, seconds in expected_s.items() if name in self._ahead}

    def end(self, *, kept: bool) -> None:
        """End with a stage; one that was kept tells nothing of the pace."""
        if not kept:
            self._took += self._clock() - self._stage_began
            self._meant += self._expected
        self._expected = 0.0

    @contextmanager
    def progress(self, title: str, total: float | None) -> Iterator[Callable[[float], None]]:
        """Show the progress of a piece of work of the stage."""
        self._title, self._piece_began = title, self._clock()
        self._done, self._total = 0.0, total or math.nan

        with self._progress(title, total) as tell:

            def advance(amount: float) -> None:
                """Count what was done."""
                tell(amount)
                self._done += amount

            yield advance
        self._reached = _PIECES.get(self._stage, {}).get(title, self._reached)

    def _pace(self, more_s: float, more_meant_s: float) -> float:
        """Tell how many times as long as expected work takes here, with a stage that has not ended."""
        return math.pow((self._took + more_s) / (self._meant + more_meant_s), self._trust)

    def standing(self) -> Standing:
        """Tell how far it is now."""
        now = self._clock()
        elapsed, piece_s, stage_s = now - self._began, now - self._piece_began, now - self._stage_began
        share = min(self._done / self._total, 1.0) if self._done > 0.0 else 0.0
        known = math.isfinite(share) and not math.isnan(self._total)
        piece_left = piece_s * (1.0 / share - 1.0) if known and share > 0.0 else None
        pace = self._pace(0.0, 0.0)
        left = pace * self._expected
        # Further pieces, such as coded targets, stand between those that every flight has.
        end = (
            self._reached
            if piece_left is None
            else _PIECES.get(self._stage, {}).get(self._title, self._reached)
        )
        if end:
            # The piece at work ends by its own pace, those after it take their usual share. Until a fifth of
            # the stage is done, what was expected counts as well.
            then_s = stage_s + (piece_left or 0.0)
            own = min((self._reached + share * (end - self._reached)) / 0.2, 1.0)
            left = own * (then_s / end - stage_s) + (1.0 - own) * max(left - stage_s, 0.0)
        elif self._expected:
            # A stage that takes longer than expected has at least this share of what it took before it.
            overdue = 0.1
            left = max(left - stage_s, piece_left or 0.0, overdue * stage_s)
        else:
            left = piece_left or 0.0
        if self._expected:
            # A stage that takes longer than expected tells of the pace before it ends.
            pace = max(pace, self._pace(stage_s + (left if end else 0.0), self._expected))
        left += pace * sum(self._ahead.values())
        # What turns out to be longer stops the bar and does not turn it back.
        self._share = max(self._share, elapsed / (elapsed + left) if elapsed + left > 0.0 else 0.0)
        piece_share = share if known else None
        return Standing(
            self._stage, self._title, piece_share, piece_left, piece_s, self._share, left, elapsed
        )


@contextmanager
def followed(course: Course, *listeners: Callable[[Standing], None]) -> Iterator[None]:
    """Tell listeners about once a second how far a run is, whatever it works on meanwhile."""
    ended = Event()

    def tell() -> None:
        """Tell until the run has ended."""
        told_every_s = 1.0
        while True:
            for listener in listeners:
                # No work ends because it cannot be told how far it is.
                with suppress(OutputError, OSError):
                    listener(course.standing())
            if ended.wait(told_every_s):
                return

    beside = Thread(target=tell, daemon=True)
    beside.start()
    try:
        yield
    finally:
        ended.set()
        beside.join()


def into(file: Path) -> Callable[[Standing], None]:
    """Give what writes it as JSON: of the piece of work, and of the whole run."""

    def write(now: Standing) -> None:
        """Write it once."""
        content = {
            "title": now.title,
            "share": now.piece_share,
            "left_s": now.piece_left_s,
            "elapsed_s": now.piece_s,
            "stage": now.stage,
            "run": {"share": now.share, "left_s": now.left_s, "elapsed_s": now.elapsed_s},
        }
        with output_file(file) as aside:
            write_json(aside, content, None)

    return write
