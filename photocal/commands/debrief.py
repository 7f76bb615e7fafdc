"""`photocal debrief`: complete, or fly again."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from acquire.console import answer, progress

if TYPE_CHECKING:
    from photocal.geometry.camera import Camera


def debrief(
    project: Annotated[Path, typer.Argument(help="Project file, or the folder that has `project.toml`.")],
    since: Annotated[
        Path | None,
        typer.Option(help="Run folder or file of cameras of the last calibration, to hold c against."),
    ] = None,
    workers: Annotated[int, typer.Option(min=0, help="Processes; 0: one for each core.")] = 0,
    language: Annotated[str, typer.Option(help="Language: en or pt-BR.")] = "en",
    as_json: Annotated[bool, typer.Option("--json", help="Print the figures as JSON.")] = False,
) -> None:
    """Judge a flight before the crew drives home: complete, to be looked at, or to be flown again.

    Exposures without pictures, blurred and badly exposed pictures, another camera or lens setting, positions
    that are not fixed, strips with too little overlap, ground that is not covered, and a quick calibration on
    reduced pictures. Run it again while pictures come in: what was looked at is kept. The answer is also
    written as debrief.json into the project's work folder.

    Example: `photocal debrief project.toml --since last/calibration`
    """
    import os

    from photocal.debrief.verdict import debrief as judged
    from photocal.debrief.verdict import debrief_json, debrief_text
    from photocal.findings.catalogue import catalogue
    from photocal.project import read_project

    file = project / "project.toml" if project.is_dir() else project
    say, last = catalogue(language), () if since is None else _cameras(since)
    made = judged(read_project(file), workers or os.cpu_count() or 1, progress, last)
    answer(as_json, lambda: debrief_json(made), lambda: debrief_text(made, say))


def _cameras(since: Path) -> tuple[Camera, ...]:
    """Cameras of a run folder or of a file of cameras."""
    from photocal.analysis.stability.camera_file import read_camera_file
    from photocal.results.folder import read_result

    if since.is_dir():
        return tuple(read_result(since).cameras.values())
    return tuple(one.camera for one in read_camera_file(since).calibrations)
