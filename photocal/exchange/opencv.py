"""OpenCV calibration files, YAML or JSON as FileStorage writes them.

Pixels: x right, y down, the centre of the upper-left pixel is (0, 0), as ours. `camera_matrix` has fx, fy,
cx, cy in px; `distortion_coefficients` are k1, k2, p1, p2, k3 of the normalised projection (`brown-ideal`),
camera axes x right, y down, z forward. Rational, thin prism and tilted terms must be zero.
"""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from drivers.arrays import Floats
from drivers.errors import InputMalformedError
from photocal.exchange.choices import Choices, file_name
from photocal.exchange.convert import Conversion
from photocal.exchange.pinhole import Pinhole, from_pinhole, to_pinhole
from photocal.exchange.reconstruction import Reconstruction, cameras_alone
from photocal.exchange.source import files_of, image_size, read_text
from photocal.geometry.camera import PARAMETERS, Camera

MATRICES = ("camera_matrix", "cameraMatrix", "K")
MOST_NUMBERS = 64
COEFFICIENTS = ("distortion_coefficients", "dist_coeffs", "distCoeffs", "D")


def read_opencv(path: Path, camera_id: str = "") -> Camera:
    """Read a calibration."""
    import cv2

    text = read_text(path)
    json = path.suffix.lower() == ".json"
    if not json and not text.startswith("%YAML"):
        raise InputMalformedError(
            "is no YAML file of OpenCV", where=path, remedy="it must begin with %YAML:1.0"
        )
    kind = cv2.FileStorage_FORMAT_JSON if json else cv2.FileStorage_FORMAT_YAML
    try:
        storage = cv2.FileStorage(text, cv2.FileStorage_READ | cv2.FileStorage_MEMORY | kind)
        try:
            matrix = _matrix(storage, MATRICES, path)
            coefficients = np.ravel(_matrix(storage, COEFFICIENTS, path))
            width, height = (float(storage.getNode(f"image_{name}").real()) for name in ("width", "height"))
        finally:
            storage.release()
    except (cv2.error, SystemError) as failure:
        raise InputMalformedError(
            "cannot be parsed by OpenCV", where=path, remedy="was it written completely?"
        ) from failure
    if matrix.shape != (3, 3) or matrix[0, 1] or not np.allclose(matrix[2], [0, 0, 1], atol=0):
        raise InputMalformedError("the camera matrix is not fx, 0, cx, 0, fy, cy, 0, 0, 1", where=path)
    if len(coefficients) < 4 or coefficients[5:].any():
        raise InputMalformedError(
            "has coefficients beyond k1, k2, p1, p2, k3, for which there is no equivalent",
            where=path,
            remedy="calibrate with the plain model",
        )
    k1, k2, p1, p2, k3 = [*coefficients[:5].tolist(), 0.0][:5]
    pinhole = Pinhole(
        image_size(width, height, path),
        matrix[0, 0],
        matrix[1, 1],
        matrix[0, 2],
        matrix[1, 2],
        k1,
        k2,
        k3,
        p1,
        p2,
    )
    own = from_pinhole(pinhole, camera_id or path.stem, path)
    free = ("c", "x0", "y0", "K1", "K2", "K3", "P1", "P2", "B1")
    return replace(own, estimated=np.array([name in free for name in PARAMETERS]))


def write_opencv(path: Path, own: Camera) -> Conversion:
    """Write a calibration."""
    import cv2

    pinhole, conversion = to_pinhole(own, "OpenCV")
    matrix = np.array([[pinhole.fx, 0, pinhole.cx], [0, pinhole.fy, pinhole.cy], [0, 0, 1]], dtype=float)
    coefficients = np.array([[pinhole.k1, pinhole.k2, pinhole.p1, pinhole.p2, pinhole.k3]])
    kind = cv2.FileStorage_FORMAT_JSON if path.suffix.lower() == ".json" else cv2.FileStorage_FORMAT_YAML
    storage = cv2.FileStorage(path.suffix, cv2.FileStorage_WRITE | cv2.FileStorage_MEMORY | kind)
    storage.write("image_width", pinhole.size_px[0])
    storage.write("image_height", pinhole.size_px[1])
    storage.write("camera_name", own.id)
    storage.write("camera_matrix", matrix)
    storage.write("distortion_model", "plumb_bob")
    storage.write("distortion_coefficients", coefficients)
    storage.write("conversion_rms_px", conversion.rms_px)
    storage.write("conversion_largest_px", conversion.largest_px)
    path.write_text(storage.releaseAndGetString(), encoding="utf-8", newline="\n")
    return conversion


def _matrix(storage: Any, names: tuple[str, ...], path: Path) -> Floats:
    for name in names:
        node = storage.getNode(name)
        if not node.empty():
            # A few numbers are expected; more is not even allocated.
            if node.isMap() and node.getNode("rows").real() * node.getNode("cols").real() > MOST_NUMBERS:
                raise InputMalformedError(f"{name} claims an impossible size", where=path)
            found = node.mat()
            if found is None or not np.isfinite(found).all():
                raise InputMalformedError(f"{name} is no matrix of finite numbers", where=path)
            return np.asarray(found, dtype=float)
    raise InputMalformedError(f"has no {names[0]}", where=path, remedy="is it a calibration?")


def export(folder: Path, given: Reconstruction, _: Choices) -> tuple[Conversion, ...]:
    """A YAML file for each camera."""
    return tuple(write_opencv(folder / f"{file_name(own.id)}.yml", own) for own in given.cameras)


def read_back(folder: Path) -> Reconstruction:
    """All calibrations of a folder, by their file names."""
    return cameras_alone([read_opencv(path) for path in files_of(folder, "*.yml")])
