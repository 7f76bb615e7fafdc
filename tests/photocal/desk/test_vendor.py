"""Libraries of the page are those that are listed, byte for byte, each with its licence."""

from __future__ import annotations

import hashlib
import tomllib
from pathlib import Path

import pytest

from tests.vendor import LISTS, ROOT, kept

ALLOWED = {"MIT", "BSD-2-Clause", "BSD-3-Clause", "MPL-2.0"}


@pytest.mark.parametrize("path", LISTS, ids=lambda path: path.relative_to(ROOT).as_posix())
def test_files_are_those_of_the_list(path: Path) -> None:
    listed = tomllib.loads(path.read_text(encoding="utf-8"))
    files = {name: entry for library in listed.values() for name, entry in library["files"].items()}
    there = {file.name for file in path.parent.iterdir()} - {path.name}
    assert there == set(files)
    for name, entry in files.items():
        assert hashlib.sha256((path.parent / name).read_bytes()).hexdigest() == entry["sha256"], name


@pytest.mark.parametrize("path", LISTS, ids=lambda path: path.relative_to(ROOT).as_posix())
def test_each_library_has_its_version_and_licence(path: Path) -> None:
    for name, library in tomllib.loads(path.read_text(encoding="utf-8")).items():
        assert library["licence"] in ALLOWED, name
        assert [file for file in library["files"] if file.endswith("-licence.txt")], name


def test_a_change_that_does_not_fit_any_more_is_an_error() -> None:
    entry = {"from": "a.js", "change": ["from 'three'", "from './three.js'"]}
    assert kept(b"import x from 'three';", entry) == b"import x from './three.js';"
    with pytest.raises(ValueError, match="once"):
        kept(b"import x from 'four';", entry)
