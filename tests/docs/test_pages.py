"""Pages of docs/ and the README: commands as the programs say, links that lead somewhere."""

from __future__ import annotations

import json
import re
from pathlib import Path
from types import ModuleType

import pytest

from photocal.adjustment.mounting import COMMON
from photocal.analysis.stability.methods import methods
from photocal.base import errors
from photocal.base.checked_toml import Table
from photocal.block import camera_setup, project, setup
from photocal.geometry.camera import PARAMETERS
from tests.docs import evidence_page, fault_page, gallery_page, picture_page, site
from tests.docs.command_pages import FOLDER, MORE, commands, pages

ROOT = Path(__file__).parents[2]
PAGES = sorted([ROOT / "README.md", ROOT / "CHANGELOG.md", *(ROOT / "docs").rglob("*.md")])
WANTED = pages()


def test_command_pages_are_those_of_the_programs() -> None:
    assert {path.name for path in FOLDER.glob("*.md")} == set(WANTED), "run `make manual`"


@pytest.mark.parametrize("name", sorted(WANTED))
def test_command_page_says_what_the_program_says(name: str) -> None:
    assert (FOLDER / name).read_text(encoding="utf-8") == WANTED[name], "run `make manual`"


def test_page_of_faults_is_that_of_the_table() -> None:
    assert picture_page.PAGE.read_text(encoding="utf-8") == picture_page.page(), "run `make manual`"
    assert fault_page.PAGE.read_text(encoding="utf-8") == fault_page.page(), "run `make manual`"


def test_lists_of_evidence_and_examples_are_those_of_the_folders() -> None:
    assert evidence_page.PAGE.read_text(encoding="utf-8") == evidence_page.page(), "run `make manual`"
    shown = gallery_page.without_output(gallery_page.PAGE.read_text(encoding="utf-8"))
    assert shown == gallery_page.page(), "run `make manual`"


def test_every_command_says_what_it_does_and_shows_an_example() -> None:
    every = {one.name: one for one in commands()}
    assert set(MORE) <= set(every)
    for name, one in every.items():
        assert len(one.summary) < 110, name
        if not hasattr(one.command, "commands"):
            assert "```sh" in WANTED[one.page], name


def test_examples_begin_with_their_command() -> None:
    for one in commands():
        for block in re.findall(r"```sh\n(.*?)```", WANTED[one.page], re.DOTALL):
            assert one.name in block.splitlines()[0], one.name


@pytest.mark.parametrize("page", PAGES, ids=lambda page: str(page.relative_to(ROOT)))
def test_links_lead_somewhere(page: Path) -> None:
    broken = [link for link in _links(page) if not _leads(page, link)]
    assert broken == []


def test_the_site_lists_every_page() -> None:
    listed = set(re.findall(r"'([^']+\.md)'", str(site.navigation())))
    assert listed == {path.relative_to(ROOT).as_posix() for path in (*PAGES, *ROOT.glob("*.md"))}


def test_the_site_is_searched_without_a_network(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """The theme takes a script for it from the network, unless the site has one of that name."""
    monkeypatch.setattr(site, "BUILD", tmp_path)
    made = json.loads(site.stage().read_text(encoding="utf-8"))
    (script,) = made["extra"]["polyfills"]
    assert "iframe-worker" in script
    assert (tmp_path / made["docs_dir"] / script).is_file()


def test_a_broken_link_is_seen(tmp_path: Path) -> None:
    (tmp_path / "there.md").write_text("# Some Title: and `code`\n")
    page = tmp_path / "page.md"
    page.write_text("[a](there.md#some-title-and-code) [b](nowhere.md) [c](there.md#other) ![d](none.png)\n")
    assert [link for link in _links(page) if not _leads(page, link)] == [
        "nowhere.md",
        "there.md#other",
        "none.png",
    ]


def test_every_page_is_reached_from_the_readme() -> None:
    seen: set[Path] = set()
    waiting = [ROOT / "README.md"]
    while waiting:
        page = waiting.pop()
        if page in seen or page.suffix != ".md":
            continue
        seen.add(page)
        for link in _links(page):
            target = (page.parent / link.split("#")[0]).resolve()
            waiting += sorted(target.glob("*.md")) if target.is_dir() else [target]
    assert set(PAGES) - seen == set()


def test_the_readme_is_short() -> None:
    assert len((ROOT / "README.md").read_text(encoding="utf-8").splitlines()) < 150


def test_figures_of_the_readme_stand_on_the_pages_behind_them() -> None:
    """A figure in bold is followed by the page that it was taken from."""
    text = (ROOT / "README.md").read_text(encoding="utf-8")
    cited = re.findall(r"\*\*(\S*\d[^*]*)\*\*[^\n]*?\]\((docs/evidence/[^)#]+)\)", text)
    assert len(cited) > 10
    for figure, page in cited:
        assert figure in (ROOT / page).read_text(encoding="utf-8"), f"{figure} is not in {page}"


def _links(page: Path) -> list[str]:
    text = re.sub(r"```.*?```", "", page.read_text(encoding="utf-8"), flags=re.DOTALL)
    found = re.findall(r"\]\(([^)\s]+)\)", text) + re.findall(r'(?:src|href)="([^"]+)"', text)
    return [link for link in found if not link.startswith(("http://", "https://"))]


def _leads(page: Path, link: str) -> bool:
    path, _, place = link.partition("#")
    target = page.parent / path if path else page
    if not target.exists():
        return False
    return not place or place in _places(target)


def _places(page: Path) -> set[str]:
    """Names of the headings as code hosts make them."""
    headings = re.findall(r"^#+ (.+)$", page.read_text(encoding="utf-8"), re.MULTILINE)
    return {re.sub(r"[^\w\- ]", "", heading.lower()).replace(" ", "-") for heading in headings}


def test_exit_codes_are_those_of_the_errors() -> None:
    page = (ROOT / "docs" / "exit-codes.md").read_text(encoding="utf-8")
    told = set(re.findall(r"^\| (\d+) \|", page, re.MULTILINE))
    classes = [one for one in vars(errors).values() if isinstance(one, type)]
    ours = {one.exit_code for one in classes if issubclass(one, errors.PhotocalError)}
    # 0 and 2 are those of every command line.
    assert {int(code) for code in told} == ours | {0, 2}


def test_targets_of_make_that_are_named_exist() -> None:
    targets = set(
        re.findall(r"^([a-z][\w-]*):", (ROOT / "Makefile").read_text(encoding="utf-8"), re.MULTILINE)
    )
    for page in PAGES:
        named = set(re.findall(r"make ([a-z]+(?:-[a-z0-9]+)*)`", page.read_text(encoding="utf-8")))
        assert named <= targets, page.name


def test_symbols_that_are_printed_are_explained() -> None:
    text = (ROOT / "docs" / "nomenclature.md").read_text(encoding="utf-8")
    for letter, first, last in re.findall(r"([KPB])(\d)-[KPB](\d)", text):
        text += " ".join(f" {letter}{k}" for k in range(int(first), int(last) + 1))
    words = set(re.findall(r"\w+", text))
    comparisons = {method.name for method in methods(2, (), 1, 0)}
    mounting = {name for name in COMMON if name[-2:] not in ("_y", "_z")}
    assert {*PARAMETERS, *comparisons, *mounting} - words == set()


@pytest.mark.parametrize(
    ("page", "modules"),
    [("block-folder", (setup, camera_setup)), ("project-file", (project,))],
    ids=["block-folder", "project-file"],
)
def test_every_key_of_a_file_stands_on_its_page(page: str, modules: tuple[ModuleType, ...]) -> None:
    words = set(re.findall(r"\w+", (ROOT / "docs" / f"{page}.md").read_text(encoding="utf-8")))
    tables = [
        one
        for module in modules
        for one in vars(module).values()
        if isinstance(one, type)
        and issubclass(one, Table)
        and one.__module__ == module.__name__
        # What other files say besides is passed over: those are results, not what a person writes.
        and one.model_config["extra"] == "forbid"
    ]
    assert len(tables) >= 5
    keys = {field.alias or name for table in tables for name, field in table.model_fields.items()}
    assert keys - words == set()
