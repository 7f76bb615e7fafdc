"""One finished project for all tests of Look: eight pictures, six targets, a mark that is 12 px off."""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

from photocal.desk.views.shown import Shown, read_shown
from tests.conftest import Once
from tests.photocal.desk.look.surveys import small


@pytest.fixture(scope="session")
def made(once: Once) -> Path:
    """The project, run to its certificate; nobody changes it."""

    def fill(folder: Path) -> None:
        small(folder / "site")
        command = [sys.executable, "-m", "photocal", "run", str(folder / "site")]
        own = {**os.environ, "XDG_CONFIG_HOME": str(folder / "settings")}
        done = subprocess.run(command, capture_output=True, text=True, check=False, env=own)
        assert done.returncode == 0, done.stderr

    return once("look-site", fill) / "site"


@pytest.fixture(scope="session")
def shown(made: Path) -> Shown:
    return read_shown(made / "work")


@pytest.fixture
def finished(made: Path, tmp_path: Path) -> Path:
    """A copy of the project, to be changed."""
    folder = tmp_path / "site"
    shutil.copytree(made, folder, symlinks=True)
    return folder
