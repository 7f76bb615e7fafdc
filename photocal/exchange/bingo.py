"""Image measurements in BINGO's form: a line for each image, then its points, ended by -99.

`IMAGE name_of_camera`, then `point x y` in mm: x right, y up, from the middle of the image, distorted, as
measured. The camera's name ends with width and height of its sensor (`H_35.9_24`). The table is read line by
line: that of a large project has millions of rays.
"""

import math
import re
from array import array
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path

import numpy as np

from photocal.base.errors import InputMalformedError
from photocal.base.text_tables import MARKS
from photocal.block.model import Observations
from photocal.exchange.parts import pixels
from photocal.exchange.source import Line, decimal_comma, number, printed, read_text, require_readable
from photocal.geometry.camera import Camera

_SENSOR = re.compile(r"sensor width of\s*(\d+(?:\.\d+)?)\s*x\s*(\d+(?:\.\d+)?)\s*mm")


def read_bingo(
    path: Path, names: Sequence[str], member: Sequence[int], cameras: Sequence[Camera], marked: frozenset[str]
) -> tuple[tuple[str, ...], Observations, list[str]]:
    """Read a table of the images of a project; each point counts once in an image.

    member: camera of each image. marked: points that stand there with a prefix that no other table has.
    returns: names of the points in the order in which they appear; their observations; and what was left out.
    """
    image_of, sensors = in_order(names), _sensors(path.parent)
    image, pitch, middle, unknown, outside = -1, (0.0, 0.0), (0.0, 0.0), 0, 0
    rays, where, number_of = array("q"), array("d"), dict[str, int]()
    seen = dict[int, set[int]]()
    # Measurements are within half a side from the middle, distorted ones by little more; others lie outside.
    far = 3.0
    for at, text in _lines(path):
        cells = text.split()
        if cells[0] == "-99":
            image = -1
        elif len(cells) >= 3 and (measured := _two_numbers(cells)) is not None:
            if image < 0:
                continue
            if "_" in cells[-2] or "_" in cells[-1]:
                # Python would take them for separators of thousands.
                raise Line(path, at, text).malformed(
                    f"{' '.join(cells[-2:])!r} are no coordinates", "correct them"
                )
            point = number_of.setdefault(" ".join(cells[:-2]), len(number_of))
            column, row = measured[0] / pitch[0], measured[1] / pitch[1]
            if abs(column) > far * (middle[0] + 1) or abs(row) > far * (middle[1] + 1):
                outside += 1
            elif point not in seen[image]:
                seen[image].add(point)
                rays.extend((image, point))
                where.extend((middle[0] + column, middle[1] - row))
        elif len(cells) >= 3 and decimal_comma(cells[-2:]):
            number(cells[-2], Line(path, at, text).place, "x")
        else:
            # Names of images and of cameras may have blanks.
            titles = (" ".join(cells[:k]) for k in range(max(len(cells) - 1, 1), 0, -1))
            image = next((k for k in map(image_of, titles) if k >= 0), -1)
            unknown += image < 0
            if image >= 0:
                seen.setdefault(image, set())
                size = cameras[member[image]].size_px
                pitch = _pitch(cells[-1], size, sensors, Line(path, at, text))
                middle = (size[0] - 1) / 2, (size[1] - 1) / 2
    if not rays:
        raise InputMalformedError("has no measurement of a calibrated image", where=path)
    told = [f"{unknown} images of {path.name} are not calibrated: left out"] if unknown else []
    told += [f"{outside} rays of {path.name} lie outside their images: left out"] if outside else []
    table = np.array(rays, dtype=np.int64).reshape(-1, 2)
    observed = pixels(table[:, 0], table[:, 1], np.array(where).reshape(-1, 2))
    return _named(tuple(number_of), marked), observed, told


def _named(written: Sequence[str], marked: frozenset[str]) -> tuple[str, ...]:
    """Names without the prefix of marked points; a tie point of the same number is named otherwise."""
    prefixed = {name: name.removeprefix("GCP_") for name in written if name not in marked}
    prefixed = {name: bare for name, bare in prefixed.items() if name != bare and bare in marked}
    taken = set(prefixed.values())
    return tuple(prefixed.get(name, f"tie {name}" if name in taken else name) for name in written)


def _lines(path: Path) -> Iterator[tuple[int, str]]:
    """Lines with content and their numbers, one by one."""
    require_readable(path)
    with path.open("rb") as stream:
        head = stream.read(4)
    if any(head.startswith(mark) for mark, name in MARKS if "16" in name):
        yield from ((k, text) for k, text in enumerate(read_text(path).split("\n"), start=1) if text.strip())
        return
    try:
        with path.open(encoding="utf-8-sig") as lines:
            for k, text in enumerate(lines, start=1):
                if "\0" in text:
                    raise InputMalformedError("is not a text file", "is it the right file?", where=path)
                if text.strip():
                    yield k, text.rstrip("\n")
    except UnicodeDecodeError:
        # Says where.
        read_text(path)
        raise


def _sensors(folder: Path) -> list[tuple[float, float]]:
    """Widths and heights, mm, that the .cam files of a folder assume."""
    texts = (p.read_text(encoding="utf-8", errors="replace") for p in sorted(folder.glob("*.cam")))
    return [(float(width), float(height)) for width, height in _SENSOR.findall("".join(texts))]


def in_order(names: Sequence[str]) -> Callable[[str], int]:
    """How a table names its images, with or without ending; of equal names each next one; -1 for none."""
    left: dict[str, list[int]] = {}
    for k, name in enumerate(names):
        for key in {name.casefold(), _stem(name)}:
            left.setdefault(key, []).append(k)

    def image(title: str) -> int:
        """Give the image of a title; of several each is taken once."""
        places = left.get(title.casefold()) or left.get(_stem(title)) or [-1]
        return places.pop(0) if len(places) > 1 else places[0]

    return image


def _stem(name: str) -> str:
    return Path(name).stem.casefold()


def _pitch(
    name: str, size_px: tuple[int, int], sensors: Sequence[tuple[float, float]], line: Line
) -> tuple[float, float]:
    """Size of a pixel, mm: the camera's name ends with width and height of the sensor, or a .cam has them."""
    sides = re.search(r"_(\d+(?:\.\d+)?)[_x](\d+(?:\.\d+)?)\D*$", name)
    stated = [] if sides is None else [(float(sides[1]), float(sides[2]))]
    for width, height in (*stated, *sensors):
        pitch = (width / size_px[0], height / size_px[1])
        # A sensor is named in mm; what is larger are pixels.
        if 0 < pitch[0] < 0.1 and abs(pitch[0] / pitch[1] - 1) < 0.01:
            return pitch
    raise line.malformed(
        f"no sensor width in mm is known that fits the images of camera {name!r}",
        "put the .cam files into the folder",
    )


def _two_numbers(cells: Sequence[str]) -> tuple[float, float] | None:
    """Measurement at the end of a line: x and y; None where no two finite numbers stand there."""
    x, y = printed(cells[-2]), printed(cells[-1])
    # Not every sum of finite numbers is finite, and no measurement is as large.
    return (x, y) if math.isfinite(x + y) else None
