"""COLMAP models as text: cameras.txt, images.txt, points3D.txt."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import numpy as np

from drivers.errors import InputMalformedError
from photocal.exchange.colmap_content import (
    NUMBERS,
    Content,
    Lens,
    Point,
    Shot,
    content_of,
    key_of,
    unknown_model,
)
from photocal.exchange.parts import digits, require_no_blanks
from photocal.exchange.source import Line, image_size, numbers, read_text, whole


def read_text_model(folder: Path) -> Content:
    """Read the three text files of a model."""
    cameras, images, points = (folder / f"{name}.txt" for name in ("cameras", "images", "points3D"))
    return content_of(_lenses(cameras), _shots(images), _points(points))


def _rows(path: Path) -> list[Line]:
    """All lines but comments; an image without marks has an empty second line."""
    lines = (Line(path, k, text) for k, text in enumerate(read_text(path).split("\n"), start=1))
    return [line for line in lines if not line.text.lstrip().startswith("#")]


def _lenses(path: Path) -> Iterator[Lens]:
    for line in _rows(path):
        cells = line.text.split()
        if not cells:
            continue
        if len(cells) < 4:
            raise InputMalformedError("is no row of a camera", where=line.place)
        if cells[1] not in NUMBERS:
            raise unknown_model(cells[1], line.place)
        key, width, height = (whole(cells[k], line.place, "camera") for k in (0, 2, 3))
        values = numbers(" ".join(cells[4:]), line.place, "camera parameters")
        yield Lens(key, cells[1], image_size(width, height, line.place), tuple(values))


def _shots(path: Path) -> Iterator[Shot]:
    rows = iter(_rows(path))
    for line in rows:
        if not line.text.strip():
            continue
        cells = line.text.split(maxsplit=9)
        if len(cells) != 10:
            raise InputMalformedError("is no row of an image", where=line.place, remedy="is the file cut?")
        values = numbers(" ".join(cells[:9]), line.place, "image")
        marks = next(rows, None)
        if marks is None:
            raise InputMalformedError(
                f"ends before the marks of image {cells[9]}", where=path, remedy="is the file cut?"
            )
        flat = np.array(numbers(marks.text, marks.place, "marks"))
        if len(flat) % 3:
            raise InputMalformedError("has a mark that is not complete", where=marks.place)
        table = flat.reshape(-1, 3)
        pose = tuple(values[1:5]), tuple(values[5:8])
        keys = np.array([key_of(value, marks.place) for value in table[:, 2].tolist()], dtype=np.int64)
        key, lens = (key_of(values[k], line.place) for k in (0, 8))
        yield Shot(key, *pose, lens, cells[9].strip(), table[:, :2], keys)


def _points(path: Path) -> Iterator[Point]:
    for line in _rows(path):
        cells = line.text.split()
        if not cells:
            continue
        if len(cells) < 8 or len(cells) % 2:
            raise InputMalformedError("is no row of a point", where=line.place, remedy="is the file cut?")
        values = numbers(line.text, line.place, "point")
        key, *track = (key_of(value, line.place) for value in (values[0], *values[8:]))
        yield key, values[1:4], values[7], np.array(track, dtype=np.int64).reshape(-1, 2)


def write_text_model(folder: Path, content: Content) -> None:
    """Write the three text files of a model, numbers with all their digits."""
    require_no_blanks((shot.name for shot in content.shots), "export the binary form, or rename it")
    with (folder / "cameras.txt").open("w", encoding="utf-8", newline="\n") as out:
        out.write("# CAMERA_ID, MODEL, WIDTH, HEIGHT, PARAMS[]\n")
        for lens in content.lenses:
            width, height = lens.size_px
            out.write(f"{lens.key} {lens.model} {width} {height} {digits(lens.parameters)}\n")
    with (folder / "images.txt").open("w", encoding="utf-8", newline="\n") as out:
        out.write(
            "# IMAGE_ID, QW, QX, QY, QZ, TX, TY, TZ, CAMERA_ID, NAME\n# POINTS2D[] as X, Y, POINT3D_ID\n"
        )
        for shot in content.shots:
            pose = f"{digits(shot.quaternion)} {digits(shot.translation)}"
            out.write(f"{shot.key} {pose} {shot.lens} {shot.name}\n")
            marks = zip(shot.marks.tolist(), shot.points.tolist(), strict=True)
            out.write(" ".join(f"{x!r} {y!r} {key}" for (x, y), key in marks) + "\n")
    with (folder / "points3D.txt").open("w", encoding="utf-8", newline="\n") as out:
        out.write("# POINT3D_ID, X, Y, Z, R, G, B, ERROR, TRACK[] as IMAGE_ID, POINT2D_IDX\n")
        errors = content.errors.tolist()
        for key, xyz, error, track in zip(
            content.keys.tolist(), content.xyz.tolist(), errors, content.tracks, strict=True
        ):
            pairs = " ".join(str(number) for number in track.ravel().tolist())
            out.write(f"{key} {digits(xyz)} 128 128 128 {error!r} {pairs}\n")
