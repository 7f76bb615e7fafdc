"""Digests of files: content decides; those of large files are remembered, so that they are read once."""

from __future__ import annotations

import hashlib
import json
import time
from pathlib import Path

from acquire.outputs import output_file

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
