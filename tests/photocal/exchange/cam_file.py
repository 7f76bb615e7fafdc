"""A reader of the .cam files that `photocal export` writes for Pix4D, to see what they say."""

from __future__ import annotations

import re
from pathlib import Path

from photocal.base.errors import InputMalformedError
from photocal.exchange.pinhole import Pinhole, from_pinhole
from photocal.exchange.pix4d_project import HEAD
from photocal.exchange.source import number, read_lines
from photocal.geometry.camera import Camera

_SENSOR = re.compile(r"#Focal Length mm assuming a sensor width of ([0-9.eE+-]+)x([0-9.eE+-]+)mm")
_KEYS = ("F", "Px", "Py", "K1", "K2", "K3", "T1", "T2")


def read_pix4d(path: Path, size_px: tuple[int, int]) -> Camera:
    """Read a .cam file with one camera."""
    lines = read_lines(path, comment="")
    heads = [line for line in lines if line.text.startswith(HEAD)]
    if len(heads) != 1:
        raise InputMalformedError(f"has {len(heads)} cameras where one was expected", where=path)
    sensor = next((found for line in lines if (found := _SENSOR.match(line.text.strip()))), None)
    if sensor is None:
        raise InputMalformedError("does not state its sensor width", "is it a .cam file?", where=path)
    width, height = (number(cell, path, "sensor") for cell in sensor.groups())
    value = {}
    for line in lines:
        cells = line.text.split()
        if cells[0] in _KEYS:
            if len(cells) != 2 or cells[0] in value:
                raise line.malformed(f"{cells[0]} is not one number")
            value[cells[0]] = number(cells[1], line.place, cells[0])
    missing = [key for key in _KEYS if key not in value]
    if missing:
        raise InputMalformedError(f"has no {missing[0]}", "was it written completely?", where=path)
    if not (width > 0 and height > 0) or abs(width / height / (size_px[0] / size_px[1]) - 1) > 1e-3:
        raise InputMalformedError(
            f"its sensor of {width:g} x {height:g} mm does not fit images of {size_px[0]} x {size_px[1]} px",
            "give the size of the images of this camera",
            where=path,
        )
    pixel = width / size_px[0]
    f, cx, cy = value["F"] / pixel, value["Px"] / pixel - 0.5, value["Py"] / pixel - 0.5
    k1, k2, k3, t1, t2 = (value[key] for key in _KEYS[3:])
    return from_pinhole(Pinhole(size_px, f, f, cx, cy, k1, k2, k3, t1, t2), path.stem, path)
