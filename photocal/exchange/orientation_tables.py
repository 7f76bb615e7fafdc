"""Tables of exterior orientations in PATB's style: angles or rotation matrix.

Object coordinates X, Y, Z in m; angles omega, phi, kappa of our own rotation, in the unit that the caller
names: degrees or gon (400 to a circle). The rotation matrix goes from camera (x right, y up, z backwards)
to object axes, by rows. One line an image: `name X Y Z omega phi kappa`, or `name X Y Z r11 r12 r13 r21 ...
r33`. In a map projection X and Y are map coordinates and the angles refer to the map's axes at the image.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from drivers.arrays import Floats
from drivers.errors import ConfigurationError, InputMalformedError
from photocal.exchange.formats import Angle, Choices
from photocal.exchange.parts import digits, poses_of_matrices, require_no_blanks, require_unique
from photocal.exchange.reconstruction import Reconstruction, orientations_alone
from photocal.exchange.source import numbers, read_lines
from photocal.geometry.conversion import Conversion
from photocal.geometry.rotation import matrix_from_angles

_CIRCLE: dict[Angle, float] = {"deg": 360.0, "gon": 400.0}


def read_angles(path: Path, unit: Angle) -> tuple[tuple[str, ...], Floats]:
    """Read a table of X, Y, Z, omega, phi, kappa."""
    names, values = _table(path, 6)
    angles = values[:, 3:] * (2 * np.pi / _CIRCLE[unit])
    if len(angles) and np.abs(angles).max() > 2 * np.pi + 1e-9:
        raise InputMalformedError(
            f"has angles of more than a circle in {unit}", where=path, remedy="name their unit: deg or gon"
        )
    return names, np.hstack([angles, values[:, :3]])


def write_angles(path: Path, names: Sequence[str], poses: Floats, unit: Angle) -> None:
    """Write a table of X, Y, Z, omega, phi, kappa; the inverse of `read_angles`."""
    turned = np.hstack([poses[:, 3:], poses[:, :3] * (_CIRCLE[unit] / (2 * np.pi))])
    _write(path, f"# image X Y Z [m] omega phi kappa [{unit}]", names, turned)


def read_matrices(path: Path) -> tuple[tuple[str, ...], Floats]:
    """Read a table of X, Y, Z and rotation matrices; result as of `read_angles`."""
    names, values = _table(path, 12)
    to_object = values[:, 3:].reshape(-1, 3, 3)
    return names, poses_of_matrices(values[:, :3], np.swapaxes(to_object, -1, -2), names, path)


def write_matrices(path: Path, names: Sequence[str], poses: Floats) -> None:
    """Write a table of X, Y, Z and rotation matrices; parameters as of `write_angles`."""
    to_object = np.swapaxes(matrix_from_angles(poses[:, :3]), -1, -2).reshape(-1, 9)
    rows = np.hstack([poses[:, 3:], to_object])
    _write(path, "# image X Y Z [m] rotation matrix camera to object, by rows", names, rows)


def _table(path: Path, count: int) -> tuple[tuple[str, ...], Floats]:
    names, rows = [], []
    for line in read_lines(path):
        cells = line.text.split(maxsplit=1)
        rows.append(numbers(cells[1] if len(cells) > 1 else "", line.place, "exterior orientation", count))
        names.append(cells[0])
    if not names:
        raise InputMalformedError("has no exterior orientation", where=path)
    require_unique(names, "image", path)
    return tuple(names), np.array(rows).reshape(-1, count)


def _write(path: Path, head: str, names: Sequence[str], values: Floats) -> None:
    require_no_blanks(names)
    rows = (f"{name} {digits(row)}" for name, row in zip(names, values, strict=True))
    path.write_text("\n".join([head, *rows]) + "\n", encoding="utf-8", newline="\n")


def export(folder: Path, given: Reconstruction, choices: Choices) -> tuple[Conversion, ...]:
    """A table of angles and one of rotation matrices."""
    if choices.angle_unit is None:
        raise ConfigurationError(
            "the unit of the angles is not given", remedy="name it: --angle-unit deg or --angle-unit gon"
        )
    write_angles(
        folder / f"orientations_{choices.angle_unit}.txt", given.image_names, given.poses, choices.angle_unit
    )
    write_matrices(folder / "orientations_matrix.txt", given.image_names, given.poses)
    return ()


def read_back(folder: Path) -> Reconstruction:
    """The table of rotation matrices, which needs no unit."""
    return orientations_alone(*read_matrices(folder / "orientations_matrix.txt"))
