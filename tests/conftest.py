"""Fixtures that all tests share."""

from __future__ import annotations

import os
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parent.parent


@pytest.fixture(scope="session")
def shared() -> Path:
    """Folder with the recorded data and the published figures, beside the project."""
    folder = Path(os.environ.get("PHOTOCAL_SHARED", ROOT.parent / "shared"))
    if not (folder / "data").is_dir():
        reason = f"recorded data not found in {folder.name}/ beside the project (or in $PHOTOCAL_SHARED)"
        if os.environ.get("CI") == "true":
            pytest.fail(reason)
        pytest.skip(reason)
    return folder
