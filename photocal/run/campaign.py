"""The stages of a project in their order; several projects, on several processes or on a cluster."""

import datetime as dt
import sys
from collections.abc import Callable, Container, Iterator, Sequence
from contextlib import contextmanager, suppress
from functools import cache, partial
from pathlib import Path
from typing import Any

from photocal.base.console import printable
from photocal.base.errors import ConfigurationError, PhotocalError, system_refusals
from photocal.base.extensions import STAGES, brought
from photocal.base.operating_system import give_back_memory
from photocal.base.progress import Bar, Progress, followed, quiet, unseen
from photocal.base.workers import Workers, run_tasks
from photocal.block.folder import read_block
from photocal.block.project import Project, read_project
from photocal.findings.texts import catalogue, finding_text, plain
from photocal.findings.verdict import Verdict, by_methods
from photocal.run.block import block_stage, given_block_stage
from photocal.run.calibration import analysis_stage, calibrated_once, calibration_stage, certificate_stage
from photocal.run.control import control_stage
from photocal.run.course import (
    CODED,
    COMPILING,
    CONTROL,
    FEATURES,
    PLAIN,
    RAYS_OF_A_PICTURE,
    Course,
    Workload,
    about_rays,
    expected,
    into,
    usual_pieces,
    workload,
)
from photocal.run.exposures import exposures_stage
from photocal.run.flown import flown_stage
from photocal.run.georeferencing import georeferencing_stage
from photocal.run.measurements import measurements_stage
from photocal.run.output_place import check_output
from photocal.run.ppk import ppk_stage
from photocal.run.project_checks import check_project, explained
from photocal.run.stage import (
    MEMORY,
    AddedStage,
    Digests,
    Stage,
    StageResult,
    alone,
    draw_pictures,
    foreseen,
    last_seconds,
    made_in,
    update_stage,
)
from photocal.run.summary import gather, kind, summary

# In the work folder while a run works: how far it is.
PROGRESS = "progress.json"
# Of our stages, whether a project has them or not.
_NAMES = ("control", "ppk", "exposures", "measurements", "flown", "certificate")
Task = tuple[Path, dt.date, str | None, str | None, bool]


def stages(
    project: Project, day: dt.date, judged: Callable[[Verdict], None] = lambda _: None
) -> tuple[Stage, ...]:
    """List the stages of a project; `judged` gets its verdict before a certificate of it is written."""
    work = made_in(project.output)
    block, calibration = work / "block", work / "calibration"
    # A block is complete before it is read, once for all stages.
    read = cache(read_block)
    calibrated = calibrated_once(block, read)
    given = project.contents.measurements
    if given is not None and given.block is not None:
        first: tuple[Stage, ...] = (given_block_stage(project, given.block),)
    else:
        ppk, exposures, measurements = (work / name for name in ("ppk", "exposures", "measurements"))
        # Observations that were given have no other start values than those of a flight.
        flown = project.contents.flight is not None or given is not None
        placed = exposures if flown else None
        checked = control_stage(project)
        first = (
            *(() if checked is None else (checked,)),
            *((ppk_stage(project), exposures_stage(project, ppk)) if flown else ()),
            measurements_stage(project, placed),
            block_stage(project, placed, measurements),
        )
    made = (
        *first,
        calibration_stage(block, calibrated),
        *((flown_stage(project, block, calibration),) if given is None or given.block is None else ()),
        georeferencing_stage(project, block, read, calibrated),
        analysis_stage(block, calibration, calibrated),
    )
    made = (*made, *_added(project, work, {stage.name for stage in made}))
    earlier = tuple(work / stage.name for stage in made)
    return (*made, certificate_stage(project, work, day, earlier, judged))


def _added(project: Project, work: Path, before: Container[str]) -> Iterator[Stage]:
    """Stages that installed packages bring."""
    for name, added in brought(STAGES, AddedStage).items():
        if name in before or name in _NAMES:
            raise ConfigurationError(f"a stage {name} already exists", "give it another name", where=STAGES)
        if all(earlier in before for earlier in added.after):
            folders = {earlier: work / earlier for earlier in added.after}
            made = partial(added.make, project, folders)
            yield Stage(name, added.title, made, after=tuple(folders.values()))


def run_project(
    project: Project,
    day: dt.date,
    progress: Progress,
    until: str | None = None,
    again: str | None = None,
    rehash: bool = False,
    report: Callable[[StageResult | Verdict], None] = lambda _: None,
    bar: Bar = unseen,
) -> tuple[StageResult, ...]:
    """Bring the stages of a project up to date; their pictures are drawn last.

    report: gets each stage, once more where its pictures met files of others; and, as soon as it is known,
        the verdict that the certificate will state, unless that is kept.
    progress: shows each piece of work by itself; bar: the whole run.
    raises PhotocalError: as the first stage that fails does; the stages that do not need it are made
        nevertheless, for they may tell why.
    """
    wanted = stages(project, day, report)
    names = [stage.name for stage in wanted]
    for option, name in (("--until", until), ("--again", again)):
        if name is not None and name not in names:
            raise ConfigurationError(
                f"this project has no stage {name!r}",
                f"use one that it has: {', '.join(names)}",
                where=option,
            )
    check_output(project)
    check_project(project)
    wanted = wanted[: None if until is None else names.index(until) + 1]
    last = {stage.name: last_seconds(stage, project.output) for stage in wanted}
    size = _size(project, wanted)
    control = project.control
    coded = bool(control.coded_targets)
    needed = {FEATURES: not coded, CODED: coded, PLAIN: control.plain_targets, CONTROL: control.points}
    pieces = usual_pieces(size, [title for title, given in needed.items() if not given])
    # Of a run that was ended some pictures are kept.
    counted, seen_s = dict.fromkeys((FEATURES, CODED), size[0]), sum(last.values())
    course = Course(
        expected(last, last, size, pieces), progress, seen_s=seen_s, pieces=pieces, counted=counted
    )
    told, piece = into(project.output / PROGRESS), _giving_back(course.progress)
    with alone(project.output), bar() as show, followed(course.standing, told, show):
        digests = Digests(project.output / MEMORY, again=rehash)
        due = foreseen(wanted, project.output, digests, again)
        course.revise({name: 0.0 for name in names if name not in due})
        if due:
            _compile_first(course)
        made: list[StageResult] = []
        missing: set[Path] = set()
        failure: PhotocalError | None = None
        try:
            for stage in wanted:
                course.begin(stage.name)
                try:
                    if missing.isdisjoint(stage.after):
                        with system_refusals():
                            made.append(
                                update_stage(stage, project.output, digests, piece, again=stage.name == again)
                            )
                        course.end(kept=made[-1].kept)
                        report(made[-1])
                        if stage.name == "block":
                            course.revise(expected(last, due, _size(project, wanted), pieces))
                        continue
                except PhotocalError as refusal:
                    failure = failure or refusal
                missing.add(made_in(project.output) / stage.name)
            refused = _draw(made, project.output, digests, course, report)
            failure = failure or refused
        finally:
            digests.keep()
    with suppress(OSError):
        (project.output / PROGRESS).unlink(missing_ok=True)
    if failure is not None:
        raise explained(project, failure) from failure
    return tuple(made)


def _giving_back(progress: Progress) -> Progress:
    """Give the system back what a piece of work leaves in memory, before workers or the next one need it."""

    @contextmanager
    def piece(title: str, total: float | None) -> Iterator[Callable[[float], None]]:
        """Show the progress of a piece of work."""
        give_back_memory()
        with progress(title, total) as advance:
            yield advance
        give_back_memory()

    return piece


def _draw(
    made: list[StageResult],
    output: Path,
    digests: Digests,
    course: Course,
    report: Callable[[StageResult | Verdict], None],
) -> PhotocalError | None:
    """Draw the pictures that stages have left for now; gives the first refusal."""
    failure: PhotocalError | None = None
    for k, result in enumerate(made):
        if result.pictures is None:
            continue
        course.begin(result.name)
        try:
            with system_refusals(), course.progress("drawing the pictures", None):
                made[k] = draw_pictures(result, output, digests)
        except PhotocalError as refusal:
            failure = failure or refusal
        if not set(made[k].foreign) <= set(result.foreign):
            report(made[k])
    return failure


def _compile_first(course: Course) -> None:
    """Compile the kernels where the program has just been installed, so that no stage waits for it unsaid."""
    from photocal.base.compiled import anything_compiled, compile_most_used

    if anything_compiled():
        return
    course.begin(COMPILING, expected({}, (COMPILING,), workload(0, 0.0, 0.0), {})[COMPILING])
    compile_most_used(course.progress)
    course.end(kept=False)


def _size(project: Project, stages: Sequence[Stage]) -> Workload:
    """How much work there is: rays as the block has them, or as many as pictures usually have."""
    pictures = max(sum(name.startswith("image ") for name in stage.inputs) for stage in stages)
    megapixels = max((camera.size_px[0] * camera.size_px[1] / 1e6 for camera in project.cameras), default=0.0)
    given = project.contents.measurements
    ready = [made_in(project.output) / "block"]
    if given is not None and given.block is not None:
        ready.append(given.block)
    rays = next(filter(None, map(about_rays, ready)), RAYS_OF_A_PICTURE * pictures)
    return workload(pictures, megapixels, rays)


# How the run of one project ended: its figures, or what ended it.
Outcome = tuple[dict[str, Any], PhotocalError | None]
# A line on the way; the figures of a project with its verdict, before certificate and pictures are made.
Said = str | dict[str, Any]


def say_line(said: Said) -> None:
    """Write a line to standard error."""
    # A terminal that is gone, or a file on a full disk, ends no run.
    if isinstance(said, str):
        with suppress(OSError):
            sys.stderr.write(printable(said) + "\n")


def run_projects(
    paths: Sequence[Path],
    day: dt.date,
    until: str | None = None,
    again: str | None = None,
    rehash: bool = False,
    workers: Workers = 1,
    bar: Bar = unseen,
    say: Callable[[Said], None] = say_line,
) -> list[dict[str, Any]]:
    """Run projects, which do not depend on each other.

    say: gets no figures of projects that run in other processes.
    raises PhotocalError: of the first project that failed, when the others have ended.
    """
    # All are read first: a mistake in the last file should not wait for hours.
    projects = [read_project(path) for path in paths]
    outside = [check_output(project) for project in projects]
    outputs = [project.output.resolve() for project in projects]
    for k, output in enumerate(outputs):
        if output in outputs[:k]:
            raise ConfigurationError(
                "two projects have the same output", "give each its own folder", where=paths[k]
            )
    for project, remark in zip(projects, outside, strict=True):
        if remark:
            say(f"{project.name}: {remark}")
    tasks: list[Task] = [(path.resolve(), day, until, again, rehash) for path in paths]
    crew = min(workers, len(tasks)) if isinstance(workers, int) else workers
    if crew == 1:
        outcomes = [_outcome(task, say, bar) for task in tasks]
    else:
        outcomes = []
        for outcome, lines in run_tasks(_elsewhere, tasks, crew):
            outcomes.append(outcome)
            for line in lines:
                say(line)
    for _, failure in outcomes:
        if failure is not None:
            raise failure
    return [figures for figures, _ in outcomes]


def _elsewhere(task: Task) -> tuple[Outcome, list[str]]:
    """Run a project in another process: what it said on the way comes back with its outcome."""
    said: list[Said] = []
    outcome = _outcome(task, said.append)
    return outcome, [line for line in said if isinstance(line, str)]


def _outcome(task: Task, say: Callable[[Said], None], bar: Bar = unseen) -> Outcome:
    try:
        with system_refusals():
            return run_one(*task, say=say, bar=bar), None
    except PhotocalError as failure:
        return {}, failure


def run_one(
    path: Path,
    day: dt.date,
    until: str | None = None,
    again: str | None = None,
    rehash: bool = False,
    progress: Progress = quiet,
    say: Callable[[Said], None] = say_line,
    bar: Bar = unseen,
) -> dict[str, Any]:
    """Run one project and give its figures; raises PhotocalError as `run_project` does."""
    project = read_project(path)
    made: list[StageResult] = []

    def report(result: StageResult | Verdict) -> None:
        """Keep a stage's result and say it in a line, or all that is known with the verdict."""
        if isinstance(result, Verdict):
            say(summary(project.name, project.output, made, result))
            return
        if result.name not in {known.name for known in made}:
            made.append(result)
            say(f"{project.name}: {result.name}: " + ("kept" if result.kept else f"{result.seconds:.1f} s"))
        for line in result.foreign:
            say(f"{project.name}: {result.name}: {line}")
        if result.name == "control":
            # Before the work that it may make useless.
            warn({result.name})

    def warn(stages: Container[str]) -> None:
        """Say what some stages found doubtful."""
        for warning in by_methods(gather(project.output, stages)):
            text = finding_text(warning, catalogue("en"), plain)
            say(f"{project.name}: {kind(warning)}: {warning.code}: {text}")

    try:
        made = list(run_project(project, day, progress, until, again, rehash, report, bar))
    except PhotocalError:
        # What other stages found doubtful is often why one cannot go on.
        warn({result.name for result in made} - {"control"})
        raise
    return summary(project.name, project.output, made)
