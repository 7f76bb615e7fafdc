"""BAL: the problems of Bundle Adjustment in the Large, as text, and compressed by bzip2 or gzip.

The first line counts cameras, points and observations. A line for each observation follows (camera, point, x,
y), then nine numbers of each camera (rotation vector, translation, f, k1, k2) and three of each point. The
middle of the image is (0, 0), in pixels, x right, y up; camera axes are x right, y up, z backwards, with
P = R X + t. With p = -P / P_z, an image point is f (1 + k1 |p|^2 + k2 |p|^4) p: our `rational` lens of K1 and
K2, so that an adjustment has the same minimum as by any other program. Each image has its own camera, whose
three parameters are estimated; the datum is free. Source: Agarwal, Snavely, Seitz and Szeliski 2010, Bundle
Adjustment in the Large, and grail.cs.washington.edu/projects/bal.
"""

import bz2
import gzip
import warnings
import zlib
from codecs import BOM_UTF8
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path
from typing import BinaryIO, NamedTuple, cast

import numpy as np
from scipy.spatial.transform import Rotation

from photocal.base.arrays import Floats, Integers
from photocal.base.errors import InputMalformedError
from photocal.block.model import Block, Images, ObjectPoints, Observations
from photocal.exchange.foreign_project import ForeignProject
from photocal.exchange.parts import UNIT_SIGMA_PX
from photocal.exchange.source import MAX_BYTES, MAX_SIDE_PX, fingerprint, require_readable
from photocal.geometry.camera import Camera, camera
from photocal.geometry.rotation import angles_from_matrix

# What one observation and one other number take at least, with what separates them.
_SMALLEST_RAY, _SMALLEST = 8, 2
_NUMBERS = {"camera": 9, "point": 3}
# Octets that are read at once, and the most that a number may take.
_PORTION, _LONGEST = 1 << 24, 100
_ESTIMATED = ("c", "K1", "K2")
_OPENERS: dict[bytes, Callable[[Path], BinaryIO]] = {
    b"BZh": lambda path: cast("BinaryIO", bz2.BZ2File(path)),
    b"\x1f\x8b": lambda path: cast("BinaryIO", gzip.GzipFile(path)),
}
_LETTERS = b"\n\r\t 0123456789+-.eE"


class BalProblem(NamedTuple):
    """What a file holds.

    cameras (images, 9): rotation vector, translation, f, k1, k2.
    points (points, 3).
    image, point (rays,): which point was seen where.
    plane (rays, 2): where, px.
    """

    cameras: Floats
    points: Floats
    image: Integers
    point: Integers
    plane: Floats


def detect(path: Path) -> bool:
    """Whether a file begins as one of this format."""
    try:
        with _opened(path) as stream:
            lines = stream.read(400).removeprefix(BOM_UTF8).splitlines()
    except (OSError, EOFError, zlib.error):
        return False
    cells = [line.split() for line in lines[:2]]
    if [len(row) for row in cells] != [3, 4]:
        return False
    return all(cell.isdigit() for cell in cells[0] + cells[1][:2])


def read(path: Path) -> ForeignProject:
    """Read a problem as a project, its cameras one for each image.

    raises InputNotFoundError: when it is missing, empty or a folder.
    raises InputMalformedError: when it is damaged, or its first line counts more than it can hold.
    """
    remarks = (
        "the format has no size of the images: each is as large as its observations reach",
        "the format has no unit of lengths: they are given as metres, and the scale is free",
    )
    block = block_of(read_problem(path), path.name.split(".")[0])
    block = replace(block, inputs=(fingerprint(path),))
    return ForeignProject("BAL", block, remarks=remarks, normalised=True)


def block_of(problem: BalProblem, name: str) -> Block:
    """Make a free block of a problem, with a camera for each image, as large as its observations reach."""
    count = len(problem.cameras)
    half = np.zeros((count, 2))
    np.maximum.at(half, problem.image, np.abs(problem.plane))
    size = 2 * np.ceil(half).astype(np.int64) + 1
    matrix = Rotation.from_rotvec(problem.cameras[:, :3]).as_matrix()
    centre = -np.einsum("nij,ni->nj", matrix, problem.cameras[:, 3:6])
    rows = zip(size.tolist(), problem.cameras[:, 6:].tolist(), strict=True)
    names = tuple(map(str, range(count)))
    sigma = np.full(problem.plane.shape, UNIT_SIGMA_PX)
    return Block(
        name,
        "local",
        "local",
        "free",
        tuple(_camera(each, *row) for each, row in zip(names, rows, strict=True)),
        Images(names, np.arange(count), np.hstack([angles_from_matrix(matrix), centre])),
        ObjectPoints(tuple(map(str, range(len(problem.points)))), problem.points),
        Observations("px", "photo", problem.image, problem.point, problem.plane, sigma),
    )


def _camera(name: str, size_px: list[int], lens: list[float]) -> Camera:
    width, height = size_px
    values = dict(zip(_ESTIMATED, lens, strict=True))
    return camera(name, "rational", "px", (width, height), (1.0, 1.0), values, estimate=_ESTIMATED)


def read_problem(path: Path) -> BalProblem:
    """Read the arrays of a problem, errors as of `read`."""
    size = require_readable(path)
    malformed = InputMalformedError.at(path)
    try:
        with _opened(path) as stream:
            head, _, text = _text(stream).removeprefix(BOM_UTF8).partition(b"\n")
            counts = _counts(path, head, size)
            images, points, rays = counts
            expected = 4 * rays + _NUMBERS["camera"] * images + _NUMBERS["point"] * points
            parts, found = list[Floats](), 0
            for part in _portions(path, stream, text):
                parts.append(part)
                found += len(part)
                if found > expected:
                    raise malformed(
                        f"has more numbers than the {expected} of its first line",
                        "is it of this format, and one file?",
                    )
    except (OSError, EOFError, zlib.error) as failure:
        raise malformed(f"cannot be decompressed ({failure})", "was it copied completely?") from failure
    if found < expected:
        raise malformed(
            f"ends after {found} of {expected} numbers that its first line promises",
            "was it copied completely?",
        )
    numbers = np.concatenate(parts) if parts else np.zeros(0)
    del parts
    seen, rest = numbers[: 4 * rays].reshape(-1, 4), numbers[4 * rays :]
    cameras = rest[: _NUMBERS["camera"] * images].reshape(-1, _NUMBERS["camera"])
    _require(path, seen, cameras, counts)
    return BalProblem(
        cameras.copy(),
        rest[cameras.size :].reshape(-1, _NUMBERS["point"]).copy(),
        seen[:, 0].astype(np.int64),
        seen[:, 1].astype(np.int64),
        seen[:, 2:].copy(),
    )


def _packing(path: Path) -> Callable[[Path], BinaryIO] | None:
    """What decompresses a file, as its first octets say: names are changed by hand."""
    with path.open("rb") as stream:
        start = stream.read(3)
    return _OPENERS.get(start) or _OPENERS.get(start[:2])


def _opened(path: Path) -> BinaryIO:
    return (_packing(path) or _plain)(path)


def _plain(path: Path) -> BinaryIO:
    return path.open("rb")


def _counts(path: Path, line: bytes, size: int) -> tuple[int, int, int]:
    """Numbers of images, points and rays, no more than the file can hold."""
    malformed = InputMalformedError.at(f"{path}, line 1")
    cells = line.split()
    if len(cells) != 3 or not all(cell.isdigit() and len(cell) <= 12 for cell in cells):
        raise malformed(
            "does not count cameras, points and observations", "is it a BAL problem, whole and unchanged?"
        )
    images, points, rays = map(int, cells)
    if not min(images, points, rays):
        raise malformed("counts no cameras, no points or no observations", "is it complete?")
    least = _SMALLEST_RAY * rays + _SMALLEST * sum(
        n * m for n, m in zip((images, points), _NUMBERS.values(), strict=True)
    )
    # What a compressed file holds is not known before: no more than any file may.
    if least > (size if _packing(path) is None else MAX_BYTES):
        raise malformed(
            f"counts {images} cameras, {points} points and {rays} observations, more than the file can hold",
            "is it truncated?",
        )
    return images, points, rays


def _text(stream: BinaryIO) -> bytes:
    """Read some megabytes, with ends of lines as ours."""
    text = stream.read(_PORTION)
    if b"\r" not in text:
        return text
    if text.endswith(b"\r"):
        text += stream.read(1)
    return text.replace(b"\r\n", b"\n").replace(b"\r", b"\n")


def _portions(path: Path, stream: BinaryIO, text: bytes) -> Iterator[Floats]:
    """Numbers of a stream from its second line on, of which some text was read, some megabytes at a time."""
    malformed, line, total = InputMalformedError.at(path), 2, len(text)
    while True:
        fresh = _text(stream)
        total += len(fresh)
        if total > MAX_BYTES:
            raise malformed(
                f"holds more than the {MAX_BYTES >> 30} GiB that can be read", "is it the right file?"
            )
        # A number that is cut waits for its end.
        cut = 1 + max(map(text.rfind, (b" ", b"\n", b"\t"))) if fresh else len(text)
        if len(text) - cut > _LONGEST:
            raise malformed("has no blanks between its numbers", "is it a BAL problem?")
        numbers = _numbers(path, line, text[:cut])
        if cut > _PORTION // 2 and not len(numbers):
            raise malformed("has megabytes without a number", "is it damaged?")
        yield numbers
        if not fresh:
            return
        line += text.count(b"\n", 0, cut)
        text = text[cut:] + fresh


def _numbers(path: Path, line: int, text: bytes) -> Floats:
    """Numbers of a text that begins in a line."""
    # Of blanks alone the library makes a number.
    if not text.strip():
        return np.zeros(0)
    if text.translate(None, _LETTERS):
        raise _complaint(path, line, text)
    with warnings.catch_warnings():
        warnings.simplefilter("error", DeprecationWarning)
        try:
            numbers = np.fromstring(text, sep=" ")
        except (DeprecationWarning, ValueError):
            raise _complaint(path, line, text) from None
    if not np.isfinite(numbers).all():
        raise _complaint(path, line, text)
    return numbers


def _complaint(path: Path, line: int, text: bytes) -> InputMalformedError:
    """Name the first line of a text that has something else than finite numbers."""
    for k, row in enumerate(text.split(b"\n"), start=line):
        for cell in row.split():
            try:
                wrong = bool(cell.translate(None, _LETTERS)) or not np.isfinite(float(cell))
            except ValueError:
                wrong = True
            if wrong:
                said = cell[:40].decode("ascii", "replace")
                return InputMalformedError(
                    f"{said!r} is not a finite number", "is it damaged?", where=f"{path}, line {k}"
                )
    return InputMalformedError(
        "has something that is no number", "is it damaged?", where=f"{path}, line {line}"
    )


def _require(path: Path, seen: Floats, cameras: Floats, counts: tuple[int, int, int]) -> None:
    """Refuse observations of what is not there, and cameras that cannot be."""
    images, points, _ = counts
    for column, (what, count) in enumerate((("camera", images), ("point", points))):
        index = seen[:, column]
        wrong = np.flatnonzero((index < 0) | (index >= count) | (index % 1 != 0))
        if len(wrong):
            raise InputMalformedError(
                f"observes {what} {index[wrong[0]]:g}, but there are {count}, from 0 on",
                "is the file damaged?",
                where=f"{path}, line {wrong[0] + 2}",
            )
    wide = np.flatnonzero(np.abs(seen[:, 2:]).max(axis=1) > MAX_SIDE_PX / 2)
    if len(wide):
        raise InputMalformedError(
            f"an observation lies more than {MAX_SIDE_PX // 2} px from the middle of its image",
            "is the file damaged?",
            where=f"{path}, line {wide[0] + 2}",
        )
    backwards = np.flatnonzero(~(cameras[:, 6] > 0))
    if len(backwards):
        first = int(backwards[0])
        place = 2 + len(seen) + cameras.shape[1] * first + 6
        raise InputMalformedError(
            f"camera {first} has a focal length of {cameras[first, 6]:g}",
            "leave it out, or turn it round with its axes",
            where=f"{path}, line {place}",
        )
