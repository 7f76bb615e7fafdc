"""Commands that the pages name: they exist, with the options that they are given."""

from __future__ import annotations

import re
import shlex
from pathlib import Path
from typing import Any

import pytest
import typer
from typer.main import get_command

from acquire.commands.cli import app as acquire_app
from photocal.commands.cli import app as photocal_app
from tests.docs.command_pages import FOLDER, INDEX

ROOT = Path(__file__).parents[2]
PROGRAMS: dict[str, Any] = {"acquire": get_command(acquire_app), "photocal": get_command(photocal_app)}
PAGES = sorted([ROOT / "README.md", ROOT / "Containerfile", *(ROOT / "docs").rglob("*.md")])
# A line of a block that shows commands, and a command within a sentence.
LINES = re.compile(r"^(?: {4})?((?:acquire|photocal) [a-z].*)$", re.MULTILINE)
MENTIONS = re.compile(r"`((?:acquire|photocal) [a-z][^`]*)`")


def _found(words: list[str]) -> tuple[Any, list[str]]:
    """The command and its arguments."""
    command: Any = PROGRAMS[words[0]]
    rest = words[1:]
    while rest and rest[0] in getattr(command, "commands", {}):
        command, rest = command.commands[rest[0]], rest[1:]
    return command, rest


def _shown(page: Path) -> list[str]:
    """Commands of blocks, without comments; two on a line are two."""
    text = page.read_text(encoding="utf-8")
    if page.parent == FOLDER:
        # The usage is no command that one could type.
        text = "\n".join(re.findall(r"```sh\n(.*?)```", text, re.DOTALL))
    return [part.strip() for line in LINES.findall(text) for part in re.split(r"&&|  +#| # ", line)[:1]]


@pytest.mark.parametrize("page", PAGES, ids=lambda page: str(page.relative_to(ROOT)))
def test_shown_commands_are_understood(page: Path) -> None:
    for line in _shown(page):
        command, arguments = _found(shlex.split(line))
        assert command not in PROGRAMS.values(), line
        command.make_context(line, list(arguments))


@pytest.mark.parametrize("page", PAGES, ids=lambda page: str(page.relative_to(ROOT)))
def test_mentioned_commands_have_their_options(page: Path) -> None:
    for mention in MENTIONS.findall(page.read_text(encoding="utf-8")):
        command, rest = _found(" ".join(mention.split()).split(" "))
        assert command not in PROGRAMS.values(), mention
        context = typer.Context(command)
        known = {
            option for parameter in command.get_params(context) for option in getattr(parameter, "opts", ())
        }
        used = {word.split("=")[0] for word in rest if re.match(r"--?[a-z]", word)}
        assert used <= known, mention


def test_what_does_not_exist_is_seen() -> None:
    command, rest = _found(["photocal", "adjust", "block", "--nonsense", "x"])
    with pytest.raises(Exception, match="nonsense"):
        command.make_context("adjust", rest)
    assert _found(["photocal", "nonsense"])[0] is PROGRAMS["photocal"]
    assert _found(["acquire", "simulate", "flight", "a.toml"]) == (
        PROGRAMS["acquire"].commands["simulate"].commands["flight"],
        ["a.toml"],
    )


def test_there_is_something_to_look_at() -> None:
    assert sum(len(_shown(page)) for page in PAGES) > 60
    assert (FOLDER / INDEX) in PAGES
