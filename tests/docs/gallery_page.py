"""docs/examples/README.md: what each example does, its code and what it prints."""

from __future__ import annotations

import ast
import subprocess
import sys
from pathlib import Path
from tempfile import TemporaryDirectory

from tests.docs.api_page import EXAMPLES

PAGE = EXAMPLES / "README.md"
_HEAD = """# Examples in Python

Each example runs unchanged: `python docs/examples/NAME.py`. Its output follows the code.
Made by `python -m tests.docs`.
"""
# It reads a log that the user has.
_OF_A_FILE = "read_a_flight_log.py"


def page() -> str:
    """Give the page, without what the examples print."""
    return "\n".join([_HEAD, *(_entry(path, "") for path in sorted(EXAMPLES.glob("*.py")))])


def _entry(path: Path, printed: str) -> str:
    code = path.read_text(encoding="utf-8")
    about = ast.get_docstring(ast.parse(code)) or ""
    body = code.partition('"""\n')[2] if about.count("\n") == 0 else code.split('"""', 2)[2]
    shown = f"```text\n{printed.rstrip()}\n```\n" if printed else ""
    title = path.stem.replace("_", " ").capitalize()
    return f"## {title}\n\n{about}\n\n[{path.name}]({path.name})\n\n```python\n{body.strip()}\n```\n\n{shown}"


def printed(path: Path) -> str:
    """Run an example in an empty folder and give what it prints."""
    if path.name == _OF_A_FILE:
        return ""
    with TemporaryDirectory() as folder:
        done = subprocess.run(
            [sys.executable, str(path)], cwd=folder, capture_output=True, text=True, check=True, timeout=300
        )
    return done.stdout


def without_output(text: str) -> str:
    """Leave what the examples print out of the page."""
    head, *rest = text.split("```text\n")
    return head + "".join(part.partition("```\n")[2] for part in rest)


def main() -> None:
    """Write the page."""
    entries = (_entry(path, printed(path)) for path in sorted(EXAMPLES.glob("*.py")))
    PAGE.write_text("\n".join([_HEAD, *entries]), encoding="utf-8", newline="\n")
