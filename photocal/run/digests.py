"""Digests of files, remembered by size and time of change, so that a hundred gigabytes are read once."""

from __future__ import annotations

import hashlib
import json
import time
from pathlib import Path

from acquire.outputs import output_file

# A file that changes twice within the clock's step keeps its time: so young ones are not remembered.
_YOUNG_NS = 2_000_000_000


class Digests:
    """SHA-256 of files and folders.

    Parameters
    ----------
    memory : Path
        File in which digests are kept between runs; without meaning for any result.
    """

    def __init__(self, memory: Path) -> None:
        self._memory = memory
        try:
            known = json.loads(memory.read_text(encoding="utf-8"))
        except (OSError, ValueError):
            known = {}
        self._known: dict[str, list[str | int]] = known if isinstance(known, dict) else {}

    def of_file(self, path: Path) -> str:
        """Give the digest of a file."""
        state = path.stat()
        name = str(path.resolve())
        match self._known.get(name):
            case [int(size), int(changed), str(digest)] if (size, changed) == (
                state.st_size,
                state.st_mtime_ns,
            ):
                return digest
        with path.open("rb") as stream:
            digest = hashlib.file_digest(stream, "sha256").hexdigest()
        if time.time_ns() - state.st_mtime_ns > _YOUNG_NS:
            self._known[name] = [state.st_size, state.st_mtime_ns, digest]
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
