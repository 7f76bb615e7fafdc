"""docs/studies, from the studies themselves, repeated: `python -m tests.docs` writes the pages anew."""

from __future__ import annotations

import re
import shutil
from pathlib import Path
from tempfile import TemporaryDirectory

from typer.main import get_command

from photocal.commands.cli import app
from photocal.report.studies.comparison import ComparedFigure, Repeated, repeat_study, shown
from photocal.report.studies.study import shipped

ROOT = Path(__file__).parents[2]
FOLDER = ROOT / "docs" / "studies"
README = ROOT / "README.md"
MARKS = "<!-- studies -->", "<!-- /studies -->"
# Tables with more figures are shown by what differs; results/compared.csv has all.
SHOWN_WHOLE = 16
HEAD = "| {} | year | printed figures that agree |\n|---|---|---|\n"
README_HEAD = "[published study](docs/studies/README.md), by `photocal study NAME`"
INDEX = """# Published studies

Five published studies, each repeated by commands of this program from its printed data. Inputs and commands
are in `configs/studies/NAME/`; `photocal study NAME` copies the folder, runs the commands and compares every
printed figure. Made by `python -m tests.docs`; a test makes each page again.

"""


def repeated(name: str, folder: Path) -> Repeated:
    """Repeat a shipped study in a new folder."""
    program = get_command(app)

    def run(words: list[str]) -> None:
        program.main(words, prog_name="photocal", standalone_mode=False)

    return repeat_study(shipped()[name], folder, run)


def page(name: str, made: Repeated) -> str:
    """Write the page of a study."""
    study = made.study
    agreeing, figures = made.printed
    head = f"{study.kind.capitalize()}, {study.place}, {study.year}."
    others = "" if agreeing == figures else "; the reason for each of the others is given below"
    parts = [
        f"# {study.title}",
        f"{head} {agreeing} of {figures} printed figures agree{others}.",
        f"    photocal study {name} -o {name}",
        f"## What was asked\n\n{study.asked}",
        f"## What came out\n\n{study.concluded}",
        "## Inputs\n\n" + _table(("file", "what", "printed as"), (_input(one) for one in study.input)),
        "## Commands\n\n" + _commands(made),
        "## Printed figures and ours\n\n" + _summary(made),
        *_details(made),
        *_pictures(name, made),
        "## What is not repeated\n\n"
        + _table(
            ("what", "tables", "why"),
            ((one.what, _names(one.tables), one.why) for one in study.not_repeated),
        ),
    ]
    return "\n\n".join(parts) + "\n"


def _input(one: object) -> tuple[str, str, str]:
    return f"`{one.file}`", one.what, _names(one.tables)  # type: ignore[attr-defined]


def _names(tables: tuple[str, ...]) -> str:
    return ", ".join(f"`{name}`" for name in tables)


def _commands(made: Repeated) -> str:
    lines = []
    for command in made.study.command:
        why = "; ".join(
            filter(None, (command.why.rstrip("."), f"exit {command.exit}" if command.exit else ""))
        )
        lines.append(f"{command.line}" + (f"  # {why}" if why else ""))
    return "```sh\n" + "\n".join(lines) + "\n```"


def _summary(made: Repeated) -> str:
    rows = []
    for one in made.tables:
        of = f"{one.agreeing} of {len(one.figures)}"
        rows.append((one.printed.title, f"`{one.printed.printed}`", of, one.printed.rounding))
    return _table(("table", "file", "agree", "tolerance"), rows)


def _details(made: Repeated) -> list[str]:
    whole = [one for one in made.tables if len(one.figures) <= SHOWN_WHOLE]
    parts = []
    differing = [f for one in made.tables for f in one.figures if not f.agrees]
    if differing:
        parts.append("### Figures that differ\n\n" + _figures(differing))
    alike = [f for one in whole for f in one.figures if f.agrees]
    if alike:
        parts.append("### Figures that agree, in short tables\n\n" + _figures(alike))
    return parts


def _figures(figures: list[ComparedFigure]) -> str:
    rows = ((f.table, f"{f.label}, {f.column}", f.printed, _rounded(f), f.why) for f in figures)
    return _table(("table", "figure", "printed", "ours", "reason"), rows)


def _rounded(figure: ComparedFigure) -> str:
    """Write ours with one decimal more than the printed one: what is beyond says nothing."""
    found = re.fullmatch(r"[+-]?\d+\.?(\d*)", figure.printed)
    if found and isinstance(figure.ours, float):
        return f"{figure.ours:.{len(found[1]) + 1}f}"
    return f"{figure.ours:.4g}" if isinstance(figure.ours, float) else shown(figure.ours)


def _pictures(name: str, made: Repeated) -> list[str]:
    if not made.study.picture:
        return []
    parts = [
        f"![{one.shows}]({name}-{one.file})\n\n"
        f"{one.shows[0].upper()}{one.shows[1:]}. The study concluded: {one.concluded}"
        for one in made.study.picture
    ]
    return ["## Figures drawn again", *parts]


def _table(heads: tuple[str, ...], rows: object) -> str:
    lines = [f"| {' | '.join(heads)} |", f"|{'---|' * len(heads)}"]
    lines += [f"| {' | '.join(cell.replace('|', chr(92) + '|') for cell in row)} |" for row in rows]  # type: ignore[attr-defined]
    return "\n".join(lines)


def counted(page_text: str) -> tuple[str, str]:
    """Read the count from a page."""
    found = re.search(r"(\d+) of (\d+) printed figures agree", page_text)
    assert found is not None
    return found[1], found[2]


def listed(pages: dict[str, str], place: str, index: str) -> str:
    """Write the list of studies with their counts."""
    rows = []
    for name, text in pages.items():
        title = text.splitlines()[0].removeprefix("# ")
        year = re.search(r", (\d{4})\. ", text)
        assert year is not None
        rows.append(f"| [{title}]({place}{name}.md) | {year[1]} | {' of '.join(counted(text))} |\n")
    return HEAD.format(index) + "".join(rows)


def with_list(readme: str, pages: dict[str, str]) -> str:
    """Put the list into the README, between its marks."""
    before, _, rest = readme.partition(MARKS[0])
    after = rest.partition(MARKS[1])[2]
    return f"{before}{MARKS[0]}\n{listed(pages, 'docs/studies/', README_HEAD)}{MARKS[1]}{after}"


def read_pages() -> dict[str, str]:
    """Read the pages that lie there, by the name of their study."""
    return {name: (FOLDER / f"{name}.md").read_text(encoding="utf-8") for name in shipped()}


def main() -> None:
    """Repeat all studies and write their pages, pictures and lists."""
    FOLDER.mkdir(exist_ok=True)
    for name in shipped():
        with TemporaryDirectory() as place:
            made = repeated(name, Path(place) / name)
            (FOLDER / f"{name}.md").write_text(page(name, made), encoding="utf-8")
            for one in made.study.picture:
                shutil.copy(Path(place) / name / one.file, FOLDER / f"{name}-{one.file}")
    pages = read_pages()
    (FOLDER / "README.md").write_text(INDEX + listed(pages, "", "study"), encoding="utf-8")
    README.write_text(with_list(README.read_text(encoding="utf-8"), pages), encoding="utf-8")


if __name__ == "__main__":
    main()
