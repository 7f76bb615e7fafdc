"""What the window is open on: the folder that was given, and the one within it that is worked on."""

import shlex
import threading
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from photocal.base.errors import InputNotFoundError
from photocal.block.project import NAME, Project, read_project
from photocal.desk.jobs import Job


class Desk:
    """The folder that was given, and the one within it that is worked on; nothing else is ever opened.

    Attributes
    ----------
    root
        Folder that was given; what lies outside of it is not shown.
    folder
        That of the project, the root or beneath it.
    cache
        Folder for tiles of pictures.
    lock
        Held while a file of the project is written.
    jobs
        Long commands of this project, by name.
    preview
        Certificate of a form that is not kept yet.
    language
        That of the window: findings and verdicts are said in it.
    """

    def __init__(self, root: Path, cache: Path) -> None:
        self.root, self._given = root.resolve(), root
        self.folder = self.root
        self.cache = cache
        self.lock = threading.RLock()
        self.jobs: dict[str, Job] = {}
        self.preview, self.language = "", "en"
        if not self.root.is_dir():
            raise InputNotFoundError("is not a folder", "name the folder of a flight", where=root)

    @property
    def file(self) -> Path:
        """Project file, there or not."""
        return self.folder / NAME

    def project(self) -> Project:
        """Read the project as it stands now; errors as of `read_project`."""
        return read_project(self.folder)

    def open(self, path: str) -> None:
        """Work on a folder beneath the root from now on; raises InputNotFoundError outside of it."""
        folder = self.inside(path)
        if not folder.is_dir():
            raise InputNotFoundError("is not a folder", "choose from the list", where=folder)
        self.folder = folder
        self.jobs.clear()
        self.preview = ""

    def job(self, name: str) -> Job:
        """A long command of the project that is open."""
        return self.jobs.setdefault(name, Job(self.folder, name))

    def start(self, name: str, arguments: Sequence[str | Path]) -> None:
        """Begin a long command; raises ConfigurationError while it is at work."""
        self.job(name).start(arguments, self.line(arguments))

    def line(self, arguments: Sequence[str | Path], program: str = "photocal") -> str:
        """Command line as a person types it who has opened the window so."""
        return shlex.join([program, *(str(self._typed(one)) for one in arguments)])

    def _typed(self, argument: str | Path) -> str | Path:
        if isinstance(argument, Path) and argument.is_relative_to(self.root):
            return self._given / argument.relative_to(self.root)
        return argument

    def inside(self, path: str) -> Path:
        """Give a file or folder by its path from the root; raises InputNotFoundError outside of it."""
        missing = InputNotFoundError.at(self.root)
        if "\0" in path:
            raise missing("does not contain this path", "choose from the list")
        # Links are followed before it is judged where they lead.
        found = (self.root / path).resolve()
        if not found.is_relative_to(self.root) or not found.exists():
            raise missing("does not contain this path", "choose from the list")
        return found

    def named(self, path: Path) -> str:
        """Name a path from the root, as the page shows it."""
        resolved = path.resolve()
        if not resolved.is_relative_to(self.root):
            return str(path)
        return resolved.relative_to(self.root).as_posix()

    def in_its_language(self, said: dict[str, Any] | None) -> dict[str, Any] | None:
        """What a command has said, if it was in the language of the window; None otherwise."""
        return said if said is not None and said.get("language", "en") == self.language else None

    def shown(self) -> dict[str, Any]:
        """What the page says of itself."""
        return {"root": str(self._given), "folder": self.named(self.folder), "file": self.file.is_file()}
