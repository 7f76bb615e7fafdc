"""Features of an image: places that other images show too, with descriptors to recognise them by."""

import hashlib
import os
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any, TypeVar

import numpy as np
from numpy.typing import NDArray

from photocal.base.archives import DAMAGES
from photocal.base.arrays import Bytes, Columns, Integers
from photocal.base.codec import packed, unpacked
from photocal.base.files import output_file
from photocal.base.program import program

Arrays = dict[str, NDArray[Any]]
Floats32 = NDArray[np.float32]
Made = TypeVar("Made")


def combined_key(*parts: object) -> str:
    """SHA-256 of several keys and settings."""
    return hashlib.sha256("\0".join(map(str, parts)).encode()).hexdigest()


def array_key(*arrays: NDArray[Any]) -> str:
    """SHA-256 of the content of arrays."""
    digest = hashlib.sha256()
    for array in arrays:
        digest.update(np.ascontiguousarray(array).data)
    return digest.hexdigest()


def cached(folder: Path, key: str, names: tuple[str, ...], make: Callable[[], Arrays]) -> Arrays:
    """Give arrays from the cache, or make and keep them; without names all there are."""
    path = _entry(folder, key)
    try:
        # Opened here, so that a damaged file is closed again.
        with path.open("rb") as stream, np.load(stream, allow_pickle=False) as held:
            return {name: held[name] for name in names or held}
    except (KeyError, *DAMAGES):
        made = make()
    with output_file(path) as aside, aside.open("wb") as target:
        np.savez(target, **made)  # type: ignore[arg-type]
    return made


def made_once(folder: Path | None, kind: Any, given: object, make: Callable[[], Made]) -> Made:
    """Give an object from the cache, or make and keep it.

    kind: its annotation.
    given: all data that it is made of. The code that may make it belongs to the key, too.
    """
    if folder is None:
        return make()
    code = program(make)
    key = combined_key(make.__qualname__, *code.values(), array_key(*packed(given).values()))
    found: Made = unpacked(kind, cached(folder, key, (), lambda: packed(make())))
    return found


def kept(folder: Path, key: str) -> bool:
    """Whether the cache has arrays of this key; what is damaged is made again."""
    return _entry(folder, key).is_file()


def _entry(folder: Path, key: str) -> Path:
    return folder / key[:2] / f"{key}.npz"


def sweep(folder: Path, most_bytes: int, unused_s: float, now_s: float) -> int:
    """Remove the files that were not used for longest."""
    files = []
    for where, _, names in os.walk(folder):
        for name in names:
            path = Path(where) / name
            try:
                facts = path.lstat()
            except OSError:
                # Another program sweeps, too.
                continue
            files.append((facts.st_mtime, facts.st_size, path))
    files.sort(key=lambda file: file[:2], reverse=True)
    remaining = 0
    for used, size, path in files:
        if remaining + size <= most_bytes and now_s - used <= unused_s:
            remaining += size
        else:
            # A folder with other files stays.
            with suppress(OSError):
                path.unlink(missing_ok=True)
                path.parent.rmdir()
    return remaining


def touch(path: Path, now_s: float) -> None:
    """Note that a file is used; once an hour is enough."""
    # Somebody else's cache, or gone: then it is not noted.
    with suppress(OSError):
        if now_s - path.stat().st_mtime > 3600:
            os.utime(path, (now_s, now_s))


@dataclass(frozen=True)
class Features(Columns):
    """Features of one image.

    pixels (n, 2): columns and rows; the centre of the upper-left pixel is (0, 0).
    scale (n,): diameter, px.
    descriptors (n, 128).
    """

    pixels: Floats32
    scale: Floats32
    descriptors: Bytes


@dataclass(frozen=True)
class FeatureSettings:
    """How features are detected.

    most: features to keep in an image.
    contrast: least contrast (SIFT's threshold, shared among its layers).
    longest_px: larger images are reduced to this length of their longer side; the places are given in the
        stored grid. Memory and time depend on it alone.
    part: they are reduced to this part of that length where they then have as many features as are kept: the
        finest ones, which are the most and cost the most, would hardly be kept. A half leaves out the finest
        octave, and no other feature.
    """

    most: int = 10_000
    contrast: float = 0.01
    longest_px: int = 2400
    part: float = 0.5


def detect(grey: Bytes, settings: FeatureSettings) -> Features:
    """Detect SIFT features (Lowe 2004), evenly spread, the coarse ones before the fine ones.

    Fine features are many, but grass and sand change from image to image: the coarse ones are found again.
    """
    import cv2

    height, width = grey.shape
    # Without the precise upscale the places are off by a fraction of a pixel.
    detector: Any = cv2
    sift = detector.SIFT_create(contrastThreshold=settings.contrast, enable_precise_upscale=True)
    points = tuple[Any, ...]()
    whole = min(1.0, settings.longest_px / max(height, width))
    part = settings.part * settings.longest_px / max(height, width)
    # To make a picture a little smaller saves nothing.
    smaller = 0.75
    for factor in (part, whole) if part < smaller * whole else (whole,):
        size = (max(1, round(width * factor)), max(1, round(height * factor)))
        small = grey if factor == 1 else cv2.resize(grey, size, interpolation=cv2.INTER_AREA)
        points = sift.detect(small, None)
        if len(points) >= settings.most:
            break
    scale = np.array([p.size for p in points], dtype=np.float32)
    chosen = _spread(_places(points), scale, size, settings.most)
    if not len(chosen):
        none = np.zeros((0, 2), dtype=np.float32)
        return Features(none, none[:, 0], np.zeros((0, 128), dtype=np.uint8))
    points, descriptors = sift.compute(small, [points[k] for k in chosen.tolist()])
    # The outer edges of both grids coincide, not the centres of their first pixels.
    zoom = np.array([width / size[0], height / size[1]], dtype=np.float32)
    scale = np.array([p.size for p in points], dtype=np.float32) * zoom.mean()
    return Features((_places(points) + 0.5) * zoom - 0.5, scale, np.asarray(descriptors).astype(np.uint8))


def _places(points: Any) -> Floats32:
    import cv2

    return np.asarray(cv2.KeyPoint.convert(points), dtype=np.float32).reshape(-1, 2)


def _spread(pixels: Floats32, strength: Floats32, size: tuple[int, int], most: int) -> Integers:
    """The strongest features of each cell, cell after cell in turns, until there are enough."""
    if len(pixels) <= most:
        return np.arange(len(pixels))
    # Cells along the longer side, in each of which the coarsest features stay.
    cells = 24
    side = max(size) / cells
    cell = (pixels[:, 0] // side).astype(np.int64) + 1000 * (pixels[:, 1] // side).astype(np.int64)
    order = np.lexsort((-strength, cell))
    starts = np.r_[0, np.flatnonzero(np.diff(cell[order])) + 1]
    lengths = np.diff(np.r_[starts, len(order)])
    rank = np.arange(len(order)) - np.repeat(starts, lengths)
    chosen = order[np.lexsort((-strength[order], rank))][:most]
    return np.sort(chosen)
