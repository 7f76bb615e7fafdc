"""`photocal adopt`: a second opinion on the project of another program."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from acquire.console import answer, progress


def adopt(
    project: Annotated[Path, typer.Argument(help="Folder of the project, or its set-up file.")],
    output: Annotated[Path, typer.Option("-o", "--output", help="Folder for block, run and certificate.")],
    gcp: Annotated[Path | None, typer.Option(help="gcp_list.txt for a project without control.")] = None,
    as_json: Annotated[bool, typer.Option("--json", help="Print adoption.json.")] = False,
) -> None:
    """Adjust a project of Pix4D, Metashape, ODM, OpenSfM, COLMAP or MicMac anew, beside its own result.

    Example: `photocal adopt field/1_initial/params -o second-opinion`
    """
    import datetime as dt

    from photocal.run.adopt import adopt as adopted
    from photocal.run.adoption_figures import adoption_text

    figures = adopted(project, output, dt.datetime.now().astimezone().date(), progress, gcp)
    answer(as_json, lambda: figures, lambda: adoption_text(figures) + f"\nwritten: {output}")
