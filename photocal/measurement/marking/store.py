"""Marks on disk: every change is saved before it is answered, and can be taken back."""

import csv
import os
from collections.abc import Iterable
from dataclasses import replace
from pathlib import Path
from threading import RLock

from photocal.base.files import output_file
from photocal.exchange.parts import Mark
from photocal.measurement.marks import read_marks

# A mark is known by its image and its point.
Key = tuple[str, str]
COLUMNS = ("image", "point", "x", "y", "sx", "sy")


# What the mark of a key was and became; None for no mark.
Change = tuple[Key, Mark | None, Mark | None]


class MarkStore:
    """The marks of a file, with the changes that were made here.

    A change is on disk when its method returns; the file is replaced whole. Where somebody else changed
    the file in between, their marks are kept, and the history of changes, which may not fit them, begins
    anew.

    path: marks.csv; may not exist yet.
    raises InputMalformedError: when the file is no table of marks.
    """

    def __init__(self, path: Path) -> None:
        self.path = path
        self._lock = RLock()
        self._marks: dict[Key, Mark] = {}
        self._done: list[Change] = []
        self._undone: list[Change] = []
        self._seen: tuple[int, int] | None = None
        self._refresh()

    @property
    def marks(self) -> tuple[Mark, ...]:
        """All marks, in the order of the file."""
        with self._lock:
            self._refresh()
            return tuple(self._marks.values())

    @property
    def history(self) -> tuple[bool, bool]:
        """Whether there is something to undo and to redo."""
        return bool(self._done), bool(self._undone)

    def put(self, mark: Mark) -> None:
        """Set the mark of a point in an image."""
        self._make((mark.image, mark.point), mark)

    def remove(self, key: Key) -> None:
        """Take the mark of an image and a point away; nothing happens when there is none."""
        self._make(key, None)

    def undo(self) -> Key | None:
        """Take the last change back; gives the image and the point, None when there is nothing."""
        return self._step(self._done, self._undone)

    def redo(self) -> Key | None:
        """Make the change again that was taken back last; as `undo`."""
        return self._step(self._undone, self._done)

    def _make(self, key: Key, after: Mark | None) -> None:
        with self._lock:
            self._refresh()
            before = self._marks.get(key)
            if before == after:
                return
            self._apply(key, after)
            self._done.append((key, before, after))
            self._undone.clear()

    def _step(self, source: list[Change], target: list[Change]) -> Key | None:
        with self._lock:
            self._refresh()
            if not source:
                return None
            key, before, after = source[-1]
            self._apply(key, before)
            source.pop()
            target.append((key, after, before))
            return key

    def _apply(self, key: Key, after: Mark | None) -> None:
        marks = dict(self._marks)
        if after is None:
            marks.pop(key, None)
        else:
            marks[key] = after
        # Only what is on disk counts: when writing fails, nothing has changed here either.
        write_marks(self.path, marks.values())
        self._marks, self._seen = marks, _fingerprint(self.path)

    def _refresh(self) -> None:
        now = _fingerprint(self.path)
        if now == self._seen:
            return
        marks = read_marks(self.path) if now is not None else ()
        self._marks = {(m.image, m.point): replace(m, place=self.path) for m in marks}
        self._seen = now
        self._done.clear()
        self._undone.clear()


def write_marks(path: Path, marks: Iterable[Mark]) -> None:
    """Write marks.csv, replacing it whole; without marks there is no file."""
    rows = [(m.image, m.point, f"{m.x:.4f}", f"{m.y:.4f}", *(f"{s:.4f}" for s in m.sigma)) for m in marks]
    if not rows:
        # A table without rows looks cut to those who read it; a missing one says that nothing is marked.
        path.unlink(missing_ok=True)
        return
    with output_file(path) as aside, aside.open("w", newline="", encoding="utf-8") as stream:
        writer = csv.writer(stream, lineterminator="\n")
        writer.writerow(COLUMNS)
        writer.writerows(rows)
        stream.flush()
        os.fsync(stream.fileno())


def _fingerprint(path: Path) -> tuple[int, int] | None:
    try:
        facts = path.stat()
    except FileNotFoundError:
        return None
    return facts.st_mtime_ns, facts.st_ino
