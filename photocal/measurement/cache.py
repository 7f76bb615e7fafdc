"""Results kept by the content they were made from, so that only what is new is computed."""

from __future__ import annotations

import hashlib
import os
import zipfile
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from acquire.outputs import output_file

Arrays = dict[str, NDArray[Any]]


def combined_key(*parts: object) -> str:
    """SHA-256 of several keys and settings."""
    return hashlib.sha256("\0".join(map(str, parts)).encode()).hexdigest()


def array_key(*arrays: NDArray[Any]) -> str:
    """SHA-256 of the content of arrays."""
    digest = hashlib.sha256()
    for array in arrays:
        digest.update(np.ascontiguousarray(array).data)
    return digest.hexdigest()


def cached(folder: Path, key: str, names: tuple[str, ...], make: Callable[[], Arrays]) -> Arrays:
    """Give arrays from the cache, or make and keep them."""
    path = folder / key[:2] / f"{key}.npz"
    try:
        # Opened here, so that a damaged file is closed again.
        with path.open("rb") as stream, np.load(stream, allow_pickle=False) as held:
            return {name: held[name] for name in names}
    except (OSError, ValueError, KeyError, EOFError, zipfile.BadZipFile):
        made = make()
    with output_file(path) as aside, aside.open("wb") as target:
        np.savez(target, **made)  # type: ignore[arg-type]
    return made


def sweep(folder: Path, most_bytes: int, unused_s: float, now_s: float) -> int:
    """Remove the files that were not used for longest."""
    files = []
    for where, _, names in os.walk(folder):
        for name in names:
            path = Path(where) / name
            try:
                facts = path.lstat()
            except OSError:
                # Another program sweeps, too.
                continue
            files.append((facts.st_mtime, facts.st_size, path))
    files.sort(key=lambda one: one[:2], reverse=True)
    remaining = 0
    for used, size, path in files:
        if remaining + size <= most_bytes and now_s - used <= unused_s:
            remaining += size
        else:
            _remove(path)
    return remaining


def touch(path: Path, now_s: float) -> None:
    """Note that a file is used; once an hour is enough."""
    try:
        if now_s - path.stat().st_mtime > 3600:
            os.utime(path, (now_s, now_s))
    except OSError:
        # Somebody else's cache, or gone: then it is not noted.
        return


def _remove(path: Path) -> None:
    try:
        path.unlink(missing_ok=True)
        path.parent.rmdir()
    except OSError:
        # A folder with other files stays.
        return
