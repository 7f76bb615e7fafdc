"""The code that a function may run: what was made with other code is made again."""

import functools
import hashlib
import importlib.util
import re
import sys
from collections.abc import Callable, Iterator, Mapping
from pathlib import Path
from typing import Any

from photocal.base.version import __version__

_PACKAGES = ("drivers", "acquire", "photocal")
# Imports of names, with comments between their brackets; of modules; texts that may name a module.
# Looking for their first letters takes a third of the time that borders of words take.
_NAMES = re.compile(
    r"""f(?<=\bf)rom\s+([\w.]+)\s+import\b[\s\\]*(\((?:[^()#]|\#[^\n]*)*\)|[^\n;#]*)"""
    r"""|i(?<=\bi)mport\s+([\w., \t]+)|["']([\w.]+)(?:(:)[^"'\n]*)?["']"""
)


def program(function: Callable[..., Any]) -> dict[str, str]:
    """Version of the program and digest of the code that a function may run: another may give other results.

    Counted are the modules that its module imports, anywhere in the text and through any number of others,
    modules whose full name stands in a table, and the files of data in their folders.
    """
    return _program(getattr(function, "func", function).__module__)


@functools.cache
def _program(start: str) -> dict[str, str]:
    digest = hashlib.sha256()
    known = _modules()
    if start not in known:
        # A script by itself has no origin.
        spec = sys.modules[start].__spec__
        known = {**known, start: Path(spec.origin)} if spec is not None and spec.origin else known
    needed = needed_modules(start, known)
    ours = needed & _modules().keys()
    rooms = {known[name].parent for name in ours}
    data = {path for room in rooms for path in room.iterdir() if path.suffix != ".py"}
    for path in sorted({known[name] for name in needed} | {path for path in data if path.is_file()}):
        state = path.stat()
        digest.update(path.name.encode())
        digest.update(_content(path, state.st_mtime_ns, state.st_size))
    return {"version": __version__, "source": digest.hexdigest()}


@functools.cache
def _content(path: Path, *_: int) -> bytes:
    """SHA-256 of a file, which is read once while it keeps its time and size."""
    return hashlib.sha256(path.read_bytes()).digest()


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
            state = known[name].stat()
            waiting += [name.rpartition(".")[0], *_named(name, known[name], state.st_mtime_ns, state.st_size)]
    return seen


@functools.cache
def _named(module: str, path: Path, *_: int) -> frozenset[str]:
    """What a source imports, or names in a text: tables name what they load, also within their package.

    Stages have most of their modules in common, and each is read once while it keeps its time and size.
    """
    return frozenset(names_in(module, path.read_text(encoding="utf-8")))


def names_in(module: str, source: str) -> Iterator[str]:
    """Find what the text of a module imports or names: all that a parser finds, in a tenth of its time."""
    # Examples of docstrings import what they show, and need it no more than a comment does.
    bare = re.sub(r"^[ \t]*>>> .*", "", source, flags=re.MULTILINE) if ">>>" in source else source
    for origin, what, plain, quoted, colon in _NAMES.findall(bare):
        if origin:
            yield origin
            yield from (f"{origin}.{name}" for name in re.findall(r"\w+", what))
        elif plain:
            yield from re.findall(r"[\w.]+", plain)
        else:
            yield quoted
            if colon:
                yield f"{module.rpartition('.')[0]}.{quoted}"


@functools.cache
def _modules() -> dict[str, Path]:
    """List all our modules by their dotted names."""
    modules = {}
    for package in _PACKAGES:
        spec = importlib.util.find_spec(package)
        root = Path(spec.origin).parent if spec is not None and spec.origin else Path()
        for path in sorted(root.rglob("*.py")):
            parts = (package, *path.relative_to(root).with_suffix("").parts)
            modules[".".join(parts[:-1] if parts[-1] == "__init__" else parts)] = path
    return modules
