"""One document in every form: terminal, Markdown, HTML, PDF and JSON say the same."""

from __future__ import annotations

import datetime as dt
import json
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st
from pypdf import PdfReader

from photocal.findings.document import (
    Column,
    Document,
    KeyValues,
    Paragraph,
    Remarks,
    Section,
    Statement,
    TablePart,
    aligned,
    as_json,
    html,
    markdown,
    pdf,
    table,
    text,
)

SECTIONS = (
    Section(
        "Distances",
        (
            Paragraph("Lengths in metres."),
            table(
                "Lines",
                ["line", "length", "remark<"],
                [("a–b", "12.345", "short"), ("b–c", "7.1", "")],
                "By tape.",
            ),
            Remarks(("The first line was measured twice.", "The second was not.")),
            KeyValues((("instrument", "tape"),)),
            Statement("note", "Held", "K₁ was not estimated."),
        ),
    ),
)
WORDS = dict.fromkeys(("table", "figure", "page", "of", "contents"), "word")
DOCUMENT = Document(
    "en", "Survey", "of two lines", "N-1", KeyValues((("Day", "today"),)), (), (), SECTIONS, WORDS
)
# What every form must say; the terminal writes parameters as programs do.
SAID = ("Distances", "Lengths in metres.", "Lines", "12.345", "short", "By tape.", "measured twice", "Held")


def test_terminal() -> None:
    said = text(SECTIONS)
    assert all(part in said for part in SAID)
    assert "line  length  remark\na–b   12.345  short\nb–c      7.1\nBy tape." in said
    assert "* The second was not." in said
    assert "K1 was not estimated" in said


def test_markdown() -> None:
    said = markdown("Survey", SECTIONS)
    assert said.startswith("# Survey\n\n## Distances\n\n")
    assert all(part in said for part in SAID)
    assert "| line | length | remark |\n| --- | --- | --- |\n| a–b | 12.345 | short |" in said
    assert "- The first line was measured twice.\n- The second was not." in said


def test_pages(tmp_path: Path) -> None:
    page = html(DOCUMENT)
    assert all(part in page for part in SAID)
    (tmp_path / "survey.pdf").write_bytes(pdf(DOCUMENT, dt.date(2026, 11, 24)))
    printed = "".join(sheet.extract_text() for sheet in PdfReader(tmp_path / "survey.pdf").pages)
    assert all(part in printed for part in SAID)


def test_json() -> None:
    content = json.loads(json.dumps(as_json(DOCUMENT), allow_nan=False))
    pieces = content["sections"][0]["pieces"]
    assert [piece["kind"] for piece in pieces] == [
        "Paragraph",
        "TablePart",
        "Remarks",
        "KeyValues",
        "Statement",
    ]
    assert pieces[1]["number"] == 1
    assert pieces[1]["rows"][0] == ["a–b", "12.345", "short"]
    assert pieces[2]["texts"] == ["The first line was measured twice.", "The second was not."]


@given(
    st.lists(
        st.tuples(*[st.text(st.characters(categories=["L", "N"]), min_size=1, max_size=9)] * 3), min_size=1
    )
)
def test_every_cell_of_a_column_begins_or_ends_at_one_place(rows: list[tuple[str, str, str]]) -> None:
    columns = (Column("", align="left"), Column("b", "m"), Column("", align="left"))
    lines = aligned(columns, rows).split("\n")
    assert len(lines) == 1 + len(rows)
    first, second = max(len(row[0]) for row in rows), max(5, *(len(row[1]) for row in rows))
    for line, (a, b, c) in zip(lines[1:], rows, strict=True):
        assert line[: first + 2].rstrip() == a
        assert line[first + 2 : first + 2 + second].strip() == b
        assert line[first + second + 4 :] == c


def test_a_table_without_heads_begins_with_its_first_row() -> None:
    given = TablePart("", (Column("", align="left"), Column("")), (("a", "1"), ("bb", "22")))
    assert text([Section("", (given,))]) == "a    1\nbb  22"


@pytest.mark.parametrize("sections", [(), (Section("", ()),), (Section("", (Paragraph(""),)),)])
def test_nothing_is_said_in_no_words(sections: tuple[Section, ...]) -> None:
    assert text(sections) == ""
