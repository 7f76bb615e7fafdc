"""How far a whole run is: one share and one remaining time over all of its stages."""

import math
import time
from collections.abc import Callable, Container, Iterable, Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from types import MappingProxyType

from photocal.base.files import output_file, write_json
from photocal.base.progress import Progress, Standing
from photocal.measurement.image_pairs import ALL_UP_TO, MOST_PARTNERS, NEAREST

# What stands before the stages where the program has just been installed.
COMPILING = "kernels"
# Seconds that a stage takes at first, for each picture, each megapixel, each pair of pictures that may show
# the same, and each thousand rays, on two cores.
_USUAL = {
    COMPILING: (80.0, 0.0, 0.0, 0.0, 0.0),
    "ppk": (5.0, 0.0, 0.0, 0.0, 0.0),
    "exposures": (1.0, 0.01, 0.0, 0.0, 0.0),
    "block": (0.05, 0.01, 0.0, 0.0, 0.003),
    "calibration": (0.7, 0.0, 0.0, 0.0, 0.016),
    "flown": (0.3, 0.01, 0.0, 0.0, 0.0),
    "georeferencing": (2.0, 0.0, 0.0, 0.0, 0.035),
    "analysis": (0.3, 0.0, 0.0, 0.0, 0.022),
    "certificate": (0.9, 0.0, 0.0, 0.0, 0.002),
}
_OTHER = (5.0, 0.0, 0.0, 0.0, 0.0)
# Pieces that not all projects have. That targets without a code take as long as those with one is assumed.
FEATURES, CODED = "detecting features", "detecting features and coded targets"
PLAIN, CONTROL = "looking for targets", "adjusting with control"
# The same for the pieces of work of a stage in their order.
_PIECES = {
    "measurements": {
        FEATURES: (2.0, 0.35, 0.005, 0.0, 0.0),
        CODED: (2.0, 0.4, 0.016, 0.0, 0.0),
        "matching pairs of images": (0.5, 0.0, 0.0, 0.04, 0.0),
        PLAIN: (0.0, 0.06, 0.018, 0.0, 0.0),
        "orienting the pictures": (1.5, 0.13, 0.0, 0.0, 0.0),
        "matching tie points precisely": (0.3, 0.1, 0.016, 0.0, 0.0),
        "adjusting the tie points": (0.1, 0.08, 0.0, 0.0, 0.0),
        CONTROL: (0.1, 0.05, 0.0, 0.0, 0.0),
        "adjusting the cameras": (1.5, 0.08, 0.0, 0.0, 0.0),
    }
}
# Stages that adjust again what a piece of work has adjusted, and how long they take beside it: a block whose
# images move while they are read, or whose valley is bent, takes ten times as long as others.
_AGAIN = {"adjusting the cameras": {"calibration": 0.2, "analysis": 0.8}}
# Of a ray in the files of a block.
_OCTETS = {"observations.csv": 45.0, "observations.parquet": 20.0}
# Work that takes longer than expected has at least this share of what it took before it.
OVERDUE = 0.1
# Pieces whose amount nobody knows take half to twice what is expected: of those that last long, half last so
# much longer than they have.
UNCOUNTED = 0.4
# Before a block tells.
RAYS_OF_A_PICTURE = 200.0


# How much a run has before it: pictures, the megapixels of all of them, pairs, thousands of rays.
Workload = tuple[float, float, float, float]


def about_rays(block: Path) -> float:
    """How many rays a block folder has, by the size of its file; 0 without one."""
    files = ((block / name, octets) for name, octets in _OCTETS.items())
    return sum(path.stat().st_size / octets for path, octets in files if path.is_file())


# Seconds of each piece of work of a stage, by their names.
Pieces = Mapping[str, Mapping[str, float]]


def _seconds(costs: tuple[float, ...], size: Workload) -> float:
    first, *each = costs
    return first + sum(seconds * amount for seconds, amount in zip(each, size, strict=True))


def workload(pictures: int, megapixels: float, rays: float) -> Workload:
    """How much work so many pictures of this size are, and so many rays."""
    neighbours = MOST_PARTNERS if pictures <= ALL_UP_TO else NEAREST
    return pictures, pictures * megapixels, pictures * min(pictures - 1, neighbours) / 2, rays / 1000.0


def usual_pieces(size: Workload, absent: Container[str] = ()) -> Pieces:
    """Seconds that are usual for the pieces of stages that have several, without those that are absent."""
    return {
        stage: {name: _seconds(costs, size) for name, costs in pieces.items() if name not in absent}
        for stage, pieces in _PIECES.items()
    }


def expected(
    last: Mapping[str, float], stages: Iterable[str], size: Workload, pieces: Pieces
) -> dict[str, float]:
    """Seconds that each stage will take: as last time, else what is usual for so much work."""

    def usual(name: str) -> float:
        """Seconds of a stage that was never made."""
        return sum(pieces[name].values()) if name in pieces else _seconds(_USUAL.get(name, _OTHER), size)

    return {name: last.get(name) or usual(name) for name in stages}


def _scaled(shares: Mapping[str, float], seconds: float) -> dict[str, float]:
    return {name: share * seconds for name, share in shares.items()}


class Course:
    """What a run has done, is doing and has before it; it is asked from beside the work."""

    def __init__(
        self,
        expected_s: Mapping[str, float],
        progress: Progress,
        clock: Callable[[], float] = time.monotonic,
        seen_s: float = 0.0,
        pieces: Pieces = MappingProxyType({}),
        counted: Mapping[str, float] = MappingProxyType({}),
    ) -> None:
        """Begin; `seen_s` of what is expected is what a run before took, by `pieces` a stage is divided.

        counted: of pieces of work that may be done in part before they begin, how much the whole is.
        """
        self._ahead, self._progress, self._clock = dict(expected_s), progress, clock
        self._began = self._stage_began = self._piece_began = clock()
        self._pieces, self._counted = pieces, counted
        self._stage, self._title, self._expected = "", "", 0.0
        # Of the stage at work: what is expected of its pieces that have not ended, when the last one ended,
        # and what those that have ended took and were expected to take.
        self._open, self._piece_ended = dict[str, float](), self._began
        self._pieces_took, self._pieces_meant = 0.0, 0.0
        self._done, self._total = 0.0, float("nan")
        self._share = 0.0
        # Seconds that stages take for what a piece of this run has adjusted.
        self._again = dict[str, float]()
        # What is seen of the pace is weighed against so many seconds as expected, and what a run before took.
        as_expected_s = 0.5
        self._took = self._meant = as_expected_s + seen_s
        # What is usual for a stage is wrong as often as the speed of the machine: of a stage that takes four
        # times as long, half is applied to those after it. What a run before took is another matter.
        self._trust = 1.0 if seen_s else 0.5

    def begin(self, stage: str, expected_s: float = 0.0) -> None:
        """Begin with a stage; `expected_s` is of one that was not expected."""
        self._stage, self._title, self._stage_began = stage, "", self._clock()
        more = self._again.get(stage, 0.0) if self._ahead.get(stage) else 0.0
        self._expected = self._ahead.pop(stage, expected_s) + more
        self._done, self._total, self._piece_began = 0.0, math.nan, self._stage_began
        usual = self._pieces.get(stage, {})
        whole = sum(usual.values())
        self._open = {name: self._expected * seconds / whole for name, seconds in usual.items()}
        self._piece_ended, self._pieces_took, self._pieces_meant = self._stage_began, 0.0, 0.0

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
        if total and title in self._counted and title in self._open:
            self._open[title] *= min(1.0, total / self._counted[title])
        with self._progress(title, total) as tell:

            def advance(amount: float) -> None:
                """Count what was done."""
                tell(amount)
                self._done += amount

            yield advance
        if self._trust < 1.0 and title in _AGAIN:
            self._again = _scaled(_AGAIN[title], self._clock() - self._piece_began)
        meant = self._open.pop(title, None)
        if meant is not None:
            now = self._clock()
            took, self._piece_ended = now - self._piece_ended, now
            # What was kept from an earlier run tells nothing of the pace.
            least = 0.25
            if took >= least * meant:
                self._pieces_took += took
                self._pieces_meant += meant
            self._done, self._total = 0.0, math.nan

    def _pace(self, more_s: float, more_meant_s: float) -> float:
        """Tell how many times as long as expected work takes here, with a stage that has not ended."""
        return math.pow((self._took + more_s) / (self._meant + more_meant_s), self._trust)

    def _least_left(self, since: float) -> float:
        """Time left of a piece that has worked so long without telling of any progress."""
        # Of few steps each takes about as long as the first, which has not ended.
        few = 10.0
        return since * max(UNCOUNTED, self._total - 1.0 if self._total <= few else 0.0)

    def _left_of_pieces(self, now: float, share: float, piece_left: float | None) -> float:
        """Time left of a stage whose pieces are known: of the piece at work, then of those after it."""
        took, meant = self._pieces_took, self._pieces_meant
        # What is seen of the pace is weighed against this share of the stage as expected.
        prior = 0.1 * self._pace(0.0, 0.0)
        since = now - self._piece_ended
        at_work = self._open.get(self._title, 0.0)
        if at_work and piece_left is not None:
            took, meant = took + share * (since + piece_left), meant + share * at_work
        pace = (took + prior * self._expected) / (meant + 0.1 * self._expected)
        others = pace * (sum(self._open.values()) - at_work)
        if not at_work:
            return max(others - since, piece_left or 0.0, OVERDUE * since)
        if piece_left is None:
            return max(pace * at_work - since, self._least_left(since)) + others
        # Until a fifth of the piece is done, what was expected of it counts as well.
        own = min(share / 0.2, 1.0)
        return own * piece_left + (1.0 - own) * max(pace * at_work - since, piece_left) + others

    def standing(self) -> Standing:
        """Tell how far it is now."""
        now = self._clock()
        elapsed, piece_s, stage_s = now - self._began, now - self._piece_began, now - self._stage_began
        share = min(self._done / self._total, 1.0) if self._done > 0.0 else 0.0
        known = math.isfinite(share) and not math.isnan(self._total)
        piece_left = piece_s * (1.0 / share - 1.0) if known and share > 0.0 else None
        pace = self._pace(0.0, 0.0)
        if self._open and self._expected:
            left = self._left_of_pieces(now, share, piece_left)
        elif self._expected:
            # A stage that takes longer than expected has at least this share of what it took before it.
            left = max(pace * self._expected - stage_s, piece_left or 0.0, OVERDUE * stage_s)
        else:
            left = piece_left or 0.0
        if self._expected:
            # A stage that takes longer than expected tells of the pace before it ends.
            told = self._pieces_meant or (piece_left is not None and self._title in self._open)
            pace = max(pace, self._pace(stage_s + (left if told else 0.0), self._expected))
        again = self._again
        if self._trust < 1.0 and self._title in _AGAIN and self._title in self._open:
            of_piece = self._least_left(piece_s) if piece_left is None else piece_left
            again = _scaled(_AGAIN[self._title], piece_s + of_piece)
        left += pace * sum(self._ahead.values())
        left += sum(seconds for stage, seconds in again.items() if self._ahead.get(stage))
        # What turns out to be longer stops the bar and does not turn it back.
        self._share = max(self._share, elapsed / (elapsed + left) if elapsed + left > 0.0 else 0.0)
        piece_share = share if known else None
        return Standing(
            self._stage, self._title, piece_share, piece_left, piece_s, self._share, left, elapsed
        )


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
