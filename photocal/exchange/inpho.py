"""Inpho project blocks (.prj): cameras and exterior orientations.

`$CAMERA_DEFINITION` has the principal distance and principal point in mm, x right, y up, and the way from
mm to pixels, whose origin is the centre of the upper-left pixel, as ours. Lens distortion is not written:
its convention is not published, so images go there without distortion. `$PHOTO` has the camera, and under
`$EXT_ORI` the principal distance (mm) with X, Y, Z (m), then in three lines the rows of the matrix from
object to camera axes (x right, y up, z backwards). In a map projection X and Y are map coordinates and the
matrix refers to the map's axes at the image. Source: projects as Inpho and its users' tools write them.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np

from drivers.arrays import Floats
from drivers.errors import InputMalformedError
from photocal.exchange.formats import Choices
from photocal.exchange.parts import digits, poses_of_matrices, require_unique
from photocal.exchange.reconstruction import Reconstruction, orientations_alone
from photocal.exchange.source import Line, numbers, read_lines
from photocal.geometry.camera import Camera
from photocal.geometry.conversion import Conversion, apart_px
from photocal.geometry.rotation import matrix_from_angles


def read_inpho(path: Path) -> tuple[tuple[str, ...], Floats]:
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
                raise InputMalformedError("an $EXT_ORI stands before its $PHOTO_NUM", where=line.place)
            places.append(_next(lines, path, 4)[1:])
            matrices.append([_next(lines, path, 3) for _ in range(3)])
            names.append(name)
    if not names:
        raise InputMalformedError("has no $EXT_ORI", where=path, remedy="is it an Inpho project?")
    require_unique(names, "image", path)
    return tuple(names), poses_of_matrices(np.array(places), np.array(matrices), names, path)


def write_inpho(path: Path, given: Reconstruction) -> tuple[Conversion, ...]:
    """Write cameras and photos of a project."""
    for own in given.cameras:
        if own.unit != "mm":
            raise InputMalformedError(
                f"camera {own.id} is in px, but the format has the principal distance in mm",
                remedy="give the camera in mm with its pixel pitch",
            )
    made = tuple(_without_distortion(own) for own in given.cameras)
    blocks = [_camera(own) for own in given.cameras]
    rotation = matrix_from_angles(given.poses[:, :3])
    for name, which, pose, matrix in zip(
        given.image_names, given.image_camera, given.poses, rotation, strict=True
    ):
        own = given.cameras[which]
        rows = [digits([own.value("c"), *pose[3:]]), *(digits(row) for row in matrix)]
        body = "\n".join(f"    {row}" for row in rows)
        head = f"$PHOTO\n  $PHOTO_NUM : {name}\n  $PHOTO_FILE : {name}\n  $CAMERA_ID : {own.id}\n"
        blocks.append(f"{head}  $EXT_ORI :\n{body}\n$END\n")
    path.write_text("".join(blocks), encoding="utf-8", newline="\n")
    return made


def _without_distortion(own: Camera) -> Conversion:
    if not own.values[3:].any():
        return Conversion(own)
    plain = replace(
        own.with_values(np.where(np.arange(len(own.values)) < 3, own.values, 0.0)), reference_radius=0.0
    )
    return Conversion(plain, *apart_px(own, plain))


def _camera(own: Camera) -> str:
    width, height = own.size_px
    across, down = (1 / side for side in own.pitch)
    return (
        f"$CAMERA_DEFINITION\n  $ID : {own.id}\n  $KIND : CCDFrame\n  $CCD_COLUMNS : {width}\n"
        f"  $CCD_ROWS : {height}\n  $PIXEL_REFERENCE : CenterTopLeft\n  $CAMERA_MOUNT_ROTATION : 0\n"
        f"  $ACTIVE_CALIBRATION : 1\n  $CALIBRATION_SET :\n    $ID : 1\n    $CCD_INTERIOR_ORIENTATION :\n"
        f"      {digits([across, 0.0, (width - 1) / 2])}\n      {digits([0.0, -down, (height - 1) / 2])}\n"
        f"    $FOCAL_LENGTH : {own.value('c')!r}\n"
        f"    $PRINCIPAL_POINT_PPA : {digits([own.value('x0'), own.value('y0')])}\n    $END\n  $END\n$END\n"
    )


def _next(lines: Iterator[Line], path: Path, count: int) -> list[float]:
    line = next(lines, None)
    if line is None:
        raise InputMalformedError("ends inside an $EXT_ORI", where=path, remedy="was it written completely?")
    return numbers(line.text, line.place, "$EXT_ORI", count)


def export(folder: Path, given: Reconstruction, _: Choices) -> tuple[Conversion, ...]:
    """Cameras and photos of a project."""
    return write_inpho(folder / "orientations.prj", given)


def read_back(folder: Path) -> Reconstruction:
    """Photos of a project."""
    return orientations_alone(*read_inpho(folder / "orientations.prj"))
