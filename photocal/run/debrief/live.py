"""The debrief in flight: pictures are judged as they come into a folder from a camera or a picture link."""

import os
import threading
import time
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path

from photocal.adjustment.envelope import on_one_thread
from photocal.base.errors import PhotocalError
from photocal.base.files import output_file, write_json
from photocal.base.operating_system import cache_folder
from photocal.base.progress import quiet
from photocal.block.project import Project
from photocal.findings.finding import Finding
from photocal.geometry.camera import Camera
from photocal.measurement.image_file import list_images
from photocal.measurement.image_metadata import image_of
from photocal.measurement.match_images import MatchingPlan
from photocal.navigation.exposure_run import ExposureRun, exposures_of_pictures
from photocal.navigation.rig import CameraOnBody
from photocal.run.debrief import verdict
from photocal.run.debrief.pictures import QUICK, PictureQuality, Quick, look, picture_findings
from photocal.run.debrief.verdict import Debrief, Together
from photocal.run.output_place import check_output
from photocal.run.stage import alone

# How often the folder is looked into. A file that has the same size and time twice is at rest.
_POLL_S = 0.5
# A picture that cannot be read may still be on its way when it was written to so lately.
_PATIENCE_S = 10.0
# Fewer pictures are not oriented: the first ones of a flight say nothing together.
_FEWEST = 6
# All are oriented anew when their number has grown by this factor, or none has come for so long, s: orienting
# all after each would take time with the square of their number.
_GROWN, _QUIET_S = 1.5, 10.0
# How often the folder is looked into after the end, until a picture that had just come is at rest.
_LAST_LOOKS = 2

_Rest = tuple[int, int]


@dataclass
class _Folder:
    """Which pictures lie in a folder, and which of them are at rest."""

    path: Path
    seen: dict[Path, tuple[_Rest, float]] = field(default_factory=dict)
    taken: dict[Path, _Rest] = field(default_factory=dict)

    def at_rest(self) -> Iterator[tuple[Path, float]]:
        """Give each picture once when it is at rest, and again when it was written anew, and since when."""
        seen = {}
        for path, rest in self._states():
            before, since = self.seen.get(path, (None, 0.0))
            seen[path] = (rest, since if rest == before else time.monotonic())
            if rest == before and rest != self.taken.get(path):
                self.taken[path] = rest
                yield path, since
        self.seen = seen

    def waiting(self) -> int:
        """Pictures that are not at rest."""
        return sum(self.taken.get(path) != rest for path, (rest, _) in self.seen.items())

    def _states(self) -> Iterator[tuple[Path, _Rest]]:
        try:
            paths = list_images(self.path)
        except PhotocalError:
            # Empty, not there yet, or a card that was pulled out: what was judged stays.
            return
        for path in paths:
            try:
                facts = path.stat()
            except OSError:
                continue
            if facts.st_size:
                yield path, (facts.st_size, facts.st_mtime_ns)


def follow(
    project: Project,
    workers: int,
    stop: threading.Event,
    report: Callable[[Debrief], None],
    last: Sequence[Camera] = (),
) -> Debrief:
    """Judge the pictures of a project as they come, until `stop`; each is examined once.

    The verdict so far is written whenever it changes. Positions are those that the pictures state: the log is
    still being recorded. What all say together is judged in the background, from where it was judged last,
    when there are half as many pictures more or no more come; the last verdict, after `stop`, is that of all.

    workers: pictures that are examined at the same time; each takes memory.
    report: takes each verdict.
    last: of the last certificate, to hold the first calibration against.
    """
    check_output(project)
    with alone(project.output), _gently(workers) as (lookers, judge):
        plan, folder = MatchingPlan(cache_folder(), 1, QUICK), _Folder(project.picture_folder)
        looks, lag_s, oriented, come = dict[Path, PictureQuality](), 0.0, 0, time.monotonic()
        pending = dict[Future[PictureQuality], tuple[Path, float]]()
        judging: Future[tuple[Together, ExposureRun | None]] | None = None
        together: Together = ((), None, None)
        run: ExposureRun | None = None
        made, changed, after_stop = _so_far({}, run, together, 0, project), True, 0
        while True:
            # What came before it was to stop is still examined, once it is at rest, and judged with all.
            after_stop += stop.is_set()
            ending, all_come = after_stop > 0, after_stop > _LAST_LOOKS
            for path, since in folder.at_rest():
                pending[lookers.submit(look, (path, plan))] = (path, since)
                come = time.monotonic()
            for future in [*filter(Future.done, pending)]:
                path, since = pending.pop(future)
                result = future.result()
                if result.facts is None and _lately(path) and not ending:
                    folder.taken.pop(path)
                    continue
                looks[path], lag_s, changed = result, time.monotonic() - since, True
            if judging is not None and judging.done():
                together, run = judging.result()
                judging, changed = None, True
            last_ones = ending or time.monotonic() - come >= _QUIET_S
            grown = len(looks) >= _FEWEST and len(looks) >= (oriented + 1 if last_ones else _GROWN * oriented)
            if judging is None and grown and not (ending and (pending or not all_come)):
                oriented = len(looks)
                judging = judge.submit(_together, _ordered(looks), last, plan, together[2])
            if changed:
                waiting = folder.waiting() + len(pending)
                made, changed = _so_far(looks, run, together, waiting, project), False
                live = {"waiting": int(made.verdict.figures["waiting"]), "lag_s": lag_s}
                with output_file(project.output / verdict.FILE) as aside:
                    write_json(aside, {**verdict.debrief_json(made), "live": live})
                report(made)
            if all_come and judging is None and not pending:
                return made
            if ending:
                time.sleep(_POLL_S)
            else:
                stop.wait(_POLL_S)


@contextmanager
def _gently(workers: int) -> Iterator[tuple[ThreadPoolExecutor, ThreadPoolExecutor]]:
    """Threads that look and one that judges, behind whatever else the computer does."""
    import cv2

    threads = cv2.getNumThreads()
    cv2.setNumThreads(1)
    if hasattr(os, "nice"):
        # The recorder goes first.
        nice = 10
        os.nice(nice)
    lookers, judge = ThreadPoolExecutor(workers), ThreadPoolExecutor(1)
    try:
        yield lookers, judge
    finally:
        for pool in (lookers, judge):
            pool.shutdown(wait=False, cancel_futures=True)
        cv2.setNumThreads(threads)


def _lately(path: Path) -> bool:
    try:
        return time.time() - path.stat().st_mtime < _PATIENCE_S
    except OSError:
        return False


def _ordered(looks: dict[Path, PictureQuality]) -> list[PictureQuality]:
    return [looks[path] for path in sorted(looks, key=lambda path: path.name)]


@on_one_thread
def _together(
    looks: Sequence[PictureQuality], last: Sequence[Camera], plan: MatchingPlan, before: Quick | None
) -> tuple[Together, ExposureRun | None]:
    """What pictures say together, continued from an orientation of some of them, and their exposures."""
    try:
        stated = ((picture.path, picture.facts) for picture in looks)
        run = exposures_of_pictures([image_of(path, facts) for path, facts in stated if facts is not None])
    except PhotocalError:
        run = None
    return verdict.judged_together(looks, run, CameraOnBody(), last, plan, quiet, before), run


def _so_far(
    looks: dict[Path, PictureQuality],
    run: ExposureRun | None,
    together: Together,
    waiting: int,
    project: Project,
) -> Debrief:
    ordered = _ordered(looks)
    findings = verdict.in_order([*picture_findings(ordered), *together[0]])
    figures = {
        "n": float(len(looks)),
        "waiting": float(waiting),
        "again": float(sum(finding.severity in verdict.AGAIN for finding in findings)),
        "look": float(sum(finding.severity in verdict.LOOK for finding in findings)),
    }
    so_far = Finding(verdict.SO_FAR, "note", figures=figures)
    return Debrief(so_far, tuple(findings), tuple(ordered), run, *together[1:], project.contents.calibration)
