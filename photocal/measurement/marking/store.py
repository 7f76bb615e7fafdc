"""Marks on disk: every change is saved before it is answered, and can be taken back.

What is marked: the pictures of one folder, the points, and what is known of the images' orientation.
"""

import os
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from threading import RLock

from photocal.base.errors import ConfigurationError, PhotocalError
from photocal.base.files import output_file, rows_text
from photocal.block.folder import read_points
from photocal.block.model import NO_POINTS, ObjectPoints
from photocal.block.project import Project
from photocal.exchange.parts import Mark
from photocal.measurement.image_facts import read_facts
from photocal.measurement.image_file import list_images
from photocal.measurement.marking.snap import DICTIONARIES
from photocal.measurement.marks import read_marks
from photocal.measurement.orientation import Orientation, of_project, of_run

# How far viewers turn a picture clockwise, degrees, by its EXIF orientation; mirrored ones are not turned.
_TURNS = {3: 180, 6: 90, 8: 270}


@dataclass(frozen=True)
class Picture:
    """An image file.

    size_px: width and height of the stored pixel grid.
    turn_deg: how far viewers turn it clockwise. Columns and rows are always those of the stored grid.
    reason: why it cannot be shown; empty for those that can.
    """

    path: Path
    size_px: tuple[int, int]
    turn_deg: int
    reason: str


@dataclass(frozen=True)
class Scene:
    """Everything that the page shows, but the marks.

    pictures: by file name: no other file is ever opened for the page.
    listed: whether only these points may be marked; else names are free.
    dictionaries: of coded targets.
    """

    name: str
    pictures: Mapping[str, Picture]
    points: ObjectPoints
    listed: bool
    orientation: Orientation | None
    dictionaries: tuple[str, ...] = DICTIONARIES


def scene_of_project(project: Project, run: Path | None) -> tuple[Scene, Path]:
    """Read what is marked in a project, and where its marks are kept.

    run: adjustment that says how images are oriented, instead of what the project has.
    raises PhotocalError: for what is missing or cannot be read.
    """
    control = project.control
    if control.marks is None:
        raise ConfigurationError(
            "marks in [control] is missing", 'add marks = "marks.csv"', where=project.path
        )
    pictures = read_pictures(project.picture_folder)
    orientation = of_project(project, tuple(pictures)) if run is None else of_run(run)
    dictionaries = tuple(target.dictionary for target in control.coded_targets) or DICTIONARIES
    points = NO_POINTS if control.points is None else read_points(control.points)
    return Scene(project.name, pictures, points, True, orientation, dictionaries), control.marks


def scene_of_folder(folder: Path, points: Path | None, run: Path | None) -> Scene:
    """Read what is marked in a folder of pictures without a project.

    points: points.csv; without it any name may be marked.
    run: adjustment that says how images are oriented.
    raises PhotocalError: for what is missing or cannot be read.
    """
    known = NO_POINTS if points is None else read_points(points)
    orientation = None if run is None else of_run(run)
    return Scene(folder.resolve().name, read_pictures(folder), known, points is not None, orientation)


def read_pictures(folder: Path) -> dict[str, Picture]:
    """List the pictures of a folder; those that cannot be shown say why."""
    return {path.name: _picture(path) for path in list_images(folder)}


def _picture(path: Path) -> Picture:
    if not path.resolve().is_relative_to(path.parent.resolve()):
        return Picture(path, (0, 0), 0, "is a link to a place outside of the folder")
    try:
        facts = read_facts(path)
    except PhotocalError as refusal:
        return Picture(path, (0, 0), 0, refusal.what)
    return Picture(path, facts.size_px, _TURNS.get(facts.orientation, 0), "")


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
    """Write marks.csv, replacing it whole; without marks the file is removed."""
    rows = [(m.image, m.point, f"{m.x:.4f}", f"{m.y:.4f}", *(f"{s:.4f}" for s in m.sigma)) for m in marks]
    if not rows:
        # A table without rows looks cut to those who read it; a missing one says that nothing is marked.
        path.unlink(missing_ok=True)
        return
    with output_file(path) as aside, aside.open("w", newline="", encoding="utf-8") as stream:
        stream.write(rows_text(COLUMNS, rows))
        stream.flush()
        os.fsync(stream.fileno())


def _fingerprint(path: Path) -> tuple[int, int] | None:
    try:
        facts = path.stat()
    except FileNotFoundError:
        return None
    return facts.st_mtime_ns, facts.st_ino
