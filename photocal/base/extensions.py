"""What installed packages bring: objects under the entry points of a group, each one file and one entry."""

from functools import cache
from importlib.metadata import entry_points
from importlib.util import find_spec
from pathlib import Path
from typing import TypeVar

from photocal.base.errors import ConfigurationError

Kind = TypeVar("Kind")
FORMATS, HYPOTHESES, LENSES, PROTOCOLS, STANDARDS, STAGES = (
    f"photocal.{name}" for name in ("formats", "hypotheses", "lenses", "protocols", "standards", "stages")
)


@cache
def brought(group: str, kind: type[Kind]) -> dict[str, Kind]:
    """Give the objects of a group by the names of their entries, in the order of these.

    raises ConfigurationError: for an entry that cannot be loaded, or gives something else.
    """
    found, what = dict[str, Kind](), group.rpartition(".")[2].removesuffix("s")
    what = {LENSES: "lens", HYPOTHESES: "hypothesis"}.get(group, what)
    for entry in sorted(entry_points(group=group), key=lambda entry: entry.name):
        wrong = ConfigurationError.at(entry.value)
        remedy = "correct the package that brings it, or remove it"
        try:
            loaded = entry.load()
        except Exception as failure:
            reason = f"{type(failure).__name__}: {failure}"
            raise wrong(f"the {what} {entry.name} cannot be loaded ({reason})", remedy) from failure
        if not isinstance(loaded, kind):
            raise wrong(f"the {what} {entry.name} is not a {kind.__module__}.{kind.__qualname__}", remedy)
        found[entry.name] = loaded
    return found


def sources(group: str) -> dict[str, bytes]:
    """Give the sources of the modules that bring the objects of a group, by the names of their entries."""
    specs = {entry.name: find_spec(entry.module) for entry in entry_points(group=group)}
    return {
        name: Path(spec.origin).read_bytes() if spec is not None and spec.origin else b""
        for name, spec in sorted(specs.items())
    }
