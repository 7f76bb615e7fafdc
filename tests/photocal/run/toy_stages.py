"""Three small stages with pictures under random edits, kills and foreign files, against runs from nothing."""

from __future__ import annotations

import os
import random
import shutil
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any
from unittest.mock import patch

from photocal.base.progress import Progress
from photocal.run.stage import Digests, Drawing, Stage, draw_pictures, made_in, update_stage

NAMES = ("first", "second", "third")
KINDS = ("content", "keep times", "touch", "add", "remove", "foreign", "change", "delete", "move")
_CALLS = ("replace", "rename", "unlink", "link", "mkdir", "rmdir")


class Killed(BaseException):
    """The process is no more."""


@contextmanager
def quiet(_: str, __: float | None) -> Iterator[Any]:
    yield lambda _: None


def stages(source: Path, work: Path) -> tuple[Stage, ...]:
    """Each reads all files that it finds in the folder of the one before, as some real ones do."""

    def make(before: Path, word: str) -> Any:
        def copy(out: Path, _: Progress) -> Drawing:
            for path in sorted(before.rglob("*")):
                if path.is_file() and path.name != "stage.json" and path.suffix != ".svg":
                    target = out / path.relative_to(before)
                    target.parent.mkdir(exist_ok=True)
                    target.write_text(f"{word} {path.read_text()}")
            drawn = sorted(path.read_text() for path in out.rglob("*") if path.is_file())
            return lambda folder: _draw(folder, drawn)

        return copy

    first, second = made_in(work) / "first", made_in(work) / "second"
    return (
        Stage("first", "", make(source, "one"), {"source": source}),
        Stage("second", "", make(first, "two"), after=(first,)),
        Stage("third", "", make(second, "three"), after=(second,)),
    )


def _draw(folder: Path, drawn: list[str]) -> None:
    (folder / "sheets").mkdir()
    (folder / "sheets" / "all.svg").write_text("\n".join(drawn))
    (folder / "count.svg").write_text(str(len(drawn)))


def run(source: Path, work: Path) -> None:
    digests = Digests(work / "digests.json")
    for result in [update_stage(stage, work, digests, quiet) for stage in stages(source, work)]:
        draw_pictures(result, work, digests)
    digests.keep()


@contextmanager
def killed_after(calls: int) -> Iterator[None]:
    """Let the process die at a call to the file system: nothing that it would do later happens."""
    left = [calls]

    def counted(function: Any) -> Any:
        def call(*arguments: Any, **keywords: Any) -> Any:
            left[0] -= 1
            if left[0] < 0:
                raise Killed
            return function(*arguments, **keywords)

        return call

    patches = [patch.object(os, name, counted(getattr(os, name))) for name in _CALLS]
    with suppress(Killed):
        for one in patches:
            one.start()
        try:
            yield
        finally:
            for one in patches:
                one.stop()


def content(folder: Path) -> dict[str, str]:
    return {
        path.relative_to(folder).as_posix(): path.read_text() for path in folder.rglob("*") if path.is_file()
    }


def sequence(folder: Path, seed: int, edits: int = 12) -> list[str]:
    """Edit, run and kill at random; tell what differs from a run from nothing, or was lost."""
    chance = random.Random(seed)  # noqa: S311 - edits, no keys
    source, work = folder / "source", folder / "work"
    source.mkdir(parents=True)
    for name in ("a.csv", "b.csv"):
        (source / name).write_text(f"{name} 0000")
    foreign: set[str] = set()
    for turn in range(edits):
        _edit(chance, source, work, foreign, f"{turn:04d}")
        if chance.random() < 0.3:
            with killed_after(chance.randrange(60)):
                run(source, work)
        elif chance.random() < 0.5:
            run(source, work)
    run(source, work)
    run(source, folder / "fresh")
    lost = []
    for name in NAMES:
        now, fresh = content(work / name), content(folder / "fresh" / name)
        lost += [f"{name}/{file}" for file, text in fresh.items() if now.get(file) != text]
    lost += sorted(foreign - {text for name in NAMES for text in content(work / name).values()})
    shutil.rmtree(folder)
    return lost


def _edit(chance: random.Random, source: Path, work: Path, foreign: set[str], mark: str) -> None:
    kind = chance.choice(KINDS)
    files = sorted(source.iterdir())
    path = chance.choice(files)
    public = sorted(path for name in NAMES for path in (work / name).rglob("*") if path.is_file())
    match kind:
        case "content" | "keep times":
            times = path.stat()
            path.write_text(path.read_text()[:-4] + mark)
            if kind == "keep times":
                os.utime(path, ns=(times.st_atime_ns, times.st_mtime_ns))
        case "touch":
            path.touch()
        case "add":
            (source / f"{mark}.csv").write_text(f"{mark} 0000")
        case "remove" if len(files) > 1:
            path.unlink()
        case "foreign":
            name = chance.choice(("signed.pdf", "a.csv", "b.csv", "c.csv", f"{mark}.csv"))
            place = work / chance.choice(NAMES) / name
            place.parent.mkdir(parents=True, exist_ok=True)
            # Written anew, as editors do, or into the very file that lies there.
            if place.exists() and chance.random() < 0.5:
                _remove(place, foreign)
            _write(place, f"foreign {mark}", foreign)
        case "change" if public:
            _write(chance.choice(public), f"changed {mark}", foreign)
        case "delete" if public:
            _remove(chance.choice(public), foreign)
        case "move":
            aside = source.with_name("moved")
            source.rename(aside)
            aside.rename(source)
        case _:
            pass


def _write(place: Path, text: str, foreign: set[str]) -> None:
    if place.exists():
        foreign.discard(place.read_text())
    place.write_text(text)
    foreign.add(text)


def _remove(place: Path, foreign: set[str]) -> None:
    foreign.discard(place.read_text())
    place.unlink()
