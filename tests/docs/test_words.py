"""The words of the glossary: no text, comment or docstring has a home-made phrase."""

from __future__ import annotations

import re

import pytest

from tests.docs.rooms import ROOT, modules
from tests.docs.texts_table import Text, in_page, in_python, remarks, texts

GLOSSARY = ROOT / "docs" / "nomenclature.md"
# Columns of the tables of terms.
COLUMNS = ["term", "symbol", "unit", "meaning", "do not say", "source"]
SOURCES = {"ISO 19159-1", "ASPRS 2024", "Luhmann", "Förstner/Wrobel", "RTKLIB", "MAVLink"}


def rows(first: str) -> list[list[str]]:
    """Rows of all tables of the glossary whose head begins with a word."""
    found, inside = list[list[str]](), False
    for line in GLOSSARY.read_text(encoding="utf-8").splitlines():
        cells = [cell.strip() for cell in line.strip("|").split("|")] if line.startswith("|") else []
        if not cells or set(line) <= set("|-"):
            inside = inside and bool(cells)
        elif cells[0] == first:
            inside = cells == COLUMNS or first != "term"
        elif inside:
            found.append(cells)
    return found


def banned() -> list[str]:
    """Phrases that the glossary bans."""
    return [phrase.strip() for cells in rows("do not write") for phrase in cells[0].split(",")]


def offences(listed: list[Text], phrases: list[str]) -> list[str]:
    """Texts that have one of the phrases as whole words, whatever their case."""
    pattern = re.compile(rf"(?<![\w-])(?:{'|'.join(map(re.escape, phrases))})(?![\w-])", re.IGNORECASE)
    return [
        f"{one.file}:{one.line}: {match[0]!r} in {one.text[:120]!r}"
        for one in listed
        if one.file != "docs/nomenclature.md" and (match := pattern.search(one.text))
    ]


def test_no_text_has_a_home_made_phrase() -> None:
    assert offences(list(texts()), banned()) == []


@pytest.mark.parametrize("phrase", banned())
def test_an_inserted_phrase_is_seen(phrase: str) -> None:
    source = f'def f(n):\n    """No {phrase}."""\n    raise ValueError(f"The point {phrase} {{n}}")\n'
    found = [*in_python(source, "a.py"), *in_page(f"# Title\n\nSome words\n{phrase} a line\n", "a.md")]
    assert [one.split(": ")[0] for one in offences(found, banned())] == ["a.py:3", "a.md:3"]


def test_no_comment_and_no_docstring_has_a_home_made_phrase() -> None:
    listed = [
        one
        for path in modules().values()
        for one in remarks(path.read_text(encoding="utf-8"), path.relative_to(ROOT).as_posix())
    ]
    assert offences(listed, banned()) == []


@pytest.mark.parametrize("phrase", banned())
def test_an_inserted_phrase_is_seen_in_comments_and_docstrings(phrase: str) -> None:
    broken = phrase.replace(" ", "\n    # ", 1)
    source = (
        f'def f(n):\n    """No {phrase}.\n\n    sought: a name.\n    """\n\n    # A {broken}.\n    return n\n'
    )
    found = offences(list(remarks(source, "a.py")), banned())
    assert [one.split(": ")[0] for one in found] == ["a.py:2", "a.py:7"]


def test_every_kind_of_text_is_read() -> None:
    kinds = {one.file.rpartition(".")[2] for one in texts()}
    assert kinds == {"py", "toml", "json", "js", "html", "md"}
    files = {one.file for one in texts()}
    assert {f"photocal/findings/findings_{one}.toml" for one in ("en", "pt-BR")} <= files
    assert {"photocal/desk/page/texts.json", "acquire/monitor/monitor.js", "docs/guide/desk.md"} <= files


def test_every_term_has_a_meaning_and_a_source() -> None:
    terms = rows("term")
    assert 30 <= len(terms) <= 45
    assert len({cells[0] for cells in terms}) == len(terms)
    for cells in terms:
        assert len(cells) == len(COLUMNS), cells
        assert all((cells[3], cells[4], cells[5] in SOURCES)), cells
