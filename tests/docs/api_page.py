"""docs/api.md: what `import photocal` offers, made from its docstrings."""

from __future__ import annotations

import ast
import inspect
from functools import cached_property
from pathlib import Path
from types import FunctionType

from photocal import api

PAGE = Path(__file__).parents[2] / "docs" / "api.md"
EXAMPLES = PAGE.parent / "examples"
_HEAD = """# photocal in Python

Made from the docstrings by `python -m tests.docs`. `import photocal` is quick; what is used is loaded then.
Lengths are metres, angles radians, unless a name says otherwise; arrays are numpy, tables Arrow
(`to_pandas()` converts them). Errors are subclasses of `photocal.PhotocalError`; their message gives cause,
place and remedy.

Examples that run: {examples}.
"""


def page() -> str:
    """Give the whole page."""
    listed = ", ".join(f"[{path.stem.replace('_', ' ')}](examples/{path.name})" for path in _examples())
    parts = [_HEAD.format(examples=listed)]
    ordered = sorted(api.__all__, key=lambda one: (inspect.isclass(getattr(api, one)), one.lower()))
    return "\n".join(parts + [_entry(name, getattr(api, name)) for name in ordered])


def _examples() -> list[Path]:
    return sorted(EXAMPLES.glob("*.py"))


def _entry(name: str, thing: object) -> str:
    lines = [f"## {name}", ""]
    if not inspect.isclass(thing):
        lines += ["```python", f"photocal.{name}{_signature(thing)}", "```", ""]
    lines += ["```text", inspect.getdoc(thing) or "", "```", ""]
    if inspect.isclass(thing):
        for key, member in vars(thing).items():
            text = inspect.getdoc(member)
            if not key.startswith("_") and text and isinstance(member, _DESCRIBED):
                lines.append(f"- `{key}`: {text.splitlines()[0]}")
        lines += [""] if lines[-1] else []
    return "\n".join(lines)


_DESCRIBED = (property, cached_property, FunctionType)


def _signature(thing: object) -> str:
    """As it is written: evaluated annotations do not show the names of what they are."""
    definition = ast.parse(inspect.getsource(thing)).body[0]  # type: ignore[arg-type]
    assert isinstance(definition, ast.FunctionDef)
    assert definition.returns is not None
    arguments = ast.unparse(definition.args).replace("=", " = ")
    return f"({arguments}) -> {ast.unparse(definition.returns)}"


def main() -> None:
    """Write it."""
    PAGE.write_text(page(), encoding="utf-8")
