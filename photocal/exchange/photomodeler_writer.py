"""Writing PhotoModeler's text export with its table of control points.

The conventions are those of `photomodeler`, the layout is that of `photomodeler_export`. Numbers have all
their digits, where PhotoModeler rounds. Standard deviations that are not known are 0.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from pathlib import Path

import numpy as np

from drivers.arrays import Floats
from drivers.errors import InputMalformedError
from photocal.exchange.choices import Choices
from photocal.exchange.parts import digits, require_file_name, whole_numbers
from photocal.exchange.photomodeler import control_beside
from photocal.exchange.reconstruction import Reconstruction
from photocal.geometry.camera import Camera
from photocal.geometry.conversion import Conversion, converted

# Tolerance and number of iterations of the head; nothing depends on them.
_HEAD = "0.0005 20"
_TERMS = ("K1", "K2", "K3", "P1", "P2", "B1")


def write_photomodeler(path: Path, given: Reconstruction) -> tuple[Conversion, ...]:
    """Write an export, and `NAME-control.txt` beside it where there is control."""
    sizes = {own.size_px for own in given.cameras}
    if len(sizes) != 1 or any(own.unit != "mm" for own in given.cameras):
        raise InputMalformedError(
            "a PhotoModeler export has images of one size, and cameras in mm",
            remedy="give the pixel pitch, and export cameras of other sizes apart",
        )
    for name in given.image_names:
        require_file_name(name)
    made = tuple(_converted(own) for own in given.cameras)
    interiors = [_interior(conversion.camera) for conversion in made]
    numbers = whole_numbers(given.point_names)
    order = sorted(range(len(numbers)), key=lambda j: int(numbers[j]))
    rows = [_point(given, j, numbers[j]) for j in order]
    control = [row for row, j in zip(rows, order, strict=True) if given.roles and given.roles[j] == "control"]
    width, height = sizes.pop()
    lines = [
        given.name,
        f"{_HEAD} {width} {height}",
        digits([1.0] * 9),
        digits(interiors[0]),
        digits([0.0] * 10),
    ]
    for k, name in enumerate(given.image_names):
        lines += _photo(k, name, given, interiors[int(given.image_camera[k])])
    # Every section ends with a blank line.
    lines += ["", *control, "", *rows, "", *_marks(given, numbers), "", ""]
    path.write_text("\n".join(lines), encoding="utf-8", newline="\n")
    if control:
        text = "".join(_surveyed(given, j, numbers[j]) for j in order if given.roles[j] == "control")
        control_beside(path).write_text(text, encoding="utf-8", newline="\n")
    return made


def _converted(own: Camera) -> Conversion:
    """A camera that corrects measurements, with its affinity in the width of the pixels."""
    if own.value("B2"):
        raise InputMalformedError(
            f"camera {own.id} has a skew (B2), which PhotoModeler cannot hold", remedy="adjust without B2"
        )
    terms = _TERMS if own.value("B1") else _TERMS[:-1]
    return converted(own, "brown-observed", "before", terms)


def _interior(own: Camera) -> list[float]:
    """Principal distance, principal point, format, K1, K2, K3, P1, P2."""
    stretch = 1 + own.value("B1")
    width, height = own.size_px[0] * own.pitch[0] * stretch, own.size_px[1] * own.pitch[1]
    point = [own.value("x0") * stretch + width / 2, height / 2 - own.value("y0")]
    terms = [-own.value(name) for name in ("K1", "K2", "K3", "P1", "P2")]
    return [own.value("c"), *point, width, height, *terms]


def _photo(k: int, name: str, given: Reconstruction, interior: Sequence[float]) -> list[str]:
    angles = np.degrees(given.poses[k, [2, 1, 0]])
    sigma = np.zeros(6)
    if len(given.pose_sigma):
        spread = np.nan_to_num(given.pose_sigma[k])
        sigma = np.concatenate([spread[3:], np.degrees(spread[[2, 1, 0]])])
    return [
        f"{k} {name}",
        f"{k} {digits([*given.poses[k, 3:], *angles])}",
        f"{k} {digits(sigma)}",
        "",
        f"{k} {digits(interior)}",
        f"{k} {digits([0.0] * 10)}",
    ]


def _point(given: Reconstruction, j: int, number: str) -> str:
    return f"{number} {digits([*given.xyz[j], *_sigma(given, j)])}"


def _surveyed(given: Reconstruction, j: int, number: str) -> str:
    values = ", ".join(repr(float(value)) for value in (*given.xyz[j], *_sigma(given, j)))
    return f"{number}, {number}, {values}\n"


def _sigma(given: Reconstruction, j: int) -> Floats:
    return np.nan_to_num(given.xyz_sigma[j]) if len(given.xyz_sigma) else np.zeros(3)


def _marks(given: Reconstruction, numbers: Sequence[str]) -> Iterable[str]:
    for ray in np.argsort(given.image, kind="stable"):
        x, y = (given.pixels[ray] + 0.5).tolist()
        yield f"{given.image[ray]} {numbers[given.point[ray]]} {x!r} {y!r} 1.0 1.0"


def export(folder: Path, given: Reconstruction, _: Choices) -> tuple[Conversion, ...]:
    """A text export and its table of control points."""
    return write_photomodeler(folder / "block.txt", given)
