"""Files that people and programs damage: of each some dozen versions that are wrong in one place."""

from __future__ import annotations

import codecs
import re
from collections.abc import Iterator
from pathlib import Path

# What stands in place of a value, whatever the key is.
_VALUES = {
    "text": '"x"',
    "empty text": '""',
    "negative": "-1",
    "zero": "0",
    "huge": "1e300",
    "beyond": "1e400",
    "nan": "nan",
    "infinite": "inf",
    "whole and huge": "9" * 30,
    "list": "[1, 2, 3]",
    "nested": "[[[[]]]]",
    "table": "{ a = 1 }",
    "date": "2026-05-01",
    "boolean": "true",
    "escapes": '"\\u001b[31m\\u0000\\n"',
    "long": '"' + "x" * 100_000 + '"',
}
_CELLS = {
    "NaN": "nan",
    "infinite": "inf",
    "huge": "1e300",
    "beyond": "1e400",
    "empty": "",
    "text": "abc",
    "zero": "0",
    "negative": "-1",
    "quote": '"',
    "formula": "=cmd|x!A1",
    "NUL": "\0",
    "long": "9" * 100_000,
}


def octets(whole: bytes) -> Iterator[tuple[str, bytes]]:
    """Versions of any file."""
    text = whole.decode()
    yield "empty", b""
    yield "blank", b"\n \n"
    yield "half", whole[: len(whole) // 2]
    yield "a NUL", whole[: len(whole) // 3] + b"\0" + whole[len(whole) // 3 :]
    yield "all NUL", bytes(len(whole))
    yield "UTF-16", text.encode("utf-16")
    yield "UTF-16 without mark", text.encode("utf-16-le")
    yield "UTF-32", text.encode("utf-32")
    yield "mark", codecs.BOM_UTF8 + whole
    yield "two marks", 2 * codecs.BOM_UTF8 + whole
    yield "Latin", whole + b"\n# \xe9\xff\n"
    yield "old line ends", whole.replace(b"\n", b"\r")
    yield "JSON", b'{"a": 1}'
    yield "twice", whole + b"\n" + whole


def of_toml(whole: bytes) -> Iterator[tuple[str, bytes]]:
    """Versions of a file of keys: each key without, and with another value."""
    yield from octets(whole)
    lines = whole.decode().splitlines()
    keys = [k for k, line in enumerate(lines) if re.match(r"\w+ *=", line)]
    for k in keys:
        name = lines[k].split("=")[0].strip()
        yield f"without {name}", "\n".join(lines[:k] + lines[k + 1 :]).encode()
    for k, (what, value) in ((k, item) for k in keys for item in _VALUES.items()):
        name = lines[k].split("=")[0].strip()
        other = [*lines[:k], f"{name} = {value}", *lines[k + 1 :]]
        yield f"{name}: {what}", ("\n".join(other) + "\n").encode()


def of_table(whole: bytes) -> Iterator[tuple[str, bytes]]:
    """Versions of a table: its head, its columns, and cells of its second row."""
    yield from octets(whole)
    head, *rows = whole.decode().splitlines()
    names = head.split(",")
    yield "100000 columns", ",".join([*names, *(f"c{k}" for k in range(100_000))]).encode() + b"\n1\n"
    yield "no head", "\n".join(rows).encode()
    yield "head alone", head.encode()
    yield "column twice", "\n".join(",".join((row, row.split(",")[0])) for row in (head, *rows)).encode()
    for k, name in enumerate(names):
        cut = [",".join(c for j, c in enumerate(row.split(",")) if j != k) for row in (head, *rows)]
        yield f"without {name}", "\n".join(cut).encode()
        for what, value in _CELLS.items():
            cells = rows[1].split(",")
            cells[k] = value
            yield f"{name}: {what}", "\n".join([head, rows[0], ",".join(cells), *rows[2:], ""]).encode()


def versions(path: Path) -> Iterator[tuple[str, bytes]]:
    """All of a file, by what is wrong with each."""
    whole = path.read_bytes()
    return of_toml(whole) if path.suffix == ".toml" else of_table(whole)
