"""Pages of the manual, one for each command, from what the commands say of themselves.

`python -m tests.docs.command_pages` writes them to docs/commands.
"""

from __future__ import annotations

import re
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import typer
from typer.main import get_command

from acquire.commands.cli import app as acquire_app
from photocal.base.console import kinds
from photocal.commands.cli import app as photocal_app

FOLDER = Path(__file__).parents[2] / "docs" / "commands"
INDEX = "README.md"

# Pages that say more about a command.
MORE = {
    "acquire check": ("recording",),
    "acquire record": ("recording",),
    "acquire recover": ("recording",),
    "acquire simulate": ("guide/README",),
    "acquire monitor": ("monitor",),
    "photocal adjust": ("block-folder", "exchange", "nomenclature"),
    "photocal analyse": ("guide/certificate",),
    "photocal certificate": ("guide/certificate",),
    "photocal check": ("georeferencing-check", "guide/processing"),
    "photocal debrief": ("project-file",),
    "photocal export": ("exchange",),
    "photocal exposures": ("exposures", "guide/hardware"),
    "photocal mark": ("marking", "guide/processing"),
    "photocal measure": ("block-folder", "guide/processing"),
    "photocal forms": ("guide/field",),
    "photocal radiometry": ("guide/certificate",),
    "photocal plan": ("guide/planning",),
    "photocal ppk": ("guide/processing",),
    "photocal targets": ("guide/planning",),
    "photocal study": ("studies/README",),
    "photocal survey": ("exposures",),
    "photocal localise": ("exposures",),
    "photocal run": ("project-file", "guide/processing", "guide/warnings"),
    "photocal verify": ("guide/certificate",),
}


@dataclass(frozen=True)
class Command:
    """One command.

    Attributes
    ----------
    name : str
        With the program and the command above it: "acquire simulate flight".
    command : object
        Of typer.
    """

    name: str
    command: Any

    @property
    def page(self) -> str:
        """Name of its page."""
        return self.name.replace(" ", "-") + ".md"

    @property
    def summary(self) -> str:
        """First paragraph of its help, in one line."""
        return _paragraphs(self.command.help)[0]


def commands() -> Iterator[Command]:
    """List the commands of both programs in the order of their own lists.

    Yields
    ------
    Command
    """
    for program, app in (("acquire", acquire_app), ("photocal", photocal_app)):
        yield from _below(program, get_command(app))


def _below(name: str, group: Any) -> Iterator[Command]:
    for word, command in group.commands.items():
        yield Command(f"{name} {word}", command)
        if hasattr(command, "commands"):
            yield from _below(f"{name} {word}", command)


def pages() -> dict[str, str]:
    """Write every page.

    Returns
    -------
    dict
        File name: content. The list of all commands is README.md.
    """
    every = tuple(commands())
    return {INDEX: _index(every), **{one.page: _page(one) for one in every}}


def _index(every: tuple[Command, ...]) -> str:
    lines = [
        "# Commands",
        "",
        "Made from the programs by `make manual`. Every command takes `--help`.",
    ]
    for program, app in (("acquire", acquire_app), ("photocal", photocal_app)):
        lines += ["", f"## {program}", "", _paragraphs(app.info.help or "")[0], ""]
        lines += ["| command | what it does |", "|---|---|"]
        lines += [
            f"| [{one.name}]({one.page}) | {_cell(one.summary)} |"
            for one in every
            if one.name.split()[0] == program
        ]
    return "\n".join(lines) + "\n"


def _page(one: Command) -> str:
    """Title, usage, what it does, examples, arguments, options."""
    context = typer.Context(one.command, info_name=one.name)
    said, examples = _without_examples(_paragraphs(one.command.help))
    usage = " ".join([one.name, *one.command.collect_usage_pieces(context)])
    lines = [f"# {one.name}", "", "\n\n".join(said), "", "```", usage, "```"]
    if examples:
        lines += ["", "Example:" if len(examples) == 1 else "Examples:", "", "```sh", *examples, "```"]
    parameters = one.command.get_params(context)
    for kind, title in (("argument", "Arguments"), ("option", "Options")):
        rows = [
            p.get_help_record(context) for p in parameters if p.param_type_name == kind and p.name != "help"
        ]
        if rows:
            lines += ["", f"## {title}", "", f"| {kind} | meaning | default, limits |", "|---|---|---|"]
            lines += [_row(*row) for row in rows if row is not None]
    lines += ["", _more(one)]
    return "\n".join(lines) + "\n"


def _more(one: Command) -> str:
    links = [f"[{page.removesuffix('/README')}](../{page}.md)" for page in MORE.get(one.name, ())]
    return " · ".join([*links, f"[all commands]({INDEX})"])


def _row(names: str, text: str) -> str:
    found = re.fullmatch(r"(.*?)(?:  )?\[([^\]]*(?:default|required|<=|>=)[^\]]*)\]", text, re.DOTALL)
    meaning, limits = found.groups() if found else (text, "")
    return f"| `{_cell(kinds(names))}` | {_cell(meaning)} | {_cell(limits)} |"


def _cell(text: str) -> str:
    return " ".join(text.split()).replace("|", r"\|")


def _paragraphs(text: str) -> list[str]:
    return [" ".join(paragraph.split()) for paragraph in text.strip().split("\n\n")]


def _without_examples(paragraphs: list[str]) -> tuple[list[str], list[str]]:
    """Take the commands out of the paragraph that begins with "Example"."""
    said = [one for one in paragraphs if not one.startswith("Example")]
    shown = [one for one in paragraphs if one.startswith("Example")]
    return said, [command for one in shown for command in re.findall(r"`([^`]+)`", one)]


def main() -> None:
    """Write docs/commands anew."""
    FOLDER.mkdir(exist_ok=True)
    wanted = pages()
    for stale in {path.name for path in FOLDER.glob("*.md")} - set(wanted):
        (FOLDER / stale).unlink()
    for name, content in wanted.items():
        (FOLDER / name).write_text(content, encoding="utf-8")


if __name__ == "__main__":
    main()
