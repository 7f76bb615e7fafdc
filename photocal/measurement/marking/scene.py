"""What is marked: the pictures of one folder, the points, and what is known of the images' orientation."""

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

from photocal.base.errors import ConfigurationError, PhotocalError
from photocal.block.folder import read_points
from photocal.block.model import NO_POINTS, ObjectPoints
from photocal.measurement.image_facts import read_facts
from photocal.measurement.image_file import list_images
from photocal.measurement.marking.snap import DICTIONARIES
from photocal.measurement.orientation import Orientation, of_project, of_run
from photocal.project import Project

# How far viewers turn a picture clockwise, degrees, by its EXIF orientation; mirrored ones are not turned.
_TURNS = {3: 180, 6: 90, 8: 270}


@dataclass(frozen=True)
class Picture:
    """An image file.

    size_px: width and height of the stored pixel grid.
    turn_deg: how far viewers turn it clockwise. Columns and rows are always those of the stored grid.
    reason: why it cannot be shown; empty for those that can.
    """

    path: Path
    size_px: tuple[int, int]
    turn_deg: int
    reason: str


@dataclass(frozen=True)
class Scene:
    """Everything that the page shows, but the marks.

    pictures: by file name: no other file is ever opened for the page.
    listed: whether only these points may be marked; else names are free.
    dictionaries: of coded targets.
    """

    name: str
    pictures: Mapping[str, Picture]
    points: ObjectPoints
    listed: bool
    orientation: Orientation | None
    dictionaries: tuple[str, ...] = DICTIONARIES


def scene_of_project(project: Project, run: Path | None) -> tuple[Scene, Path]:
    """Read what is marked in a project, and where its marks are kept.

    run: adjustment that says how images are oriented, instead of what the project has.
    raises PhotocalError: for what is missing or cannot be read.
    """
    control = project.control
    if control.marks is None:
        raise ConfigurationError(
            "marks in [control] is missing", 'add marks = "marks.csv"', where=project.path
        )
    pictures = read_pictures(project.picture_folder)
    orientation = of_project(project, tuple(pictures)) if run is None else of_run(run)
    dictionaries = tuple(target.dictionary for target in control.coded_targets) or DICTIONARIES
    points = NO_POINTS if control.points is None else read_points(control.points)
    return Scene(project.name, pictures, points, True, orientation, dictionaries), control.marks


def scene_of_folder(folder: Path, points: Path | None, run: Path | None) -> Scene:
    """Read what is marked in a folder of pictures without a project.

    points: points.csv; without it any name may be marked.
    run: adjustment that says how images are oriented.
    raises PhotocalError: for what is missing or cannot be read.
    """
    known = NO_POINTS if points is None else read_points(points)
    orientation = None if run is None else of_run(run)
    return Scene(folder.resolve().name, read_pictures(folder), known, points is not None, orientation)


def read_pictures(folder: Path) -> dict[str, Picture]:
    """List the pictures of a folder; those that cannot be shown say why."""
    return {path.name: _picture(path) for path in list_images(folder)}


def _picture(path: Path) -> Picture:
    if not path.resolve().is_relative_to(path.parent.resolve()):
        return Picture(path, (0, 0), 0, "is a link to a place outside of the folder")
    try:
        facts = read_facts(path)
    except PhotocalError as refusal:
        return Picture(path, (0, 0), 0, refusal.what)
    return Picture(path, facts.size_px, _TURNS.get(facts.orientation, 0), "")
