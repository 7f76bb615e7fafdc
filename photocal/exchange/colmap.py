"""COLMAP models: cameras, images and points3D, as text or binary.

Pixels: x right, y down, the centre of the upper-left pixel is (0.5, 0.5), half a pixel more than ours. The
distortion is added to the normalised projection (`brown-ideal`), camera axes x right, y down, z forward; an
image has the rotation (quaternion w, x, y, z) and translation from object to camera axes. Written with the
model FULL_OPENCV, whose k4, k5, k6 are zero but for a `rational` lens, or OPENCV_FISHEYE. Source: COLMAP
documentation, "Output format" and "Camera models".
"""

import struct
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

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
from photocal.exchange.source import Line, image_size, numbers, read_lines, read_text, require_readable, whole
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
_MARK = np.dtype([("xy", "<f8", 2), ("key", "<i8")])
_TRACK = np.dtype([("image", "<u4"), ("place", "<u4")])
FILES = ("cameras", "images", "points3D")

# What COLMAP has of other lenses.
_OTHERS: dict[Model, tuple[str, ...]] = {
    "rational": ("K1", "K2", "K3", "K4", "K5", "K6", "P1", "P2"),
    "equidistant": ("K1", "K2", "K3", "K4"),
}
# Which of our parameters each of COLMAP's makes free.
_FREES = {f"k{n}": (f"K{n}",) for n in range(1, 7)} | {"p1": ("P1", "P2"), "fx": ("B1",)}


@dataclass(frozen=True)
class Lens:
    """One camera."""

    key: int
    model: str
    size_px: tuple[int, int]
    parameters: tuple[float, ...]


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


class _Reader:
    """Goes through a binary file; never believes a count that the file is too short for."""

    def __init__(self, path: Path) -> None:
        require_readable(path)
        self.path, self.content, self.at = path, path.read_bytes(), 0

    def take(self, layout: str) -> tuple[Any, ...]:
        """Read values of a layout (as of `struct`); raises InputMalformedError where they are not finite."""
        size = struct.calcsize("<" + layout)
        self._require(size)
        values = struct.unpack_from("<" + layout, self.content, self.at)
        if not all(np.isfinite(value) for value in values):
            raise InputMalformedError(f"has a number that is not finite at byte {self.at}", where=self.path)
        self.at += size
        return values

    def count(self, smallest: int) -> int:
        """Read a number of entries, each of so many bytes at least."""
        count = int(self.take("Q")[0])
        if count * smallest > len(self.content) - self.at:
            raise InputMalformedError(
                f"states {count} entries, more than the file can hold", "is it cut?", where=self.path
            )
        return count

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
            raise InputMalformedError("has a name that is not UTF-8", where=self.path) from failure

    def records(self, layout: np.dtype[np.void]) -> NDArray[np.void]:
        """Read a counted table of records."""
        count = self.count(layout.itemsize)
        rows = np.frombuffer(self.content, layout, count, self.at)
        self.at += layout.itemsize * count
        return rows

    def _require(self, size: int) -> None:
        if self.at + size > len(self.content):
            raise InputMalformedError(
                f"is cut at byte {len(self.content)}", "was it written completely?", where=self.path
            )


def _lenses(path: Path) -> Iterator[Lens]:
    reader = _Reader(path)
    for _ in range(reader.count(24)):
        key, model, width, height = reader.take("IiQQ")
        if model not in MODELS:
            raise unknown_model(model, path)
        name, names = MODELS[model]
        yield Lens(key, name, image_size(width, height, path), reader.take(f"{len(names)}d"))


def _shots(path: Path) -> Iterator[Shot]:
    reader = _Reader(path)
    for _ in range(reader.count(73)):
        key, *pose, lens = reader.take("I7dI")
        name = reader.name()
        rows = reader.records(_MARK)
        if not np.isfinite(rows["xy"]).all():
            raise InputMalformedError(f"image {name} has a mark that is not finite", where=path)
        marks, keys = rows["xy"].astype(float), rows["key"].astype(np.int64)
        yield Shot(key, tuple(pose[:4]), tuple(pose[4:]), lens, name, marks, keys)


def _points(path: Path) -> Iterator[Point]:
    reader = _Reader(path)
    for _ in range(reader.count(51)):
        key, x, y, z, _, _, _, error = reader.take("Q3d3Bd")
        rows = reader.records(_TRACK)
        yield (
            key_of(key, path),
            (x, y, z),
            error,
            np.column_stack([rows["image"], rows["place"]]).astype(np.int64),
        )


def _rigs(path: Path) -> Iterator[Rig]:
    reader = _Reader(path)
    for _ in range(reader.count(8)):
        key, count = reader.take("II")
        sensors: dict[str, Sensor] = {}
        for k in range(count):
            name = "{} {}".format(*reader.take("iI"))
            if k == 0:
                sensors[name] = np.eye(3), np.zeros(3)
            elif reader.take("B")[0]:
                pose = reader.take("7d")
                sensors[name] = sensor_of(pose[:4], pose[4:], path)
            else:
                sensors[name] = None
        yield key, sensors


def _frames(path: Path) -> Iterator[Frame]:
    reader = _Reader(path)
    for _ in range(reader.count(68)):
        key, rig, *_, count = reader.take("II7dI")
        data = (reader.take("iIQ") for _ in range(count))
        yield key, rig, [(f"{kind} {sensor}", image) for kind, sensor, image in data]


def write_binary_model(
    folder: Path, lenses: Sequence[Lens], shots: Sequence[Shot], points: Sequence[Point]
) -> None:
    """Write the three binary files of a model."""
    with (folder / "cameras.bin").open("wb") as out:
        out.write(struct.pack("<Q", len(lenses)))
        for lens in lenses:
            layout = f"<IiQQ{len(lens.parameters)}d"
            out.write(struct.pack(layout, lens.key, NUMBERS[lens.model], *lens.size_px, *lens.parameters))
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


def _text_rows(path: Path) -> list[Line]:
    """All lines but comments; an image without marks has an empty second line."""
    lines = (Line(path, k, text) for k, text in enumerate(read_text(path).split("\n"), start=1))
    return [line for line in lines if not line.text.lstrip().startswith("#")]


def _text_lenses(path: Path) -> Iterator[Lens]:
    for line in _text_rows(path):
        cells = line.text.split()
        if not cells:
            continue
        if len(cells) < 4:
            raise line.malformed("is not a row of a camera")
        if cells[1] not in NUMBERS:
            raise unknown_model(cells[1], line.place)
        key, width, height = (whole(cells[k], line.place, "camera") for k in (0, 2, 3))
        values = numbers(" ".join(cells[4:]), line.place, "camera parameters")
        yield Lens(key, cells[1], image_size(width, height, line.place), tuple(values))


def _text_shots(path: Path) -> Iterator[Shot]:
    rows = iter(_text_rows(path))
    for line in rows:
        if not line.text.strip():
            continue
        cells = line.text.split(maxsplit=9)
        if len(cells) != 10:
            raise line.malformed("is not a row of an image", "is the file cut?")
        values = numbers(" ".join(cells[:9]), line.place, "image")
        marks = next(rows, None)
        if marks is None:
            raise InputMalformedError(
                f"ends before the marks of image {cells[9]}", "is the file cut?", where=path
            )
        flat = np.array(numbers(marks.text, marks.place, "marks"))
        if len(flat) % 3:
            raise InputMalformedError("has a mark that is not complete", where=marks.place)
        table = flat.reshape(-1, 3)
        pose = tuple(values[1:5]), tuple(values[5:8])
        keys = np.array([key_of(value, marks.place) for value in table[:, 2].tolist()], dtype=np.int64)
        key, lens = (key_of(values[k], line.place) for k in (0, 8))
        yield Shot(key, *pose, lens, cells[9].strip(), table[:, :2], keys)


def _text_points(path: Path) -> Iterator[Point]:
    for line in _text_rows(path):
        cells = line.text.split()
        if not cells:
            continue
        if len(cells) < 8 or len(cells) % 2:
            raise line.malformed("is not a row of a point", "is the file cut?")
        values = numbers(line.text, line.place, "point")
        key, *track = (key_of(value, line.place) for value in (values[0], *values[8:]))
        yield key, values[1:4], values[7], np.array(track, dtype=np.int64).reshape(-1, 2)


def _text_rigs(path: Path) -> Iterator[Rig]:
    for line in read_lines(path):
        cells = line.text.split()
        sensors: dict[str, Sensor] = {" ".join(cells[2:4]): (np.eye(3), np.zeros(3))}
        at = 4
        while at + 2 < len(cells):
            name, known = " ".join(cells[at : at + 2]), cells[at + 2] == "1"
            pose = numbers(" ".join(cells[at + 3 : at + 10]), line.place, "sensor", 7) if known else []
            sensors[name] = sensor_of(pose[:4], pose[4:], line.place) if known else None
            at += 10 if known else 3
        yield whole(cells[0], line.place, "rig"), sensors


def _text_frames(path: Path) -> Iterator[Frame]:
    for line in read_lines(path):
        cells = line.text.split()
        if len(cells) < 10:
            raise line.malformed("is not a row of a frame", "is the file cut?")
        key, rig = (whole(cell, line.place, "frame") for cell in cells[:2])
        places = range(10, len(cells) - 2, 3)
        yield (
            key,
            rig,
            [(" ".join(cells[k : k + 2]), whole(cells[k + 2], line.place, "frame")) for k in places],
        )


def write_text_model(
    folder: Path, lenses: Sequence[Lens], shots: Sequence[Shot], points: Sequence[Point]
) -> None:
    """Write the three text files of a model, numbers with all their digits."""
    require_no_blanks((shot.name for shot in shots), "export the binary form, or rename it")
    with (folder / "cameras.txt").open("w", encoding="utf-8", newline="\n") as out:
        out.write("# CAMERA_ID, MODEL, WIDTH, HEIGHT, PARAMS[]\n")
        for lens in lenses:
            width, height = lens.size_px
            out.write(f"{lens.key} {lens.model} {width} {height} {digits(lens.parameters)}\n")
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
    binary = (folder / "cameras.bin").exists()
    first, second, third = files = [folder / f"{name}.{'bin' if binary else 'txt'}" for name in FILES]
    lenses = list((_lenses if binary else _text_lenses)(first))
    shots = list((_shots if binary else _text_shots)(second))
    points = list((_points if binary else _text_points)(third))
    cameras = {lens.key: _camera(lens, folder) for lens in lenses}
    order = {key: k for k, key in enumerate(cameras)}
    position = {key: k for k, (key, *_) in enumerate(points)}
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
    xyz = np.array([place for _, place, _, _ in points], dtype=float).reshape(-1, 3)
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
    suffix = "bin" if binary else "txt"
    paths = folder / f"rigs.{suffix}", folder / f"frames.{suffix}"
    if not all(path.is_file() for path in paths):
        return of_colmap(given, folder, keys, (), ())
    read = (_rigs, _frames) if binary else (_text_rigs, _text_frames)
    return of_colmap(given, folder, keys, read[0](paths[0]), read[1](paths[1]))


def write_text(folder: Path, given: Block, choices: Choices) -> tuple[Conversion, ...]:
    """cameras.txt, images.txt, points3D.txt."""
    return write_colmap(folder, given, choices)


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
        lenses.append(Lens(k, model, pinhole.size_px, tuple(values)))
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
    names = MODELS[NUMBERS[lens.model]][1]
    if len(lens.parameters) != len(names):
        raise InputMalformedError(
            f"camera {lens.key} has {len(lens.parameters)} parameters where {lens.model} has {len(names)}",
            where=place,
        )
    value = dict(zip(names, lens.parameters, strict=True))
    f = value.get("f", 0.0)
    pinhole = Pinhole(
        lens.size_px,
        value.get("fx", f),
        value.get("fy", f),
        value["cx"] - 0.5,
        value["cy"] - 0.5,
        **{k: value.get(k, 0.0) for k in ("k1", "k2", "k3", "p1", "p2", "k4", "k5", "k6")},
        fisheye=lens.model.endswith("FISHEYE"),
    )
    camera = from_pinhole(pinhole, str(lens.key), place)
    free = {"c", "x0", "y0"}.union(*(ours for theirs, ours in _FREES.items() if theirs in value))
    # Without k4 to k6 a FULL_OPENCV lens is Brown's, whose K4 is another.
    free &= set(camera.lens.names) - ({"K4"} if camera.model == "brown-ideal" else set())
    return replace(camera, estimated=np.array([parameter in free for parameter in PARAMETERS]))
