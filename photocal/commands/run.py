"""`photocal run`: from flight log, images and control points to the certificate."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from acquire.console import answer, progress
from photocal.commands.options import AsJson


def run(
    projects: Annotated[list[Path], typer.Argument(help="Project file; several are run one by one.")],
    until: Annotated[str | None, typer.Option(help="Last stage to be made.")] = None,
    again: Annotated[
        str | None, typer.Option(help="Stage to be made again although nothing has changed.")
    ] = None,
    rehash: Annotated[
        bool, typer.Option("--rehash", help="Read all files again, whatever their size and times say.")
    ] = False,
    workers: Annotated[int, typer.Option(min=1, help="Projects at a time.")] = 1,
    cluster: Annotated[
        str | None, typer.Option(help="Dask scheduler that runs the projects: tcp://HOST:PORT.")
    ] = None,
    as_json: AsJson = False,
) -> None:
    """Process a flight: PPK, exposures, image points, calibration, check points, analysis, certificate.

    Without a flight log the pictures and their control points, positions, or neither, take its place.

    Each stage has its folder in the project's work folder and is kept while neither its inputs nor the code
    that it runs change. Files of yours in these folders stay, and are named. The project file is described in
    docs/project-file.md.

    Example: `photocal run PROJECT.toml`
    """
    import datetime as dt

    from photocal.run.campaign import run_projects
    from photocal.run.summary import summary_text

    day = dt.datetime.now().astimezone().date()
    figures = run_projects(projects, day, progress, until, again, rehash, workers, cluster)
    answer(
        as_json,
        lambda: figures[0] if len(projects) == 1 else figures,
        lambda: "\n\n".join(summary_text(one) for one in figures),
    )
