"""Finding the block folder that a run was made from."""

from __future__ import annotations

import hashlib
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from drivers.errors import InputMalformedError, InputNotFoundError

SETUP = "block.toml"
# Folders below the current one that are looked into: `configs/demo/NAME` is three deep.
DEPTH = 3


def block_of_run(run: Path, result: dict[str, Any], given: Path | None, here: Path) -> Path:
    """Find the block of a run and make sure that it has not changed.

    Parameters
    ----------
    run : Path
        The run folder.
    result : dict
        Content of its result.json.
    given : Path or None
        The block folder, when the user named it.
    here : Path
        Folder to look below when nothing else helps.

    Returns
    -------
    Path
        The block folder, all of whose files have the hashes of the run.

    Raises
    ------
    InputNotFoundError
        When no folder has these files.
    InputMalformedError
        When a file of the named folder has changed since the run.
    """
    hashes = {str(one["path"]): str(one["sha256"]) for one in result["inputs"]}
    if given is not None:
        changed = _changed(given, hashes)
        if changed:
            raise InputMalformedError(
                "is not the file that the run was made from",
                where=given / changed,
                remedy="adjust the block again, or name the folder of this run",
            )
        return given
    for folder in _candidates(run, here):
        if _changed(folder, hashes) is None:
            return folder
    raise InputNotFoundError(
        "no block folder with the files of this run was found beside it or below the current folder",
        where=run,
        remedy="name it with --block, or adjust the block again if it has changed",
    )


def _candidates(run: Path, here: Path) -> Iterator[Path]:
    """Folders with a block.toml, the nearest to the run first."""
    beside = run.resolve().parent
    for base, depth in ((run.resolve(), 0), (beside, 1), (here, DEPTH)):
        for level in range(depth + 1):
            yield from sorted(found.parent for found in base.glob("*/" * level + SETUP))


def _changed(folder: Path, hashes: dict[str, str]) -> str | None:
    """Name the first file that is missing or different; None when all are the same."""
    for name, expected in hashes.items():
        path = folder / name
        if not path.is_file():
            return name
        with path.open("rb") as stream:
            if hashlib.file_digest(stream, "sha256").hexdigest() != expected:
                return name
    return None
