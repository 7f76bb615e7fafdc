"""The window's server: its files are there, nothing outside of the folder is shown, nobody else is let in."""

from __future__ import annotations

import json
import re
from collections.abc import Iterator
from pathlib import Path

import pytest

from photocal.run.output_place import STAGES
from tests.photocal.desk.client import Client, opened

PAGE = Path(__file__).parents[3] / "photocal" / "desk" / "page"
CATALOGUES = sorted(PAGE.rglob("texts.json"))
# Keys that are put together of a name: all with this beginning are there.
MADE_OF_NAMES = re.compile(r"say\(`([a-z_.-]+)\$\{")


@pytest.fixture
def client(tmp_path: Path) -> Iterator[Client]:
    folder = tmp_path / "flight"
    folder.mkdir()
    with opened(folder, tmp_path / "cache") as asked:
        yield asked


def test_every_file_that_a_module_imports_is_served(client: Client) -> None:
    waiting, seen = ["/", "/desk.js"], set[str]()
    while waiting:
        path = waiting.pop()
        if path in seen:
            continue
        seen.add(path)
        answer = client.get(path)
        assert answer.status == 200, path
        if path.endswith(".js") and not path.startswith("/vendor/"):
            found = re.findall(r"(?:from|import\() ?[\"']([^\"']+)[\"']", answer.text)
            base = path.rpartition("/")[0]
            waiting += [str(Path("/", base, name).resolve()) if name[0] == "." else name for name in found]
    assert "/dom.js" in seen


def texts() -> dict[str, list[str]]:
    found: dict[str, list[str]] = {}
    for path in CATALOGUES:
        content = json.loads(path.read_text(encoding="utf-8"))
        assert not found.keys() & content.keys()
        found |= content
    return found


def test_each_text_is_there_in_both_languages_with_the_same_values() -> None:
    for key, pair in texts().items():
        assert len(pair) == 2, key
        assert all(pair), key
        english, portuguese = (sorted(re.findall(r"\{\w+\}", text)) for text in pair)
        assert english == portuguese, key


def test_every_text_that_the_page_says_is_in_the_catalogue() -> None:
    known = texts()
    for path in sorted(PAGE.rglob("*.js")):
        source = path.read_text(encoding="utf-8")
        for key in re.findall(r"\bsay\(\"([^\"]+)\"", source):
            assert key in known, f"{path.name}: {key}"
        for beginning in MADE_OF_NAMES.findall(source):
            assert any(key.startswith(beginning) for key in known), f"{path.name}: {beginning}"


def test_every_word_of_how_a_step_stands_is_in_the_catalogue() -> None:
    source = (PAGE.parent / "standing.py").read_text(encoding="utf-8")
    words = set(re.findall(r'"(stands\.[a-z]+)"', source))
    words |= {f"stands.{name}" for name in ("busy", "failed", "stopped")}
    words |= {f"stands.found-{state}" for state in ("good", "warn", "bad")}
    assert len(words) > 10
    assert words <= texts().keys()


def test_every_stage_has_its_name_in_the_catalogue() -> None:
    assert {f"stage.{name}" for name in STAGES} <= texts().keys()


def test_every_work_within_a_stage_has_its_title_in_the_catalogue() -> None:
    titles = set[str]()
    for room in ("run", "measurement"):
        for path in (PAGE.parents[1] / room).glob("*.py"):
            titles |= set(re.findall(r'\b(?:progress|show)\("([^"]+)"', path.read_text(encoding="utf-8")))
    assert "matching pairs of images" in titles
    assert {f"work.{title}" for title in titles} <= texts().keys()


def test_nothing_in_the_page_reads_text_as_html() -> None:
    for path in sorted(PAGE.rglob("*.js")):
        source = path.read_text(encoding="utf-8")
        forbidden = r"innerHTML|outerHTML|insertAdjacentHTML|document\.write|\beval\(|new Function"
        assert not re.search(forbidden, source), path.name
