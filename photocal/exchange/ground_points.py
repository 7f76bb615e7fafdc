"""ODM's gcp_list.txt and geo.txt.

gcp_list.txt: first line the coordinate system (EPSG:n, WGS84 UTM zone, or a PROJ string), then X, Y, Z,
column, row, image and an optional name, separated by blanks; pixels x right, y down, the centre of the
upper-left pixel is (0, 0), as ours; rows with the same coordinates are the same point. geo.txt: coordinate
system, then image, X, Y and optional Z, yaw, pitch, roll (deg), horizontal and vertical accuracy (m).
Yaw, pitch and roll turn from north, east, down to a body whose camera looks down and whose image has its
upper edge forward: all three are 0 for a camera that looks down, its upper edge to the north; a gimbal's
pitch of -90 is 0 here. Neither states the kind of the heights: that stays with the reader. Source:
OpenDroneMap documentation, "Ground control points" and "Image geolocation files"; ODM's `compute_opk`.
"""

import re
from collections import defaultdict
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from photocal.base.arrays import Floats
from photocal.base.errors import ConfigurationError, InputMalformedError
from photocal.block.model import Block
from photocal.exchange.exporting import Choices
from photocal.exchange.parts import Mark, digits, require_no_blanks, require_unique
from photocal.exchange.source import Line, number, numbers, read_lines, read_text
from photocal.geometry.conversion import Conversion
from photocal.geometry.rotation import matrix_from_angles, turned_left

_CAMERA_TO_BODY = np.array([[0.0, 1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, -1.0]])
_NED_TO_ENU = np.array([[0.0, 1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, -1.0]])
# The list says nothing of how well a mark is placed.
_SIGMA_PX = (1.0, 1.0)
_PICTURE = re.compile(r"(?i)\.(jpe?g|tiff?|png|dng)$")
Places = Mapping[str, Sequence[float]]


@dataclass(frozen=True)
class GcpRow:
    """A row of gcp_list.txt: a place and where an image shows it.

    name: empty where the row has none.
    """

    line: Line
    xyz: tuple[float, float, float]
    column: float
    row: float
    image: str
    name: str


def read_gcp_rows(path: Path) -> tuple[str, tuple[GcpRow, ...], tuple[InputMalformedError, ...]]:
    """Read gcp_list.txt as somebody has typed it, row by row; rows that cannot be read come with the reason.

    returns: the system as the first line calls it, empty where that is a row already; rows; refusals.
    raises InputMalformedError: when no row can be read.
    """
    system, lines = _system(read_lines(path, comment="#", windows=True))
    first = read_text(path, windows=True).lstrip().partition("\n")[0]
    if not system and (named := re.fullmatch(r"#\s*(EPSG[ :=]*\d{4,6})\s*", first, re.IGNORECASE)):
        # The system as a comment.
        system = _odm_system(named[1])
    rows, refused = list[GcpRow](), list[InputMalformedError]()
    for line in lines:
        try:
            row = _row(line)
            if re.fullmatch(r"[-+.\d]+", row.image):
                raise line.malformed(f"has {row.image!r} where the name of an image was expected")
            rows.append(row)
        except InputMalformedError as refusal:
            refused.append(refusal)
    if not rows:
        raise (
            refused[0]
            if refused
            else InputMalformedError("has no row of a ground point", "is the file truncated?", where=path)
        )
    return system, _told_apart(_in_order(rows)), tuple(refused)


def _in_order(rows: Sequence[GcpRow]) -> Sequence[GcpRow]:
    """Rows whose images have their names, where a list has point before image throughout."""
    turned = []
    for row in rows:
        point, _, image = (row.image, "", row.name) if row.name else row.image.rpartition(" ")
        if not point or _PICTURE.search(point) or not _PICTURE.search(image):
            return rows
        turned.append(replace(row, image=image, name=point))
    # Words that begin the name of every picture are no points.
    points = {(row.name, row.xyz) for row in turned}
    alike = len(points) == len({name for name, _ in points}) == len({xyz for _, xyz in points})
    return turned if alike else rows


def _told_apart(rows: Sequence[GcpRow]) -> tuple[GcpRow, ...]:
    """Rows by the whole names of their points where the first word is that of several places."""
    whole = [" ".join(_cells(row.line.text)[6:]) for row in rows]
    places, names = defaultdict[str, set[object]](set), defaultdict[str, set[str]](set)
    for row, name in zip(rows, whole, strict=True):
        places[row.name].add(row.xyz)
        names[row.name].add(name)
    several = {name for name in names if name and len(names[name]) > 1 and len(places[name]) > 1}
    return tuple(
        replace(row, name=name) if row.name in several else row for row, name in zip(rows, whole, strict=True)
    )


def read_gcp_list(
    path: Path, sigma_px: tuple[float, float] = _SIGMA_PX
) -> tuple[str, Places, tuple[Mark, ...]]:
    """Read gcp_list.txt: its coordinate system, X, Y, Z of the points by name, and their marks.

    Geographic coordinates are longitude, latitude (deg), height (m).

    raises InputNotFoundError, InputMalformedError: also when one name has two places, or a point is marked
        twice in an image.
    """
    crs, lines = _head(path)
    marks = []
    names: dict[tuple[float, float, float], str] = {}
    for line in lines:
        row = _row(line)
        known = names.setdefault(row.xyz, row.name or f"point{len(names) + 1}")
        if row.name and row.name != known:
            raise line.malformed(f"points {known} and {row.name} have the same coordinates")
        marks.append(Mark(row.image, known, row.column, row.row, sigma_px, line.place))
    require_unique(list(names.values()), "a point with other coordinates,", path)
    require_unique([f"{mark.point} in image {mark.image}" for mark in marks], "point", path)
    return crs, {name: xyz for xyz, name in names.items()}, tuple(marks)


def _row(line: Line) -> GcpRow:
    cells = _cells(line.text)
    if len(cells) < 6:
        raise line.malformed(
            f"has {len(cells)} cells where X Y Z column row image were expected",
            "complete the row, or is the file truncated?",
        )
    x, y, z, column, row = numbers(" ".join(cells[:5]), line.place, "ground point", 5)
    return GcpRow(line, (x, y, z), column, row, cells[5], cells[6] if len(cells) > 6 else "")


def _cells(text: str) -> list[str]:
    """Cells between tabs, blanks, semicolons, or commas; a comma may be decimal where no point is.

    Names may have blanks: between tabs or semicolons any, else those of pictures with an ending.
    """
    image, words = 5, text.split()
    commas = text.count(", ") >= image or any(word.count(",") > 1 for word in words)
    between = next((mark for mark in "\t;" if text.count(mark) >= image), "," if commas else None)
    cells = text.replace(";", " ").split() if between is None else list(map(str.strip, text.split(between)))
    cells = [cell.strip("\"'") for cell in cells]
    if between is None and len(cells) > image:
        end = next((k for k in range(image, len(cells)) if _PICTURE.search(cells[k])), image)
        cells[image : end + 1] = [" ".join(cells[image : end + 1])]
    if any("." in cell for cell in cells[:5]):
        return cells
    return [*(cell.replace(",", ".") for cell in cells[:5]), *cells[5:]]


def write_gcp_list(path: Path, crs: str, places: Places, marks: Sequence[Mark]) -> None:
    """Write gcp_list.txt."""
    require_no_blanks(name for mark in marks for name in (mark.image, mark.point))
    rows = (f"{digits((*places[mark.point], mark.x, mark.y))} {mark.image} {mark.point}" for mark in marks)
    path.write_text("\n".join([crs, *rows]) + "\n", encoding="utf-8", newline="\n")


def read_geo(path: Path) -> tuple[str, Places]:
    """Read geo.txt: its coordinate system, and by image what `write_geo` takes; NaN where it says nothing."""
    crs, lines = _head(path)
    names, rows = [], []
    for line in lines:
        cells = line.text.split()
        if not 3 <= len(cells) <= 9:
            raise line.malformed(
                f"has {len(cells)} cells where image X Y [Z yaw pitch roll accuracies] were expected"
            )
        # Orientation may be skipped by writing "-" or "nan"; both mean not known.
        values = [
            float("nan") if cell.lower() in ("-", "nan") and k >= 2 else number(cell, line.place, "position")
            for k, cell in enumerate(cells[1:])
        ]
        names.append(cells[0])
        rows.append(values + [float("nan")] * (8 - len(values)))
    require_unique(names, "image", path)
    return crs, dict(zip(names, rows, strict=True))


def angles_of_geo(to_camera: Floats) -> Floats:
    """Return yaw, pitch, roll as geo.txt means them, degrees (n, 3); NaN where the rotation is unknown.

    to_camera (n, 3, 3): from east, north, up to camera axes (x right, y up in the image, z backwards).
    """
    # The body's forward is the camera's y, its right the x, its down the direction of view.
    to_body = _CAMERA_TO_BODY @ to_camera @ _NED_TO_ENU
    pitch = np.arcsin(np.clip(-to_body[:, 0, 2], -1.0, 1.0))
    yaw = np.arctan2(to_body[:, 0, 1], to_body[:, 0, 0]) % (2 * np.pi)
    roll = np.arctan2(to_body[:, 1, 2], to_body[:, 2, 2])
    return np.asarray(np.degrees(np.stack([yaw, pitch, roll], axis=1)))


def write_geo(path: Path, crs: str, images: Places) -> None:
    """Write geo.txt; what is not known at the end of a row is left out, in between it is "nan".

    images: X, Y, Z, yaw, pitch, roll (deg), horizontal and vertical accuracy (m), by name.
    """
    require_no_blanks(images)
    rows = []
    for image, values in images.items():
        last = max((k for k, value in enumerate(values) if not np.isnan(value)), default=1)
        rows.append(f"{image} {digits(values[: last + 1])}")
    path.write_text("\n".join([crs, *rows]) + "\n", encoding="utf-8", newline="\n")


def write(folder: Path, given: Block, _: Choices | None = None) -> tuple[Conversion, ...]:
    """Write gcp_list.txt of the control points and geo.txt of the images."""
    if given.frame == "local":
        raise ConfigurationError(
            "the block is in a local frame, but ODM's lists name a coordinate reference system",
            'adjust in one, for example frame = "EPSG:31982"',
        )
    # A compound name has the heights' system behind a plus.
    crs = given.frame.split("+")[0]
    names, xyz = given.points.names, given.points.values.tolist()
    control = {names[j]: xyz[j] for j in np.flatnonzero(given.points.of_role("control"))}
    rays = zip(
        given.observations.image.tolist(),
        given.observations.point.tolist(),
        given.observations.values.tolist(),
        strict=True,
    )
    marks = [
        Mark(given.images.names[i], names[j], x, y, _SIGMA_PX, "")
        for i, j, (x, y) in rays
        if names[j] in control
    ]
    if marks:
        write_gcp_list(folder / "gcp_list.txt", crs, control, marks)
    poses = given.images.values
    to_camera = matrix_from_angles(poses[:, :3]) @ _to_map(crs, poses[:, 3], poses[:, 4])
    sigma = given.images.sigma[:, 3:]
    sx, sy, sz = np.where(np.isfinite(sigma), sigma, np.nan).T
    known = np.column_stack([poses[:, 3:], angles_of_geo(to_camera), np.hypot(sx, sy), sz])
    write_geo(folder / "geo.txt", crs, dict(zip(given.images.names, known.tolist(), strict=True)))
    return ()


def _to_map(crs: str, x: Floats, y: Floats) -> Floats:
    """Return the rotations from east, north, up to the axes of a map at places on it (n, 3, 3)."""
    from pyproj import Transformer

    way = Transformer.from_crs(crs, "EPSG:4326", always_xy=True)
    lon, lat = way.transform(x, y)
    # Some metres to the north, in which meridians are straight.
    north_deg = 1e-4
    north_x, north_y = way.transform(lon, lat + north_deg, direction="INVERSE")
    return turned_left(np.arctan2(north_x - x, north_y - y))


def _head(path: Path) -> tuple[str, list[Line]]:
    lines = read_lines(path, comment="#")
    first = _odm_system(lines[0].text) if lines else ""
    if not re.fullmatch(r"EPSG: ?\d{4,6}(\+\d{4,6})?|\+(PROJ|INIT).*", first.upper()):
        raise InputMalformedError(
            f"begins with {first[:40]!r}, not with a coordinate system",
            "write EPSG:n, WGS84 UTM zone, or a PROJ string in the first line",
            where=path,
        )
    return first, lines[1:]


def _odm_system(text: str) -> str:
    """Give ODM's own names, WGS84 UTM 22S and WGS84 longlat, their codes; others stay as they are."""
    first = " ".join(text.split())
    zone = re.fullmatch(r"WGS ?84 UTM (?:ZONE )?(\d+) ?([NS])", first.upper())
    if zone:
        return f"EPSG:{32600 + 100 * (zone[2] == 'S') + int(zone[1])}"
    if code := re.fullmatch(r"EPSG[ :=]*(\d{4,6})( ?;.*)?", first.upper()):
        return f"EPSG:{code[1]}"
    return "EPSG:4326" if re.fullmatch(r"WGS84( LONGLAT| LATLONG)?", first.upper()) else first


def _system(lines: Sequence[Line]) -> tuple[str, list[Line]]:
    """Take the system off the first line; a list may begin with its first row."""
    if not lines:
        return "", []
    try:
        _row(lines[0])
    except InputMalformedError:
        # Spreadsheets fill the line up to the width of the others.
        return _odm_system(lines[0].text.strip(" \t,;")), list(lines[1:])
    return "", list(lines)
