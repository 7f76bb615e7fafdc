"""A study repeated: its folder copied, its commands run, its figures compared."""

import contextlib
import io
import shlex
import shutil
from collections.abc import Callable, Iterator
from pathlib import Path

from photocal.base.errors import ConfigurationError, OutputError, PhotocalError
from photocal.base.files import refusals, rows_text
from photocal.studies.comparison import RESULTS, Repeated, compare_study, shown
from photocal.studies.study import Command, read_study

# Runs the arguments of a command in the current folder.
Run = Callable[[list[str]], None]


def repeat_study(
    source: Path, folder: Path, run: Run, done: Callable[[str], None] = lambda _: None
) -> Repeated:
    """Copy a study into a new folder, run its commands there and compare.

    raises OutputError: when the folder exists and is not empty.
    raises ConfigurationError: when a command ends otherwise than the study says.
    """
    study = read_study(source)
    if folder.exists() and (not folder.is_dir() or any(folder.iterdir())):
        raise OutputError("exists and is not empty", "name a new folder", where=folder)
    with refusals(folder):
        shutil.copytree(source, folder, dirs_exist_ok=True)
        (folder / RESULTS).mkdir(exist_ok=True)
    for command in study.command:
        _run(command, folder, run)
        done(command.name)
    repeated = compare_study(study, folder)
    rows = [
        (
            one.table,
            one.label,
            one.column,
            one.printed,
            shown(one.ours),
            "yes" if one.agrees else "no",
            one.why,
        )
        for one in repeated.figures
    ]
    heads = ("table", "row", "column", "printed", "ours", "agrees", "why")
    with refusals(folder):
        (folder / RESULTS / "compared.csv").write_text(rows_text(heads, rows), encoding="utf-8")
    return repeated


def _run(command: Command, folder: Path, run: Run) -> None:
    words = shlex.split(command.line)[1:]
    ended, said = 0, io.StringIO()
    with _inside(folder), contextlib.redirect_stdout(said):
        try:
            run(words)
        except PhotocalError as refusal:
            if refusal.exit_code != command.exit:
                raise
            ended = refusal.exit_code
    if ended != command.exit:
        raise ConfigurationError(
            f"{command.line} ended with {ended}, the study says {command.exit}",
            "correct study.toml",
            where=folder,
        )
    ending = ".json" if "--json" in words else ".txt"
    with refusals(folder):
        (folder / RESULTS / f"{command.name}{ending}").write_text(said.getvalue(), encoding="utf-8")


@contextlib.contextmanager
def _inside(folder: Path) -> Iterator[None]:
    """Paths of the commands are those of the study's folder."""
    with contextlib.chdir(folder):
        yield
