"""Files kept for later use: no more than so many bytes, and none that nobody wants any more."""

from __future__ import annotations

import os
from pathlib import Path


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
