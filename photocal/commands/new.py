"""`photocal new`: from a folder of pictures, control and logs to a project file."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from acquire.console import answer


def new(
    folder: Annotated[Path, typer.Argument(help="Folder of a flight: pictures, control, marks, logs.")],
    crs: Annotated[str, typer.Option(help="System of the control points, where their file has none.")] = "",
    height: Annotated[str, typer.Option(help="Of the control points: ellipsoidal or orthometric.")] = "",
    as_json: Annotated[bool, typer.Option("--json", help="Print what was found as JSON.")] = False,
) -> None:
    """Look at a folder and write its project.toml, saying what was found and what is missing.

    Example: `photocal new flight`, then `photocal run flight/project.toml`
    """
    from photocal.run.new_project import new_project

    made = new_project(folder, crs, height)
    parts = {"found": made.found, "missing": made.missing, "asked": made.asked}
    answer(
        as_json,
        lambda: {"schema": "photocal.new/1", "project": str(made.path), **parts},
        lambda: "\n".join(
            [
                *(f"{word}: {line}" for word, lines in parts.items() for line in lines),
                f"written: {made.path}; next: "
                + ("fill in what is asked, then " if made.asked else "")
                + f"photocal run {made.path}",
            ]
        ),
    )
