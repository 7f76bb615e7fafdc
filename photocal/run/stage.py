"""One stage of a run: made whole in its folder, and not again while nothing it depends on changes."""

import hashlib
import itertools
import json
import os
import platform
import shutil
import tempfile
import time
from collections.abc import Callable, Iterable, Iterator, Mapping
from contextlib import contextmanager, suppress
from dataclasses import asdict, dataclass, field, replace
from pathlib import Path, PurePosixPath
from typing import TYPE_CHECKING, Any, TextIO

from photocal.adjustment.ledger import because, ledger
from photocal.base.codec import kept_json
from photocal.base.console import printable
from photocal.base.errors import InputNotFoundError, OutputError
from photocal.base.files import digest, filled, output_file, output_folder, refusals, write_json
from photocal.base.operating_system import lock as take
from photocal.base.program import program
from photocal.base.progress import Progress

if TYPE_CHECKING:
    from photocal.block.project import Project

# Smaller files are read each time: nothing deceives that, and it takes no time. Most pictures are larger.
_SMALL_BYTES = 1 << 20
# Of a work folder: digests of files between runs, written when a run ends, however it ends.
MEMORY = ".digests.json"
# What a stage was made from and what it wrote.
RECORD = "stage.json"
# Draws pictures into a folder, of what is at hand.
Drawing = Callable[[Path], None]
_REMEDY = "choose another output in the project file"
_ASIDE, _OLD = ".partial", ".old.partial"


class Digests:
    """SHA-256 of files and folders.

    memory: file in which digests are kept between runs; without meaning for any result.
    again: whether every file is read, whatever is remembered.
    """

    def __init__(self, memory: Path, *, again: bool = False) -> None:
        self._memory = memory
        self._known: dict[str, list[str | int]] = {} if again else kept_json(memory)

    def of_file(self, path: Path) -> str:
        """Give the digest of a file."""
        state = path.stat()
        large = state.st_size > _SMALL_BYTES
        name = str(path.resolve())
        # The time of the change of its entry cannot be set back by those who set back that of its content.
        hint = [state.st_size, state.st_mtime_ns, state.st_ctime_ns, state.st_ino]
        match self._known.get(name) if large else None:
            case [*remembered, str(found)] if remembered == hint:
                return found
        found = digest(path)
        # A file that changes twice within the clock's step keeps its times: so young ones are not remembered.
        young_ns = 2_000_000_000
        if large and time.time_ns() - max(state.st_mtime_ns, state.st_ctime_ns) > young_ns:
            self._known[name] = [*hint, found]
        return found

    def of_folder(self, folder: Path, leave_out: str = "") -> dict[str, str]:
        """Give the digests of all files of a folder by their path in it."""
        return {
            path.relative_to(folder).as_posix(): self.of_file(path)
            for path in sorted(folder.rglob("*"))
            if path.is_file() and path.name != leave_out
        }

    def of_any(self, path: Path) -> str | dict[str, str]:
        """Give the digest of a file, or those of a folder."""
        return self.of_folder(path) if path.is_dir() else self.of_file(path)

    def keep(self) -> None:
        """Write the memory, where there is room: without it files are read again."""
        # A project that was taken away in the middle of a run is not begun anew.
        if not self._memory.parent.is_dir():
            return
        with suppress(OutputError), output_file(self._memory) as aside:
            write_json(aside, self._known, None)


@contextmanager
def replaced_folder(folder: Path) -> Iterator[Path]:
    """Give an empty folder aside; on success it takes the place of `folder`, old files and all."""
    with refusals(folder, _REMEDY):
        folder.parent.mkdir(parents=True, exist_ok=True)
        aside = Path(tempfile.mkdtemp(prefix=f".{folder.name}.", suffix=_ASIDE, dir=folder.parent))
    try:
        with filled(aside, folder):
            yield aside
        with refusals(folder, _REMEDY):
            aside.chmod(0o755)
            old = aside.with_name(aside.name.removesuffix(_ASIDE) + _OLD)
            if folder.exists():
                folder.replace(old)
            aside.replace(folder)
            shutil.rmtree(old, ignore_errors=True)
    finally:
        shutil.rmtree(aside, ignore_errors=True)


def sweep(folder: Path) -> None:
    """Remove what a killed run has left beside a folder."""
    for left in folder.parent.glob(f".{folder.name}.*{_ASIDE}"):
        shutil.rmtree(left, ignore_errors=True)


def publish(made: Path, public: Path, record: Path) -> tuple[str, ...]:
    """Bring the public copy of a stage's files up to date; what the stages have not written stays."""
    new = {path.relative_to(made).as_posix(): _digest(path) for path in _files(made) if path != made / RECORD}
    known = kept_json(record).items()
    owned = {name: list(map(str, digests)) for name, digests in known if isinstance(digests, list)}
    with refusals(public, _REMEDY):
        # A run that is killed from here on knows both its old and its new files.
        both = {name: owned.get(name, []) for name in owned.keys() | new.keys()}
        _remember(record, {name: [*old, new[name]] if name in new else old for name, old in both.items()})
        foreign_place = public.is_symlink() or (public.exists() and not public.is_dir())
        remarks = _set_aside(public) if foreign_place else []
        for name in owned.keys() - new.keys():
            if _digest(public / name) in owned[name]:
                (public / name).unlink()
                with suppress(OSError):
                    (public / name).parent.rmdir()
        for name, digest in new.items():
            ours = (digest, *owned.get(name, ()))
            remarks += _place(made / name, public, name, ours, record.with_suffix(".partial"))
        _remember(record, {name: [digest] for name, digest in new.items()})
        foreign = (path.relative_to(public).as_posix() for path in _files(public))
        return (
            *remarks,
            *(f"{name} does not belong to this run and stays" for name in foreign if name not in new),
        )


def _place(source: Path, public: Path, name: str, ours: tuple[str, ...], aside: Path) -> list[str]:
    """Put a file in its place, unless it is there; what stands there and is not ours is renamed."""
    place, remarks = public / name, []
    for parent in reversed(PurePosixPath(name).parents[:-1]):
        if (public / parent).is_symlink() or (public / parent).is_file():
            remarks += _set_aside(public / parent)
    there = _digest(place)
    if there == ours[0]:
        return remarks
    if os.path.lexists(place) and there not in ours:
        remarks += _set_aside(place)
    place.parent.mkdir(parents=True, exist_ok=True)
    aside.unlink(missing_ok=True)
    try:
        try:
            os.link(source, aside)
        except OSError:
            shutil.copyfile(source, aside)
        aside.replace(place)
    finally:
        aside.unlink(missing_ok=True)
    return remarks


def _set_aside(path: Path) -> list[str]:
    kept = next(
        free
        for k in itertools.count(1)
        if not os.path.lexists(free := path.with_name(f"{path.stem}.kept-{k}{path.suffix}"))
    )
    path.rename(kept)
    return [f"{path.name} was changed since this run wrote it and is kept as {kept.name}"]


def _files(folder: Path) -> list[Path]:
    return sorted(path for path in folder.rglob("*") if path.is_symlink() or not path.is_dir())


def _digest(path: Path) -> str:
    """Digest of a regular file; nothing for all else."""
    if path.is_symlink() or not path.is_file():
        return ""
    return digest(path)


def _remember(record: Path, content: dict[str, list[str]]) -> None:
    with output_file(record) as aside:
        write_json(aside, content)


@contextmanager
def alone(work: Path) -> Iterator[None]:
    """Keep other runs out of a work folder; the lock ends with the process, however that ends."""
    with refusals(work, _REMEDY):
        work.mkdir(parents=True, exist_ok=True)
        lock = (work / ".lock").open("a+", encoding="utf-8")
    with lock:
        if not take(lock):
            who = _said_in(lock)
            raise OutputError(
                f"another run is working in this folder{who}", "wait for its end, or stop it", where=work
            )
        # Who reads it while nobody holds the lock sees who was here last.
        lock.seek(0)
        lock.truncate()
        lock.write(f"process {os.getpid()} on {platform.node()}\n")
        lock.flush()
        yield


def _said_in(lock: TextIO) -> str:
    """Return who holds a lock, as far as it can be read."""
    with suppress(OSError, ValueError):
        lock.seek(0)
        if said := printable(lock.readline().strip()[:100]):
            return f": {said}"
    return ""


@dataclass(frozen=True)
class Stage:
    """What a stage depends on and how it is made.

    make: gets the folder to write into and what shows progress; gives what draws its pictures, which no stage
        reads and which wait for the verdict of the run.
    inputs: files and folders by a name that does not change when the project is moved.
    settings: whatever else decides over the result, ready for JSON.
    after: folders of earlier stages whose files are read.
    before: gets the folder that was made and the public one before that is brought up to date; gives what it
        has done there, a phrase each.
    """

    name: str
    title: str
    make: Callable[[Path, Progress], Drawing | None]
    inputs: Mapping[str, Path] = field(default_factory=dict)
    settings: Mapping[str, Any] = field(default_factory=dict)
    after: tuple[Path, ...] = ()
    before: Callable[[Path, Path], tuple[str, ...]] = lambda *_: ()


@dataclass(frozen=True)
class AddedStage:
    """A stage that an installed package brings, between the analysis and the certificate.

    Its name is that of its entry point:

        [project.entry-points."photocal.stages"]
        toy = "toy_stage:STAGE"

    title: what progress shows.
    make: gets the project, the folders of the stages that it follows by their names, the folder to write
        into and what shows progress.
    after: names of these stages; in a project that lacks one of them it is left out.
    """

    title: str
    make: Callable[["Project", Mapping[str, Path], Path, Progress], None]
    after: tuple[str, ...]


def pictures_of(project: "Project") -> dict[str, Path]:
    """The pictures as inputs of a stage; their folder may hold the project, too."""
    from photocal.measurement.image_file import list_images

    return {f"image {path.name}": path for path in list_images(project.picture_folder)}


@dataclass(frozen=True)
class StageResult:
    """A finished stage.

    Attributes
    ----------
    adjustments
        Reason of each adjustment that it computed.
    foreign
        Files in its folder that the stage has not written, one phrase each.
    pictures
        What draws those that it still lacks.
    """

    name: str
    folder: Path
    kept: bool
    seconds: float
    adjustments: tuple[str, ...] = ()
    foreign: tuple[str, ...] = ()
    pictures: Drawing | None = None


def update_stage(
    stage: Stage, work: Path, digests: Digests, progress: Progress, *, again: bool = False
) -> StageResult:
    """Make a stage, or keep it while its inputs, settings and code do not change, and publish it.

    Its pictures are drawn by `draw_pictures`; a stage that lacks them is made again.
    """
    made = made_in(work) / stage.name
    kept, record, pictures = _made(stage, made, digests, progress, again=again)
    public = work / stage.name
    seconds, taken = float(record.get("seconds", 0.0)), record.get("adjustments", [])
    reasons = tuple(entry["reason"] for entry in taken)
    remarks = (*stage.before(made, public), *publish(made, public, _published(work, stage.name)))
    return StageResult(stage.name, public, kept, seconds, reasons, remarks, pictures)


def draw_pictures(result: StageResult, work: Path, digests: Digests) -> StageResult:
    """Draw the pictures that a stage has left for later, and publish them; its seconds count these too."""
    if result.pictures is None:
        return result
    made, began = made_in(work) / result.name, time.monotonic()
    with output_folder(made) as aside:
        result.pictures(aside)
        drawn = digests.of_folder(aside)
    seconds = round(result.seconds + time.monotonic() - began, 3)
    with output_file(made / RECORD) as aside:
        write_json(aside, kept_json(made / RECORD) | {"pictures": drawn, "seconds": seconds})
    remarks = publish(made, result.folder, _published(work, result.name))
    return replace(result, seconds=seconds, foreign=remarks, pictures=None)


def _published(work: Path, stage: str) -> Path:
    """Record of the public files of a stage."""
    return made_in(work) / f"{stage}.published.json"


def last_seconds(stage: Stage, work: Path) -> float:
    """What a stage took when it was made last, 0 for one that never was."""
    return float(kept_json(made_in(work) / stage.name / RECORD).get("seconds", 0.0))


def foreseen(stages: Iterable[Stage], work: Path, digests: Digests, again: str | None = None) -> set[str]:
    """Name the stages that will be made: what has changed, and all that reads the results of those."""
    changed = set[Path]()
    for stage in stages:
        folder = made_in(work) / stage.name
        follows = stage.name == again or not changed.isdisjoint(stage.after)
        # What is missing now may be made until then, or is refused in its turn.
        with suppress(InputNotFoundError, OSError):
            if not follows and _standing(folder, _key(stage, digests), digests) is not None:
                continue
        changed.add(folder)
    return {folder.name for folder in changed}


def made_in(work: Path) -> Path:
    """Folder of the stages of a work folder in which nobody else writes."""
    return work / ".stages"


def is_stage(folder: Path) -> bool:
    """Whether a folder is what a run of a project has published."""
    return (made_in(folder.resolve().parent) / folder.resolve().name).is_dir()


def _made(
    stage: Stage, folder: Path, digests: Digests, progress: Progress, *, again: bool
) -> tuple[bool, dict[str, Any], Drawing | None]:
    """Make a stage or keep it: which of both, its record, and what draws the pictures that it lacks."""
    sweep(folder)
    key = _key(stage, digests)
    record = None if again else _standing(folder, key, digests)
    if record is not None:
        return True, record, None
    began = time.monotonic()
    with replaced_folder(folder) as aside, ledger() as adjustments, because(stage.title):
        pictures = stage.make(aside, progress)
        seconds = time.monotonic() - began
        content = {
            "schema": "photocal.stage/1",
            "stage": stage.name,
            "key": key,
            "seconds": round(seconds, 3),
            "program": program(stage.make),
            "settings": stage.settings,
            "inputs": {name: digests.of_any(path) for name, path in stage.inputs.items()},
            "outputs": digests.of_folder(aside),
            "pictures": {} if pictures is None else None,
            "adjustments": [asdict(entry) for entry in adjustments],
        }
        write_json(aside / RECORD, content)
    return False, content, pictures


def _standing(folder: Path, key: str, digests: Digests) -> dict[str, Any] | None:
    """Record of a stage that was made from the same, and whose files are as it wrote them."""
    record = kept_json(folder / RECORD)
    pictures = record.get("pictures")
    if record.get("key") != key or pictures is None:
        return None
    files = record.get("outputs", {}) | pictures
    return record if digests.of_folder(folder, leave_out=RECORD) == files else None


def _read_by_others(folder: Path, digests: Digests) -> dict[str, str]:
    """Digests of the files of a stage but for its pictures."""
    pictures = kept_json(folder / RECORD).get("pictures") or ()
    files = digests.of_folder(folder, leave_out=RECORD)
    return {name: digest for name, digest in files.items() if name not in pictures}


def _key(stage: Stage, digests: Digests) -> str:
    for name, path in stage.inputs.items():
        if not path.exists():
            remedy = "check the project file"
            if path.suffix == ".mcap":
                remedy = f"check the project file, or make it: acquire import RECORDINGS -o {path.name}"
            raise InputNotFoundError(f"{name} does not exist", remedy, where=path)
    content = {
        "stage": stage.name,
        "program": program(stage.make),
        "settings": stage.settings,
        "inputs": {name: digests.of_any(path) for name, path in stage.inputs.items()},
        "after": {folder.name: _read_by_others(folder, digests) for folder in stage.after},
    }
    return hashlib.sha256(json.dumps(content, sort_keys=True).encode()).hexdigest()
