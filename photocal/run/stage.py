"""One stage of a run: made whole in its folder, and not again while nothing it depends on changes."""

from __future__ import annotations

import hashlib
import json
import math
import time
from collections.abc import Callable, Iterator, Mapping
from contextlib import AbstractContextManager, contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from acquire.outputs import output_file
from drivers.errors import InputNotFoundError
from photocal.run.digests import Digests
from photocal.run.folders import RECORD, publish, replaced_folder, sweep
from photocal.run.source import program

_TOLD_EVERY_S = 1.0
Progress = Callable[[str, float | None], AbstractContextManager[Callable[[float], None]]]


@dataclass(frozen=True)
class Stage:
    """What a stage depends on and how it is made.

    name: also that of its folder.
    title: what it does, for people.
    make: gets the folder to write into and what shows progress.
    inputs: files and folders by a name that does not change when the project is moved.
    settings: whatever else decides over the result, ready for JSON.
    after: folders of earlier stages whose files are read.
    """

    name: str
    title: str
    make: Callable[[Path, Progress], None]
    inputs: Mapping[str, Path] = field(default_factory=dict)
    settings: Mapping[str, Any] = field(default_factory=dict)
    after: tuple[Path, ...] = ()


@dataclass(frozen=True)
class StageResult:
    """A stage that is done.

    kept: whether it was there already.
    seconds: that it took when it was made.
    foreign: what lies in its folder and is not of it, one phrase each.
    """

    name: str
    folder: Path
    kept: bool
    seconds: float
    foreign: tuple[str, ...] = ()


def written(progress: Progress, file: Path) -> Progress:
    """Show progress and write it, about once a second, as JSON: title, share and seconds left where known."""

    @contextmanager
    def shown(title: str, total: float | None) -> Iterator[Callable[[float], None]]:
        began, done, last = time.monotonic(), 0.0, -math.inf

        def advance(amount: float) -> None:
            nonlocal done, last
            tell(amount)
            done, now = done + amount, time.monotonic()
            if now - last < _TOLD_EVERY_S:
                return
            last, share = now, done / total if total else None
            left = (now - began) * (1 / share - 1) if share else None
            content = {"title": title, "share": share, "left_s": left, "elapsed_s": now - began}
            with output_file(file) as aside:
                aside.write_text(json.dumps(content) + "\n", encoding="utf-8")

        with progress(title, total) as tell:
            advance(0.0)
            yield advance

    return shown


def update_stage(
    stage: Stage, work: Path, digests: Digests, progress: Progress, *, again: bool = False
) -> StageResult:
    """Make a stage, or keep it while its inputs, settings and code do not change, and publish it.

    It is made and kept in `made_in(work)`, where later stages read it; people find it in `work`.
    """
    kept, seconds = _made(stage, made_in(work) / stage.name, digests, progress, again=again)
    public = work / stage.name
    record = made_in(work) / f"{stage.name}.published.json"
    return StageResult(stage.name, public, kept, seconds, publish(made_in(work) / stage.name, public, record))


def made_in(work: Path) -> Path:
    """Folder of the stages of a work folder in which nobody else writes."""
    return work / ".stages"


def is_stage(folder: Path) -> bool:
    """Whether a folder is what a run of a project has published."""
    return (made_in(folder.resolve().parent) / folder.resolve().name).is_dir()


def _made(
    stage: Stage, folder: Path, digests: Digests, progress: Progress, *, again: bool
) -> tuple[bool, float]:
    """Make a stage or keep it: which of both, and the seconds that it took."""
    sweep(folder)
    key = _key(stage, digests)
    record = _record(folder)
    if not again and record.get("key") == key and _whole(folder, record, digests):
        return True, float(record.get("seconds", 0.0))
    began = time.monotonic()
    with replaced_folder(folder) as aside:
        stage.make(aside, progress)
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
        }
        text = json.dumps(content, indent=1, allow_nan=False) + "\n"
        (aside / RECORD).write_text(text, encoding="utf-8")
    return False, seconds


def _key(stage: Stage, digests: Digests) -> str:
    for name, path in stage.inputs.items():
        if not path.exists():
            raise InputNotFoundError(f"{name} does not exist", where=path, remedy="check the project file")
    content = {
        "stage": stage.name,
        "program": program(stage.make),
        "settings": stage.settings,
        "inputs": {name: digests.of_any(path) for name, path in stage.inputs.items()},
        "after": {folder.name: digests.of_folder(folder, leave_out=RECORD) for folder in stage.after},
    }
    return hashlib.sha256(json.dumps(content, sort_keys=True).encode()).hexdigest()


def _record(folder: Path) -> dict[str, Any]:
    try:
        content = json.loads((folder / RECORD).read_text(encoding="utf-8"))
    except (OSError, ValueError, RecursionError):
        return {}
    return content if isinstance(content, dict) else {}


def _whole(folder: Path, record: dict[str, Any], digests: Digests) -> bool:
    """Whether the files of a stage are those that it wrote."""
    return bool(digests.of_folder(folder, leave_out=RECORD) == record.get("outputs"))
