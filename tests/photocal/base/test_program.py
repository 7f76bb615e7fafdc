"""Which code a function may run."""

from __future__ import annotations

import ast
from pathlib import Path

import pytest

from photocal.base.program import _modules, names_in, needed_modules


def test_only_imported_code_counts(tmp_path: Path) -> None:
    sources = {
        "p.a": "def f():\n    from p.b import g\n",
        "p.b": "TABLE = {'x': 'p.c:read', 'y': 'e:read'}\n",
        "p.c": "import os\n",
        "p.d": "from p import a\n",
        "p.e": "",
        "p": "",
    }
    known = {}
    for name, text in sources.items():
        known[name] = tmp_path / f"{name}.py"
        known[name].write_text(text, encoding="utf-8")
    assert needed_modules("p.a", known) == {"p", "p.a", "p.b", "p.c", "p.e"}


def test_the_text_of_a_module_tells_what_a_parser_finds() -> None:
    known = _modules()
    for module, path in known.items():
        source = path.read_text(encoding="utf-8")
        parsed: set[str] = set()
        for node in ast.walk(ast.parse(source)):
            if isinstance(node, ast.Import):
                parsed |= {alias.name for alias in node.names}
            elif isinstance(node, ast.ImportFrom) and node.module is not None:
                parsed |= {node.module, *(f"{node.module}.{alias.name}" for alias in node.names)}
            elif isinstance(node, ast.Constant) and isinstance(node.value, str):
                name, colon, _ = node.value.partition(":")
                parsed |= {name, f"{module.rpartition('.')[0]}.{name}"} if colon else {name}
        # A text in a comment may name some more; all modules would be no answer.
        told = known.keys() & names_in(module, source)
        assert known.keys() & parsed <= told, module
        assert len(told) <= len(known.keys() & parsed) + 3, module


@pytest.mark.parametrize(
    "source",
    [
        "import q, p.b",
        "import p.b as b",
        "if x: import p.b",
        "from p import (\n    a,  # (not all)\n    b,\n)",
        "from p import \\\n    b",
        "from p import a, b; a()",
        "TABLE = {'b': 'p.b'}",
        'TABLE = {"b": "b:Thing"}',
    ],
)
def test_an_import_counts_however_it_is_written(source: str) -> None:
    assert "p.b" in set(names_in("p.a", source))


def test_the_example_of_a_docstring_is_no_import() -> None:
    assert not set(names_in("p.a", '"""Do it.\n\n    >>> import p.b\n    >>> from p import c\n    """\n'))


def test_a_stage_does_not_depend_on_rooms_that_it_does_not_use() -> None:

    ppk = needed_modules("photocal.run.ppk", _modules())
    assert "photocal.navigation.engine" in ppk
    assert not [
        name for name in ppk if name.startswith(("acquire.monitor", "photocal.products", "photocal.planning"))
    ]
