"""Folders of stages: replaced as a whole, published beside what others put there; one run at a time."""

from __future__ import annotations

import hashlib
import itertools
import json
import os
import shutil
import tempfile
import time
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path, PurePosixPath

from acquire.operating_system import lock as take
from acquire.outputs import output_file, refusals
from drivers.errors import OutputError
from photocal.block.model import digest

# Smaller files are read each time: nothing deceives that, and it takes no time.
_SMALL_BYTES = 1 << 22
# A file that changes twice within the clock's step keeps its times: so young ones are not remembered.
_YOUNG_NS = 2_000_000_000


class Digests:
    """SHA-256 of files and folders.

    memory: file in which digests are kept between runs; without meaning for any result.
    again: whether every file is read, whatever is remembered.
    """

    def __init__(self, memory: Path, *, again: bool = False) -> None:
        self._memory = memory
        try:
            known = {} if again else json.loads(memory.read_text(encoding="utf-8"))
        except (OSError, ValueError, RecursionError):
            known = {}
        self._known: dict[str, list[str | int]] = known if isinstance(known, dict) else {}

    def of_file(self, path: Path) -> str:
        """Give the digest of a file."""
        state = path.stat()
        large = state.st_size > _SMALL_BYTES
        name = str(path.resolve())
        # The time of the change of its entry cannot be set back by those who set back that of its content.
        hint = [state.st_size, state.st_mtime_ns, state.st_ctime_ns, state.st_ino]
        match self._known.get(name) if large else None:
            case [*remembered, str(digest)] if remembered == hint:
                return digest
        with path.open("rb") as stream:
            digest = hashlib.file_digest(stream, "sha256").hexdigest()
        if large and time.time_ns() - max(state.st_mtime_ns, state.st_ctime_ns) > _YOUNG_NS:
            self._known[name] = [*hint, digest]
        return digest

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
        """Write the memory."""
        with output_file(self._memory) as aside:
            aside.write_text(json.dumps(self._known), encoding="utf-8")


# What a stage was made from and what it wrote.
RECORD = "stage.json"
_REMEDY = "choose another output in the project file"
_ASIDE, _OLD = ".partial", ".old.partial"


@contextmanager
def replaced_folder(folder: Path) -> Iterator[Path]:
    """Give an empty folder aside; on success it takes the place of `folder`, old files and all."""
    with refusals(folder, _REMEDY):
        folder.parent.mkdir(parents=True, exist_ok=True)
        aside = Path(tempfile.mkdtemp(prefix=f".{folder.name}.", suffix=_ASIDE, dir=folder.parent))
    try:
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
    owned = _published(record)
    with refusals(public, _REMEDY):
        # A run that is killed from here on knows both its old and its new files.
        both = {name: owned.get(name, []) for name in owned.keys() | new.keys()}
        _remember(record, {name: [*old, new[name]] if name in new else old for name, old in both.items()})
        said = _set_aside(public) if public.is_symlink() or (public.exists() and not public.is_dir()) else []
        for name in owned.keys() - new.keys():
            if _digest(public / name) in owned[name]:
                (public / name).unlink()
                with suppress(OSError):
                    (public / name).parent.rmdir()
        for name, digest in new.items():
            own = (digest, *owned.get(name, ()))
            said += _place(made / name, public, name, own, record.with_suffix(".partial"))
        _remember(record, {name: [digest] for name, digest in new.items()})
        foreign = (path.relative_to(public).as_posix() for path in _files(public))
        return (*said, *(f"{name} is not of this run and stays" for name in foreign if name not in new))


def _place(source: Path, public: Path, name: str, own: tuple[str, ...], aside: Path) -> list[str]:
    """Put a file in its place, unless it is there; what stands there and is not ours is renamed."""
    place, said = public / name, []
    for parent in reversed(PurePosixPath(name).parents[:-1]):
        if (public / parent).is_symlink() or (public / parent).is_file():
            said += _set_aside(public / parent)
    there = _digest(place)
    if there == own[0]:
        return said
    if os.path.lexists(place) and there not in own:
        said += _set_aside(place)
    place.parent.mkdir(parents=True, exist_ok=True)
    aside.unlink(missing_ok=True)
    try:
        os.link(source, aside)
    except OSError:
        shutil.copyfile(source, aside)
    aside.replace(place)
    return said


def _set_aside(path: Path) -> list[str]:
    kept = next(
        free
        for k in itertools.count(1)
        if not os.path.lexists(free := path.with_name(f"{path.stem}.kept-{k}{path.suffix}"))
    )
    path.rename(kept)
    return [f"{path.name} was not as this run had written it and is kept as {kept.name}"]


def _files(folder: Path) -> list[Path]:
    return sorted(path for path in folder.rglob("*") if path.is_symlink() or not path.is_dir())


def _digest(path: Path) -> str:
    """Digest of a regular file; nothing for all else."""
    if path.is_symlink() or not path.is_file():
        return ""
    return digest(path)


def _published(record: Path) -> dict[str, list[str]]:
    try:
        content = json.loads(record.read_text(encoding="utf-8"))
        return {str(name): [str(digest) for digest in digests] for name, digests in content.items()}
    except (OSError, ValueError, AttributeError, TypeError, RecursionError):
        return {}


def _remember(record: Path, content: dict[str, list[str]]) -> None:
    with output_file(record) as aside:
        aside.write_text(json.dumps(content, indent=1), encoding="utf-8")


@contextmanager
def alone(work: Path) -> Iterator[None]:
    """Keep other runs out of a work folder; the lock ends with the process, however that ends."""
    with refusals(work, _REMEDY):
        work.mkdir(parents=True, exist_ok=True)
        lock = (work / ".lock").open("w")
    with lock:
        if not take(lock):
            raise OutputError(
                "another run is working in this folder", where=work, remedy="wait for its end, or stop it"
            )
        yield
