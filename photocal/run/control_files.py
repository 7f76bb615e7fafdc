"""Control and marks of a file as people have them: tables under any heads, lists and projects of programs."""

import contextlib
import re
from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from photocal.base.arrays import Floats, Integers
from photocal.base.errors import InputMalformedError, InputNotFoundError, PhotocalError
from photocal.base.layers import SUFFIXES as LAYERS
from photocal.base.layers import file_of
from photocal.base.text_tables import TextTable, folded, read_columns, shortened
from photocal.block.model import ROLES, Block, ObjectPoints, Role
from photocal.exchange.parts import Mark, PointEntry, object_points
from photocal.exchange.source import number, read_lines, read_text
from photocal.findings.texts import Catalogue
from photocal.geometry.frames import code_of, system_of
from photocal.measurement.control_review import listed
from photocal.measurement.image_file import SUFFIXES
from photocal.measurement.marks import (
    BY_HAND_PX,
    MARK_HEADS,
    POINT_HEADS,
    ControlMarks,
    from_corner,
    named_after,
    read_any_marks,
    read_control_marks,
    read_typed_list,
)
from photocal.measurement.place_tables import read_places, unit_of_head
from photocal.measurement.position_files import PLACE_HEADS, in_degrees

# Sigma of control points whose file has none, horizontal and vertical, m: a network RTK of short occupation.
ASSUMED_M = (0.02, 0.03)
# Heads of columns as people write them.
HEADS = {
    "point": POINT_HEADS,
    **PLACE_HEADS,
    "role": ("role", "tipo", "type", "uso"),
}
# Of a table with a row for each mark: x and y are those of the marks, or marks have other heads.
_IN_IMAGE = {key: words for key, words in MARK_HEADS if key != "point"}
_MARKED_HEADS = (
    {**HEADS, **_IN_IMAGE, "X": HEADS["X"][1:], "Y": HEADS["Y"][1:]},
    {**HEADS, **_IN_IMAGE, "x": _IN_IMAGE["x"][1:], "y": _IN_IMAGE["y"][1:]},
)
# Words of check points in the names of files, and of roles as people write them.
CHECKS = ("check", "checagem", "verificação", "verificacao", "checkpoint", "check point", "chk")
_CHECK_ROLES = (
    *CHECKS, "independent check", "independent check point", "ponto de verificação", "ponto de checagem",
    "pv", "contrôle", "point de contrôle", "chequeo", "punto de chequeo", "comprobación", "kontrollpunkt",
    "prüfpunkt",
)  # fmt: skip
_CONTROLS = (
    "control", "controle", "apoio", "gcp", "control point", "3d gcp", "ground control",
    "ground control point", "ponto de apoio", "ponto de controle", "pa", "apoyo", "punto de apoyo",
    "point d appui", "calage", "passpunkt",
)  # fmt: skip
# A check point beside "gcp", a control point beside "check", and alone it may be either.
_EITHER = "cp"
# What a table in degrees is taken for, and files that name the system of a table, the best first.
_DEGREES, _SYSTEMS = "EPSG:4326", (".qpj", ".prj", ".wkt")
TABLES, _PROJECTS = (".csv", ".txt"), (".p4d", ".psz")
# What names control or check points.
_CONTROL_WORDS = ("gcp", "control", "controle", "pontos", "points", "marks", "apoio", "check")
# Who speaks of pictures does so at once.
_HEAD_BYTES = 1 << 16
Sizes = dict[str, tuple[int, int]]
# What tells a table of places: its first rows, and what a number is, with a decimal point or comma.
_FIRST_ROWS, _NUMBER = 20, re.compile(r"[-+]?(\d+([.,]\d*)?|[.,]\d+)([eE][-+]?\d+)?")


def control_of(path: Path, sizes: Sizes, unread: list[str], say: Catalogue) -> ControlMarks | None:
    """Control or marks of a file; None for one that has neither. What looks like them tells why not."""
    refusals, kind = [], file_of(path).suffix.lower()
    for read in READERS[kind]:
        try:
            control = read(path, sizes, say)
        except PhotocalError as refusal:
            refusals.append(refusal)
            continue
        control = replace(control, file=path)
        if control.rows:
            return control
        unread += control.refused
        return replace(control, refused=())
    if kind in LAYERS:
        unread.append(str(refusals[0]))
        return None
    cells = set(re.split(r"[\s,;\"]+", path.read_bytes()[:_HEAD_BYTES].decode("latin-1")))
    named = any(name in cells or Path(name).stem in cells for name in sizes)
    headed, lists_places = _seems_a_table(path) if kind in TABLES else (False, False)
    if refusals and (named or lists_places or kind in _PROJECTS or means_control(path)):
        # What heads its columns is no list of ODM's.
        unread.append(str(refusals[READERS[kind].index(_table)] if headed else refusals[0]))
    return None


def means_control(path: Path) -> bool:
    """Whether the name of a file says that it has control or check points."""
    return any(word in path.stem.lower() for word in _CONTROL_WORDS)


def with_system_beside(
    control: ControlMarks, files: Sequence[Path], unread: list[str], say: Catalogue
) -> ControlMarks:
    """Take the system that a file of the same name says beside a table that names none.

    QGIS and others write it as WKT beside a table as beside a shapefile.
    """
    from pyproj.exceptions import CRSError

    degrees = control.crs == _DEGREES
    if control.crs and not degrees:
        return control
    stem = control.file.with_suffix("").as_posix().casefold()
    named = {
        path.suffix.casefold(): path for path in files if path.with_suffix("").as_posix().casefold() == stem
    }
    for path in (named[kind] for kind in _SYSTEMS if kind in named):
        try:
            system = system_of(read_text(path, windows=True).strip())
        except (CRSError, PhotocalError):
            unread.append(say("new.crs_file_unknown", file=path.name))
            continue
        if system.is_geographic == degrees:
            return replace(control, crs=code_of(system) or system.to_wkt(), crs_file=path)
        if not degrees:
            unread.append(
                say("new.crs_file_degrees", file=path.name, system=system.name, table=control.file.name)
            )
    return control


def _seems_a_table(path: Path) -> tuple[bool, bool]:
    """Whether a text has a line of words before its rows, and whether these name a thing and its place."""
    try:
        lines = read_lines(path, windows=True)[:_FIRST_ROWS]
    except PhotocalError:
        return False, False
    rows = [re.split(r"[\t;]+| *, +|,(?!\d)| +", line.text.strip()) for line in lines]
    count = [sum(_NUMBER.fullmatch(cell.strip('"')) is not None for cell in row) for row in rows]
    headed = len(rows) > 1 and len(rows[0]) > 3 and count[0] == 0
    # East and north; a row of units or of sums may lack them.
    least, most = 2, sorted(count[headed:])
    return headed, len(rows) > headed and most[len(most) // 3] >= least


def _one_file(path: Path, sizes: Sizes, _: Catalogue) -> ControlMarks:
    return read_control_marks(path, ASSUMED_M, sizes)


def _typed_list(path: Path, _: Sizes, say: Catalogue) -> ControlMarks:
    return read_typed_list(path, ASSUMED_M, say)


def _headed_list(path: Path, sizes: Sizes, say: Catalogue) -> ControlMarks:
    """The list of ODM that a spreadsheet has saved: its first line is a system."""
    first = read_text(path, windows=True).lstrip().partition("\n")[0].strip(" \t,;")
    if not re.match(r"EPSG[ :=]*\d{4,6}$|\+proj=|WGS84 UTM", first, re.IGNORECASE):
        raise InputMalformedError("has no system in its first line", "name it there", where=path)
    return _typed_list(path, sizes, say)


def _other_program(path: Path, _: Sizes, __: Catalogue) -> ControlMarks:
    from photocal.exchange.formats import read_foreign_block

    return of_foreign(path, read_foreign_block(path))


def of_foreign(path: Path, block: Block) -> ControlMarks:
    """Control, its marks and the cameras of another program's block."""
    from photocal.exchange.foreign_project import in_pixels

    surveyed = ~block.points.of_role("tie")
    if not surveyed.any():
        raise InputNotFoundError("has no control points", where=path)
    images, points, seen = block.images.names, block.points.names, in_pixels(block).observations
    marks = tuple(
        Mark(images[i], points[j], x, y, (sx, sy), path)
        for i, j, (x, y), (sx, sy) in zip(
            seen.image, seen.point, seen.values.tolist(), seen.sigma.tolist(), strict=True
        )
        if surveyed[j]
    )
    return ControlMarks(block.frame, block.points.only(surveyed), marks, cameras=block.cameras)


def _micmac(path: Path, _: Sizes, __: Catalogue) -> ControlMarks:
    from photocal.exchange.micmac import PLACEHOLDER, read_ground_points, read_measures

    try:
        ground = read_ground_points(path)
    except PhotocalError:
        return ControlMarks("", marks=read_measures(path))
    assumed = all(sigma == PLACEHOLDER for point in ground for sigma in point.sigma)
    if assumed:
        ground = tuple(replace(point, sigma=(ASSUMED_M[0], *ASSUMED_M)) for point in ground)
    points = object_points(ground)
    return ControlMarks("local", points, assumed=frozenset(points.names if assumed else ()))


def _table(path: Path, sizes: Sizes, say: Catalogue) -> ControlMarks:
    """A table of points under any heads that people write, with a row for each point or for each mark."""
    for heads in _MARKED_HEADS:
        with contextlib.suppress(InputNotFoundError):
            degrees = in_degrees(path, besides=_IN_IMAGE["x"] + _IN_IMAGE["y"])
            return _of_marked_table(
                *read_places(path, heads, tuple(_IN_IMAGE), say, degrees=degrees), sizes, say
            )
    table, places, given = read_places(path, HEADS, (), say, degrees=in_degrees(path))
    # Surveyors of many countries call north X.
    given = replace(given, unordered=folded(table.heads["X"]) == "x")
    index, names = table.names("point")
    first = np.unique(index, return_index=True)[1]
    roles = _roles(table.texts("role"))[0] if table.has("role") else [None] * len(index)
    again = [
        say("new.row_again_role", place=table.place(row), name=names[place])
        if same and roles[row] != roles[first[place]]
        else _again(table.place(row), names[place], say, same=same)
        for row, place in enumerate(index.tolist())
        if first[place] != row
        for same in [bool(np.array_equal(places[row], places[first[place]], equal_nan=True))]
    ]
    return _of_table(table, places[first], replace(given, refused=(*given.refused, *again)), first, say)


def _of_marked_table(
    table: TextTable, places: Floats, given: ControlMarks, sizes: Sizes, say: Catalogue
) -> ControlMarks:
    """Points and marks of a table with a row for each mark; a row that contradicts one before is refused."""
    (index, names), (image, images) = table.names("point"), table.names("image")
    first = np.unique(index, return_index=True)[1]
    moved = np.any((places != places[first[index]]) & ~np.isnan(places), axis=1)
    pixels = from_corner(table.matrix("xy"))
    marks, refused = dict[tuple[str, str], Mark](), list(given.refused)
    for row, (i, j, (x, y)) in enumerate(zip(image, index, pixels.tolist(), strict=True)):
        where, pair = table.place(row), (images[i], names[j])
        if moved[row]:
            refused.append(say("new.row_moved", place=where, name=names[j]))
        elif pair in marks:
            refused.append(say("new.mark_again", place=where, point=names[j], image=images[i]))
        else:
            marks[pair] = Mark(*pair, x, y, (BY_HAND_PX, BY_HAND_PX), where)
    listed = replace(given, rows=len(table) + len(given.refused), refused=tuple(refused))
    listed = replace(listed, marks=named_after(marks.values(), sizes))
    return _of_table(table, places[first], listed, first, say)


def _of_table(
    table: TextTable, places: Floats, given: ControlMarks, rows: Integers, say: Catalogue
) -> ControlMarks:
    """Points of those rows of a table; what the table does not say of their precision is assumed."""
    names, stated = table.names("point")[1], table.has("sX")
    sigma = np.column_stack(
        [
            _sigma(table, name, given.unit_m, assumed)[rows]
            for name, assumed in zip(("sX", "sY", "sZ"), (ASSUMED_M[0], *ASSUMED_M), strict=True)
        ]
    )
    words = _role_words(table)
    roles = ["control"] * len(names)
    if words:
        meant, known = _roles(words)
        roles = [meant[row] for row in rows]
        unclear = [row for row in rows.tolist() if _role_word(words[row]) not in known]
        either = [row for row in unclear if _role_word(words[row]) == _EITHER]
        told = [say("new.role_either", place=table.place(row), role=words[row]) for row in either[:1]]
        # Under other heads stand kinds of all sorts.
        if table.has("role") and folded(table.heads["role"]) == "role":
            others = [row for row in unclear if row not in either]
            told += [say("new.role_unknown", place=table.place(row), role=words[row]) for row in others]
        given = replace(given, doubtful=tuple(told))
    # Of the plane alone: a height to start from, which counts for nothing.
    plane = np.isnan(places[:, 2])
    places = np.column_stack([places[:, :2], np.where(plane, np.nanmedian(places[:, 2]), places[:, 2])])
    sigma[plane, 2] = np.inf
    checks = np.array(roles) == "check"
    lost, used = plane & checks, plane & ~checks
    if used.any():
        told_of = listed([names[k] for k in np.flatnonzero(used)], say)
        given = replace(given, doubtful=(*given.doubtful, say("new.plane_only", names=told_of)))
    cells = [(table.place(rows[k]), names[k]) for k in np.flatnonzero(lost)]
    given = replace(
        given,
        refused=(*given.refused, *(say("new.row_empty", place=p, name=n, axis="Z") for p, n in cells)),
    )
    sigma[np.array(roles) == "check"] = np.where(stated, sigma[np.array(roles) == "check"], np.inf)
    role = np.array([ROLES.index(name) for name in roles], dtype=np.int64)
    points = ObjectPoints(names, places, sigma, role).only(~lost)
    return replace(given, points=points, assumed=frozenset(() if stated else points.names))


def _sigma(table: TextTable, name: str, unit_m: float, assumed: float) -> Floats:
    """Sigmas of a coordinate, in the unit of the coordinates unless their head states another."""
    cells = table.numbers(name, empty=np.nan)
    stated = unit_of_head(table.heads[name]) if table.has(name) else None
    return np.where(np.isnan(cells), assumed, cells * (stated or unit_m) / unit_m)


def named_as_checks(file: Path) -> bool:
    """Whether the name of a table says that it has check points, and says nothing of control."""
    stem = folded(file.stem)
    return any(word in stem for word in CHECKS) and not re.search("contro|gcp|apoio|apoyo", stem)


def named_checks(given: ControlMarks) -> ControlMarks:
    """Points of a table that says nothing of their roles, as check points."""
    points = given.points
    stated = np.array([[name not in given.assumed] for name in points.names])
    role = np.full(len(points.names), ROLES.index("check"))
    return replace(given, points=replace(points, sigma=np.where(stated, points.sigma, np.inf), role=role))


def _role_words(table: TextTable) -> Sequence[str]:
    """The column of the roles: that of its head, else the one whose words are all of roles; none without."""
    if table.has("role"):
        return table.texts("role")
    whole = read_columns(table.path).columns
    for cells in whole.columns:
        column = [str(cell or "") for cell in cells.to_pylist()]
        column = [column[row] for row in table.kept] if table.kept else column
        told = set(map(_role_word, column))
        checks = not told.isdisjoint(_CHECK_ROLES) or (_EITHER in told and not told.isdisjoint(_CONTROLS))
        if checks and told <= {"", _EITHER, *_CHECK_ROLES, *_CONTROLS}:
            return column
    return ()


def _role_word(text: str) -> str:
    """A word of a role as it is compared: "Check_Points" is "check point"."""
    word = " ".join(re.split(r"[\W_]+", text.lower())).strip()
    return word.removesuffix("s") if word not in (*_CHECK_ROLES, *_CONTROLS) else word


def _roles(words: Sequence[str]) -> tuple[list[Role], frozenset[str]]:
    """What the words of a table mean, row by row, and those that leave no doubt."""
    plain = list(map(_role_word, words))
    told = set(plain)
    checks = {*_CHECK_ROLES, *({_EITHER} if told.isdisjoint(_CHECK_ROLES) else ())}
    clear = not told.isdisjoint(_CHECK_ROLES) or not told.isdisjoint(_CONTROLS)
    roles: list[Role] = ["check" if word in checks else "control" for word in plain]
    return roles, frozenset({"", *_CHECK_ROLES, *_CONTROLS, *({_EITHER} if clear else ())})


def _bare_table(path: Path, sizes: Sizes, say: Catalogue) -> ControlMarks:
    """Points without a head, or with one between blanks: name, east, north, height, as many export them."""
    pictures = {called.casefold() for name in sizes for called in (name, Path(name).stem)}
    # Coordinates of a cloud, times of a track.
    entries, no_name = dict[str, PointEntry](), re.compile(r"[-+]?\d*[.,]\d+|\d+:.*")
    refused = list[str]()
    lines = read_lines(path, windows=True)
    heads = [shortened(folded(cell)) for cell in lines[0].text.split()] if lines else []
    words = {key: set(map(folded, HEADS[key])) for key in ("point", *"XYZ")}
    order = [next((k for k, cell in enumerate(heads) if cell in words[key]), -1) for key in words]
    headed = min(order) >= 0
    if headed:
        lines = lines[1:]
    else:
        order = list(range(4))
    unreadable = list[PhotocalError]()
    for line in lines:
        between = next((mark for mark in "\t;," if line.text.count(mark) >= 3), None)
        given = [cell.strip().strip('"') for cell in line.text.split(between)]
        name, *cells = (given[k] for k in order) if len(given) > max(order) else given
        taken = name.casefold() in pictures or Path(name).suffix.lower() in SUFFIXES
        if taken or no_name.fullmatch(name):
            raise line.malformed("has no name, east, north and height of a point")
        try:
            if len(cells) < 3:
                raise line.malformed("has no name, east, north and height of a point")
            if between != ",":
                cells = [cell.replace(",", ".") for cell in cells]
            xyz = [number(cell, line.place, "coordinate") for cell in cells[:3]]
        except PhotocalError as refusal:
            # A first line that is no point heads columns of which nobody knows the order.
            if line is lines[0]:
                raise
            unreadable.append(refusal)
            continue
        if name in entries:
            refused.append(_again(line.place, name, say, same=entries[name].xyz == xyz))
        else:
            entries[name] = PointEntry(name, "control", xyz, (ASSUMED_M[0], *ASSUMED_M))
    # Of a list some rows are none of a point; of another text most are.
    if unreadable and len(unreadable) * 3 > len(entries):
        raise unreadable[0]
    if not entries:
        raise InputNotFoundError("has no points", where=path)
    points = object_points(entries.values())
    refused += map(str, unreadable)
    assumed = frozenset(points.names)
    return ControlMarks("", points, assumed=assumed, refused=tuple(refused), unordered=not headed)


def _again(place: object, name: str, say: Catalogue, *, same: bool) -> str:
    return say("new.row_again" if same else "new.row_again_moved", place=place, name=name)


def _marks(path: Path, sizes: Sizes, _: Catalogue) -> ControlMarks:
    return ControlMarks("", marks=read_any_marks(path, sizes))


READERS: dict[str, tuple[Callable[[Path, Sizes, Catalogue], ControlMarks], ...]] = {
    ".xml": (_one_file, _micmac, _other_program),
    ".json": (_one_file,),
    ".psz": (_other_program,),
    ".p4d": (_one_file,),
    ".csv": (_table, _headed_list, _bare_table, _marks),
    ".txt": (_typed_list, _table, _bare_table, _marks),
    **dict.fromkeys(LAYERS, (_table, _marks)),
}
