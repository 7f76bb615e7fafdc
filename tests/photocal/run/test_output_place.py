"""Where a project may write: neither into a root nor among pictures, blocks and files of others."""

from __future__ import annotations

from pathlib import Path

import pytest

from photocal.base.errors import ConfigurationError
from photocal.block.project import read_project
from photocal.run.output_place import STAGES, check_output

PROJECT = """
[project]
name = "field"
crs = "local"
height = "local"
output = {output!r}
"""
PICTURES = '[images]\nfolder = "images"\n'
BLOCK = '[measurements]\nblock = "block"\n'


def told(folder: Path, output: str, more: str = PICTURES) -> str:
    for name in ("images", "block"):
        (folder / name).mkdir(parents=True, exist_ok=True)
    (folder / "project.toml").write_text(PROJECT.format(output=output) + more, encoding="utf-8")
    return check_output(read_project(folder))


@pytest.mark.parametrize(
    ("output", "more", "why"),
    [
        ("/", PICTURES, "is the root of a disk"),
        (".", PICTURES, "holds the project itself"),
        ("..", PICTURES, "holds the project itself"),
        ("images", PICTURES, "holds the pictures"),
        ("images/../images/.", PICTURES, "holds the pictures"),
        ("block", BLOCK, "and the block folder: one contains the other"),
        ("block/work", BLOCK, "and the block folder: one contains the other"),
    ],
)
def test_it_is_refused(output: str, more: str, why: str, tmp_path: Path) -> None:
    with pytest.raises(ConfigurationError, match=why) as refused:
        told(tmp_path / "field", output, more)
    assert str(tmp_path / "field" / "project.toml") in str(refused.value)


def test_the_home_folder_is_refused(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("HOME", str(tmp_path / "home"))
    monkeypatch.setenv("USERPROFILE", str(tmp_path / "home"))
    (tmp_path / "home").mkdir()
    with pytest.raises(ConfigurationError, match="your home folder"):
        told(tmp_path / "field", "../home")


def test_a_link_to_the_pictures_is_the_pictures(tmp_path: Path) -> None:
    told(tmp_path, "work")
    (tmp_path / "link").symlink_to(tmp_path / "images")
    with pytest.raises(ConfigurationError, match="holds the pictures"):
        told(tmp_path, "link")


def test_files_of_others_are_not_mixed_with(tmp_path: Path) -> None:
    (tmp_path / "taxes").mkdir()
    (tmp_path / "taxes" / "2026.pdf").write_bytes(b"%PDF")
    with pytest.raises(ConfigurationError, match=r"contains files that no run has written, first 2026\.pdf"):
        told(tmp_path, "taxes")


def test_its_own_folder_is_taken_whatever_lies_in_it(tmp_path: Path) -> None:
    assert told(tmp_path, "work") == ""
    (tmp_path / "work").mkdir()
    assert told(tmp_path, "work") == ""
    (tmp_path / "work" / ".stages").mkdir()
    (tmp_path / "work" / "notes.txt").write_text("of the crew", encoding="utf-8")
    assert told(tmp_path, "work") == ""


def test_what_an_older_run_has_published_is_its_own(tmp_path: Path) -> None:
    for name in STAGES:
        (tmp_path / "work" / name).mkdir(parents=True)
    assert told(tmp_path, "work") == ""


def test_a_folder_outside_is_told_of(tmp_path: Path) -> None:
    where = told(tmp_path / "field", "../elsewhere")
    assert where == f"the results go outside the project, into {tmp_path / 'elsewhere'}"
