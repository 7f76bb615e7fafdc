"""Sentences of the front page and the guide are short enough to be understood at first reading."""

from __future__ import annotations

import re
from collections.abc import Iterator
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
PAGES = [ROOT / "README.md", *sorted((ROOT / "docs" / "guide").glob("*.md"))]
MOST_WORDS = 25


def parts(text: str) -> Iterator[str]:
    """Paragraphs, items of lists and cells of tables, without code and what is made from other pages."""
    text = re.sub(r"```.*?```|<!-- (\w+) -->.*?<!-- /\1 -->|<[^>]*>", "", text, flags=re.DOTALL)
    for block in re.split(r"\n\s*\n", text):
        if block.startswith("    "):
            continue
        if block.lstrip().startswith("|"):
            yield from block.replace("\n", "|").split("|")
        else:
            yield from re.split(r"\n(?=\s*(?:[-*]|\d+\.) )", block)


def sentences(text: str) -> Iterator[str]:
    for part in parts(text):
        if not part.strip():
            continue
        plain = re.sub(r"!?\[([^\]]*)\]\([^)]*\)", r"\1", " ".join(part.split()))
        yield from re.split(r"(?<=[.!?:;])\s+(?=[A-Z`\"(*\d])", plain)


def words(sentence: str) -> int:
    return sum(re.search(r"\w", word) is not None for word in sentence.split())


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.name)
def test_no_sentence_is_longer_than_25_words(page: Path) -> None:
    found = list(sentences(page.read_text(encoding="utf-8")))
    assert len(found) > 5
    assert [one for one in found if words(one) > MOST_WORDS] == []


def test_a_long_sentence_is_found() -> None:
    long = " ".join(["word"] * 26)
    assert [words(one) for one in sentences(f"Short one. L{long[1:]}.\n\n```sh\n{long} {long}\n```\n")] == [
        2,
        26,
    ]
