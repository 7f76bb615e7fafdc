"""Folders that are replaced as a whole, and one run at a time in a work folder."""

from __future__ import annotations

import shutil
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from acquire.operating_system import lock as take
from drivers.errors import OutputError

_ASIDE, _OLD = ".partial", ".old.partial"


@contextmanager
def replaced_folder(folder: Path) -> Iterator[Path]:
    """Give an empty folder aside; on success it takes the place of `folder`, old files and all."""
    with _refusals(folder):
        folder.parent.mkdir(parents=True, exist_ok=True)
        aside = Path(tempfile.mkdtemp(prefix=f".{folder.name}.", suffix=_ASIDE, dir=folder.parent))
    try:
        yield aside
        with _refusals(folder):
            aside.chmod(0o755)
            old = aside.with_name(aside.name.removesuffix(_ASIDE) + _OLD)
            if folder.exists():
                folder.replace(old)
            aside.replace(folder)
            shutil.rmtree(old, ignore_errors=True)
    finally:
        shutil.rmtree(aside, ignore_errors=True)


def sweep(folder: Path) -> None:
    """Remove what a killed run has left beside a folder.

    Parameters
    ----------
    folder : Path
        That `replaced_folder` was making.
    """
    for left in folder.parent.glob(f".{folder.name}.*{_ASIDE}"):
        shutil.rmtree(left, ignore_errors=True)


@contextmanager
def alone(work: Path) -> Iterator[None]:
    """Keep other runs out of a work folder; the lock ends with the process, however that ends."""
    with _refusals(work):
        work.mkdir(parents=True, exist_ok=True)
        lock = (work / ".lock").open("w")
    with lock:
        if not take(lock):
            raise OutputError(
                "another run is working in this folder", where=work, remedy="wait for its end, or stop it"
            )
        yield


@contextmanager
def _refusals(folder: Path) -> Iterator[None]:
    try:
        yield
    except OSError as refusal:
        reason = refusal.strerror or str(refusal)
        raise OutputError(
            f"cannot be written ({reason})", where=folder, remedy="choose another output in the project file"
        ) from refusal
