"""COLMAP models as binary: cameras.bin, images.bin, points3D.bin (little-endian)."""

from __future__ import annotations

import struct
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from drivers.errors import InputMalformedError
from photocal.exchange.colmap_content import (
    MODELS,
    NUMBERS,
    Content,
    Lens,
    Point,
    Shot,
    content_of,
    key_of,
    unknown_model,
)
from photocal.exchange.source import image_size, require_readable

_MARK = np.dtype([("xy", "<f8", 2), ("key", "<i8")])
_TRACK = np.dtype([("image", "<u4"), ("place", "<u4")])


class _Reader:
    """Goes through a binary file; never believes a count that the file is too short for."""

    def __init__(self, path: Path) -> None:
        require_readable(path)
        self.path, self.content, self.at = path, path.read_bytes(), 0

    def take(self, layout: str) -> tuple[Any, ...]:
        size = struct.calcsize("<" + layout)
        self._require(size)
        values = struct.unpack_from("<" + layout, self.content, self.at)
        if not all(np.isfinite(value) for value in values):
            raise InputMalformedError(f"has a number that is not finite at byte {self.at}", where=self.path)
        self.at += size
        return values

    def count(self, smallest: int) -> int:
        count = int(self.take("Q")[0])
        if count * smallest > len(self.content) - self.at:
            raise InputMalformedError(
                f"claims {count} entries, more than the file can hold", where=self.path, remedy="is it cut?"
            )
        return count

    def name(self) -> str:
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
        count = self.count(layout.itemsize)
        rows = np.frombuffer(self.content, layout, count, self.at)
        self.at += layout.itemsize * count
        return rows

    def _require(self, size: int) -> None:
        if self.at + size > len(self.content):
            raise InputMalformedError(
                f"is cut at byte {len(self.content)}", where=self.path, remedy="was it written completely?"
            )


def read_binary_model(folder: Path) -> Content:
    """Read the three binary files of a model."""
    cameras, images, points = (folder / f"{name}.bin" for name in ("cameras", "images", "points3D"))
    return content_of(_lenses(cameras), _shots(images), _points(points))


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


def write_binary_model(folder: Path, content: Content) -> None:
    """Write the three binary files of a model."""
    with (folder / "cameras.bin").open("wb") as out:
        out.write(struct.pack("<Q", len(content.lenses)))
        for lens in content.lenses:
            layout = f"<IiQQ{len(lens.parameters)}d"
            out.write(struct.pack(layout, lens.key, NUMBERS[lens.model], *lens.size_px, *lens.parameters))
    with (folder / "images.bin").open("wb") as out:
        out.write(struct.pack("<Q", len(content.shots)))
        for shot in content.shots:
            out.write(struct.pack("<I7dI", shot.key, *shot.quaternion, *shot.translation, shot.lens))
            out.write(shot.name.encode() + b"\0" + struct.pack("<Q", len(shot.marks)))
            rows = np.empty(len(shot.marks), _MARK)
            rows["xy"], rows["key"] = shot.marks, shot.points
            out.write(rows.tobytes())
    with (folder / "points3D.bin").open("wb") as out:
        out.write(struct.pack("<Q", len(content.keys)))
        errors = content.errors.tolist()
        for key, xyz, error, track in zip(
            content.keys.tolist(), content.xyz.tolist(), errors, content.tracks, strict=True
        ):
            out.write(struct.pack("<Q3d3BdQ", key, *xyz, 128, 128, 128, error, len(track)))
            out.write(track.astype("<u4").tobytes())
