"""`photocal new`: a commented project file of what a folder has, and what is missing."""

from dataclasses import replace
from pathlib import Path

import numpy as np

from photocal.base.errors import InputNotFoundError, OutputError
from photocal.base.files import rows_text, write_file
from photocal.block.model import ROLES, ObjectPoints
from photocal.block.project import NAME
from photocal.findings.texts import catalogue
from photocal.measurement.control_review import listed as some_names
from photocal.measurement.mark_frames import parse_frame
from photocal.measurement.marks import ControlMarks, named_after, pointed_after
from photocal.run.camera_card import ChosenPictures, chosen_pictures
from photocal.run.control_files import named_as_checks, named_checks
from photocal.run.folder_survey import FolderContents, survey
from photocal.run.new_control import ELSEWHERE_M, NewProject
from photocal.run.project_text import PICTURES, ProjectText
from photocal.run.renewed_project import answered_height, differing, kept_text, renewed, written_before


def new_project(
    folder: Path,
    crs: str = "",
    height: str = "",
    marks: str = "",
    language: str = "en",
    *,
    again: bool = False,
) -> NewProject:
    """Write `project.toml` and, where control stands in another form, `control.csv` and `marks.csv`.

    crs, height, marks: what a person says of the control beside its file: system by code or name, kind of
        heights, size and turn of the pictures that its marks were made in.
    language: of comments, of what is found, missing and asked, and of the certificate.
    again: where they are there already, keep what a person has written, and add what was found since.
    raises InputNotFoundError: when the folder has neither pictures nor a log.
    raises OutputError: when one of the files is there already.
    """
    # Whoever has stated the kind of heights is not asked for it again.
    stated = height or (answered_height(folder) if again else "")
    made_in, say = parse_frame(marks) if marks else None, catalogue(language)
    made = NewProject(crs=crs, height=stated, say=say)
    seen = survey(folder, say, written_before(folder) if again else ())
    if not seen.pictures and not seen.logs:
        raise InputNotFoundError(
            "has neither pictures nor a flight log",
            "; ".join([*map(_found, seen.control), *seen.unread][:3]) or "name the folder of a flight",
            where=folder,
        )
    chosen = chosen_pictures(folder, seen.pictures, seen.events, say)
    seen.pictures, seen.events = chosen.pictures, list(chosen.events)
    text = ProjectText(folder, seen, chosen, _chosen(seen, chosen), made, made_in)
    files = {NAME: "\n".join(text.lines()) + "\n"}
    if text.listed:
        files[PICTURES] = text.pictures_table()
    if text.given is not None:
        files["control.csv"] = _points_table(text.control_points)
        if text.marks:
            columns = ("image", "point", "x", "y", "sx", "sy")
            rows = [[m.image, m.point, *(f"{v:.3f}" for v in (m.x, m.y, *m.sigma))] for m in text.marks]
            files["marks.csv"] = rows_text(columns, rows)
    # What is read stays as it is.
    sources = {found.file for found in (*seen.control, *seen.marks)}
    for name in [name for name in files if folder / name in sources]:
        files[f"read-{name}"] = files.pop(name)
        files[NAME] = files[NAME].replace(f'"{name}"', f'"read-{name}"')
    changes: tuple[str, ...] = ()
    there = [name for name in files if (folder / name).exists()]
    if again and NAME in there:
        moved = [name for name in files if name.endswith("marks.csv") and made_in is not None]
        for name, points in differing(folder, files, moved).items():
            made.doubtful.append(say("new.kept_other", file=name, points=some_names(points, say)))
        files, changes = renewed(folder, files, moved)
    elif there:
        remedy = f"photocal new {folder} --again keeps your entries and adds new findings"
        raise OutputError("exists already", remedy, where=folder / there[0])
    for name, content in files.items():
        # What stays as it is keeps its time: it makes no result out of date.
        if name not in there or kept_text(folder / name) != content:
            write_file(folder / name, content)
    made.path, made.changes = folder / NAME, changes
    return made


def _found(control: ControlMarks) -> str:
    points, pictures = len(control.points.names), len({mark.image for mark in control.marks})
    return f"{control.file.name} has {points} points and marks in {pictures} pictures: put them beside it"


def _chosen(seen: FolderContents, chosen: ChosenPictures) -> ControlMarks | None:
    """The control of the folder: with marks in its pictures if there is such a file, else the first."""
    names, others = [image.name for image in chosen.facts], chosen.alike_elsewhere()
    if not seen.control:
        return None

    def shown(control: ControlMarks) -> int:
        """Count the marks in pictures that are there."""
        return sum(mark.image in names for mark in named_after(control.marks, names, others))

    best = max(
        seen.control,
        key=lambda control: (
            shown(control),
            _marked(control, seen),
            not named_as_checks(control.file),
            control.points.of_role("check").sum(),
        ),
    )
    if shown(best):
        return best
    best = _joined(best, seen)
    tables = sorted(seen.marks, key=shown, reverse=True)
    points = best.points.names
    # Programs leave the same marks in several files.
    found = (pointed_after(marks, points) for marks in (best.marks, *(table.marks for table in tables[::-1])))
    every = {(mark.image, mark.point): mark for marks in found for mark in marks}
    bare = tuple(dict.fromkeys(mark.point for mark in every.values() if mark.point not in points))
    known = tuple(mark for mark in every.values() if mark.point in points)
    return replace(best, marks=known, without_coordinates=(*best.without_coordinates, *bare))


def _marked(control: ControlMarks, seen: FolderContents) -> int:
    """Count the points of a table that tables of marks name."""
    points = control.points.names
    named = (pointed_after(table.marks, points) for table in seen.marks)
    return len({mark.point for marks in named for mark in marks}.intersection(points))


def _joined(best: ControlMarks, seen: FolderContents) -> ControlMarks:
    """A table of points with those of others that list more points with marks in the same way.

    People keep check points in a file of their own, and call it so.
    """
    checks = {table.file for table in seen.control if named_as_checks(table.file)}
    middle, tables, listed = np.nanmedian(best.points.values, axis=0), [best], set(best.points.names)

    def way(table: ControlMarks) -> tuple[object, ...]:
        """Unit and kind of heights, as far as a table states them."""
        return table.unit_m, table.height, table.level, table.unordered, bool(table.marks)

    for other in seen.control:
        used = other.file in checks or _marked(other, seen) > 0
        near = np.abs(np.nanmedian(other.points.values, axis=0) - middle).max() < ELSEWHERE_M
        # So near together, the system that one states is that of both.
        near &= not (best.crs and other.crs) or best.crs == other.crs
        if used and near and way(other) == way(best) and listed.isdisjoint(other.points.names):
            tables.append(other)
            listed.update(other.points.names)
    if len(tables) == 1:
        stated = not best.points.of_role("control").all()
        return best if stated or best.file not in checks else named_checks(best)
    tables = [named_checks(table) if table.file in checks else table for table in tables]
    first, *others = sorted(tables, key=lambda table: (table.file in checks, -len(table.points.names)))
    for other in others:
        first = replace(
            first,
            points=first.points.plus(other.points),
            crs=first.crs or other.crs,
            without_coordinates=(*first.without_coordinates, *other.without_coordinates),
            refused=(*first.refused, *other.refused),
            doubtful=(*first.doubtful, *other.doubtful),
            assumed=first.assumed | other.assumed,
            beside=(*first.beside, other.file),
        )
    return first


def _points_table(points: ObjectPoints) -> str:
    columns = zip(points.names, points.values, points.sigma, points.role, strict=True)
    rows = [
        [name, *(f"{v:.4f}" if np.isfinite(v) else "" for v in (*value, *sigma)), ROLES[role]]
        for name, value, sigma, role in columns
    ]
    return rows_text(("point", "X", "Y", "Z", "sX", "sY", "sZ", "role"), rows)
