"""PhotoModeler's text export ("export text file", solution with marks), as the file has it.

Sections: head with image size and default camera; photos with orientation and camera; control points, object
points, marked points, each ended by a blank line. What the numbers mean: see `photomodeler`.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from drivers.arrays import Floats
from drivers.errors import InputMalformedError
from photocal.block.model import InputFile
from photocal.exchange import parts
from photocal.exchange.dbat_camera import to_column_row
from photocal.exchange.source import Line, fingerprint, image_size, numbers, read_text

DEFAULT_SIGMA_PX = 1.0


@dataclass(frozen=True)
class Photo:
    """One photo of an export.

    number: from 0.
    name: file name without folders.
    pose (6,): omega, phi, kappa in radians, X, Y, Z.
    interior: principal distance, principal point, format (mm), K1, K2, K3, P1, P2.
    """

    number: int
    name: str
    pose: Floats
    interior: tuple[float, ...]


@dataclass(frozen=True)
class Export:
    """What a text export holds.

    interior: default camera of the head, with one digit more than the photos have.
    control: coordinates of the control points by their name.
    points: coordinates of all object points by their name, SmartPoints renumbered behind the others.
    marks: column and row.
    """

    title: str
    size_px: tuple[int, int]
    interior: tuple[float, ...]
    photos: tuple[Photo, ...]
    control: dict[str, Floats]
    points: dict[str, Floats]
    marks: tuple[parts.Mark, ...]
    file: InputFile


class _Cursor:
    """Goes through the lines of an export, whose sections end at a blank line."""

    def __init__(self, path: Path) -> None:
        self.lines = [Line(path, k, text) for k, text in enumerate(read_text(path).split("\n"), start=1)]
        self.path, self.at = path, 0

    def next(self) -> Line:
        if self.at >= len(self.lines):
            raise InputMalformedError(
                "ends before its tables do", where=self.path, remedy="was it written completely?"
            )
        self.at += 1
        return self.lines[self.at - 1]

    def values(self, what: str, count: int) -> list[float]:
        line = self.next()
        return numbers(line.text, line.place, what, count)

    def section(self) -> list[Line]:
        begin = self.at
        while self.next().text.strip():
            pass
        return self.lines[begin : self.at - 1]


def looks_like_export(path: Path) -> bool:
    """Whether a text file has the head of a PhotoModeler export: title, tolerances, and image size."""
    head = read_text(path).split("\n", 2)
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
    while cursor.lines[cursor.at].text.strip():
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
        raise InputMalformedError("has no marked points", where=path, remedy="export the marks too")
    return Export(title, size_px, interior, tuple(photos), control, points, marks, fingerprint(path))


def _photo(cursor: _Cursor, expected: int) -> Photo:
    line = cursor.next()
    cells = line.text.split(maxsplit=1)
    if len(cells) != 2 or not cells[0].isdecimal() or int(cells[0]) != expected:
        raise InputMalformedError(f"is not the head of photo {expected}", where=line.place)
    pose = cursor.values("orientation", 7)[1:]
    cursor.values("its standard deviations", 7)
    covariance = cursor.next()
    if covariance.text.strip():
        numbers(covariance.text, covariance.place, "its covariances", 4)
    interior = cursor.values("interior orientation", 11)[1:]
    cursor.values("its standard deviations", 11)
    name = cells[1].strip().replace("\\", "/").rsplit("/", 1)[-1]
    return Photo(expected, name, np.array([*np.radians(pose[:2:-1]), *pose[:3]]), tuple(interior))


def _points(lines: list[Line]) -> list[tuple[str, Floats]]:
    rows = []
    for line in lines:
        values = numbers(line.text, line.place, "point, coordinates and standard deviations", 7)
        rows.append((str(int(values[0])), np.array(values[1:4])))
    return rows


def _smart_shift(ids: list[int]) -> tuple[int, int]:
    """By how much the numbers of SmartPoints are raised, and the row of the first of them.

    SmartPoints have numbers of their own, after the object points in the table; where they begin the
    numbers fall.
    """
    falls = [k for k in range(1, len(ids)) if ids[k] < ids[k - 1]]
    if len(falls) != 1:
        return 0, len(ids)
    first = falls[0]
    return max(ids[:first]) + 1 - min(ids[first:]), first


def _mark(line: Line, photos: list[Photo], shift: int) -> parts.Mark:
    photo, point, x, y, sx, sy = numbers(line.text, line.place, "photo, point, x, y and sigmas", 6)
    if not 0 <= photo < len(photos):
        raise InputMalformedError(f"observes photo {photo:g}, which is not in the file", where=line.place)
    smart = sx == 0 and sy == 0
    sigma = (DEFAULT_SIGMA_PX, DEFAULT_SIGMA_PX) if smart else (sx, sy)
    name = str(int(point) + shift) if smart else str(int(point))
    return parts.Mark(photos[int(photo)].name, name, *to_column_row(x, y), sigma, line.place)
