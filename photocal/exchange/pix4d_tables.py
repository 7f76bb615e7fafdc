"""Single files of a Pix4D project: its cameras (.cam), and its orientations without measurements.

`pix4d_calibrated_internal_camera_parameters.cam` has for each camera F, Px, Py in mm on a sensor of the
stated size, from the image's upper-left corner, and K1 K2 K3, T1 T2 of coordinates divided by F
(`brown-ideal`). `calibrated_external_camera_parameters.txt` has a head and a row for each image: name X Y Z
Omega Phi Kappa, m in the output system (`wkt.prj` beside it) and degrees of our own rotation. The .cam of the
same name without "pix4d" is Inpho's: it has no distortion, and is not read.
"""

import re
from collections.abc import Iterable
from dataclasses import replace
from pathlib import Path

import numpy as np

from photocal.base.errors import InputMalformedError
from photocal.block.model import NO_OBSERVATIONS, NO_POINTS, Images
from photocal.exchange.foreign_project import ForeignProject
from photocal.exchange.output_system import output_system
from photocal.exchange.parts import block, distinct
from photocal.exchange.pinhole import Pinhole, from_pinhole
from photocal.exchange.pix4d_project import EXTERNAL, HEAD, file_of
from photocal.exchange.source import Line, number, numbers, read_lines
from photocal.geometry.camera import Camera

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
    return tuple(_camera(part, sizes, name, path) for part, name in zip(parts, names, strict=True))


def _camera(lines: list[Line], sizes: tuple[tuple[int, int], ...], name: str, path: Path) -> Camera:
    found = [sensor for line in lines if (sensor := _SENSOR.match(line.text.strip()))]
    if not found:
        raise lines[0].malformed("states no width of a sensor", "was it written completely?")
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
            f"its sensor of {width:g} x {height:g} mm has the shape of no picture",
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
