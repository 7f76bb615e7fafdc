"""OpenCV calibration files, YAML or JSON as FileStorage writes them.

Pixels: x right, y down, the centre of the upper-left pixel is (0, 0), as ours. `camera_matrix` has fx, fy,
cx, cy in px; `distortion_coefficients` are k1, k2, p1, p2, k3 of the normalised projection (`brown-ideal`),
camera axes x right, y down, z forward; with k4, k5, k6 and s1 to s4 it is `rational`. Tilted terms must be
zero. Four coefficients beside `distortion_model` equidistant or fisheye are of a fisheye (`equidistant`).
"""

import json
import re
from dataclasses import replace
from pathlib import Path

import numpy as np

from photocal.base.arrays import Floats
from photocal.base.errors import InputMalformedError
from photocal.block.model import NO_OBSERVATIONS, NO_POINTS, Block, Images
from photocal.exchange.exporting import Choices, file_name
from photocal.exchange.foreign_project import ForeignProject
from photocal.exchange.parts import block
from photocal.exchange.pinhole import Pinhole, from_pinhole, to_pinhole
from photocal.exchange.source import image_size, number, read_json, read_text, structured
from photocal.geometry.camera import MODELS, Camera, Model, among
from photocal.geometry.conversion import Conversion

MATRICES = ("camera_matrix", "cameraMatrix", "K")
# An entry of the file begins a line, what belongs to it is indented; the size and the numbers of a matrix.
_ENTRY = re.compile(r"^(\w+) *:(.*(?:\n[ \t].*)*)", re.MULTILINE)
_SHAPE = re.compile(r"\b(rows|cols)\"? *: *(\d{1,4})\b")
_DATA = re.compile(r"\bdata\"? *: *\[([^\]]*)\]")
_FISHEYE = ("equidistant", "fisheye")
_OF_FISHEYE = ("k1", "k2", "k3", "k4")
_COEFFICIENTS = ("k1", "k2", "p1", "p2", "k3", "k4", "k5", "k6", "s1", "s2", "s3", "s4")
_TERMS = ("K1", "K2", "K3", "P1", "P2")
_OTHERS: dict[Model, tuple[str, ...]] = {name: MODELS[name].terms for name in ("rational", "equidistant")}
COEFFICIENTS = ("distortion_coefficients", "dist_coeffs", "distCoeffs", "D")


def read_opencv(path: Path) -> Camera:
    """Read a calibration."""
    entries = _entries(path)
    matrix = _matrix(entries, MATRICES, path)
    coefficients = np.ravel(_matrix(entries, COEFFICIENTS, path))
    lens = entries.get("distortion_model", "").strip(' \n"').lower()
    width, height = (number(entries.get(key, ""), path, key) for key in ("image_width", "image_height"))
    if matrix.shape != (3, 3) or matrix[0, 1] or not np.allclose(matrix[2], [0, 0, 1], atol=0):
        raise InputMalformedError("the camera matrix is not fx, 0, cx, 0, fy, cy, 0, 0, 1", where=path)
    fisheye = lens in _FISHEYE
    names = _OF_FISHEYE if fisheye else _COEFFICIENTS
    if len(coefficients) < 4 or coefficients[len(names) :].any():
        raise InputMalformedError(
            f"has coefficients beyond {', '.join(names)}, for which there is no equivalent",
            "calibrate without tilt",
            where=path,
        )
    values = dict(zip(names, coefficients[: len(names)].tolist(), strict=False))
    focal_and_centre = matrix[0, 0], matrix[1, 1], matrix[0, 2], matrix[1, 2]
    pinhole = Pinhole(image_size(width, height, path), *focal_and_centre, **values, fisheye=fisheye)
    camera = from_pinhole(pinhole, path.stem, path)
    free = {"c", "x0", "y0", "B1", *(camera.lens.terms if camera.lens.relative else _TERMS)}
    return replace(camera, estimated=among(*free))


def write_opencv(path: Path, camera: Camera) -> Conversion:
    """Write a calibration."""
    import cv2

    pinhole, conversion = to_pinhole(camera, "OpenCV", _OTHERS)
    rational = conversion.camera.model == "rational"
    names = _OF_FISHEYE if pinhole.fisheye else _COEFFICIENTS if rational else _COEFFICIENTS[:5]
    matrix = np.array([[pinhole.fx, 0, pinhole.cx], [0, pinhole.fy, pinhole.cy], [0, 0, 1]], dtype=float)
    coefficients = np.array([[getattr(pinhole, name) for name in names]])
    kind = cv2.FileStorage_FORMAT_JSON if path.suffix.lower() == ".json" else cv2.FileStorage_FORMAT_YAML
    storage = cv2.FileStorage(path.suffix, cv2.FileStorage_WRITE | cv2.FileStorage_MEMORY | kind)
    storage.write("image_width", pinhole.size_px[0])
    storage.write("image_height", pinhole.size_px[1])
    storage.write("camera_name", camera.id)
    storage.write("camera_matrix", matrix)
    name = "equidistant" if pinhole.fisheye else "rational_polynomial" if rational else "plumb_bob"
    storage.write("distortion_model", name)
    storage.write("distortion_coefficients", coefficients)
    storage.write("conversion_rms_px", conversion.rms_px)
    storage.write("conversion_largest_px", conversion.largest_px)
    path.write_text(storage.releaseAndGetString(), encoding="utf-8", newline="\n")
    return conversion


def _entries(path: Path) -> dict[str, str]:
    """Text of each entry of a file, which OpenCV's own reader answers with a crash when it is damaged."""
    if path.suffix.lower() == ".json":
        content = structured(path, "a file of OpenCV", lambda: dict(read_json(path)))
        return {
            name: value if isinstance(value, str) else json.dumps(value) for name, value in content.items()
        }
    text = read_text(path)
    if not text.startswith("%YAML"):
        raise InputMalformedError("is not a YAML file of OpenCV", "it must begin with %YAML:1.0", where=path)
    return dict(_ENTRY.findall(text))


def _matrix(entries: dict[str, str], names: tuple[str, ...], path: Path) -> Floats:
    name = next((name for name in names if name in entries), None)
    if name is None:
        raise InputMalformedError(f"has no {names[0]}", "is it a calibration?", where=path)
    size = dict(_SHAPE.findall(entries[name]))
    shape = [int(size.get(side, 0)) for side in ("rows", "cols")]
    data = _DATA.search(entries[name])
    cells = data[1].split(",") if data else []
    if not cells or shape[0] * shape[1] != len(cells):
        raise InputMalformedError(f"{name} is not a matrix of rows, cols and data", where=path)
    return np.array([number(cell, path, name) for cell in cells]).reshape(shape)


def write(folder: Path, given: Block, _: Choices) -> tuple[Conversion, ...]:
    """A YAML file for each camera."""
    return tuple(write_opencv(folder / f"{file_name(camera.id)}.yml", camera) for camera in given.cameras)


def read(path: Path) -> ForeignProject:
    """All calibrations of the folder of a file, by their names."""
    files = sorted(path.parent.glob("*.yml"))
    images = Images((), np.zeros(0, dtype=np.int64))
    cameras = [read_opencv(file) for file in files]
    return ForeignProject("OpenCV", block(path.stem, cameras, images, NO_POINTS, NO_OBSERVATIONS, files))
