"""`photocal mark`: points marked in images by hand, on a local page."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from acquire.console import answer, progress
from drivers.errors import ConfigurationError

if TYPE_CHECKING:
    from photocal.measurement.marking.scene import Scene
    from photocal.measurement.marking.store import MarkStore


def mark(
    project: Annotated[
        Path | None, typer.Argument(help="Project file: pictures, control points and where marks are kept.")
    ] = None,
    images: Annotated[Path | None, typer.Option(help="Folder with the images, without a project.")] = None,
    points: Annotated[
        Path | None, typer.Option(help="points.csv; without it, beside --images, any name may be marked.")
    ] = None,
    output: Annotated[
        Path | None, typer.Option("-o", "--output", help="marks.csv to write, beside --images.")
    ] = None,
    run: Annotated[
        Path | None, typer.Option(help="Folder of an adjustment that says how the images are oriented.")
    ] = None,
    address: Annotated[
        str, typer.Option(help="HOST:PORT of the page. Beyond this computer the page demands a token.")
    ] = "127.0.0.1:8750",
    cache: Annotated[
        Path | None, typer.Option(help="Folder for tiles; ~/.cache/photocal when not given.")
    ] = None,
    as_json: Annotated[
        bool, typer.Option("--json", help="Print what is marked as JSON, and show no page.")
    ] = False,
) -> None:
    """Mark control and check points in the images on a local web page; every mark is saved at once.

    Example: `photocal mark PROJECT.toml`; without a project
    `photocal mark --images photos --points points.csv -o marks.csv`.
    """
    from photocal.measurement.marking.store import MarkStore

    scene, path = _scene(project, images, points, output, run)
    store = MarkStore(path)
    if as_json:
        answer(True, lambda: _figures(scene, store), str)
    else:
        _show(scene, store, address, cache)


def _scene(
    project: Path | None, images: Path | None, points: Path | None, output: Path | None, run: Path | None
) -> tuple[Scene, Path]:
    from photocal.measurement.marking.scene import scene_of_folder, scene_of_project

    if (project is None) == (images is None):
        raise ConfigurationError("what to mark is not clear", remedy="give PROJECT.toml or --images FOLDER")
    with progress("reading images", None):
        if project is not None:
            from photocal.project import read_project

            if points is not None or output is not None:
                raise ConfigurationError(
                    "a project names its own points and marks", remedy="leave --points and --output out"
                )
            return scene_of_project(read_project(project), run)
        if output is None:
            raise ConfigurationError("no file for the marks is given", remedy="give -o marks.csv")
        return scene_of_folder(images or Path(), points, run), output


def _figures(scene: Scene, store: MarkStore) -> dict[str, object]:
    marks = store.marks
    return {
        "marks": str(store.path),
        "count": len(marks),
        "images": {name: sum(m.image == name for m in marks) for name in scene.pictures},
        "points": {name: sum(m.point == name for m in marks) for name in scene.points.names},
        "left_out": [{"image": n, "reason": p.reason} for n, p in scene.pictures.items() if p.reason],
    }


def _show(scene: Scene, store: MarkStore, address: str, cache: Path | None) -> None:
    from acquire.operating_system import cache_folder, stopped_by_signals
    from acquire.web import read_address, serving
    from photocal.measurement.marking.service import application

    stop = stopped_by_signals()
    for name, own in scene.pictures.items():
        if own.reason:
            typer.echo(f"{name}: {own.reason}", err=True)
    page = application(scene, store, cache or cache_folder())
    with serving(page, read_address(address)) as url:
        typer.echo(f"open {url} (Ctrl-C ends); marks: {store.path}")
        stop.wait()
