"""PhotoModeler's text export ("export text file", solution with marks) into a block.

Image coordinates in px from the upper-left corner of the upper-left pixel, x right, y down (half a pixel more
than ours); interior orientation in mm from that corner, K and P with the opposite sign of ours; pixels of
format / size, which need not be square; distortion corrects the measurement (`brown-observed`). Orientation
as X, Y, Z (project unit, taken as m), kappa, phi, omega (deg) of our own rotation. Standard deviations of
control points in the export are a posteriori: those of the survey come from a table of control points. A
mark with sigma 0 (a SmartPoint) has the default of 1 px.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from photocal.base.arrays import Floats
from photocal.base.errors import ConfigurationError, InputMalformedError, PhotocalError
from photocal.block.model import Block, Images
from photocal.exchange import parts
from photocal.exchange.dbat_camera import read_rows, to_column_row
from photocal.exchange.exporting import Choices
from photocal.exchange.foreign_project import ForeignProject
from photocal.exchange.parts import digits, known, require_file_name, whole_numbers, write_rows
from photocal.exchange.source import Line, image_size, numbers, read_lines, read_text
from photocal.geometry.camera import Camera, camera
from photocal.geometry.conversion import Conversion, converted

# Tolerance and number of iterations of the head; nothing depends on them.
_HEAD = "0.0005 20"
_TERMS = ("K1", "K2", "K3", "P1", "P2", "B1")


# Principal distance, principal point, format (mm), K1, K2, K3, P1, P2.
Interior = tuple[float, ...]
# File name without folders; omega, phi, kappa in radians, X, Y, Z; interior orientation.
Photo = tuple[str, Floats, Interior]


@dataclass(frozen=True)
class Export:
    """What a text export holds.

    interior: default camera of the head, with one digit more than the photos have.
    points: coordinates of all object points by their name, SmartPoints renumbered behind the others.
    """

    title: str
    size_px: tuple[int, int]
    interior: Interior
    photos: tuple[Photo, ...]
    control: dict[str, Floats]
    points: dict[str, Floats]
    marks: tuple[parts.Mark, ...]
    path: Path


class _Cursor:
    """Goes through the lines of an export, whose sections end at a blank line."""

    def __init__(self, path: Path) -> None:
        self.lines = [Line(path, k, text) for k, text in enumerate(read_text(path).split("\n"), start=1)]
        self.path, self.at = path, 0

    def next(self) -> Line:
        """Give the next line; raises InputMalformedError at the end of the file."""
        if self.at >= len(self.lines):
            raise InputMalformedError(
                "ends before its tables do", "was it written completely?", where=self.path
            )
        self.at += 1
        return self.lines[self.at - 1]

    @property
    def in_section(self) -> bool:
        """Whether the section goes on."""
        return self.at < len(self.lines) and bool(self.lines[self.at].text.strip())

    def values(self, what: str, count: int) -> list[float]:
        """Read so many numbers of the next line."""
        line = self.next()
        return numbers(line.text, line.place, what, count)

    def section(self) -> list[Line]:
        """Give the lines up to the next empty one."""
        begin = self.at
        while self.next().text.strip():
            pass
        return self.lines[begin : self.at - 1]


def detect(path: Path) -> bool:
    """Whether a text file has the head of a PhotoModeler export: title, tolerances, and image size."""
    try:
        head = read_text(path).split("\n", 2)
    except PhotocalError:
        return False
    return len(head) == 3 and len(head[1].split()) == 4 and head[1].split()[2].isdecimal()


def read_export(path: Path) -> Export:
    """Read a text export."""
    cursor = _Cursor(path)
    title = cursor.next().text.strip()
    line = cursor.next()
    head = numbers(line.text, line.place, "tolerance, iterations and image size", 4)
    size_px = image_size(head[2], head[3], line.place)
    cursor.next()
    interior = tuple(cursor.values("default camera", 10))
    cursor.next()
    photos = list[Photo]()
    while cursor.in_section:
        photos.append(_photo(cursor, len(photos)))
    cursor.next()
    control = dict(_points(cursor.section()))
    objects = _points(cursor.section())
    shift, first_smart = _smart_shift([int(name) for name, _ in objects])
    points = {
        str(int(name) + shift) if k >= first_smart else name: xyz for k, (name, xyz) in enumerate(objects)
    }
    parts.require_unique([name for name, _ in objects[:first_smart]], "object point", path)
    marks = tuple(_mark(row, photos, shift) for row in cursor.section())
    if not marks:
        raise InputMalformedError("has no marked points", "export the marks too", where=path)
    return Export(title, size_px, interior, tuple(photos), control, points, marks, path)


def _photo(cursor: _Cursor, expected: int) -> Photo:
    line = cursor.next()
    cells = line.text.split(maxsplit=1)
    if len(cells) != 2 or not cells[0].isdecimal() or int(cells[0]) != expected:
        raise line.malformed(f"is not the head of photo {expected}")
    pose = cursor.values("orientation", 7)[1:]
    cursor.values("its standard deviations", 7)
    covariance = cursor.next()
    if covariance.text.strip():
        numbers(covariance.text, covariance.place, "its covariances", 4)
    interior = cursor.values("interior orientation", 11)[1:]
    cursor.values("its standard deviations", 11)
    name = cells[1].strip().replace("\\", "/").rsplit("/", 1)[-1]
    return name, np.array([*np.radians(pose[:2:-1]), *pose[:3]]), tuple(interior)


def _points(lines: list[Line]) -> list[tuple[str, Floats]]:
    rows = []
    for line in lines:
        values = numbers(line.text, line.place, "point, coordinates and standard deviations", 7)
        rows.append((str(int(values[0])), np.array(values[1:4])))
    return rows


def _smart_shift(ids: list[int]) -> tuple[int, int]:
    """By how much the numbers of SmartPoints are raised, and the row of the first of them."""
    falls = [k for k in range(1, len(ids)) if ids[k] < ids[k - 1]]
    if len(falls) != 1:
        return 0, len(ids)
    first = falls[0]
    return max(ids[:first]) + 1 - min(ids[first:]), first


def _mark(line: Line, photos: list[Photo], shift: int) -> parts.Mark:
    photo, point, x, y, sx, sy = numbers(line.text, line.place, "photo, point, x, y and sigmas", 6)
    if not 0 <= photo < len(photos):
        raise line.malformed(f"observes photo {photo:g}, which is not in the file")
    smart = sx == 0 and sy == 0
    default_sigma_px = 1.0
    sigma = (default_sigma_px, default_sigma_px) if smart else (sx, sy)
    name = str(int(point) + shift) if smart else str(int(point))
    return parts.Mark(photos[int(photo)][0], name, *to_column_row(x, y), sigma, line.place)


def read_control(path: Path) -> dict[str, tuple[Floats, Floats]]:
    """Read a table of control points: id, name, X, Y, Z and, optionally, three standard deviations."""
    widths = {len(line.text.split(",")) for line in read_lines(path)}
    layout = "id,label,x,y,z" + (",sx,sy,sz" if widths != {5} else "")
    rows = list(read_rows(path, layout, ("id", "label", "x", "y", "z", "sx", "sy", "sz")))
    parts.require_unique([row.name("id") for row in rows], "control point", path)
    return {
        row.name("id"): (np.array([row.value(axis) for axis in "xyz"]), np.array(row.sigma())) for row in rows
    }


def block_from_export(
    export: Export, control: dict[str, tuple[Floats, Floats]], files: Sequence[Path] = ()
) -> Block:
    """Make a block from an export and a table of control points."""
    place = export.path
    shift = _shift(export, control, place)
    names, poses, own = zip(*export.photos, strict=True)
    parts.require_unique(names, "photo", place)
    observed = {mark.point for mark in export.marks}
    idle = [name for name in export.points if name not in observed and name not in control]
    if idle:
        raise InputMalformedError(
            f"object point {', '.join(idle[:5])} has no observation at all",
            "export its marks, or remove it",
            where=place,
        )
    points = [parts.PointEntry(name, "control", xyz, sigma) for name, (xyz, sigma) in control.items()]
    points += [
        parts.PointEntry(name, "tie", xyz + shift)
        for name, xyz in export.points.items()
        if name not in control
    ]
    values = np.array(poses)
    values[:, 3:] += shift
    interiors = list(dict.fromkeys(own))
    # The photos' c and principal point are printed to 1 um, their coefficients to five decimals; the head has
    # the same values with more digits.
    rounding = [0.51e-3] * 3 + [0.51e-5] * 7
    alike = zip(interiors[0], export.interior, rounding, strict=True)
    rounded = len(interiors) == 1 and all(abs(a - b) <= most for a, b, most in alike)
    printed = [export.interior] if rounded else interiors
    cameras = tuple(
        _camera(export.size_px, interior, f"camera{k}", place) for k, interior in enumerate(printed, start=1)
    )
    which = [interiors.index(interior) for interior in own]
    shots = Images(names, np.array(which, dtype=np.int64), values)
    return parts.block_of_marks(
        export.title or place.as_posix(), cameras, shots, points, export.marks, files or [place]
    )


def read(path: Path) -> ForeignProject:
    """Read an export with the table of control points in its folder."""
    export, control = read_export(path), control_beside(path)
    if control.exists():
        block = block_from_export(export, read_control(control), [path, control])
        return ForeignProject("PhotoModeler", block, weighted=True)
    if export.control:
        raise ConfigurationError(
            "has control points, whose standard deviations in a PhotoModeler export are a posteriori",
            f"put a table id,name,X,Y,Z,sX,sY,sZ beside it as {control.name}",
            where=path,
        )
    return ForeignProject("PhotoModeler", block_from_export(export, {}), weighted=True)


def control_beside(export: Path) -> Path:
    """Where the control points of an export are looked for: `NAME-control.txt` beside it."""
    return export.with_name(f"{export.stem}-control.txt")


def _shift(export: Export, control: dict[str, tuple[Floats, Floats]], place: Path) -> Floats:
    """What must be added to exported coordinates: the mean over common control points."""
    common = [name for name in export.control if name in control]
    if not common:
        return np.zeros(3)
    missing = [name for name in export.control if name not in control]
    if missing:
        raise InputMalformedError(
            f"control point {missing[0]} of the export is not in the table of control points", where=place
        )
    return np.asarray(np.mean([control[name][0] - export.control[name] for name in common], axis=0))


def _camera(size_px: tuple[int, int], interior: Interior, name: str, place: Path) -> Camera:
    c, px, py, width, height, k1, k2, k3, p1, p2 = interior
    if not (c > 0 and width > 0 and height > 0):
        raise InputMalformedError("principal distance or format is not positive", where=place)
    calibrated = camera(
        name,
        "brown-observed",
        "mm",
        size_px,
        (width / size_px[0], height / size_px[1]),
        {"c": c, "x0": px - width / 2, "y0": height / 2 - py}
        | {"K1": -k1, "K2": -k2, "K3": -k3, "P1": -p1, "P2": -p2},
    )
    return replace(calibrated, distortion_at="measured")


def write(path: Path, given: Block, _: Choices | None = None) -> tuple[Conversion, ...]:
    """Write an export, and `NAME-control.txt` beside it where there is control."""
    sizes = {camera.size_px for camera in given.cameras}
    if len(sizes) != 1 or any(camera.unit != "mm" for camera in given.cameras):
        raise InputMalformedError(
            "a PhotoModeler export has images of one size, and cameras in mm",
            "give the pixel pitch, and export cameras of other sizes separately",
        )
    for name in given.images.names:
        require_file_name(name)
    made = tuple(_converted(camera) for camera in given.cameras)
    interiors = [_interior(conversion.camera) for conversion in made]
    numbers = whole_numbers(given.points.names)
    order = sorted(range(len(numbers)), key=lambda j: int(numbers[j]))
    sigma = known(given.points.sigma)
    rows = {j: f"{numbers[j]} {digits([*given.points.values[j], *sigma[j]])}" for j in order}
    control = set(np.flatnonzero(given.points.of_role("control")).tolist())
    surveyed = [j for j in order if j in control]
    width, height = sizes.pop()
    lines = [
        given.name,
        f"{_HEAD} {width} {height}",
        digits([1.0] * 9),
        digits(interiors[0]),
        digits([0.0] * 10),
    ]
    for k, name in enumerate(given.images.names):
        lines += _photo_lines(k, name, given, interiors[int(given.images.camera[k])])
    marks, seen = [], given.observations
    for ray in np.argsort(seen.image, kind="stable"):
        x, y = (seen.values[ray] + 0.5).tolist()
        marks.append(f"{seen.image[ray]} {numbers[seen.point[ray]]} {x!r} {y!r} 1.0 1.0")
    # Every section ends with a blank line.
    lines += ["", *(rows[j] for j in surveyed), "", *rows.values(), "", *marks, "", ""]
    path.write_text("\n".join(lines), encoding="utf-8", newline="\n")
    if control:
        cells = [[numbers[j], numbers[j], *given.points.values[j], *sigma[j]] for j in surveyed]
        write_rows(control_beside(path), cells, ", ")
    return made


def _converted(camera: Camera) -> Conversion:
    """A camera that corrects measurements, with its affinity in the width of the pixels."""
    if camera.value("B2"):
        raise InputMalformedError(
            f"camera {camera.id} has a skew (B2), which PhotoModeler cannot hold", "adjust without B2"
        )
    terms = _TERMS if camera.value("B1") else _TERMS[:-1]
    return converted(camera, "brown-observed", "before", terms)


def _interior(camera: Camera) -> list[float]:
    """Principal distance, principal point, format, K1, K2, K3, P1, P2."""
    stretch = 1 + camera.value("B1")
    width, height = camera.size_px[0] * camera.pitch[0] * stretch, camera.size_px[1] * camera.pitch[1]
    point = [camera.value("x0") * stretch + width / 2, height / 2 - camera.value("y0")]
    terms = [-camera.value(name) for name in ("K1", "K2", "K3", "P1", "P2")]
    return [camera.value("c"), *point, width, height, *terms]


def _photo_lines(k: int, name: str, given: Block, interior: Sequence[float]) -> list[str]:
    pose, spread = (
        [*v[3:], *np.degrees(v[2::-1])] for v in (given.images.values[k], known(given.images.sigma[k]))
    )
    return [
        f"{k} {name}",
        f"{k} {digits(pose)}",
        f"{k} {digits(spread)}",
        "",
        f"{k} {digits(interior)}",
        f"{k} {digits([0.0] * 10)}",
    ]
