"""The survey with painted targets, for the place Mark."""

from __future__ import annotations

import shutil
from pathlib import Path

import pytest

from tests.photocal.measurement.marking.conftest import Survey, fly


@pytest.fixture(scope="session")
def flown(tmp_path_factory: pytest.TempPathFactory) -> Survey:
    return fly(tmp_path_factory.mktemp("survey") / "field")


@pytest.fixture
def survey(flown: Survey, tmp_path: Path) -> Survey:
    """A copy of the survey without marks."""
    folder = tmp_path / "field"
    shutil.copytree(flown.folder, folder)
    return Survey(folder, flown.site, flown.points)
