"""COLMAP models: cameras, images and points3D, as text or binary.

Pixels: x right, y down, the centre of the upper-left pixel is (0.5, 0.5), half a pixel more than ours. The
distortion is added to the normalised projection (`brown-ideal`), camera axes x right, y down, z forward; an
image has the rotation (quaternion w, x, y, z) and translation from object to camera axes. Written with the
model FULL_OPENCV, whose k4, k5, k6 are zero but for a `rational` lens, or OPENCV_FISHEYE. Source: COLMAP
documentation, "Output format" and "Camera models".
"""

import re
import struct
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np

from photocal.base.arrays import Floats, Integers
from photocal.base.errors import InputMalformedError
from photocal.block.model import Block, Images, ObjectPoints
from photocal.exchange.exporting import Choices
from photocal.exchange.foreign_project import ForeignProject
from photocal.exchange.parts import block, digits, pixels, rays_of, require_no_blanks, whole_numbers
from photocal.exchange.pinhole import (
    LARGEST,
    Pinhole,
    from_pinhole,
    from_vision,
    quaternion_from_rotation,
    rotation_from_quaternion,
    to_pinhole,
    to_vision,
)
from photocal.exchange.rigs import Frame, Rig, Sensor, of_colmap, sensor_of
from photocal.exchange.source import Line, image_size, number, numbers, read_text, require_readable
from photocal.geometry.camera import PARAMETERS, Camera, Model
from photocal.geometry.conversion import Conversion

# Name and parameters of each model by COLMAP's number.
MODELS: dict[int, tuple[str, tuple[str, ...]]] = {
    0: ("SIMPLE_PINHOLE", ("f", "cx", "cy")),
    1: ("PINHOLE", ("fx", "fy", "cx", "cy")),
    2: ("SIMPLE_RADIAL", ("f", "cx", "cy", "k1")),
    3: ("RADIAL", ("f", "cx", "cy", "k1", "k2")),
    4: ("OPENCV", ("fx", "fy", "cx", "cy", "k1", "k2", "p1", "p2")),
    5: ("OPENCV_FISHEYE", ("fx", "fy", "cx", "cy", "k1", "k2", "k3", "k4")),
    6: ("FULL_OPENCV", ("fx", "fy", "cx", "cy", "k1", "k2", "p1", "p2", "k3", "k4", "k5", "k6")),
    8: ("SIMPLE_RADIAL_FISHEYE", ("f", "cx", "cy", "k1")),
    9: ("RADIAL_FISHEYE", ("f", "cx", "cy", "k1", "k2")),
}
NUMBERS = {name: number for number, (name, _) in MODELS.items()}
LARGEST_KEY = 1 << 62
# Key of a mark that belongs to no point.
NO_POINT = -1
# Number, place, reprojection error and track of a point.
Point = tuple[int, Sequence[float], float, Integers]
# Number, model, size in px and parameters of a camera.
Lens = tuple[int, str, tuple[int, int], tuple[float, ...]]
_MARK = np.dtype([("xy", "<f8", 2), ("key", "<i8")])
FILES = ("cameras", "images", "points3D")

# What COLMAP has of other lenses.
_OTHERS: dict[Model, tuple[str, ...]] = {
    "rational": ("K1", "K2", "K3", "K4", "K5", "K6", "P1", "P2"),
    "equidistant": ("K1", "K2", "K3", "K4"),
}
# Which of our parameters each of COLMAP's makes free.
_FREES = {f"k{n}": (f"K{n}",) for n in range(1, 7)} | {"p1": ("P1", "P2"), "fx": ("B1",)}


@dataclass(frozen=True)
class Shot:
    """One image.

    quaternion, translation: from object to camera axes.
    points (n,): keys of the points, or `NO_POINT`.
    """

    key: int
    quaternion: tuple[float, ...]
    translation: tuple[float, ...]
    lens: int
    name: str
    marks: Floats
    points: Integers


def key_of(value: float, place: object) -> int:
    """Check a number that names something."""
    if not -1 <= value < LARGEST_KEY or value % 1:
        raise InputMalformedError(f"the number {value:g} refers to nothing", "is it damaged?", where=place)
    return int(value)


def unknown_model(name: object, place: object) -> InputMalformedError:
    """Complaint about a camera model that we have no equivalent of."""
    known = ", ".join(known for known, _ in MODELS.values())
    return InputMalformedError(
        f"camera model {name} has no equivalent", f"convert it to one of {known}", where=place
    )


class _Octets:
    """Goes through a binary file; never believes a count that the file is too short for."""

    def __init__(self, path: Path) -> None:
        require_readable(path)
        self.place, self.content, self.at = path, path.read_bytes(), 0

    def entries(self, _: str, smallest: int) -> Iterator[None]:
        """Begin one entry after the other, each of so many bytes at least."""
        yield from (None for _ in range(self._count(smallest)))

    def take(self, layout: str) -> tuple[Any, ...]:
        """Read values of a layout (as of `struct`); raises InputMalformedError where they are not finite."""
        size = struct.calcsize("<" + layout)
        self._require(size)
        values = struct.unpack_from("<" + layout, self.content, self.at)
        if not all(np.isfinite(value) for value in values):
            raise InputMalformedError(f"has a number that is not finite at byte {self.at}", where=self.place)
        self.at += size
        return values

    def model(self) -> tuple[str, tuple[float, ...]]:
        """Read a camera model that stands before the size, and the size."""
        (model,) = self.take("i")
        if model not in MODELS:
            raise unknown_model(model, self.place)
        return MODELS[model][0], self.take("QQ")

    def parameters(self, count: int) -> tuple[float, ...]:
        """Read the parameters of a model that has so many."""
        return self.take(f"{count}d")

    def name(self) -> str:
        """Read a text that ends with a zero byte."""
        end = self.content.find(b"\0", self.at)
        if end < 0:
            self._require(len(self.content))
        text = self.content[self.at : end]
        self.at = end + 1
        try:
            return text.decode("utf-8")
        except UnicodeDecodeError as failure:
            raise InputMalformedError("has a name that is not UTF-8", where=self.place) from failure

    def sensor(self) -> str:
        """Read kind and number of a sensor."""
        return " ".join(map(str, self.take("iI")))

    def marks(self) -> tuple[Floats, Integers]:
        """Read a counted table of marks, and the keys of their points."""
        count = self._count(_MARK.itemsize)
        rows = np.frombuffer(self.content, _MARK, count, self.at)
        self.at += _MARK.itemsize * count
        return rows["xy"].astype(float), rows["key"].astype(np.int64)

    def track(self) -> None:
        """Pass over the images that show a point: these say it, too."""
        pair = struct.calcsize("<II")
        count = self._count(pair)
        self.at += pair * count

    def _count(self, smallest: int) -> int:
        count = int(self.take("Q")[0])
        if count * smallest > len(self.content) - self.at:
            raise InputMalformedError(
                f"states {count} entries, more than the file can hold", "is it truncated?", where=self.place
            )
        return count

    def _require(self, size: int) -> None:
        if self.at + size > len(self.content):
            raise InputMalformedError(
                f"is truncated at byte {len(self.content)}", "was it written completely?", where=self.place
            )


@cache
def _codes(layout: str) -> str:
    """One letter for each value of a layout."""
    return "".join(int(count or 1) * code for count, code in re.findall(r"(\d*)([A-Za-z])", layout))


class _Rows:
    """Goes through a text file by the steps of `_Octets`: a row has what an entry has, without counts."""

    def __init__(self, path: Path) -> None:
        lines = (Line(path, k, text) for k, text in enumerate(read_text(path).split("\n"), start=1))
        # An image without marks has an empty second line.
        self.lines = (line for line in lines if not line.text.lstrip().startswith("#"))
        self.line, self.cells, self.what = Line(path, 0, ""), list[str](), ""

    @property
    def place(self) -> str:
        """File and line, for messages."""
        return self.line.place

    def entries(self, what: str, _: int) -> Iterator[None]:
        """Begin one row after the other."""
        self.what = what
        for line in self.lines:
            if line.text.strip():
                self.line, self.cells = line, line.text.split()
                yield

    def take(self, layout: str) -> tuple[Any, ...]:
        """Read numbers, one for each of a layout (as of `struct`)."""
        codes, place = _codes(layout), self.place
        pairs = zip(codes, self._words(len(codes)), strict=True)
        values = ((code, number(cell, place, self.what)) for code, cell in pairs)
        return tuple(value if code == "d" else key_of(value, place) for code, value in values)

    def model(self) -> tuple[str, tuple[float, ...]]:
        """Read a camera model that stands before the size, and the size."""
        (model,) = self._words(1)
        if model not in NUMBERS:
            raise unknown_model(model, self.place)
        return model, self.take("QQ")

    def parameters(self, _: int) -> tuple[float, ...]:
        """Read all numbers that are left: how many a model has is checked where it is known."""
        return tuple(numbers(" ".join(self.cells), self.place, self.what))

    def name(self) -> str:
        """Read a name, which may have blanks, to the end of the row, and go to the next."""
        self._words(0, more=1)
        before = len(self.line.text.split()) - len(self.cells)
        name = self.line.text.split(maxsplit=before)[before].strip()
        line = next(self.lines, None)
        if line is None:
            what = f"ends before the marks of image {name}"
            raise InputMalformedError(what, "is the file truncated?", where=self.line.path)
        self.line, self.cells = line, line.text.split()
        return name

    def sensor(self) -> str:
        """Read kind and number of a sensor."""
        return " ".join(self._words(2))

    def marks(self) -> tuple[Floats, Integers]:
        """Read the marks of the rest of a row, and the keys of their points."""
        table, place = self._table(3), self.place
        return table[:, :2], np.array([key_of(v, place) for v in table[:, 2].tolist()], dtype=np.int64)

    def track(self) -> None:
        """Pass over the images that show a point: these say it, too."""
        place = self.place
        for value in self._table(2).ravel().tolist():
            key_of(value, place)

    def _words(self, count: int, more: int = 0) -> list[str]:
        if len(self.cells) < count + more:
            raise self.line.malformed(f"is not a row of {self.what}", "is the file truncated?")
        words, self.cells = self.cells[:count], self.cells[count:]
        return words

    def _table(self, columns: int) -> Floats:
        flat = np.array(self.parameters(0))
        if len(flat) % columns:
            raise self.line.malformed("has a mark that is not complete")
        return flat.reshape(-1, columns)


_Source = _Octets | _Rows


def _lenses(source: _Source) -> Iterator[Lens]:
    for _ in source.entries("a camera", 24):
        (key,) = source.take("I")
        name, (width, height) = source.model()
        size = image_size(width, height, source.place)
        yield key, name, size, source.parameters(len(MODELS[NUMBERS[name]][1]))


def _shots(source: _Source) -> Iterator[Shot]:
    for _ in source.entries("an image", 73):
        key, *pose, lens = source.take("I7dI")
        name = source.name()
        marks, keys = source.marks()
        if not np.isfinite(marks).all():
            raise InputMalformedError(f"image {name} has a mark that is not finite", where=source.place)
        yield Shot(key, tuple(pose[:4]), tuple(pose[4:]), lens, name, marks, keys)


def _points(source: _Source) -> Iterator[tuple[int, tuple[float, ...]]]:
    for _ in source.entries("a point", 51):
        key, *xyz = source.take("Q3d")
        source.take("3Bd")
        source.track()
        yield key_of(key, source.place), tuple(xyz)


def _rigs(source: _Source) -> Iterator[Rig]:
    for _ in source.entries("a rig", 8):
        key, count = source.take("II")
        sensors: dict[str, Sensor] = {source.sensor(): (np.eye(3), np.zeros(3))} if count else {}
        for _ in range(1, count):
            name = source.sensor()
            pose = source.take("7d") if source.take("B")[0] else ()
            sensors[name] = sensor_of(pose[:4], pose[4:], source.place) if pose else None
        yield key, sensors


def _frames(source: _Source) -> Iterator[Frame]:
    for _ in source.entries("a frame", 68):
        key, rig, *_, count = source.take("II7dI")
        yield key, rig, [(source.sensor(), source.take("Q")[0]) for _ in range(count)]


def write_binary_model(
    folder: Path, lenses: Sequence[Lens], shots: Sequence[Shot], points: Sequence[Point]
) -> None:
    """Write the three binary files of a model."""
    with (folder / "cameras.bin").open("wb") as out:
        out.write(struct.pack("<Q", len(lenses)))
        for key, model, size_px, parameters in lenses:
            layout = f"<IiQQ{len(parameters)}d"
            out.write(struct.pack(layout, key, NUMBERS[model], *size_px, *parameters))
    with (folder / "images.bin").open("wb") as out:
        out.write(struct.pack("<Q", len(shots)))
        for shot in shots:
            out.write(struct.pack("<I7dI", shot.key, *shot.quaternion, *shot.translation, shot.lens))
            out.write(shot.name.encode() + b"\0" + struct.pack("<Q", len(shot.marks)))
            rows = np.empty(len(shot.marks), _MARK)
            rows["xy"], rows["key"] = shot.marks, shot.points
            out.write(rows.tobytes())
    with (folder / "points3D.bin").open("wb") as out:
        out.write(struct.pack("<Q", len(points)))
        for key, xyz, error, track in points:
            out.write(struct.pack("<Q3d3BdQ", key, *xyz, 128, 128, 128, error, len(track)))
            out.write(track.astype("<u4").tobytes())


def write_text_model(
    folder: Path, lenses: Sequence[Lens], shots: Sequence[Shot], points: Sequence[Point]
) -> None:
    """Write the three text files of a model, numbers with all their digits."""
    require_no_blanks((shot.name for shot in shots), "export the binary form, or rename it")
    with (folder / "cameras.txt").open("w", encoding="utf-8", newline="\n") as out:
        out.write("# CAMERA_ID, MODEL, WIDTH, HEIGHT, PARAMS[]\n")
        for key, model, (width, height), parameters in lenses:
            out.write(f"{key} {model} {width} {height} {digits(parameters)}\n")
    with (folder / "images.txt").open("w", encoding="utf-8", newline="\n") as out:
        out.write(
            "# IMAGE_ID, QW, QX, QY, QZ, TX, TY, TZ, CAMERA_ID, NAME\n# POINTS2D[] as X, Y, POINT3D_ID\n"
        )
        for shot in shots:
            pose = f"{digits(shot.quaternion)} {digits(shot.translation)}"
            out.write(f"{shot.key} {pose} {shot.lens} {shot.name}\n")
            marks = zip(shot.marks.tolist(), shot.points.tolist(), strict=True)
            out.write(" ".join(f"{x!r} {y!r} {key}" for (x, y), key in marks) + "\n")
    with (folder / "points3D.txt").open("w", encoding="utf-8", newline="\n") as out:
        out.write("# POINT3D_ID, X, Y, Z, R, G, B, ERROR, TRACK[] as IMAGE_ID, POINT2D_IDX\n")
        for key, xyz, error, track in points:
            pairs = " ".join(str(number) for number in track.ravel().tolist())
            out.write(f"{key} {digits(xyz)} 128 128 128 {error!r} {pairs}\n")


def read(path: Path) -> ForeignProject:
    """Read a model by one of its files."""
    return ForeignProject("COLMAP", read_colmap(path.parent), normalised=True)


def read_colmap(folder: Path) -> Block:
    """Read a model folder; binary files where there are any."""
    suffix = "bin" if (folder / "cameras.bin").exists() else "txt"
    opened: Callable[[Path], _Source] = _Octets if suffix == "bin" else _Rows
    files = [folder / f"{name}.{suffix}" for name in FILES]
    lenses, shots = list(_lenses(opened(files[0]))), list(_shots(opened(files[1])))
    points = list(_points(opened(files[2])))
    cameras = {lens[0]: _camera(lens, folder) for lens in lenses}
    order = {key: k for k, key in enumerate(cameras)}
    position = {key: k for k, (key, _) in enumerate(points)}
    if len(position) < len(points) or len(cameras) < len(lenses):
        raise InputMalformedError("has two points or cameras of the same number", where=folder)
    for shot in shots:
        lost = [key for key in shot.points.tolist() if key != NO_POINT and key not in position]
        if shot.lens not in order or lost:
            what = f"point {lost[0]}" if lost else f"camera {shot.lens}"
            raise InputMalformedError(f"image {shot.name} has the unknown {what}", where=folder)
    seen = [shot.points != NO_POINT for shot in shots]
    uses = list(zip(shots, seen, strict=True))
    quaternions = np.array([shot.quaternion for shot in shots]).reshape(-1, 4)
    # The largest part of a unit quaternion lies between 1/2 and 1.
    crooked = np.flatnonzero(np.abs(np.abs(quaternions).max(axis=1, initial=0) - 0.75) > 0.251)
    if len(crooked):
        name = shots[crooked[0]].name
        raise InputMalformedError(f"the quaternion of image {name} does not have length 1", where=folder)
    rotation = rotation_from_quaternion(quaternions)
    translation = np.array([shot.translation for shot in shots]).reshape(-1, 3)
    xyz = np.array([place for _, place in points], dtype=float).reshape(-1, 3)
    if not max(np.abs(translation).max(initial=0), np.abs(xyz).max(initial=0)) < LARGEST:
        raise InputMalformedError("has coordinates beyond 1e9 m", "is it damaged?", where=folder)
    image = np.repeat(np.arange(len(seen)), [int(use.sum()) for use in seen])
    point = np.array(
        [position[key] for shot, use in uses for key in shot.points[use].tolist()], dtype=np.int64
    )
    marks = np.vstack([np.empty((0, 2)), *(shot.marks[use] for shot, use in uses)]) - 0.5
    images = Images(
        tuple(shot.name for shot in shots),
        np.array([order[shot.lens] for shot in shots], dtype=np.int64),
        from_vision(rotation, translation),
    )
    listed, rays = ObjectPoints(tuple(map(str, position)), xyz), pixels(image, point, marks)
    given = block(folder.name, tuple(cameras.values()), images, listed, rays, files)
    keys = {shot.key: shot.name for shot in shots}
    paths = folder / f"rigs.{suffix}", folder / f"frames.{suffix}"
    if not all(path.is_file() for path in paths):
        return of_colmap(given, folder, keys, (), ())
    return of_colmap(given, folder, keys, _rigs(opened(paths[0])), _frames(opened(paths[1])))


def write_binary(folder: Path, given: Block, choices: Choices) -> tuple[Conversion, ...]:
    """cameras.bin, images.bin, points3D.bin."""
    return write_colmap(folder, given, choices, binary=True)


def write_colmap(
    folder: Path, given: Block, choices: Choices, *, binary: bool = False
) -> tuple[Conversion, ...]:
    """Write a model folder."""
    images, listed, seen = given.images, given.points, given.observations
    made = [to_pinhole(camera, "COLMAP", _OTHERS) for camera in given.cameras]
    lenses = []
    for k, (pinhole, _conversion) in enumerate(made, start=1):
        model = "OPENCV_FISHEYE" if pinhole.fisheye else "FULL_OPENCV"
        # The principal point half a pixel further.
        values = [getattr(pinhole, n) + (0.5 if n in ("cx", "cy") else 0) for n in MODELS[NUMBERS[model]][1]]
        lenses.append((k, model, pinhole.size_px, tuple(values)))
    rotation, translation = to_vision(images.values)
    quaternion = quaternion_from_rotation(rotation)
    keys = np.array([int(name) for name in whole_numbers(listed.names)], dtype=np.int64)
    place = np.empty(len(seen.image), dtype=np.int64)
    shots = []
    for k, rays in enumerate(rays_of(seen.image, len(images.names))):
        place[rays] = np.arange(len(rays))
        pose = tuple(quaternion[k].tolist()), tuple(translation[k].tolist())
        marks, points_seen = seen.values[rays] + 0.5, keys[seen.point[rays]]
        shots.append(Shot(k + 1, *pose, int(images.camera[k]) + 1, images.names[k], marks, points_seen))
    track = np.column_stack([seen.image + 1, place])
    tracks = [track[rays] for rays in rays_of(seen.point, len(listed.names))]
    # Mean length of each point's residuals, px; -1 when not known.
    count = np.bincount(seen.point, minlength=len(listed.names))
    total = np.bincount(seen.point, np.hypot(*choices.residuals_of(given).T), minlength=len(count))
    errors = np.where((count > 0) & np.isfinite(total), total / np.maximum(count, 1), -1.0)
    points = list(zip(keys.tolist(), listed.values.tolist(), errors.tolist(), tracks, strict=True))
    (write_binary_model if binary else write_text_model)(folder, lenses, shots, points)
    return tuple(conversion for _, conversion in made)


def _camera(lens: Lens, place: object) -> Camera:
    key, model, size_px, parameters = lens
    names = MODELS[NUMBERS[model]][1]
    if len(parameters) != len(names):
        raise InputMalformedError(
            f"camera {key} has {len(parameters)} parameters where {model} has {len(names)}", where=place
        )
    value = dict(zip(names, parameters, strict=True))
    f = value.get("f", 0.0)
    pinhole = Pinhole(
        size_px,
        value.get("fx", f),
        value.get("fy", f),
        value["cx"] - 0.5,
        value["cy"] - 0.5,
        **{k: value.get(k, 0.0) for k in ("k1", "k2", "k3", "p1", "p2", "k4", "k5", "k6")},
        fisheye=model.endswith("FISHEYE"),
    )
    camera = from_pinhole(pinhole, str(key), place)
    free = {"c", "x0", "y0"}.union(*(ours for theirs, ours in _FREES.items() if theirs in value))
    # Without k4 to k6 a FULL_OPENCV lens is Brown's, whose K4 is another.
    free &= set(camera.lens.names) - ({"K4"} if camera.model == "brown-ideal" else set())
    return replace(camera, estimated=np.array([parameter in free for parameter in PARAMETERS]))
