"""Writing a block folder: everything that a block holds, so that it is equal when it is read again."""

from pathlib import Path
from typing import Any

import numpy as np
from pydantic import ValidationError

from photocal.adjustment.lasers import OFFSET, SCALE, LaserDistances
from photocal.adjustment.network import ANGLES, RELATIONS, Relations
from photocal.base.codec import as_degrees, toml_text
from photocal.base.errors import OutputError
from photocal.base.files import output_folder, refusals
from photocal.base.text_tables import LONG_TABLE, name_cells, named_columns, write_table
from photocal.block.camera_setup import camera_keys
from photocal.block.folder import (
    CHECK_DISTANCES,
    CORNERS,
    FIDUCIAL_FITS,
    IMAGE_COLUMNS,
    IMAGE_SIGMAS,
    LASER_DISTANCES,
    MARKS,
    POINT_CROSS,
    READINGS,
    SETUP,
)
from photocal.block.model import ROLES, Block, Images, ObjectPoints
from photocal.block.motion import RATE, SIGMAS_OF_MOTION, VELOCITY
from photocal.block.mounting import attitude_columns, mounting_keys, position_columns
from photocal.block.rig import head_keys
from photocal.block.setup import BlockKeys, LaserKeys, ObservationKeys, Setup
from photocal.geometry.camera import SHAKE

_TABLES = (
    *("images.csv", "points.csv", "observations.csv", "observations.parquet", "positions.csv"),
    *(
        "attitudes.csv",
        CHECK_DISTANCES,
        FIDUCIAL_FITS,
        LASER_DISTANCES,
        MARKS,
        READINGS,
        *(f"{kind}s.csv" for kind in RELATIONS),
    ),
)


def write_block(folder: Path, block: Block) -> None:
    """Write a block folder: what is read of it again is equal, but for the fingerprints of its files.

    Numbers have all their digits. Angles stand in degrees: they are equal where they once were degrees, else
    to the last place. Tables that an earlier block has left in the folder go.

    raises OutputError: when the folder cannot be written, or the block has what no block folder can hold:
        names that begin or end with a blank, observations between points of a kind of one's own.
    """
    try:
        text = toml_text(setup_of(block), "Written by photocal; docs/block-folder.md has the keys.")
    except ValidationError as failure:
        first = failure.errors()[0]
        place = ".".join(map(str, first["loc"]))
        raise OutputError(f"{place}: {first['msg']}", "correct the value", where=folder) from None
    tables = _tables(block)
    with output_folder(folder) as aside:
        (aside / SETUP).write_text(text, encoding="utf-8", newline="\n")
        for name, columns in tables.items():
            write_table(aside / name, columns)
        with refusals(folder):
            for name in set(_TABLES) - set(tables):
                (folder / name).unlink(missing_ok=True)


def setup_of(block: Block) -> Setup:
    """What stands in `block.toml`."""
    ids = {camera.id for camera in block.cameras}
    # A head whose images were all left out is none of the block's; one alone is no frame.
    heads = [head for head in block.heads if {head.camera, head.of} <= ids and head.camera != head.of]
    level, sided = block.global_test
    seen = block.observations
    return Setup(
        block=BlockKeys(
            name=block.name,
            frame=block.frame,
            height=block.height,  # type: ignore[arg-type]
            datum=block.datum,
            datum_points=block.datum_points,
            global_test=sided,
            level=level,
            refraction=block.refraction,
            curvature=block.curvature,
        ),
        observations=ObservationKeys(unit=seen.unit, axes=seen.axes, repetition=block.repetition),
        camera=[camera_keys(camera) for camera in block.cameras],
        mounting=mounting_keys(block.mounting, block.positions),
        head=tuple(map(head_keys, heads)),
        laser=_laser_keys(block.lasers),
    )


def _laser_keys(lasers: LaserDistances) -> LaserKeys | None:
    if not len(lasers.image):
        return None
    offset, scale = lasers.common_sigma[OFFSET], lasers.common_sigma[SCALE]
    return LaserKeys(offset_sigma_m=offset if np.isfinite(offset) else "free", scale_sigma=scale)


def _tables(block: Block) -> dict[str, dict[str, Any]]:
    """Columns of each table by its file."""
    points, seen = block.points, block.observations
    images, names = name_cells("image", block.images.names), name_cells("point", points.names)
    rays = {"image": images.take(seen.image), "point": names.take(seen.point)}
    rays |= named_columns("x y", seen.values) | named_columns("sx sy", seen.sigma)
    kind = "parquet" if len(seen.image) > LONG_TABLE else "csv"
    tables = {
        "images.csv": _images(block.images, [camera.id for camera in block.cameras]),
        "points.csv": _points(points),
        f"observations.{kind}": rays,
    }
    if block.relations.further:
        raise OutputError("has observations of a user-defined kind", "leave them out")
    for code, relation in enumerate(RELATIONS):
        if (block.relations.kind == code).any():
            of_kind = block.relations.rows(block.relations.kind == code)
            tables[f"{relation}s.csv"] = _relations(of_kind, relation, names)
    if len(block.check_distances.kind):
        tables[CHECK_DISTANCES] = _relations(block.check_distances, "distance", names)
    if len(block.positions.image):
        seen_from = images.take(block.positions.image)
        tables["positions.csv"] = {"image": seen_from, **position_columns(block.positions)}
    if len(block.attitudes.image):
        seen_from = images.take(block.attitudes.image)
        tables["attitudes.csv"] = {"image": seen_from, **attitude_columns(block.attitudes)}
    lasers = block.lasers
    if len(lasers.image):
        ends = {corner: names.take(rows) for corner, rows in zip(CORNERS, lasers.corners.T, strict=True)}
        seen_from = images.take(lasers.image)
        tables[LASER_DISTANCES] = {
            "image": seen_from, **ends, "value": lasers.values, "sigma": lasers.sigma,
        }  # fmt: skip
    if block.fiducial_fits:
        tables[FIDUCIAL_FITS] = _fits(block)
    return tables


def _images(images: Images, cameras: list[str]) -> dict[str, Any]:
    scale = np.array([1.0] * 3 + [-1.0] * (images.motion.shape[1] - 3))
    moving = np.hstack([images.motion[:, :3], as_degrees(images.motion[:, 3:])]) * scale
    spread = np.hstack([images.motion_sigma[:, :3], as_degrees(images.motion_sigma[:, 3:])])
    angles = slice(0, 3)
    values, sigma = images.values[:, [3, 4, 5, 0, 1, 2]], images.sigma.copy()
    values[:, 3:], sigma[:, angles] = (
        as_degrees(images.values[:, angles]),
        as_degrees(images.sigma[:, angles]),
    )
    columns: dict[str, Any] = {
        "image": name_cells("image", images.names),
        "camera": name_cells("camera", cameras).take(images.camera),
        **dict(zip(IMAGE_COLUMNS[2:], values.T, strict=True)),
        **dict(zip(IMAGE_SIGMAS, sigma.T, strict=True)),
    }
    if any(images.exposure):
        name_cells("exposure", [name for name in images.exposure if name])
        columns["exposure"] = images.exposure
    # What inside is the turn of what a camera sees is the rate of the camera outside.
    more = dict(zip((*VELOCITY, *RATE), moving.T, strict=False)) | dict(
        zip(SIGMAS_OF_MOTION, spread.T, strict=True)
    )
    more |= {"time_s": images.time, "temperature_c": images.temperature}
    shake = dict(zip(SHAKE, moving.T[6:], strict=False))
    return columns | {k: v for k, v in more.items() if np.isfinite(v).any()} | shake


def _points(points: ObjectPoints) -> dict[str, Any]:
    columns = {"point": name_cells("point", points.names), **named_columns("X Y Z", points.values)}
    columns |= named_columns("sX sY sZ", points.sigma)
    if points.cross is not None:
        columns |= dict(zip(POINT_CROSS, points.cross.T, strict=True))
    return columns | {"role": [ROLES[role] for role in points.role]}


def _relations(of_kind: Relations, relation: str, names: Any) -> dict[str, Any]:
    ends = zip(RELATIONS[relation], of_kind.ends.T, strict=False)
    columns = {column: names.take(rows) for column, rows in ends}
    turn = as_degrees if relation in ANGLES else np.asarray
    values = {} if relation == "line" else {"value": turn(of_kind.values)}
    return {**columns, **values, "sigma": turn(of_kind.sigma)}


def _fits(block: Block) -> dict[str, Any]:
    fits = block.fiducial_fits
    marks = np.repeat(np.arange(len(fits)), [len(fit.fiducials) for fit in fits])
    return {
        "image": name_cells("image", [fit.image for fit in fits]).take(marks),
        "fiducial": name_cells("fiducial", [name for fit in fits for name in fit.fiducials]),
        **named_columns("vx vy", np.vstack([fit.residuals for fit in fits])),
        "redundancy": np.array([float(fit.redundancy) for fit in fits])[marks],
        "sigma0": np.array([fit.sigma0 for fit in fits])[marks],
    }
