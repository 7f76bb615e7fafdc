"""Folders that the window is opened on: a rendered flight as it comes home, and one that was processed."""

from __future__ import annotations

import datetime as dt
import shutil
import subprocess
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest

from photocal.base.progress import quiet
from photocal.block.project import read_project
from photocal.run.campaign import run_project
from photocal.run.new_project import new_project
from tests.conftest import Once
from tests.photocal.desk.client import Client, opened
from tests.photocal.desk.served import free_port, serving_at
from tests.photocal.run.typed_site import site_folder

# Names that would be code, if any page read them as HTML.
HOSTILE = "<img src=x onerror=alert(1)>"


def fresh(once: Once, folder: Path, name: str, **choices: object) -> Path:
    """A rendered flight of eight pictures with a control list, copied from where it was made once."""

    def fill(where: Path) -> None:
        (where / "rendered").mkdir()
        site_folder(where / "rendered", where / "site", **choices)  # type: ignore[arg-type]

    return Path(shutil.copytree(once(name, fill) / "site", folder))


@pytest.fixture(autouse=True)
def own_settings(tmp_path_factory: pytest.TempPathFactory, monkeypatch: pytest.MonkeyPatch) -> None:
    """Keys of tests are nobody's keys."""
    monkeypatch.setenv("XDG_CONFIG_HOME", str(tmp_path_factory.mktemp("settings")))


@pytest.fixture(scope="session")
def finished(once: Once) -> Path:
    """The same flight after a run; to be copied, not changed."""

    def fill(where: Path) -> None:
        site = fresh(once, where / "site", "desk-site", positions=True)
        made = new_project(site, height="orthometric")
        run_project(read_project(made.path), dt.date(2026, 5, 1), quiet)

    return once("desk-finished", fill) / "site"


@pytest.fixture
def home(once: Once, tmp_path: Path) -> Path:
    """A folder of folders: a flight, and one with a name that would be code."""
    folder = tmp_path / "home"
    folder.mkdir()
    fresh(once, folder / "site", "desk-site", positions=True)
    (folder / HOSTILE).mkdir()
    (folder / HOSTILE / "notes.txt").write_text("nothing")
    return folder


@pytest.fixture
def window(home: Path, tmp_path: Path) -> Iterator[Client]:
    """The window, opened on it."""
    with opened(home, tmp_path / "cache") as client:
        yield client


@pytest.fixture
def port() -> int:
    return free_port()


@pytest.fixture
def serve(port: int) -> Iterator[Callable[[Path], subprocess.Popen[str]]]:
    with serving_at(port) as start:
        yield lambda folder: start("desk", folder)
