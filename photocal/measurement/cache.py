"""Results kept by the content they were made from, so that only what is new is computed."""

from __future__ import annotations

import hashlib
import zipfile
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from acquire.outputs import output_file

Arrays = dict[str, NDArray[Any]]


def content_key(path: Path) -> str:
    """SHA-256 of a file's content."""
    with path.open("rb") as stream:
        return hashlib.file_digest(stream, "sha256").hexdigest()


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
