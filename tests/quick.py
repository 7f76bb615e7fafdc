"""`make quick`: ruff on what has changed, and the tests of the rooms in which it stands.

Changed is what differs from the main branch or is not committed. Run are the tests in the mirror of
a changed room and those that import a changed module themselves, less those marked `slow`, `long` and
`browser`.
"""

from __future__ import annotations

import subprocess
import sys
from collections.abc import Iterable
from pathlib import Path

from tests.docs.rooms import ROOT, imported, modules, room_of


def changed_files() -> list[str]:
    """Files that differ from the main branch, and new ones."""
    base = _git("merge-base", "HEAD", "main") or ["HEAD"]
    return sorted(
        {*_git("diff", "--name-only", base[0]), *_git("ls-files", "--others", "--exclude-standard")}
    )


def _git(*arguments: str) -> list[str]:
    done = subprocess.run(["git", *arguments], cwd=ROOT, capture_output=True, text=True, check=False)
    return done.stdout.split("\n")[:-1] if done.returncode == 0 else []


def tests_of(changed: Iterable[str]) -> list[str]:
    """Tests that concern changed files: themselves, those of their rooms, and those that import them."""
    names = {path.relative_to(ROOT).as_posix(): name for name, path in modules().items()}
    touched = {names[file] for file in changed if file in names}
    rooms = {room_of(name) for name in touched}
    chosen = {file for file in changed if Path(file).name.startswith("test_") and (ROOT / file).exists()}
    for path in (ROOT / "tests").rglob("test_*.py"):
        file = path.relative_to(ROOT)
        if file.parts[1] in ("benchmarks", "evidence"):
            continue
        if ".".join(file.parts[1:3]) in rooms or touched & set(imported(path)):
            chosen.add(file.as_posix())
    return sorted(chosen)


def main() -> int:
    """Check and test."""
    changed = changed_files()
    sources = [file for file in changed if file.endswith(".py") and (ROOT / file).exists()]
    if (
        sources
        and subprocess.run(
            [sys.executable, "-m", "ruff", "check", *sources], cwd=ROOT, check=False
        ).returncode
    ):
        return 1
    tests = tests_of(changed)
    if not tests:
        sys.stdout.write("nothing has changed that a test looks at\n")
        return 0
    shared = ["-n", "auto", "--dist", "loadfile", "--no-loadscope-reorder"]
    command = [sys.executable, "-m", "pytest", "-q", *shared]
    return subprocess.run(
        [*command, "-m", "not slow and not long and not browser", *tests], cwd=ROOT, check=False
    ).returncode


if __name__ == "__main__":
    sys.exit(main())
