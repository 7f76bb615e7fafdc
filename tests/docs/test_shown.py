"""No picture of the docs is older than the page that it shows; `python -m tests.docs` makes them anew."""

from __future__ import annotations

import shutil
from pathlib import Path

import pytest

from tests.docs import shown


@pytest.mark.parametrize("picture", shown.sources(), ids=lambda path: path.name)
def test_a_picture_shows_its_page_as_it_is(picture: Path) -> None:
    assert shown.shown(picture) == shown.fingerprint(shown.sources()[picture])


def test_a_changed_page_is_seen(tmp_path: Path) -> None:
    page = shown.sources()[shown.MONITOR]
    copied = tmp_path / "page"
    shutil.copytree(page, copied, ignore=shutil.ignore_patterns("__pycache__"))
    assert shown.fingerprint(copied) == shown.fingerprint(page)
    sheet = next(copied.glob("*.css"))
    sheet.write_text(sheet.read_text(encoding="utf-8").replace("margin", "padding", 1), encoding="utf-8")
    assert shown.fingerprint(copied) != shown.fingerprint(page)
