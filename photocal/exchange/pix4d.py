"""Pix4D's internal camera parameters (`..._calibrated_internal_camera_parameters.cam`).

In mm on a nominal sensor: focal length F, principal point Px, Py from the upper-left corner of the upper-left
pixel, x right, y down (the centre of that pixel lies half a pixel further). The distortion is added to the
normalised projection (`brown-ideal`), K1, K2, K3, T1, T2 as k1, k2, k3, p1, p2 of OpenCV. The file has no
image size: the caller gives it. Source: Pix4D documentation, "How are the internal and external camera
parameters defined".
"""

from __future__ import annotations

import re
from pathlib import Path

from drivers.errors import InputMalformedError
from photocal.exchange.choices import Choices, file_name
from photocal.exchange.pinhole import Pinhole, from_pinhole, require_one_focal_length, to_pinhole
from photocal.exchange.reconstruction import Reconstruction
from photocal.exchange.source import number, read_lines
from photocal.geometry.camera import Camera
from photocal.geometry.conversion import Conversion

HEAD = "Pix4D camera calibration file"
_SENSOR = re.compile(r"#Focal Length mm assuming a sensor width of ([0-9.eE+-]+)x([0-9.eE+-]+)mm")
_KEYS = ("F", "Px", "Py", "K1", "K2", "K3", "T1", "T2")


def read_pix4d(path: Path, size_px: tuple[int, int], camera_id: str = "") -> Camera:
    """Read a .cam file with one camera."""
    lines = read_lines(path, comment="")
    heads = [line for line in lines if line.text.startswith(HEAD)]
    if len(heads) != 1:
        raise InputMalformedError(f"has {len(heads)} cameras where one was expected", where=path)
    sensor = next((found for line in lines if (found := _SENSOR.match(line.text.strip()))), None)
    if sensor is None:
        raise InputMalformedError("does not state its sensor width", where=path, remedy="is it a .cam file?")
    width, height = (number(cell, path, "sensor") for cell in sensor.groups())
    value = {}
    for line in lines:
        cells = line.text.split()
        if cells[0] in _KEYS:
            if len(cells) != 2 or cells[0] in value:
                raise InputMalformedError(f"{cells[0]} is not one number", where=line.place)
            value[cells[0]] = number(cells[1], line.place, cells[0])
    missing = [key for key in _KEYS if key not in value]
    if missing:
        raise InputMalformedError(f"has no {missing[0]}", where=path, remedy="was it written completely?")
    if not (width > 0 and height > 0) or abs(width / height / (size_px[0] / size_px[1]) - 1) > 1e-3:
        raise InputMalformedError(
            f"its sensor of {width:g} x {height:g} mm does not fit images of {size_px[0]} x {size_px[1]} px",
            where=path,
            remedy="give the size of the images of this camera",
        )
    pixel = width / size_px[0]
    pinhole = Pinhole(
        size_px,
        value["F"] / pixel,
        value["F"] / pixel,
        value["Px"] / pixel - 0.5,
        value["Py"] / pixel - 0.5,
        value["K1"],
        value["K2"],
        value["K3"],
        value["T1"],
        value["T2"],
    )
    return from_pinhole(pinhole, camera_id or path.stem, path)


def write_pix4d(path: Path, own: Camera) -> Conversion:
    """Write a .cam file; the sensor is that of the camera, or pixels of 1 um for a camera in px."""
    pinhole, conversion = to_pinhole(own, "Pix4D")
    require_one_focal_length(pinhole, own.id, "a .cam file")
    pixel = own.pitch[0] if own.unit == "mm" else 1e-3
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


def export(folder: Path, given: Reconstruction, _: Choices) -> tuple[Conversion, ...]:
    """A .cam file for each camera."""
    name = "_pix4d_calibrated_internal_camera_parameters.cam"
    return tuple(write_pix4d(folder / (file_name(own.id) + name), own) for own in given.cameras)
