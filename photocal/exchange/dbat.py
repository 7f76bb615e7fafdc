"""DBAT's XML set-ups (dbat_script_version 1) with their tables.

Image coordinates in px from the upper-left corner of the upper-left pixel, x right, y down (half a pixel more
than ours); interior orientation in mm, signs and lens models as in `dbat_camera`; object space in the
project's unit, taken as m. A control coordinate without sigma is held. Exterior orientations are left open.
"""

from collections.abc import Collection, Iterator
from pathlib import Path, PurePosixPath
from xml.etree.ElementTree import Element, SubElement

import numpy as np

from photocal.base.arrays import Integers
from photocal.base.errors import InputMalformedError, PhotocalError
from photocal.block.model import Block, Images, ObjectPoints, Role
from photocal.exchange import parts
from photocal.exchange.dbat_camera import (
    NAMES,
    OURS,
    DbatRow,
    from_dbat,
    read_rows,
    to_column_row,
    to_dbat,
)
from photocal.exchange.exporting import Choices
from photocal.exchange.foreign_project import ForeignProject, in_pixels
from photocal.exchange.source import (
    beside,
    child,
    image_size,
    number,
    read_xml,
    text_of,
    write_xml,
)
from photocal.geometry.camera import PARAMETERS, Camera
from photocal.geometry.conversion import Conversion, unbalanced

_CONTROL_FIELDS = ("id", "label", "dummy", "x", "y", "z", "sx", "sy", "sz", "sxy", "sxyz")
_IMAGE_FIELDS = ("id", "path", "dummy", "ignored")
_MARK_FIELDS = ("id", "im", "ignored", "dummy", "x", "y", "sx", "sy", "sxy")
# Tables that the input section of a set-up names: their files, each with its element.
_SECTIONS = ("ctrl_pts", "check_pts", "images", "image_pts")
Tables = dict[str, list[tuple[Path, Element]]]
_UNITS = {"mm": 1.0, "m": 1e3, "um": 1e-3}
_GROUPS = {
    "cc": ("cc",),
    "pp": ("px", "py"),
    "aspect": ("as",),
    "skew": ("sk",),
    "K": ("K1", "K2", "K3", "K4"),
    "P": ("P1", "P2"),
}
CONTROL_FORMAT = "id,x,y,z,sx,sy,sz"
# The parameters of ours that each switch of DBAT's estimation frees.
_SWITCHES = {key: tuple(OURS[NAMES.index(name)] for name in names) for key, names in _GROUPS.items()}


def read(path: Path) -> ForeignProject:
    """Read a set-up, and the cameras that the program wrote below it."""
    block = read_dbat(path)
    names = {camera.id for camera in block.cameras}
    cameras: dict[str, Camera] = {}
    for file in sorted(path.parent.glob("result*/*.xml")):
        try:
            cameras |= {given.id: given for given in read_dbat_cameras(file)}
        except PhotocalError:
            continue
    known = tuple(camera for name, camera in cameras.items() if name in names)
    return ForeignProject("DBAT", block, cameras=known, weighted=True)


def read_dbat(path: Path) -> Block:
    """Read a DBAT set-up and the tables that it names."""
    root = read_xml(path)
    if root.tag != "document" or "dbat_script_version" not in root.attrib:
        raise InputMalformedError(
            "is not a DBAT set-up (dbat_script_version is missing)", "name the set-up file", where=path
        )
    given = child(root, "input", path)
    if given.get("base_dir", "$HERE") != "$HERE":
        raise InputMalformedError(
            f"base_dir {given.get('base_dir')!r} is outside the folder of the set-up",
            'put the tables beside the set-up and write base_dir="$HERE"',
            where=path,
        )
    tables: Tables = {
        section: [
            (beside(path.parent, (element.text or "").strip(), path), element)
            for element in given.iterfind(f"{section}/file")
        ]
        for section in _SECTIONS
    }
    cameras = _used_cameras(root, given, path)
    if len(cameras) > 1:
        raise InputMalformedError(
            "has several cameras",
            "split it: the file does not state which image has which camera",
            where=path,
        )
    roles: tuple[tuple[str, Role], ...] = (("ctrl_pts", "control"), ("check_pts", "check"))
    surveyed = [point for section, role in roles for point in _points(tables, section, role, given, path)]
    image_of = {row.name("id"): row.cells.get("path", "") for row in _rows(tables, "images", _IMAGE_FIELDS)}
    # File names of the images by their number; the numbers where file names repeat.
    short = {key: PurePosixPath(path.replace("\\", "/")).name or key for key, path in image_of.items()}
    names = short if len(set(short.values())) == len(short) else {key: key for key in image_of}
    marks = []
    for file, element in tables["image_pts"]:
        common = element.get("sxy")
        sigma = None if common is None else number(common, path, "sxy")
        listed = read_rows(file, element.get("format", ""), _MARK_FIELDS)
        marks += [_mark(row, names, sigma) for row in listed]
    files = dict.fromkeys(file for section in tables.values() for file, _ in section)
    title = (root.findtext("meta/name") or path.stem).strip()
    shots = Images(tuple(names.values()), np.zeros(len(names), dtype=np.int64))
    return parts.block_of_marks(title, cameras, shots, surveyed, marks, [path, *files])


def read_dbat_cameras(path: Path) -> tuple[Camera, ...]:
    """Read a DBAT camera file (dbat_camera_version 1)."""
    root = read_xml(path)
    if "dbat_camera_version" not in root.attrib:
        raise InputMalformedError("is not a DBAT camera file", where=path)
    given = enumerate(root.iterfind("cameras/camera"), start=1)
    return tuple(_camera(element, path, f"camera{k}", loaded=True) for k, element in given)


def _rows(tables: Tables, section: str, allowed: tuple[str, ...]) -> Iterator[DbatRow]:
    """Give the rows of all tables of a section."""
    for path, element in tables[section]:
        yield from read_rows(path, element.get("format", ""), allowed)


def _points(
    tables: Tables, section: str, role: Role, given: Element, path: Path
) -> Iterator[parts.PointEntry]:
    """Give the points of a section in a role, as its filters choose them."""
    rules = [_rule(element, path) for element in given.iterfind(f"{section}/filter")]
    for row in _rows(tables, section, _CONTROL_FIELDS):
        name = row.name("id")
        if all((name in names) is keep for names, keep in rules):
            yield parts.PointEntry(name, role, [row.value(axis) for axis in "xyz"], row.sigma())


def _rule(element: Element, path: Path) -> tuple[set[str], bool]:
    action = (element.text or "").strip()
    if action not in ("keep", "remove") or not element.get("id"):
        raise InputMalformedError(f"filter {action!r} is not known", "use keep or remove", where=path)
    return {name.strip() for name in element.get("id", "").split(",")}, action == "keep"


def _mark(row: DbatRow, names: dict[str, str], common: float | None) -> parts.Mark:
    image = row.name("im")
    if image not in names:
        raise row.line.malformed(f"observes image {image}, which is not in the list of images")
    x, y = to_column_row(row.value("x"), row.value("y"))
    # The sigma of the set-up overrides that of the table.
    sigma = (row.value("sx"), row.value("sy")) if common is None else (common, common)
    return parts.Mark(names[image], row.name("id"), x, y, sigma, row.line.place)


def _used_cameras(root: Element, given: Element, path: Path) -> list[Camera]:
    start = root.find("operations/operation/set_initial_values/io")
    loaded = start is not None and (start.findtext("all") or start.text or "").strip() == "loaded"
    switches = _estimated_interior(root, path)
    elements = enumerate(given.iterfind("cameras/camera"), start=1)
    return [_camera(element, path, f"camera{k}", switches, loaded=loaded) for k, element in elements]


def _estimated_interior(root: Element, path: Path) -> set[str]:
    """Which of DBAT's interior parameters the set-up estimates."""
    interior = root.find("operations/operation/set_bundle_estimate_params/io")
    if interior is None:
        return set()
    switches: dict[str, bool] = dict.fromkeys(NAMES, False)
    plain = (interior.text or "").strip()
    if plain:
        switches = dict.fromkeys(NAMES, _truth(plain, path))
    for element in interior:
        value = _truth((element.text or "").strip(), path)
        names = NAMES if element.tag == "all" else _GROUPS.get(element.tag, (element.tag,))
        unknown = [name for name in names if name not in NAMES]
        if unknown:
            raise InputMalformedError(f"<io> names {unknown[0]}, which is not a parameter", where=path)
        switches.update(dict.fromkeys(names, value))
    return {name for name, on in switches.items() if on}


def _truth(text: str, path: Path) -> bool:
    if text not in ("true", "false"):
        raise InputMalformedError(f"{text!r} is neither true nor false", where=path)
    return text == "true"


def _camera(
    element: Element, path: Path, unnamed: str, switches: Collection[str] = NAMES, *, loaded: bool
) -> Camera:
    """Read `<camera>`; with `loaded`, its calibrated values, else nominal ones.

    unnamed: what it is called where it has no name.
    switches: parameters that may be estimated.
    """
    unit = (element.findtext("unit") or "mm").strip()
    malformed = InputMalformedError.at(path)
    if unit not in _UNITS:
        raise malformed(f"camera unit {unit!r} is not known", f"use {', '.join(_UNITS)}")
    if unit != "mm":
        raise malformed(f"camera unit is {unit}", "give the camera in mm")
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
            raise malformed(f"has more than {most} coefficients {name}")
        counts[name] = count
    if loaded:
        values |= _calibrated(element, path, lists)
    estimate = ["cc", "px", "py", "as", "sk"]
    estimate += [f"{name}{k + 1}" for name in "KP" for k in range(counts[name])]
    name = (element.findtext("name") or element.findtext("id") or "").strip() or unnamed
    number_of_model = int(_list(element, "model", path, 1, [1])[0])
    free = tuple(term for term in estimate if term in switches)
    return from_dbat(name, number_of_model, size_px, pixel, values, free, path)


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
    malformed = InputMalformedError.at(path)
    if len(cells) != 2 or cells == ["auto", "auto"]:
        raise malformed(f"sensor {sensor!r} is not a width and a height", "give both in mm")
    stretch = 2 - aspect
    sides = [0.0 if cell == "auto" else number(cell, path, "sensor") for cell in cells]
    pixel = sides[1] / size_px[1] if sides[1] else sides[0] / size_px[0] / stretch
    if not pixel > 0:
        raise malformed(f"sensor {sensor!r} is impossible", "give it in mm")
    if all(sides) and abs(sides[0] / size_px[0] / (pixel * stretch) - 1) > 1e-4:
        raise malformed(
            f"sensor {sensor!r} and image {size_px[0]},{size_px[1]} make pixels that are not square, "
            f"against aspect {aspect:g}",
            "correct the sensor or the aspect",
        )
    return pixel, size_px[0] * pixel


def _list(
    element: Element, name: str, path: Path, count: int | None, default: list[float] | None = None
) -> list[float]:
    text = (element.findtext(name) or "").strip()
    malformed = InputMalformedError.at(path)
    if not text:
        if default is None:
            raise malformed(f"<camera> has no <{name}>", "add it")
        return default
    values = [number(cell, path, name) for cell in text.split(",")]
    if count is not None and len(values) != count:
        raise malformed(f"<{name}> has {len(values)} values where {count} were expected")
    return values


def detect(path: Path) -> bool:
    """Whether an XML file is a set-up of this program."""
    return "dbat_script_version" in read_xml(path).attrib


def write_dbat(folder: Path, block: Block) -> Path:
    """Write setup.xml, images.txt, marks.txt, control.txt and check.txt."""
    _require_expressible(block)
    camera = unbalanced(block.cameras[0])
    names = block.points.names
    control = np.flatnonzero(block.points.of_role("control"))
    check = np.flatnonzero(block.points.of_role("check"))
    parts.write_rows(folder / "control.txt", _surveyed(block.points, control), ", ")
    parts.write_rows(folder / "check.txt", _surveyed(block.points, check), ", ")
    parts.write_rows(folder / "images.txt", list(enumerate(block.images.names, start=1)), ", ")
    seen = in_pixels(block).observations
    marks = zip(seen.image, seen.point, seen.values, seen.sigma, strict=True)
    parts.write_rows(
        folder / "marks.txt",
        [[names[j], int(i) + 1, *(pixel + 0.5).tolist(), *s.tolist()] for i, j, pixel, s in marks],
        ", ",
    )
    root = Element("document", dbat_script_version="1.0")
    SubElement(SubElement(root, "meta"), "name").text = block.name
    given = SubElement(root, "input", base_dir="$HERE")
    for section, count in (("ctrl_pts", len(control)), ("check_pts", len(check))):
        if count:
            name = "control.txt" if section == "ctrl_pts" else "check.txt"
            SubElement(SubElement(given, section), "file", format=CONTROL_FORMAT).text = name
    SubElement(SubElement(given, "images"), "file", format="id,path").text = "images.txt"
    SubElement(SubElement(given, "image_pts"), "file", format="id,im,x,y,sx,sy").text = "marks.txt"
    _write_camera(SubElement(SubElement(given, "cameras"), "camera"), camera)
    _operations(SubElement(root, "operations"), camera)
    path = folder / "setup.xml"
    write_xml(path, root)
    return path


def lens_model(camera: Camera) -> int:
    """Number of DBAT's lens model for a camera."""
    index = [PARAMETERS.index(name) for name in ("B1", "B2")]
    affine = bool(camera.values[index].any() or camera.estimated[index].any())
    others = [PARAMETERS.index(name) for name in ("P3", "P4")]
    expressible = not (camera.values[others].any() or camera.estimated[others].any())
    if camera.affinity_form != "fraser" and affine:
        expressible = False
    if camera.model == "brown-ideal" and not affine and expressible:
        return -1
    if camera.model == "brown-observed" and expressible and (not affine or camera.affinity != "additive"):
        return 4 if camera.affinity == "after" else 3
    raise InputMalformedError(
        f"camera {camera.id} has no equivalent in DBAT", "use brown-observed, affinity before or after"
    )


def _require_expressible(block: Block) -> None:
    if len(block.cameras) != 1 or block.cameras[0].unit != "mm":
        raise InputMalformedError("only blocks with one camera, in mm, can be written for DBAT")
    camera = block.cameras[0]
    if camera.pitch[0] != camera.pitch[1]:
        raise InputMalformedError("pixels are not square", "give them square, and the affinity as B1")
    if (
        np.isfinite(camera.prior_sigma).any()
        or np.isfinite(block.images.sigma).any()
        or block.relations.kind.size
    ):
        raise InputMalformedError(
            "the block observes orientations or distances, which a set-up cannot hold",
            "leave out their sigmas",
        )
    for key, names in _SWITCHES.items():
        held = {bool(camera.estimated[PARAMETERS.index(name)]) for name in names[: _count(camera, key)]}
        if len(held) > 1:
            raise InputMalformedError(f"DBAT estimates {', '.join(names)} together or not at all")
    for name in block.points.names:
        if not name.isdecimal():
            raise InputMalformedError(f"point {name!r} has a name that is not a number, which DBAT needs")


def _count(camera: Camera, key: str) -> int:
    """How many parameters of a group the camera has: coefficients end with the last that is used."""
    names = _SWITCHES[key]
    if key not in ("K", "P"):
        return len(names)
    index = [PARAMETERS.index(name) for name in names]
    used = np.flatnonzero((camera.values[index] != 0) | camera.estimated[index])
    return int(used[-1]) + 1 if len(used) else 0


def _surveyed(points: ObjectPoints, rows: Integers) -> list[parts.Row]:
    table: list[parts.Row] = []
    for k in rows:
        if not np.isfinite(points.sigma[k]).all() and points.of_role("control")[k]:
            raise InputMalformedError(f"control point {points.names[k]} has coordinates without sigma")
        sigma = np.where(np.isfinite(points.sigma[k]), points.sigma[k], 0.0)
        table.append([points.names[k], *points.values[k].tolist(), *sigma.tolist()])
    return table


def _write_camera(element: Element, camera: Camera) -> None:
    value = to_dbat(camera, lens_model(camera))
    lists = {key: [value[name] for name in _SWITCHES[key][: _count(camera, key)]] for key in ("K", "P")}
    texts = {
        "name": camera.id,
        "unit": "mm",
        "sensor": f"auto,{camera.size_px[1] * camera.pitch[1]!r}",
        "image": f"{camera.size_px[0]},{camera.size_px[1]}",
        "aspect": repr(1 - value["as"]),
        "focal": repr(value["cc"]),
        "model": str(lens_model(camera)),
        "nK": str(len(lists["K"])),
        "nP": str(len(lists["P"])),
        "cc": repr(value["cc"]),
        "pp": f"{value['px']!r},{value['py']!r}",
        "skew": repr(value["sk"]),
    } | {key: ",".join(repr(number) for number in numbers) for key, numbers in lists.items() if numbers}
    for key, text in texts.items():
        SubElement(element, key).text = text


def _operations(element: Element, camera: Camera) -> None:
    values = SubElement(SubElement(element, "operation"), "set_initial_values")
    SubElement(values, "io").text = "loaded"
    SubElement(values, "op").text = "loaded"
    estimate = SubElement(SubElement(element, "operation"), "set_bundle_estimate_params")
    switches = SubElement(estimate, "io")
    for key, names in _SWITCHES.items():
        SubElement(switches, key).text = str(bool(camera.estimated[PARAMETERS.index(names[0])])).lower()
    SubElement(SubElement(estimate, "eo"), "all").text = "true"
    SubElement(SubElement(estimate, "op"), "all").text = "default"
    for name in ("spatial_resection", "forward_intersection", "bundle_adjustment"):
        SubElement(element, "operation").text = name


def write(folder: Path, given: Block, _: Choices) -> tuple[Conversion, ...]:
    """A set-up and its tables; orientations and tie points are start values there."""
    seen, images = given.observations, given.images
    rays = parts.pixels(seen.image, seen.point, seen.values)
    started = Images(images.names, images.camera, images.values)
    write_dbat(folder, parts.block(given.name, given.cameras, started, given.points, rays, ()))
    return tuple(Conversion(camera) for camera in given.cameras)
