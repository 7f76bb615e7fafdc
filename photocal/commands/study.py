"""`photocal study`: a published study repeated on its own print."""

from pathlib import Path
from typing import Annotated

import typer

from photocal.base.console import AsJson, Language, answer, argument, option
from photocal.base.progress_bars import progress


def study(
    context: typer.Context,
    name: Annotated[
        str | None,
        argument("Name of a shipped study, or a folder with a study.toml; without: a list.", metavar="STUDY"),
    ] = None,
    output: Annotated[
        Path | None, option("New folder for its files and results; without: its name.", "-o", "--output")
    ] = None,
    language: Language = "",
    as_json: AsJson = False,
) -> None:
    """Repeat a published study: copy its files, run its commands, compare with the printed results.

    The folder then holds the inputs, the printed tables, study.toml with the commands, and results/: the
    answer of each command, and compared.csv with every printed figure and ours.

    Example: `photocal study ixus220 -o ixus220`
    """
    from photocal.findings.texts import catalogue, spoken
    from photocal.report.studies.study import read_study, shipped, study_folder

    say = catalogue(spoken(language))
    if name is None:
        listed = {key: read_study(folder) for key, folder in shipped().items()}
        answer(
            as_json,
            lambda: {key: {"title": one.title, "year": one.year} for key, one in listed.items()},
            lambda: "\n".join(
                f"{key:<12} {one.year}  {say.stored(one.title, one.languages.get(say.language))}"
                for key, one in listed.items()
            ),
        )
        return
    from photocal.report.studies.comparison import as_record, as_text, repeat_study

    source = study_folder(name)
    folder = output or Path(source.name)
    program = context.find_root().command

    def run(words: list[str]) -> None:
        """Run another command of the program."""
        program.main(words, prog_name="photocal", standalone_mode=False)

    count = len(read_study(source).command)
    with progress("repeating the study", count) as advance:
        repeated = repeat_study(source, folder, run, lambda _: advance(1))
    answer(
        as_json,
        lambda: as_record(repeated),
        lambda: f"{as_text(repeated, say)}\n{say('result.written', place=folder)}",
    )
