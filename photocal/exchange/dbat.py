"""DBAT's XML set-ups (dbat_script_version 1) with their tables, read into a block.

Image coordinates in px from the upper-left corner of the upper-left pixel, x right, y down (half a pixel more
than ours); interior orientation in mm, signs and lens models as in `dbat_camera`; object space in the
project's unit, taken as m. A control coordinate without sigma is held. Exterior orientations are left open.
"""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path, PurePosixPath
from xml.etree.ElementTree import Element

from drivers.errors import InputMalformedError
from photocal.block.model import Block, InputFile, Role
from photocal.exchange import parts
from photocal.exchange.dbat_camera import NAMES, DbatCamera, from_dbat, to_column_row
from photocal.exchange.dbat_tables import CONTROL_FIELDS, IMAGE_FIELDS, MARK_FIELDS, Row, read_rows
from photocal.exchange.markup import child, read_xml, text_of
from photocal.exchange.reconstruction import Reconstruction, of_block
from photocal.exchange.source import beside, fingerprint, image_size, number

_UNITS = {"mm": 1.0, "m": 1e3, "um": 1e-3}
_GROUPS = {
    "cc": ("cc",),
    "pp": ("px", "py"),
    "aspect": ("as",),
    "skew": ("sk",),
    "K": ("K1", "K2", "K3", "K4"),
    "P": ("P1", "P2"),
}


def read_dbat(path: Path) -> Block:
    """Read a DBAT set-up and the tables that it names."""
    root = read_xml(path)
    if root.tag != "document" or "dbat_script_version" not in root.attrib:
        raise InputMalformedError(
            "is no DBAT set-up (dbat_script_version is missing)", where=path, remedy="name the set-up file"
        )
    given = child(root, "input", path)
    if given.get("base_dir", "$HERE") != "$HERE":
        raise InputMalformedError(
            f"base_dir {given.get('base_dir')!r} leads out of the set-up's folder",
            where=path,
            remedy='put the tables beside the set-up and write base_dir="$HERE"',
        )
    reader = _Tables(path, given)
    cameras = [
        from_dbat(camera, camera.name or f"camera{k}", path)
        for k, camera in enumerate(_used_cameras(root, given, path), start=1)
    ]
    if len(cameras) > 1:
        raise InputMalformedError(
            "has several cameras", where=path, remedy="split it: which image has which camera is not said"
        )
    surveyed = [*reader.points("ctrl_pts", "control"), *reader.points("check_pts", "check")]
    image_of = {row.name("id"): row.cells.get("path", "") for row in reader.rows("images", IMAGE_FIELDS)}
    names = _image_names(image_of)
    marks = [_mark(row, names, sigma) for row, sigma in reader.marks()]
    known = {point.name for point in surveyed}
    tie = dict.fromkeys(mark.point for mark in marks if mark.point not in known)
    points = [*surveyed, *(parts.PointEntry(name, "tie") for name in tie)]
    parts.require_unique([point.name for point in points], "point", path)
    observed = parts.observations(
        marks, list(names.values()), [point.name for point in points], "px", "pixel"
    )
    return Block(
        (root.findtext("meta/name") or path.stem).strip(),
        "local",
        "",
        "control",
        (),
        tuple(cameras),
        parts.images(list(names.values()), [0] * len(names)),
        parts.object_points(points),
        observed,
        (fingerprint(path), *reader.read),
    )


def read_dbat_cameras(path: Path) -> tuple[DbatCamera, ...]:
    """Read a DBAT camera file (dbat_camera_version 1)."""
    root = read_xml(path)
    if "dbat_camera_version" not in root.attrib:
        raise InputMalformedError("is no DBAT camera file", where=path)
    return tuple(_camera(element, path, loaded=True) for element in root.iterfind("cameras/camera"))


class _Tables:
    """The tables that the input section names; remembers what was read."""

    def __init__(self, path: Path, given: Element) -> None:
        self.path, self.given = path, given
        self.read: list[InputFile] = []

    def files(self, section: str) -> Iterator[tuple[Path, Element]]:
        for element in self.given.iterfind(f"{section}/file"):
            found = beside(self.path.parent, (element.text or "").strip(), self.path)
            digest = fingerprint(found)
            if digest not in self.read:
                self.read.append(digest)
            yield found, element

    def rows(self, section: str, allowed: tuple[str, ...]) -> Iterator[Row]:
        for path, element in self.files(section):
            yield from read_rows(path, element.get("format", ""), allowed)

    def points(self, section: str, role: Role) -> Iterator[parts.PointEntry]:
        rules = [_rule(element, self.path) for element in self.given.iterfind(f"{section}/filter")]
        for row in self.rows(section, CONTROL_FIELDS):
            name = row.name("id")
            if all((name in names) is keep for names, keep in rules):
                yield parts.PointEntry(name, role, [row.value(axis) for axis in "xyz"], row.sigma())

    def marks(self) -> Iterator[tuple[Row, float | None]]:
        for path, element in self.files("image_pts"):
            common = element.get("sxy")
            sigma = None if common is None else number(common, self.path, "sxy")
            for row in read_rows(path, element.get("format", ""), MARK_FIELDS):
                yield row, sigma


def _rule(element: Element, path: Path) -> tuple[set[str], bool]:
    action = (element.text or "").strip()
    if action not in ("keep", "remove") or not element.get("id"):
        raise InputMalformedError(f"filter {action!r} is not known", where=path, remedy="use keep or remove")
    return {name.strip() for name in element.get("id", "").split(",")}, action == "keep"


def _mark(row: Row, names: dict[str, str], common: float | None) -> parts.Mark:
    image = row.name("im")
    if image not in names:
        raise InputMalformedError(
            f"observes image {image}, which is not in the list of images", where=row.line.place
        )
    x, y = to_column_row(row.value("x"), row.value("y"))
    # The sigma of the set-up overrides that of the table.
    sigma = (row.value("sx"), row.value("sy")) if common is None else (common, common)
    return parts.Mark(names[image], row.name("id"), x, y, sigma, row.line.place)


def _image_names(paths: dict[str, str]) -> dict[str, str]:
    """File names of the images by their number; the numbers where file names repeat."""
    short = {key: PurePosixPath(path.replace("\\", "/")).name or key for key, path in paths.items()}
    return short if len(set(short.values())) == len(short) else {key: key for key in paths}


def _used_cameras(root: Element, given: Element, path: Path) -> Iterator[DbatCamera]:
    loaded = _initial_interior(root) == "loaded"
    switches = _estimated_interior(root, path)
    for element in given.iterfind("cameras/camera"):
        camera = _camera(element, path, loaded)
        estimate = tuple(name for name in camera.estimate if name in switches)
        yield DbatCamera(
            camera.name, camera.lens_model, camera.size_px, camera.pixel_mm, camera.values, estimate
        )


def _initial_interior(root: Element) -> str:
    found = root.find("operations/operation/set_initial_values/io")
    if found is None:
        return "default"
    return (found.findtext("all") or found.text or "default").strip()


def _estimated_interior(root: Element, path: Path) -> set[str]:
    """Which of DBAT's interior parameters the set-up estimates."""
    found = root.find("operations/operation/set_bundle_estimate_params/io")
    if found is None:
        return set()
    switches: dict[str, bool] = dict.fromkeys(NAMES, False)
    plain = (found.text or "").strip()
    if plain:
        switches = dict.fromkeys(NAMES, _truth(plain, path))
    for element in found:
        value = _truth((element.text or "").strip(), path)
        names = NAMES if element.tag == "all" else _GROUPS.get(element.tag, (element.tag,))
        unknown = [name for name in names if name not in NAMES]
        if unknown:
            raise InputMalformedError(f"<io> names {unknown[0]}, which is no parameter", where=path)
        switches.update(dict.fromkeys(names, value))
    return {name for name, on in switches.items() if on}


def _truth(text: str, path: Path) -> bool:
    if text not in ("true", "false"):
        raise InputMalformedError(f"{text!r} is neither true nor false", where=path)
    return text == "true"


def _camera(element: Element, path: Path, loaded: bool) -> DbatCamera:
    """Read `<camera>`; with `loaded`, its calibrated values, else nominal ones."""
    unit = (element.findtext("unit") or "mm").strip()
    if unit not in _UNITS:
        raise InputMalformedError(
            f"camera unit {unit!r} is not known", where=path, remedy=f"use {', '.join(_UNITS)}"
        )
    if unit != "mm":
        raise InputMalformedError(f"camera unit is {unit}", where=path, remedy="give the camera in mm")
    size = _list(element, "image", path, 2)
    size_px = image_size(size[0], size[1], path)
    aspect = _list(element, "aspect", path, 1, [1.0])[0]
    pixel, width = _pixel(text_of(element, "sensor", path), size_px, aspect, path)
    counts = {name: int(_list(element, f"n{name}", path, 1, [-1])[0]) for name in "KP"}
    values = {
        "cc": _list(element, "focal", path, 1, [0.0])[0],
        "px": width / 2,
        "py": size_px[1] * pixel / 2,
        "as": 1 - aspect,
    }
    lists = {name: _list(element, name, path, None, []) for name in "KP"}
    for name, most in (("K", 4), ("P", 2)):
        count = counts[name] if counts[name] >= 0 else len(lists[name])
        if not max(count, len(lists[name])) <= most:
            raise InputMalformedError(f"has more than {most} coefficients {name}", where=path)
        counts[name] = count
    if loaded:
        values |= _calibrated(element, path, lists)
    estimate = ["cc", "px", "py", "as", "sk"]
    estimate += [f"{name}{k + 1}" for name in "KP" for k in range(counts[name])]
    return DbatCamera(
        (element.findtext("name") or element.findtext("id") or "").strip(),
        int(_list(element, "model", path, 1, [1])[0]),
        size_px,
        pixel,
        values,
        tuple(estimate),
    )


def _calibrated(element: Element, path: Path, lists: dict[str, list[float]]) -> dict[str, float]:
    """Calibrated values; a principal distance or point of zero is a placeholder, not a value."""
    values = {f"{name}{k}": value for name in "KP" for k, value in enumerate(lists[name], start=1)}
    distance = _list(element, "cc", path, 1, [0.0])[0]
    if distance > 0:
        values["cc"] = distance
    point = _list(element, "pp", path, 2, [0.0, 0.0])
    if any(point):
        values["px"], values["py"] = point
    values["sk"] = _list(element, "skew", path, 1, [0.0])[0]
    return values


def _pixel(sensor: str, size_px: tuple[int, int], aspect: float, path: Path) -> tuple[float, float]:
    """Height of a pixel and width of the sensor, mm; one side of the sensor may be "auto"."""
    cells = [cell.strip() for cell in sensor.split(",")]
    if len(cells) != 2 or cells == ["auto", "auto"]:
        raise InputMalformedError(
            f"sensor {sensor!r} is not a width and a height", where=path, remedy="give both in mm"
        )
    stretch = 2 - aspect
    sides = [0.0 if cell == "auto" else number(cell, path, "sensor") for cell in cells]
    pixel = sides[1] / size_px[1] if sides[1] else sides[0] / size_px[0] / stretch
    if not pixel > 0:
        raise InputMalformedError(f"sensor {sensor!r} is impossible", where=path, remedy="give it in mm")
    if all(sides) and abs(sides[0] / size_px[0] / (pixel * stretch) - 1) > 1e-4:
        raise InputMalformedError(
            f"sensor {sensor!r} and image {size_px[0]},{size_px[1]} make pixels that are not square, "
            f"against aspect {aspect:g}",
            where=path,
            remedy="correct the sensor or the aspect",
        )
    return pixel, size_px[0] * pixel


def _list(
    element: Element, name: str, path: Path, count: int | None, default: list[float] | None = None
) -> list[float]:
    text = (element.findtext(name) or "").strip()
    if not text:
        if default is None:
            raise InputMalformedError(f"<camera> has no <{name}>", where=path, remedy="add it")
        return default
    values = [number(cell, path, name) for cell in text.split(",")]
    if count is not None and len(values) != count:
        raise InputMalformedError(
            f"<{name}> has {len(values)} values where {count} were expected", where=path
        )
    return values


def read_back(folder: Path) -> Reconstruction:
    """A set-up with its tables; it has no orientations."""
    return of_block(read_dbat(folder / "setup.xml"))


def recognises(path: Path) -> bool:
    """Whether an XML file is a set-up of this program."""
    return "dbat_script_version" in read_xml(path).attrib
