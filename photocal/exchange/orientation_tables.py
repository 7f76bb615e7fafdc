"""Tables of exterior orientations in PATB's style: angles or rotation matrix.

Object coordinates X, Y, Z in m; angles omega, phi, kappa of our own rotation, in the unit that the caller
names: degrees or gon (400 to a circle). The rotation matrix goes from camera (x right, y up, z backwards)
to object axes, by rows. One line an image: `name X Y Z omega phi kappa`, or `name X Y Z r11 r12 r13 r21 ...
r33`. In a map projection X and Y are map coordinates and the angles refer to the map's axes at the image.
"""

from collections.abc import Iterator, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from photocal.base.arrays import Floats
from photocal.base.errors import ConfigurationError, InputMalformedError
from photocal.block.model import NO_OBSERVATIONS, NO_POINTS, Block, Images
from photocal.exchange.exporting import Angle, Choices
from photocal.exchange.foreign_project import ForeignProject
from photocal.exchange.parts import block, digits, poses_of_matrices, require_no_blanks, require_unique
from photocal.exchange.source import Line, numbers, read_lines
from photocal.geometry.camera import Camera
from photocal.geometry.conversion import Conversion, apart_px
from photocal.geometry.rotation import matrix_from_angles

_CIRCLE: dict[Angle, float] = {"deg": 360.0, "gon": 400.0}


def write_angles(path: Path, names: Sequence[str], poses: Floats, unit: Angle) -> None:
    """Write a table of X, Y, Z, omega, phi, kappa."""
    turned = np.hstack([poses[:, 3:], poses[:, :3] * (_CIRCLE[unit] / (2 * np.pi))])
    _write(path, f"# image X Y Z [m] omega phi kappa [{unit}]", names, turned)


def read_matrices(path: Path) -> tuple[tuple[str, ...], Floats]:
    """Read names and orientations of a table of X, Y, Z and rotation matrices."""
    names, rows = [], []
    for line in read_lines(path):
        cells = line.text.split(maxsplit=1)
        rows.append(numbers(cells[1] if len(cells) > 1 else "", line.place, "exterior orientation", 12))
        names.append(cells[0])
    if not names:
        raise InputMalformedError("has no exterior orientation", where=path)
    require_unique(names, "image", path)
    values = np.array(rows)
    to_object = values[:, 3:].reshape(-1, 3, 3)
    return tuple(names), poses_of_matrices(values[:, :3], np.swapaxes(to_object, -1, -2), names, path)


def write_matrices(path: Path, names: Sequence[str], poses: Floats) -> None:
    """Write a table of X, Y, Z and rotation matrices; parameters as of `write_angles`."""
    to_object = np.swapaxes(matrix_from_angles(poses[:, :3]), -1, -2).reshape(-1, 9)
    rows = np.hstack([poses[:, 3:], to_object])
    _write(path, "# image X Y Z [m] rotation matrix camera to object, by rows", names, rows)


def _write(path: Path, head: str, names: Sequence[str], values: Floats) -> None:
    require_no_blanks(names)
    rows = (f"{name} {digits(row)}" for name, row in zip(names, values, strict=True))
    path.write_text("\n".join([head, *rows]) + "\n", encoding="utf-8", newline="\n")


def write_patb(folder: Path, given: Block, choices: Choices) -> tuple[Conversion, ...]:
    """A table of angles and one of rotation matrices."""
    if choices.angle_unit is None:
        raise ConfigurationError(
            "the unit of the angles is not given", "name it: --angle-unit deg or --angle-unit gon"
        )
    write_angles(
        folder / f"orientations_{choices.angle_unit}.txt",
        given.images.names,
        given.images.values,
        choices.angle_unit,
    )
    write_matrices(folder / "orientations_matrix.txt", given.images.names, given.images.values)
    return ()


def read_patb(path: Path) -> ForeignProject:
    """Read a table of X, Y, Z and rotation matrices."""
    return _project("PATB", path, *read_matrices(path))


def _project(program: str, path: Path, names: Sequence[str], poses: Floats) -> ForeignProject:
    """Images of unknown cameras."""
    images = Images(tuple(names), np.full(len(names), -1), poses)
    return ForeignProject(program, block(path.stem, (), images, NO_POINTS, NO_OBSERVATIONS, [path]))


def read_inpho(path: Path) -> ForeignProject:
    """Read the exterior orientations of a project."""
    names, places, matrices = [], [], []
    lines = iter(read_lines(path, comment=""))
    name = ""
    for line in lines:
        key, _, value = line.text.strip().partition(":")
        if key.strip() == "$PHOTO":
            name = ""
        elif key.strip() == "$PHOTO_NUM":
            name = value.strip()
        elif key.strip().startswith("$EXT_ORI"):
            if not name:
                raise line.malformed("an $EXT_ORI comes before its $PHOTO_NUM")
            places.append(_next(lines, path, 4)[1:])
            matrices.append([_next(lines, path, 3) for _ in range(3)])
            names.append(name)
    if not names:
        raise InputMalformedError("has no $EXT_ORI", "is it an Inpho project?", where=path)
    require_unique(names, "image", path)
    return _project(
        "Inpho", path, names, poses_of_matrices(np.array(places), np.array(matrices), names, path)
    )


def write_inpho(path: Path, given: Block, _: Choices | None = None) -> tuple[Conversion, ...]:
    """Write cameras and photos of a project."""
    for camera in given.cameras:
        if camera.unit != "mm":
            raise InputMalformedError(
                f"camera {camera.id} is in px, but the format has the principal distance in mm",
                "give the camera in mm with its pixel pitch",
            )
    made = tuple(_without_distortion(camera) for camera in given.cameras)
    blocks = [_camera(camera) for camera in given.cameras]
    rotation = matrix_from_angles(given.images.values[:, :3])
    for name, which, pose, matrix in zip(
        given.images.names, given.images.camera, given.images.values, rotation, strict=True
    ):
        camera = given.cameras[which]
        rows = [digits([camera.value("c"), *pose[3:]]), *(digits(row) for row in matrix)]
        body = "\n".join(f"    {row}" for row in rows)
        head = f"$PHOTO\n  $PHOTO_NUM : {name}\n  $PHOTO_FILE : {name}\n  $CAMERA_ID : {camera.id}\n"
        blocks.append(f"{head}  $EXT_ORI :\n{body}\n$END\n")
    path.write_text("".join(blocks), encoding="utf-8", newline="\n")
    return made


def _without_distortion(camera: Camera) -> Conversion:
    if not camera.values[3:].any():
        return Conversion(camera)
    plain = replace(
        camera.with_values(np.where(np.arange(len(camera.values)) < 3, camera.values, 0.0)),
        reference_radius=0.0,
    )
    return Conversion(plain, *apart_px(camera, plain))


def _camera(camera: Camera) -> str:
    width, height = camera.size_px
    across, down = (1 / side for side in camera.pitch)
    return (
        f"$CAMERA_DEFINITION\n  $ID : {camera.id}\n  $KIND : CCDFrame\n  $CCD_COLUMNS : {width}\n"
        f"  $CCD_ROWS : {height}\n  $PIXEL_REFERENCE : CenterTopLeft\n  $CAMERA_MOUNT_ROTATION : 0\n"
        f"  $ACTIVE_CALIBRATION : 1\n  $CALIBRATION_SET :\n    $ID : 1\n    $CCD_INTERIOR_ORIENTATION :\n"
        f"      {digits([across, 0.0, (width - 1) / 2])}\n      {digits([0.0, -down, (height - 1) / 2])}\n"
        f"    $FOCAL_LENGTH : {camera.value('c')!r}\n"
        f"    $PRINCIPAL_POINT_PPA : {digits([camera.value('x0'), camera.value('y0')])}\n"
        f"    $END\n  $END\n$END\n"
    )


def _next(lines: Iterator[Line], path: Path, count: int) -> list[float]:
    line = next(lines, None)
    if line is None:
        raise InputMalformedError("ends inside an $EXT_ORI", "was it written completely?", where=path)
    return numbers(line.text, line.place, "$EXT_ORI", count)
