"""How far a whole run is: one share and one remaining time over all of its stages."""

import math
import time
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager, suppress
from pathlib import Path
from threading import Event, Thread

from photocal.base.errors import OutputError
from photocal.base.files import output_file, write_json
from photocal.base.progress import Progress, Standing

# Seconds that a stage takes at first, and for each picture, on two cores; what it took last time tells more.
_USUAL = {
    "ppk": (10.0, 0.0),
    "exposures": (1.0, 0.01),
    "measurements": (5.0, 2.0),
    "block": (0.5, 0.01),
    "calibration": (2.0, 0.03),
    "flown": (1.0, 0.01),
    "georeferencing": (2.0, 0.05),
    "analysis": (2.0, 0.05),
    "certificate": (6.0, 0.02),
}
_OTHER = (5.0, 0.0)


def expected(last: Mapping[str, float], stages: tuple[str, ...], pictures: int) -> dict[str, float]:
    """Seconds that each stage will take: as last time, else what is usual for so many pictures."""

    def usual(name: str) -> float:
        """Seconds of a stage that was never made."""
        first, each = _USUAL.get(name, _OTHER)
        return first + each * pictures

    return {name: last.get(name) or usual(name) for name in stages}


class Course:
    """What a run has done, is doing and has before it; it is asked from beside the work."""

    def __init__(
        self,
        expected_s: Mapping[str, float],
        progress: Progress,
        clock: Callable[[], float] = time.monotonic,
    ) -> None:
        self._ahead, self._progress, self._clock = dict(expected_s), progress, clock
        self._began = self._stage_began = self._piece_began = clock()
        self._stage, self._title, self._expected = "", "", 0.0
        self._done, self._total = 0.0, float("nan")
        self._share = 0.0
        # So many seconds of work as expected are set beside what was seen of this machine's pace.
        as_expected_s = 5.0
        self._took = self._meant = as_expected_s

    def begin(self, stage: str) -> None:
        """Begin with a stage."""
        self._stage, self._title, self._stage_began = stage, "", self._clock()
        self._expected = self._ahead.pop(stage, 0.0)
        self._done, self._total, self._piece_began = 0.0, math.nan, self._stage_began

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

    def standing(self) -> Standing:
        """Tell how far it is now."""
        now = self._clock()
        pace, elapsed, piece_s = self._took / self._meant, now - self._began, now - self._piece_began
        share = min(self._done / self._total, 1.0) if self._done > 0.0 else 0.0
        known = math.isfinite(share) and not math.isnan(self._total)
        piece_left = piece_s * (1.0 / share - 1.0) if known and share > 0.0 else None
        stage_s = now - self._stage_began
        left = max(pace * self._expected - stage_s, piece_left or 0.0)
        if self._expected:
            # A stage that takes longer than expected has at least this share of what it took before it.
            overdue = 0.1
            left = max(left, overdue * stage_s)
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
