"""One stage of a run: made whole in its folder, and not again while nothing it depends on changes."""

from __future__ import annotations

import functools
import hashlib
import importlib.metadata
import importlib.util
import json
import time
from collections.abc import Callable, Mapping
from contextlib import AbstractContextManager
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from drivers.errors import InputNotFoundError
from photocal.run.digests import Digests
from photocal.run.folders import replaced_folder, sweep

Progress = Callable[[str, float | None], AbstractContextManager[Callable[[float], None]]]
RECORD = "stage.json"
_PACKAGES = ("drivers", "acquire", "photocal")


@dataclass(frozen=True)
class Stage:
    """What a stage depends on and how it is made.

    Attributes
    ----------
    name : str
        Also that of its folder.
    title : str
        What it does, for people.
    make : callable
        Gets the folder to write into and what shows progress.
    inputs : mapping of str to Path
        Files and folders by a name that does not change when the project is moved.
    settings : mapping
        Whatever else decides over the result, ready for JSON.
    after : tuple of Path
        Folders of earlier stages whose files are read.
    """

    name: str
    title: str
    make: Callable[[Path, Progress], None]
    inputs: Mapping[str, Path] = field(default_factory=dict)
    settings: Mapping[str, Any] = field(default_factory=dict)
    after: tuple[Path, ...] = ()


@dataclass(frozen=True)
class Made:
    """A stage that is done.

    Attributes
    ----------
    kept : bool
        Whether it was there already.
    seconds : float
        That it took when it was made.
    """

    name: str
    folder: Path
    kept: bool
    seconds: float


def bring(stage: Stage, work: Path, digests: Digests, progress: Progress, *, again: bool = False) -> Made:
    """Make a stage, or keep it when its inputs, settings and program are those of its last making."""
    folder = work / stage.name
    sweep(folder)
    key = _key(stage, digests)
    record = _record(folder)
    if not again and record.get("key") == key and _whole(folder, record, digests):
        return Made(stage.name, folder, True, float(record.get("seconds", 0.0)))
    began = time.monotonic()
    with replaced_folder(folder) as aside:
        stage.make(aside, progress)
        seconds = time.monotonic() - began
        content = {
            "schema": "photocal.stage/1",
            "stage": stage.name,
            "key": key,
            "seconds": round(seconds, 3),
            "program": program(),
            "settings": stage.settings,
            "inputs": {name: digests.of_any(path) for name, path in stage.inputs.items()},
            "outputs": digests.of_folder(aside),
        }
        text = json.dumps(content, indent=1, allow_nan=False) + "\n"
        (aside / RECORD).write_text(text, encoding="utf-8")
    return Made(stage.name, folder, False, seconds)


def _key(stage: Stage, digests: Digests) -> str:
    for name, path in stage.inputs.items():
        if not path.exists():
            raise InputNotFoundError(f"{name} does not exist", where=path, remedy="check the project file")
    content = {
        "stage": stage.name,
        "program": program(),
        "settings": stage.settings,
        "inputs": {name: digests.of_any(path) for name, path in stage.inputs.items()},
        "after": {folder.name: digests.of_folder(folder, leave_out=RECORD) for folder in stage.after},
    }
    return hashlib.sha256(json.dumps(content, sort_keys=True).encode()).hexdigest()


@functools.cache
def program() -> dict[str, str]:
    """Version of the program and digest of its source: a changed program may give other results."""
    digest = hashlib.sha256()
    for package in _PACKAGES:
        spec = importlib.util.find_spec(package)
        root = Path(spec.origin).parent if spec is not None and spec.origin else Path()
        for path in sorted(root.rglob("*.py")):
            digest.update(path.relative_to(root).as_posix().encode())
            digest.update(path.read_bytes())
    return {"version": importlib.metadata.version("photocal"), "source": digest.hexdigest()}


def _record(folder: Path) -> dict[str, Any]:
    try:
        content = json.loads((folder / RECORD).read_text(encoding="utf-8"))
    except (OSError, ValueError):
        return {}
    return content if isinstance(content, dict) else {}


def _whole(folder: Path, record: dict[str, Any], digests: Digests) -> bool:
    """Whether the files of a stage are those that it wrote."""
    return bool(digests.of_folder(folder, leave_out=RECORD) == record.get("outputs"))
