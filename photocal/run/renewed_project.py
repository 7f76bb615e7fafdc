"""A project file made again: a person's answers and comments stay, what was found since is added."""

import csv
import difflib
import io
from collections.abc import Collection, Mapping
from pathlib import Path
from typing import Any

import tomlkit
from tomlkit.items import AoT, Table

from photocal.base.codec import toml_document
from photocal.base.files import rows_text
from photocal.block.project import ASKED, NAME
from photocal.exchange.source import read_text

# What tells entries of a list of tables apart.
_IDS = {"camera": "id", "head": "camera"}


def written_before(folder: Path) -> tuple[Path, ...]:
    """Tables that the project file of a folder names: they are no sources, but what came of them."""
    path = folder / NAME
    if not path.exists():
        return ()
    content = toml_document(path)
    named = [
        content.get(section, {}).get(key)
        for section, key in (("control", "points"), ("control", "marks"), ("images", "pictures"))
    ]
    return tuple(folder / str(name) for name in named if name)


def answered_height(folder: Path) -> str:
    """Kind of heights that the project file of a folder states; "" where it is still to be filled in."""
    path = folder / NAME
    if not path.exists():
        return ""
    stated = str(toml_document(path).get("project", {}).get("height", ASKED))
    return "" if stated == ASKED else stated


def renewed(
    folder: Path, files: Mapping[str, str], moved: Collection[str] = ()
) -> tuple[dict[str, str], tuple[str, ...]]:
    """Give the files as they become, and the lines of the project file that change.

    Keys that stand there stay as they are, but those still to be filled in. Tables of control and marks are
    written anew where the project file did not have them, or only where nobody has changed them: rows that
    are there stay, new ones are added.

    moved: tables of marks that a person has said to lie elsewhere.
    """
    path = folder / NAME
    before = path.read_text(encoding="utf-8")
    document, found = toml_document(path), tomlkit.parse(files[NAME])
    _merge(document, found)
    after = tomlkit.dumps(document)
    lines = difflib.unified_diff(before.splitlines(), after.splitlines(), lineterm="", n=0)
    changes = [
        line for line in lines if line[:1] in "+-" and line[:3] not in ("+++", "---") and line[1:].strip()
    ]
    made = {NAME: after}
    for name, content in files.items():
        if name == NAME:
            continue
        merged, added = _rows(folder / name, content)
        if name in moved:
            merged, elsewhere = _moved(merged, content)
            added = [*elsewhere, *added]
        made[name] = merged
        changes += [f"+ {name}: {row}" for row in added]
    return made, tuple(changes)


def differing(folder: Path, files: Mapping[str, str], moved: Collection[str] = ()) -> dict[str, list[str]]:
    """Points, by the tables that keep them, whose places are by now others in the list that was read."""
    found = {}
    for name in files.keys() - {NAME, *moved}:
        if (folder / name).exists():
            there, now = _places(kept_text(folder / name)), _places(files[name])
            found[name] = [of for of in now.keys() & there.keys() if now[of] != there[of]]
    return {name: sorted({of[-1] for of in those}) for name, those in sorted(found.items()) if those}


def kept_text(path: Path) -> str:
    """Text of a table that a person may have saved by another program, in another encoding."""
    return read_text(path, windows=True)


def _cells(table: str) -> list[list[str]]:
    return [row for row in csv.reader(io.StringIO(table)) if row]


def _places(table: str) -> dict[tuple[str, ...], list[str]]:
    """Coordinates of points, or of marks, by their names; how many digits are written does not matter."""
    head, *rows = _cells(table) or [[]]
    names = head.index("point") + 1 if "point" in head else len(head)

    def plain(cell: str) -> str:
        """Give a number to a millimetre, or to a thousandth of a pixel."""
        try:
            return f"{float(cell):.3f}"
        except ValueError:
            return cell.strip()

    return {tuple(row[:names]): [plain(cell) for cell in row[names:4]] for row in rows}


def _merge(kept: Any, found: Any) -> None:
    """Add what one table lacks, and fill in what is still asked."""
    for key, value in found.items():
        if key not in kept:
            kept.append(key, value)
        elif isinstance(value, AoT) and isinstance(kept[key], AoT):
            name = _IDS.get(key, "id")
            there = {str(entry.get(name)) for entry in kept[key]}
            for entry in value:
                if str(entry.get(name)) not in there:
                    kept[key].append(entry)
        elif isinstance(value, Table) and isinstance(kept[key], Table):
            _merge(kept[key], value)
        elif kept[key] == ASKED and value != ASKED:
            kept[key] = value


def _rows(path: Path, content: str) -> tuple[str, list[str]]:
    """Rows of a table that is there, and those that are new behind them, by their first cells."""
    if not path.exists():
        return content, content.splitlines()[1:]
    there = kept_text(path)
    head, *rows = _cells(content)
    kept = _cells(there)
    if kept[:1] != [head]:
        return there, []
    # An image and a point name a mark, a point names a point.
    names = 2 if head[:2] == ["image", "point"] else 1
    known = {tuple(row[:names]) for row in kept}
    added = [rows_text(row, ()).rstrip("\n") for row in rows if tuple(row[:names]) not in known]
    return there.rstrip("\n") + "\n" + "".join(f"{row}\n" for row in added), added


def _moved(there: str, content: str) -> tuple[str, list[str]]:
    """Marks of a list at the places that they have by now; those with other sigmas were set by hand."""

    def what(row: str) -> tuple[str, ...]:
        """Image, point and sigmas: all but the place."""
        (cells,) = _cells(row) or [[]]
        return (*cells[:2], *cells[4:])

    found = {what(row): row for row in content.splitlines()}
    rows = [(row, found.get(what(row), row)) for row in there.splitlines()]
    return "".join(f"{now}\n" for _, now in rows), [now for before, now in rows if now != before]
