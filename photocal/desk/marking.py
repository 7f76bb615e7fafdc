"""Answers to the place Mark: points marked by hand in the pictures of a project, or of a mere folder."""

from __future__ import annotations

import threading
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Any

from starlette.routing import BaseRoute

from photocal.base.web import doing, finding, telling
from photocal.desk.session import Desk

if TYPE_CHECKING:
    from photocal.block.project import Project
    from photocal.measurement.marking.service import MarkingService

Service = Callable[[], "MarkingService"]


class OpenMarking:
    """What marks points in the project that is open; made again when what it knows has changed.

    run: adjustment that says how images are oriented, instead of what the project has.
    """

    def __init__(self, desk: Desk, run: Path | None = None) -> None:
        self._desk, self._run, self._lock = desk, run, threading.Lock()
        self._made: tuple[object, MarkingService] | None = None
        self.opened = False

    def __call__(self) -> MarkingService:
        """Give it; errors as of `scene_of_project`."""
        from photocal.measurement.marking.service import MarkingService
        from photocal.measurement.marking.store import MarkStore, scene_of_project

        project = self._desk.project()
        with self._lock:
            known = _known(project)
            if self._made is None or self._made[0] != known:
                scene, path = scene_of_project(project, self._run)
                # Who marks while a run ends can still undo.
                before = None if self._made is None else self._made[1].store
                store = before if before is not None and before.path == path else MarkStore(path)
                self._made = known, MarkingService(scene, store)
            return self._made[1]

    def place(self) -> dict[str, Any]:
        """What the place Mark begins with, and the command that opens it; from now on it is opened."""
        self.opened = True
        run: list[str | Path] = [] if self._run is None else ["--run", self._run]
        return self().project() | {"line": self._desk.line(["mark", self._desk.folder, *run])}


def _known(project: Project) -> object:
    """What changes when points, pictures or orientations are others."""
    from photocal.block.results.folder import RESULT

    work, folder = project.output, project.picture_folder
    read = (
        project.path,
        project.control.points,
        folder if folder.is_dir() else folder.parent,
        work / "calibration" / RESULT,
        work / "exposures" / "images.csv",
    )
    facts = [path.stat() if path is not None and path.exists() else None for path in read]
    return [*zip(read, [seen and (seen.st_mtime_ns, seen.st_ino) for seen in facts], strict=True)]


def routes(marking: Service, place: Callable[[], dict[str, Any]]) -> list[BaseRoute]:
    """Return what answers for the place Mark; `place` says what it begins with."""

    def found(given: dict[str, str]) -> dict[str, Any]:
        """Give the pictures that may show a point."""
        return marking().images(given.get("point", ""))

    return [
        telling("/api/mark/project", place),
        telling("/api/mark/state", lambda: marking().state()),
        finding("/api/mark/images", found),
        doing("/api/mark/mark", lambda body: marking().mark(body)),
        doing("/api/mark/remove", lambda body: marking().remove(body)),
        doing("/api/mark/undo", lambda _: marking().undo()),
        doing("/api/mark/redo", lambda _: marking().redo()),
        doing("/api/mark/adjust", lambda _: marking().adjust()),
    ]
