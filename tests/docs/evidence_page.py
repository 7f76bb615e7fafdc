"""docs/evidence/README.md: the studies of the program itself, by their titles."""

from __future__ import annotations

from pathlib import Path

FOLDER = Path(__file__).parents[2] / "docs" / "evidence"
PAGE = FOLDER / "README.md"
_HEAD = """# Evidence

Statistical studies of the program: simulated flights with known truth, recorded data compared with other
programs, attempts to lose or forge a result. `make evidence` makes them again, and
`python -m tests.evidence.NAME` one of them (with underscores; `live` needs a folder of pictures). Speed is
from `make bench`, the supply chain from `make audit`. This list is made by `python -m tests.docs`.

| study | page |
|---|---|
"""


def page() -> str:
    """Give the list of studies in the order of their titles."""
    titles = {
        path.read_text(encoding="utf-8").splitlines()[0].removeprefix("# "): path.name
        for path in FOLDER.glob("*.md")
        if path != PAGE
    }
    rows = (f"| {title} | [{name}]({name}) |" for title, name in sorted(titles.items()))
    return _HEAD + "\n".join(rows) + "\n"


def main() -> None:
    """Write the page."""
    PAGE.write_text(page(), encoding="utf-8", newline="\n")
