"""The code that a stage runs: what its module imports, and what that imports in turn."""

from __future__ import annotations

import ast
import functools
import hashlib
import importlib.metadata
import importlib.util
from collections.abc import Callable, Iterator, Mapping
from pathlib import Path
from typing import Any

_PACKAGES = ("drivers", "acquire", "photocal")


def program(function: Callable[..., Any]) -> dict[str, str]:
    """Version of the program and digest of the code that a function may run: another may give other results.

    Counted are the modules that its module imports, anywhere in the text and through any number of others,
    modules whose full name stands in a table, and the files of data in their folders.
    """
    return _program(function.__module__)


@functools.cache
def _program(start: str) -> dict[str, str]:
    digest = hashlib.sha256()
    known = _modules()
    needed = needed_modules(start, known)
    data = {path for name in needed for path in known[name].parent.iterdir() if path.suffix != ".py"}
    for path in sorted({known[name] for name in needed} | {path for path in data if path.is_file()}):
        digest.update(path.name.encode())
        digest.update(path.read_bytes())
    return {"version": importlib.metadata.version("photocal"), "source": digest.hexdigest()}


def needed_modules(start: str, known: Mapping[str, Path]) -> set[str]:
    """Follow the imports from a module through all modules that are known by name and file."""
    seen: set[str] = set()
    waiting = [start]
    while waiting:
        name = waiting.pop()
        if name in known and name not in seen:
            seen.add(name)
            if name in _PACKAGES:
                # The face of a package offers all of it, and loads what is asked for.
                continue
            waiting += [name.rpartition(".")[0], *_named(name, known[name])]
    return seen


def _named(module: str, path: Path) -> Iterator[str]:
    """What a source imports, or names in a text: tables name what they load, also within their package."""
    for node in ast.walk(ast.parse(path.read_bytes())):
        if isinstance(node, ast.Import):
            yield from (alias.name for alias in node.names)
        elif isinstance(node, ast.ImportFrom) and node.module is not None:
            yield node.module
            yield from (f"{node.module}.{alias.name}" for alias in node.names)
        elif isinstance(node, ast.Constant) and isinstance(node.value, str):
            named, colon, _ = node.value.partition(":")
            yield named
            if colon:
                yield f"{module.rpartition('.')[0]}.{named}"


@functools.cache
def _modules() -> dict[str, Path]:
    """List all our modules by their dotted names."""
    found = {}
    for package in _PACKAGES:
        spec = importlib.util.find_spec(package)
        root = Path(spec.origin).parent if spec is not None and spec.origin else Path()
        for path in sorted(root.rglob("*.py")):
            parts = (package, *path.relative_to(root).with_suffix("").parts)
            found[".".join(parts[:-1] if parts[-1] == "__init__" else parts)] = path
    return found
