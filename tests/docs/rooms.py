"""Rooms of the house and who imports whom, read from the sources."""

from __future__ import annotations

import ast
from collections.abc import Iterator
from functools import cache
from pathlib import Path

ROOT = Path(__file__).parents[2]
PACKAGES = ("drivers", "acquire", "photocal")
# Inside a package: a folder is a room; modules at its top are rooms of their own.
Edges = dict[str, set[str]]


def modules() -> dict[str, Path]:
    """List all modules of the program.

    Returns
    -------
    dict
        Dotted name: file.
    """
    found = {}
    for package in PACKAGES:
        for path in sorted((ROOT / package).rglob("*.py")):
            parts = path.relative_to(ROOT).with_suffix("").parts
            found[".".join(parts[:-1] if parts[-1] == "__init__" else parts)] = path
    return found


def imported(path: Path) -> Iterator[str]:
    """List what a module imports anywhere, also inside functions.

    Parameters
    ----------
    path : Path
        Its source.

    Yields
    ------
    str
        Dotted names; of `from a import b` both `a` and `a.b`, since b may be a module.
    """
    for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
        if isinstance(node, ast.Import):
            yield from (alias.name for alias in node.names)
        elif isinstance(node, ast.ImportFrom) and node.module is not None and node.level == 0:
            yield node.module
            yield from (f"{node.module}.{alias.name}" for alias in node.names)


@cache
def between_modules() -> Edges:
    """Return which module imports which of ours."""
    known = modules()
    return {name: {one for one in imported(path) if one in known} - {name} for name, path in known.items()}


def room_of(module: str) -> str:
    """Return the room of a module: "drivers", "acquire.log", "photocal.geometry", "photocal.api", ...

    Parameters
    ----------
    module : str
        Dotted name.
    """
    parts = module.split(".")
    return parts[0] if parts[0] == "drivers" else ".".join(parts[:2])


def between_rooms() -> Edges:
    """Return which room imports from which."""
    edges: Edges = {}
    for module, others in between_modules().items():
        if room_of(module) in PACKAGES and room_of(module) != "drivers":
            continue
        mine = edges.setdefault(room_of(module), set())
        mine |= {room_of(one) for one in others} - {room_of(module), "acquire", "photocal"}
    return edges


def circle(edges: Edges) -> list[str]:
    """Find a circle.

    Parameters
    ----------
    edges : dict
        Name: names that it points to.

    Returns
    -------
    list of str
        The names along one circle, in order; empty when there is none.
    """
    done: set[str] = set()

    def walk(name: str, way: list[str]) -> list[str]:
        if name in way:
            return [*way[way.index(name) :], name]
        if name in done:
            return []
        for other in sorted(edges.get(name, ())):
            if found := walk(other, [*way, name]):
                return found
        done.add(name)
        return []

    for name in sorted(edges):
        if found := walk(name, []):
            return found
    return []
