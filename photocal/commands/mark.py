"""`photocal mark`, `targets`: points marked by hand on a local page, and target sheets to print."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from photocal.base.console import Address, Answering, answer, argument, option, printable, spread
from photocal.base.errors import ConfigurationError
from photocal.base.progress_bars import progress

if TYPE_CHECKING:
    from photocal.findings.texts import Catalogue
    from photocal.measurement.marking.store import MarkStore, Scene


@spread
def mark(
    project: Annotated[
        Path | None,
        argument("Project file: pictures, control points and where marks are kept.", metavar="PROJECT"),
    ] = None,
    images: Annotated[Path | None, option("Folder with the images, without a project.")] = None,
    points: Annotated[
        Path | None, option("points.csv; with --images and without it, any name may be marked.")
    ] = None,
    output: Annotated[Path | None, option("marks.csv to write, with --images.", "-o", "--output")] = None,
    run: Annotated[
        Path | None, option("Folder of an adjustment that has the orientations of the images.")
    ] = None,
    address: Address = "127.0.0.1:8750",
    cache: Annotated[Path | None, option("Folder for tiles; ~/.cache/photocal when not given.")] = None,
    *,
    answering: Answering,
) -> None:
    """Mark control and check points in the images on a local web page; every mark is saved at once.

    With --json the marks are printed, and no page is opened.

    Example: `photocal mark PROJECT.toml`; without a project
    `photocal mark --images photos --points points.csv -o marks.csv`.
    """
    from photocal.findings.texts import catalogue, spoken
    from photocal.measurement.marking.store import MarkStore

    scene, path = _scene(project, images, points, output, run)
    store = MarkStore(path)
    if answering.as_json:
        answer(True, lambda: _figures(scene, store), str)
    else:
        say = catalogue(spoken(answering.language))
        _show(project, run, scene, store, address, cache, say)


def _scene(
    project: Path | None, images: Path | None, points: Path | None, output: Path | None, run: Path | None
) -> tuple[Scene, Path]:
    from photocal.measurement.marking.store import scene_of_folder, scene_of_project

    if (project is None) == (images is None):
        raise ConfigurationError("what to mark is not clear", "give PROJECT.toml or --images FOLDER")
    with progress("reading images", None):
        if project is not None:
            from photocal.block.project import read_project

            if points is not None or output is not None:
                raise ConfigurationError(
                    "a project names its own points and marks", "leave --points and --output out"
                )
            return scene_of_project(read_project(project), run)
        if output is None:
            raise ConfigurationError("no file for the marks is given", "give -o marks.csv")
        return scene_of_folder(images or Path(), points, run), output


def _figures(scene: Scene, store: MarkStore) -> dict[str, object]:
    marks = [mark for mark in store.marks if mark.image in scene.pictures]
    return {
        "marks": str(store.path),
        "count": len(marks),
        "images": {name: sum(m.image == name for m in marks) for name in scene.pictures},
        "points": {name: sum(m.point == name for m in marks) for name in scene.points.names},
        "absent": sorted({mark.image for mark in store.marks} - set(scene.pictures)),
        "left_out": [{"image": n, "reason": p.reason} for n, p in scene.pictures.items() if p.reason],
    }


def _show(
    project: Path | None,
    run: Path | None,
    scene: Scene,
    store: MarkStore,
    address: str,
    cache: Path | None,
    say: Catalogue,
) -> None:
    from photocal.base.operating_system import cache_folder, stopped_by_signals, wait_until
    from photocal.base.web import read_address, serving
    from photocal.block.project import NAME
    from photocal.desk.standing import application, marking_application

    stop = stopped_by_signals()
    for name, picture in scene.pictures.items():
        if picture.reason:
            typer.echo(printable(f"{name}: {say.stored(picture.reason)}"), err=True)
    tiles = cache or cache_folder()
    # The window is that of a folder: a project file of another name has its marks there, and nothing else.
    if project is not None and (project.is_dir() or project.name == NAME):
        page = application(project if project.is_dir() else project.parent, tiles, "mark", run)
    else:
        page = marking_application(scene, store, tiles)
    with serving(page, read_address(address)) as url:
        typer.echo(say("marked.open", url=url, file=store.path))
        wait_until(stop)


@spread
def targets(
    kind: Annotated[
        str,
        argument(
            "disc, ring, cross, hourglass, chessboard, charuco, or a dictionary such as apriltag_36h11.",
            metavar="KIND",
        ),
    ],
    output: Annotated[Path, option("PDF to write.", "-o", "--output")],
    size_mm: Annotated[float, option("Diameter or side of the target, of a square for boards, mm.")] = 120.0,
    numbers: Annotated[str, option("Numbers of coded targets, such as 1-20 or 3,7.")] = "0",
    board: Annotated[str, option("Squares of a board in a row and in a column.")] = "10x7",
    charuco: Annotated[str, option("Marker dictionary of a ChArUco board.")] = "4x4_50",
    paper: Annotated[str, option("a4, a3, a2, a1 or a0.")] = "a4",
    *,
    answering: Answering,
) -> None:
    """Write target sheets as PDF, true to scale, for all targets that `photocal measure` reads.

    Example: `photocal targets apriltag_36h11 --numbers 1-20 --size-mm 110 -o targets.pdf`
    """
    from photocal.base.files import write_pdf
    from photocal.findings.texts import catalogue, spoken
    from photocal.measurement.markers import DICTIONARIES, parse_board
    from photocal.measurement.target_shapes import board_target, coded_target, plain_target, sheets_pdf

    if not 1 <= size_mm <= 1000:
        raise ConfigurationError(f"a size of {size_mm:g} mm is impossible", "give 1 to 1000 mm")
    if kind.lower() in DICTIONARIES:
        sheets = [coded_target(kind.lower(), number, size_mm) for number in _numbers(numbers)]
    elif kind in ("chessboard", "charuco"):
        wanted = parse_board(board, size_mm / 1000, charuco if kind == "charuco" else "")
        sheets = [board_target(wanted)]
    else:
        sheets = [plain_target(kind, size_mm)]
    content = sheets_pdf(sheets, paper)
    write_pdf(output, content)
    titles = [sheet.title for sheet in sheets]
    answer(
        answering.as_json,
        lambda: {"file": str(output), "sheets": titles},
        lambda: "\n".join([*titles, catalogue(spoken(answering.language))("marked.print", file=output)]),
    )


def _numbers(text: str) -> list[int]:
    numbers: list[int] = []
    try:
        for part in text.split(","):
            first, _, last = part.partition("-")
            numbers += range(int(first), int(last or first) + 1)
    except ValueError:
        numbers = []
    if not numbers or len(numbers) > 1000:
        raise ConfigurationError(
            f"numbers {text!r} are not understood", "write them as 1-20 or 3,7 (at most 1000)"
        )
    return numbers
