"""Pix4Dmapper's `params` folder: cameras, orientations, control and image measurements of a whole project.

All names end alike; a project's name stands before. Per image `calibrated_camera_parameters.txt` has K in
px (the corner of the upper-left pixel is 0), K1 K2 K3, T1 T2 (`brown-ideal`, OpenCV's k and p), the position
less `offset.xyz` and R, x = K [R, -R t] X. `tp_bingo.txt` has the measurements as they were: mm from the
middle of the image, y up. Coordinates are those of the output system (`wkt.prj`), in which the program
reckons as if it were Cartesian; the block takes them for what they are. Source: layouts of real projects, of
one full-frame camera and of rigs.

Single files of a Pix4D project: its cameras (.cam), and its orientations without measurements.

`pix4d_calibrated_internal_camera_parameters.cam` has for each camera F, Px, Py in mm on a sensor of the
stated size, from the image's upper-left corner, and K1 K2 K3, T1 T2 of coordinates divided by F
(`brown-ideal`). `calibrated_external_camera_parameters.txt` has a head and a row for each image: name X Y Z
Omega Phi Kappa, m in the output system (`wkt.prj` beside it) and degrees of our own rotation. The .cam of the
same name without "pix4d" is Inpho's: it has no distortion, and is not read.
"""

import re
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import replace
from decimal import Decimal
from pathlib import Path

import numpy as np

from photocal.base.arrays import Floats
from photocal.base.errors import InputMalformedError, InputNotFoundError, PhotocalError
from photocal.block.model import NO_OBSERVATIONS, NO_POINTS, Block, Images
from photocal.exchange.bingo import in_order, read_bingo
from photocal.exchange.exporting import Choices, file_name
from photocal.exchange.foreign_project import ASSUMED_M, ForeignProject, without_weak_points
from photocal.exchange.parts import PointEntry, block, distinct, object_points, output_system
from photocal.exchange.pinhole import Pinhole, from_pinhole, from_vision, require_one_focal_length, to_pinhole
from photocal.exchange.pix4d_inputs import SUFFIX as PROJECT
from photocal.exchange.pix4d_inputs import read_inputs
from photocal.exchange.rigs import of_poses
from photocal.exchange.source import Line, decimal_comma, image_size, number, numbers, printed, read_lines
from photocal.geometry.camera import Camera
from photocal.geometry.conversion import Conversion

HEAD = "Pix4D camera calibration file"
CAMERAS = "calibrated_camera_parameters.txt"
BINGO = "tp_bingo.txt"
EXTERNAL = "calibrated_external_camera_parameters.txt"
_ERRORS = "calibrated_external_camera_parameters_error.txt"
_MEASURED_ESTIMATED = "measured_estimated_gcps_position.txt"
_ERROR_COLUMNS = (
    "imageName",
    *(f"{axis}_{kind}" for kind in ("gps", "acc", "uncertainty") for axis in "XYZ"),
    *(f"{angle}_uncertainty" for angle in ("Omega", "Phi", "Kappa")),
)
_GROUND_COLUMNS = (
    "GCP label",
    "GCP weight",
    *(f"GCP {kind} {axis}" for kind in ("measured", "estimated") for axis in "XYZ"),
)
# No system has larger coordinates.
ON_EARTH_M = 5e7
_ROWS = 10
# Name, lens, position and rotation of an image.
_Shot = tuple[str, tuple[float, ...], Floats, Floats]


def write_pix4d(path: Path, camera: Camera) -> Conversion:
    """Write a .cam file; the sensor is that of the camera, or pixels of 1 um for a camera in px."""
    pinhole, conversion = to_pinhole(camera, "Pix4D")
    require_one_focal_length(pinhole, camera.id, "a .cam file")
    pixel = camera.pitch[0] if camera.unit == "mm" else 1e-3
    width, height = (side * pixel for side in pinhole.size_px)
    rows = [
        f"{HEAD} 0",
        f"#Focal Length mm assuming a sensor width of {width!r}x{height!r}mm",
        f"F {pinhole.fx * pixel!r}",
        "#Principal Point mm",
        f"Px {(pinhole.cx + 0.5) * pixel!r}",
        f"Py {(pinhole.cy + 0.5) * pixel!r}",
        "#Symmetrical Lens Distortion Coeffs",
        *(f"K{n} {getattr(pinhole, f'k{n}')!r}" for n in (1, 2, 3)),
        "#Tangential Lens Distortion Coeffs",
        f"T1 {pinhole.p1!r}",
        f"T2 {pinhole.p2!r}",
    ]
    path.write_text("\n".join(rows) + "\n", encoding="utf-8", newline="\n")
    return conversion


def write(folder: Path, given: Block, _: Choices) -> tuple[Conversion, ...]:
    """A .cam file for each camera."""
    name = "_pix4d_calibrated_internal_camera_parameters.cam"
    return tuple(write_pix4d(folder / (file_name(camera.id) + name), camera) for camera in given.cameras)


def read(path: Path) -> ForeignProject:
    """Read a params folder by its file of cameras, or by the project file (.p4d) that it belongs to."""
    if path.suffix.casefold() == PROJECT:
        path = _computed_of(path)
    folder = path.parent
    bingo = file_of(folder, BINGO)
    if bingo is None:
        raise InputNotFoundError(
            f"has no ..._{BINGO}",
            "export it: Process, Processing options, 1. Initial processing, Advanced",
            where=folder,
        )
    image_names, own_lenses, local, rotation = zip(*_shots(path), strict=True)
    offset, offset_told = _offset(folder, image_names, np.array(local))
    lenses = list(dict.fromkeys(own_lenses))
    names = ["camera" if len(lenses) == 1 else f"camera-{k}" for k in range(1, len(lenses) + 1)]
    cameras = tuple(_camera(lens, name, path) for lens, name in zip(lenses, names, strict=True))
    member = [lenses.index(lens) for lens in own_lenses]
    poses = from_vision(np.array(rotation), -np.einsum("nij,nj->ni", rotation, local))
    poses[:, 3:] += offset
    _require_on_earth(zip(image_names, poses[:, 3:].tolist(), strict=True), "image", path)
    heads, exposure = of_poses(cameras, np.array(member), poses)
    control, manual, adjusted, ground_told = _ground(folder)
    remarks = [*offset_told, *ground_told]
    _require_on_earth(((name, xyz) for name, (xyz, _) in control.items()), "control point", folder)
    # Images see no farther, m.
    most_m = 5e4
    middle = np.median([xyz for xyz, _ in control.values()] or poses[:, 3:], axis=0)
    apart_m = float(np.linalg.norm(middle - np.median(poses[:, 3:], axis=0)))
    if offset_told and apart_m > most_m:
        raise InputNotFoundError(
            f"has no ..._offset.xyz, and its control lies {apart_m / 1e3:.0f} km from its images",
            f"copy it, or ..._{EXTERNAL}, from the project",
            where=folder,
        )
    seen_names, seen, left_out = read_bingo(bingo, image_names, member, cameras, manual.union(control))
    remarks += left_out
    points = sorted(seen_names)
    checks, checks_told = _checks(folder)
    remarks += checks_told
    entries = [
        PointEntry(name, "check" if name in checks else "control", *control[name])
        if name in control
        else PointEntry(name)
        for name in points
    ]
    place = np.empty(len(points), dtype=np.int64)
    place[sorted(range(len(points)), key=seen_names.__getitem__)] = np.arange(len(points))
    frame, height, told = output_system(file_of(folder, "wkt.prj"), poses[:, 3:])
    remarks += told
    given, weak = without_weak_points(
        block(
            path.name.removesuffix(CAMERAS).strip("_") or folder.parent.name,
            cameras,
            Images(tuple(distinct(image_names)), np.array(member, dtype=np.int64), poses, exposure=exposure),
            object_points(entries),
            replace(seen, point=place[seen.point]),
            [path, bingo],
        )
    )
    given = replace(given, frame=frame, height=height, heads=heads)
    if weak:
        remarks.append(f"{weak} points have one ray only: left out")
    position, sigma, pose_sigma = _positions(folder, image_names)
    wild = (np.abs(position) > ON_EARTH_M).any(axis=1)
    if wild.any():
        remarks.append(f"{int(wild.sum())} positions are not on the earth: left out")
        position[wild], sigma[wild] = np.nan, np.nan
    if heads:
        remarks.append(
            f"{len(heads)} cameras have the same relative orientation at all exposures: heads on one frame"
        )
        # The heads of an exposure have one and the same fix of the receiver.
        others = (np.array(exposure) != "") & (
            np.array(member) != [c.id for c in cameras].index(heads[0].camera)
        )
        position[others] = np.nan
    away = np.linalg.norm(position - poses[:, 3:], axis=1)
    # Positions farther from the adjusted ones are in another system.
    far_m = 1000.0
    if np.isfinite(away).any() and np.nanmedian(away) > far_m:
        remarks.append(
            f"positions are {np.nanmedian(away):.0f} m from the adjusted ones: of another system, left out"
        )
        position, sigma = np.full_like(position, np.nan), np.full_like(sigma, np.nan)
    return ForeignProject(
        "Pix4D", given, position, sigma, pose_sigma, adjusted, remarks=tuple(remarks), normalised=True
    )


def _computed_of(project: Path) -> Path:
    """The file of cameras that belongs to a project file: in the folder of its name, beside it."""
    folder = project.parent / project.stem / "1_initial" / "params"
    cameras = file_of(folder, CAMERAS) if folder.is_dir() else None
    if cameras is None:
        raise InputNotFoundError(
            f"has no ..._{CAMERAS} in {project.stem}/1_initial/params beside it",
            "name the params folder; points and marks of the file alone are read by photocal new",
            where=project,
        )
    return cameras


def _checks(folder: Path) -> tuple[frozenset[str], list[str]]:
    """Check points of the project file, where it is still next to its folder."""
    # NAME.p4d beside NAME/1_initial/params.
    if len(folder.resolve().parents) < 2:
        return frozenset(), []
    root = folder.resolve().parents[1]
    project = root.parent / f"{root.name}{PROJECT}"
    if not project.is_file():
        return frozenset(), []
    try:
        points = read_inputs(project, (1.0, 1.0)).points
    except PhotocalError as refusal:
        return frozenset(), [str(refusal)]
    names = frozenset(point.name for point in points if point.role == "check")
    told = f"{len(names)} check points by {project.name}: {', '.join(sorted(names)[:5])}"
    return names, [told] if names else []


def _offset(folder: Path, names: Sequence[str], local: Floats) -> tuple[Floats, list[str]]:
    """What was subtracted from all coordinates: by its file, else by the orientations in the map."""
    path, table = file_of(folder, "offset.xyz"), file_of(folder, EXTERNAL)
    if path is not None:
        text = " ".join(line.text for line in read_lines(path))
        # Commas between numbers; within one where no point stands.
        text = text if "." not in text and text.count(",") == 3 else text.replace(",", " ")
        return np.array(numbers(text, path, "offset", 3)), []
    image_of, apart = in_order(names), list[Floats]()
    for line in read_lines(table) if table is not None else ():
        image, *values = line.text.rsplit(None, 6)
        k = image_of(image.strip().strip('"')) if len(values) == 6 else -1
        if k >= 0:
            apart.append(np.array([printed(value) for value in values[:3]]) - local[k])
    if not apart or not np.isfinite(apart).all():
        return np.zeros(3), ["no ..._offset.xyz: coordinates of the images are used unchanged"]
    return np.median(apart, axis=0), [f"no ..._offset.xyz: the offset is that of ..._{EXTERNAL}"]


def _require_on_earth(places: Iterable[tuple[str, Sequence[float]]], what: str, where: Path) -> None:
    for name, place in places:
        if max(map(abs, place)) > ON_EARTH_M:
            raise InputMalformedError(
                f"{what} {name} has the coordinate {max(place, key=abs):g}, which is not on the earth",
                "correct it",
                where=where,
            )


def file_of(folder: Path, ending: str) -> Path | None:
    """Find the file of a params folder whose name ends so; before it stands that of the project."""
    names = {path: path.name.casefold() for path in sorted(folder.iterdir())}
    paths = [path for path, name in names.items() if name == ending or name.endswith(f"_{ending}")]
    return min(paths, key=lambda path: len(path.name), default=None)


def _shots(path: Path) -> list[_Shot]:
    """Images of the file: each begins with a name and two whole numbers, before a matrix."""
    lines = read_lines(path, comment="")
    starts = [k for k in range(len(lines) - _ROWS + 1) if _begins(lines, k)]
    if not starts:
        for line in lines:
            if decimal_comma(line.text.split()):
                numbers(line.text, line.place, "camera")
        raise InputMalformedError("has no image", "was it written completely?", where=path)
    shots = []
    for k, end in zip(starts, [*starts[1:], len(lines)], strict=True):
        if end - k != _ROWS:
            raise lines[k].malformed(
                f"has {end - k} lines for an image where {_ROWS} were expected", "was it written completely?"
            )
        name, width, height = lines[k].text.rsplit(None, 2)
        w, h = image_size(float(width), float(height), lines[k].place)
        rows = [numbers(line.text, line.place, "camera") for line in lines[k + 1 : k + _ROWS]]
        if [len(row) for row in rows] != [3, 3, 3, 3, 2, 3, 3, 3, 3]:
            raise lines[k].malformed("is not an image of this file")
        matrix, rotation = np.array(rows[:3]), np.array(rows[6:])
        if np.abs(rotation @ rotation.T - np.eye(3)).max() > 1e-4 or np.linalg.det(rotation) < 0:
            raise lines[k].malformed("has a matrix that is not a rotation")
        lens = (w, h, matrix[0, 0], matrix[1, 1], matrix[0, 2], matrix[1, 2], *rows[3], *rows[4])
        shots.append((name.strip().strip('"'), lens, np.array(rows[5]), rotation))
    return shots


def _begins(lines: Sequence[Line], k: int) -> bool:
    cells = lines[k].text.split()
    matrix = [line.text.split() for line in lines[k + 1 : k + 4]]
    whole = len(cells) >= 3 and all(cell.isdecimal() for cell in cells[-2:])
    return (
        whole and all(len(row) == 3 for row in matrix) and [printed(c) for c in matrix[2]] == [0.0, 0.0, 1.0]
    )


def _camera(lens: tuple[float, ...], name: str, path: Path) -> Camera:
    width, height, fx, fy, cx, cy, k1, k2, k3, t1, t2 = lens
    size = int(width), int(height)
    return from_pinhole(Pinhole(size, fx, fy, cx - 0.5, cy - 0.5, k1, k2, k3, t1, t2), name, path)


def _rows(path: Path | None, columns: Sequence[str]) -> Iterator[list[str]]:
    """Cells of some columns, by the head of a table that is cut at commas only: names have blanks.

    A spreadsheet saves it with semicolons and decimal commas.
    """
    head: list[str] | None = None
    between = ","
    for line in read_lines(path) if path is not None else ():
        if head is None and line.text.count(";") >= len(columns):
            between = ";"
        cells = [cell.strip().strip('"') for cell in line.text.split(between)]
        if head is None:
            head = [cell.casefold() for cell in cells]
            lost = [column for column in columns if column.casefold() not in head]
            if lost:
                raise line.malformed(
                    f"is not a header with a column {lost[0]}", "export the file again, with its first line"
                )
        elif len(cells) != len(head):
            raise line.malformed(
                f"has {len(cells)} cells where the head has {len(head)}",
                "was it written completely, and are all numbers written with a decimal point?",
            )
        else:
            if between == ";":
                cells = [cell.replace(",", ".") if decimal_comma([cell]) else cell for cell in cells]
            yield [cells[head.index(column.casefold())] for column in columns]


def _named(path: Path | None) -> dict[str, list[float]]:
    """Rows of a name and three numbers or more, between commas or blanks."""
    rows = {}
    for line in read_lines(path) if path is not None else ():
        cells = re.split(r"[,;\t]", line.text) if re.search(r"[,;\t]", line.text) else line.text.split()
        values = [printed(cell) for cell in cells[1:]]
        if len(values) >= 3 and np.isfinite(values[:3]).all():
            rows[cells[0].strip().strip('"')] = values
    return rows


# Surveyed coordinates of a point and their sigmas, m.
Surveyed = tuple[list[float], list[float]]


def _ground(folder: Path) -> tuple[dict[str, Surveyed], frozenset[str], dict[str, Floats], list[str]]:
    """Points that a person has marked.

    returns: those that were surveyed; manual tie points, which stand among them with a weight of 1;
        coordinates as the program adjusted them; and what was assumed.
    """
    both, measured = file_of(folder, _MEASURED_ESTIMATED), file_of(folder, "measured_gcps_position.txt")
    surveyed, adjusted = _named(measured), _named(file_of(folder, "estimated_gcps_position.txt"))
    remarks = []
    if measured is not None and both is None and not surveyed:
        remarks.append(
            f"{measured.name} has no names of points: no control without ..._{_MEASURED_ESTIMATED}"
        )
    manual = set[str]()
    for name, weight, *cells in _rows(both, _GROUND_COLUMNS):
        values = [printed(cell) for cell in cells]
        # Weights of surveyed points come near to 1 and are never exactly it.
        if np.isfinite(printed(weight)) and Decimal(weight) == 1:
            manual.add(name)
        elif np.isfinite(values[:3]).all():
            surveyed.setdefault(name, values[:3])
        if np.isfinite(values[3:]).all():
            adjusted.setdefault(name, values[3:])
    control, bare = {}, 0
    for name, values in surveyed.items():
        if name not in manual:
            # Weight and number of images may stand there: accuracies are three, below a metre.
            stated = len(values) == 6 and all(0 < accuracy < 1 for accuracy in values[3:])
            bare += not stated
            control[name] = values[:3], values[3:] if stated else list(ASSUMED_M)
    manual |= set(adjusted) - set(control)
    if manual:
        remarks.append(f"{len(manual)} points have marks but were not surveyed: tie points")
    if bare:
        remarks.append(f"{bare} control points have no accuracy: {ASSUMED_M[0]} and {ASSUMED_M[2]} m assumed")
    places = {name: np.array(adjusted[name][:3]) for name in control if name in adjusted}
    return control, frozenset(manual), places, remarks


def _positions(folder: Path, names: Sequence[str]) -> tuple[Floats, Floats, Floats]:
    """Positions by GNSS, their accuracies as stated, and the sigmas that the program promises."""
    table, image_of = np.full((len(names), len(_ERROR_COLUMNS) - 1), np.nan), in_order(names)
    for name, *cells in _rows(file_of(folder, _ERRORS), _ERROR_COLUMNS):
        k = image_of(name)
        if k >= 0:
            table[k] = [printed(cell) for cell in cells]
    given, stated, places, angles = table[:, :3], table[:, 3:6], table[:, 6:9], table[:, 9:]
    # No receiver states less than a hundredth of a millimetre.
    least_m = 1e-5
    unstated = ~(stated > least_m).all(axis=1)
    given[unstated], stated[unstated] = np.nan, np.nan
    return given, stated, np.hstack([np.radians(angles), places])


_SENSOR = re.compile(r"#Focal Length mm assuming a sensor width of ([0-9.eE+-]+)x([0-9.eE+-]+)mm")
_KEYS = ("F", "Px", "Py", "K1", "K2", "K3", "T1", "T2")


def read_cam(path: Path, sizes_px: Iterable[tuple[int, int]]) -> tuple[Camera, ...]:
    """Read the cameras of a .cam file.

    sizes_px: of the pictures that are there: the file has its sensors in mm alone, of which the first with
        the same relation of its sides is taken.

    raises InputMalformedError: also when no picture has the shape of a sensor.
    """
    lines, sizes = read_lines(path, comment=""), tuple(sizes_px)
    starts = [k for k, line in enumerate(lines) if line.text.startswith(HEAD)]
    if not starts:
        raise InputMalformedError("has no camera of Pix4D", "is it a .cam file of Pix4D?", where=path)
    parts = [lines[k:end] for k, end in zip(starts, [*starts[1:], len(lines)], strict=True)]
    names = [path.stem if len(parts) == 1 else f"{path.stem}-{k}" for k in range(1, len(parts) + 1)]
    return tuple(_listed_camera(part, sizes, name, path) for part, name in zip(parts, names, strict=True))


def _listed_camera(lines: list[Line], sizes: tuple[tuple[int, int], ...], name: str, path: Path) -> Camera:
    found = [sensor for line in lines if (sensor := _SENSOR.match(line.text.strip()))]
    if not found:
        raise lines[0].malformed("does not state the width of the sensor", "was it written completely?")
    width, height = (number(cell, lines[0].place, "sensor") for cell in found[0].groups())
    value = dict[str, float]()
    for line in lines:
        cells = line.text.split()
        if cells[0] in _KEYS:
            if len(cells) != 2 or cells[0] in value:
                raise line.malformed(f"{cells[0]} is not one number")
            value[cells[0]] = number(cells[1], line.place, cells[0])
    missing = [key for key in _KEYS if key not in value]
    if missing:
        raise lines[0].malformed(f"has no {missing[0]}", "was it written completely?")
    fitting = [size for size in sizes if _shaped(size, width, height)]
    if not fitting:
        raise lines[0].malformed(
            f"its sensor of {width:g} x {height:g} mm does not have the shape of a picture",
            "is it the camera of these pictures?",
        )
    size = fitting[0]
    pixel = width / size[0]
    f, cx, cy = value["F"] / pixel, value["Px"] / pixel - 0.5, value["Py"] / pixel - 0.5
    k1, k2, k3, t1, t2 = (value[key] for key in _KEYS[3:])
    return from_pinhole(Pinhole(size, f, f, cx, cy, k1, k2, k3, t1, t2), name, path)


def _shaped(size: tuple[int, int], width: float, height: float) -> bool:
    """Whether a sensor of some mm has the shape of a picture."""
    # Sides of a sensor and of its pictures are in the same relation, but for rounding.
    alike = 1e-3
    return width > 0 and height > 0 and abs(width / height * size[1] / size[0] - 1) <= alike


def read_external(path: Path) -> ForeignProject:
    """Read the orientations of a project without its measurements: images of unknown cameras."""
    names, rows = list[str](), list[list[float]]()
    for line in read_lines(path)[1:]:
        cells = line.text.rsplit(None, 6)
        if len(cells) != 7:
            raise line.malformed("has no name X Y Z Omega Phi Kappa", "was it written completely?")
        names.append(cells[0].strip().strip('"'))
        rows.append(numbers(" ".join(cells[1:]), line.place, "exterior orientation"))
    if not rows:
        raise InputMalformedError("has no exterior orientation", "was it written completely?", where=path)
    values = np.array(rows)
    poses = np.hstack([np.radians(values[:, 3:]), values[:, :3]])
    frame, height, remarks = output_system(file_of(path.parent, "wkt.prj"), poses[:, 3:])
    images = Images(tuple(distinct(names)), np.full(len(names), -1), poses)
    made = block(path.name.removesuffix(EXTERNAL).strip("_"), (), images, NO_POINTS, NO_OBSERVATIONS, [path])
    return ForeignProject("Pix4D", replace(made, frame=frame, height=height), remarks=tuple(remarks))
