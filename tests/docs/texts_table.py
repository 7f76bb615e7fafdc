"""`python -m tests.docs.texts_table`: every text that a user can see, in one table (file, line, text)."""

from __future__ import annotations

import ast
import csv
import io
import json
import re
import sys
import tokenize
from collections.abc import Iterator
from dataclasses import dataclass
from functools import cache
from pathlib import Path

from tests.docs.rooms import PACKAGES, ROOT, modules
from tests.sources import template

# A string of one word is a key or a name; two words and more are read by somebody.
_READ = re.compile(r"[^\W\d_]{2,}[,;:.]?\s+[^\W\d_]{2,}")
_TOML_LINE = re.compile(r"""^\s*["\w.-]+\s*=\s*(["'])(.*)\1\s*$""")
_JSON_TEXT = re.compile(r'("(?:\\.|[^"\\])*")(\s*:)?')
_SCRIPT_TEXT = re.compile(r"""(["'`])((?:\\.|(?!\1)[^\\\n])*)\1""")
_MARKUP_TEXT = re.compile(r'>([^<>{}]+)<|(?:title|placeholder|aria-label|alt)="([^"]+)"')
# The names that a line of a docstring explains: code, not words.
_NAMES = re.compile(r"^ *[a-z_]\w*(, [a-z_]\w*)*(?=:| \()", re.MULTILINE)
# Their docstring is the help of a command.
_COMMANDS = re.compile(r"(?:acquire|photocal)\.commands\.")


@dataclass(frozen=True)
class Text:
    """One text: the file that has it, from the root of the project, and its line there."""

    file: str
    line: int
    text: str


@cache
def texts() -> tuple[Text, ...]:
    """Return all texts: of the packages, their catalogues and pages, and of the documentation."""
    found = list[Text]()
    for name, path in modules().items():
        found += in_python(path.read_text(encoding="utf-8"), _named(path), bool(_COMMANDS.match(name)))
    for package in PACKAGES:
        for path in sorted((ROOT / package).rglob("*")):
            reader = {
                ".toml": _in_toml, ".json": _in_json, ".js": _in_script, ".html": _in_markup
            }.get(path.suffix)  # fmt: skip
            if reader is not None and "vendor" not in path.parts:
                found += reader(path.read_text(encoding="utf-8"), _named(path))
    for path in pages():
        found += in_page(path.read_text(encoding="utf-8"), _named(path))
    return tuple(found)


def pages() -> list[Path]:
    """Return the pages of the documentation, and the README."""
    return sorted([ROOT / "README.md", *(ROOT / "docs").rglob("*.md")])


def _named(path: Path) -> str:
    return path.relative_to(ROOT).as_posix()


def in_python(source: str, file: str, commands: bool = False) -> Iterator[Text]:
    """Find the texts of a module: literals of two words and more, and the help of commands.

    Parameters
    ----------
    source, file
        The module, and how it is named in the table.
    commands
        Whether docstrings are read by users.

    Yields
    ------
    Text
        Of an f-string all its parts are one, with braces where values stand.
    """
    tree = ast.parse(source)
    silent = set[int]()
    for node in ast.walk(tree):
        if isinstance(node, ast.Expr) and isinstance(node.value, ast.Constant) and not commands:
            silent.add(id(node.value))
        if isinstance(node, ast.JoinedStr):
            silent |= {id(part) for part in node.values}
    for node in ast.walk(tree):
        if isinstance(node, ast.JoinedStr):
            text = template(node)
        elif isinstance(node, ast.Constant) and isinstance(node.value, str) and id(node) not in silent:
            text = node.value
        else:
            continue
        if _READ.search(text):
            yield Text(file, node.lineno, " ".join(text.split()))


def remarks(source: str, file: str) -> Iterator[Text]:
    """Find the remarks of a module: docstrings, and comments, of which lines in succession are one."""
    for node in ast.walk(ast.parse(source)):
        if isinstance(node, ast.Expr) and isinstance(node.value, ast.Constant):
            words = _NAMES.sub("", str(node.value.value))
            yield Text(file, node.lineno, " ".join(words.split()))
    begun, last, gathered = 0, 0, list[str]()
    for token in tokenize.generate_tokens(io.StringIO(source).readline):
        if token.type == tokenize.COMMENT:
            if gathered and token.start[0] > last + 1:
                yield Text(file, begun, " ".join(gathered))
                gathered = []
            begun, last = begun if gathered else token.start[0], token.start[0]
            gathered.append(token.string.lstrip("# "))
    if gathered:
        yield Text(file, begun, " ".join(gathered))


def _in_toml(source: str, file: str) -> Iterator[Text]:
    for number, line in enumerate(source.splitlines(), 1):
        match = _TOML_LINE.match(line)
        if match and match[2]:
            yield Text(file, number, match[2])


def _in_json(source: str, file: str) -> Iterator[Text]:
    for number, line in enumerate(source.splitlines(), 1):
        yield from (
            Text(file, number, json.loads(match[1])) for match in _JSON_TEXT.finditer(line) if not match[2]
        )


def _in_script(source: str, file: str) -> Iterator[Text]:
    for number, line in enumerate(source.splitlines(), 1):
        if not line.lstrip().startswith(("//", "*", "/*")):
            yield from (
                Text(file, number, match[2])
                for match in _SCRIPT_TEXT.finditer(line)
                if _READ.search(match[2])
            )


def _in_markup(source: str, file: str) -> Iterator[Text]:
    for number, line in enumerate(source.splitlines(), 1):
        for match in _MARKUP_TEXT.finditer(line):
            text = (match[1] or match[2]).strip()
            if text:
                yield Text(file, number, text)


def in_page(source: str, file: str) -> Iterator[Text]:
    """Find the texts of a page: paragraphs as one line, rows of tables and lines of blocks one by one."""
    begun, gathered, block = 0, list[str](), False
    for number, line in enumerate([*source.splitlines(), ""], 1):
        fence = line.lstrip().startswith("```")
        alone = block or fence or not line.strip() or line.lstrip().startswith(("|", "#", "- ", "    "))
        if gathered and alone:
            yield Text(file, begun, " ".join(" ".join(gathered).split()))
            gathered = []
        if fence:
            block = not block
        elif line.lstrip().startswith("- ") and not block:
            begun, gathered = number, [line]
        elif alone and line.strip():
            yield Text(file, number, line.strip())
        elif line.strip():
            begun = begun if gathered else number
            gathered.append(line)


def main() -> None:
    """Write the table as CSV to standard output."""
    table = csv.writer(sys.stdout)
    table.writerow(("file", "line", "text"))
    table.writerows((one.file, one.line, one.text) for one in texts())


if __name__ == "__main__":
    main()
