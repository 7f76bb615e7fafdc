"""Oriented images of a block folder, as given or as adjusted."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from drivers.errors import ConfigurationError, InputMalformedError, InputNotFoundError
from photocal.block.folder import IMAGE_COLUMNS, IMAGE_SIGMAS
from photocal.block.model import Block
from photocal.block.network import block_frame
from photocal.block.table import read_table
from photocal.exchange.any_block import read_any_block
from photocal.geometry.camera import PARAMETERS, Camera
from photocal.geometry.frames import Frame, nearest_rotation
from photocal.geometry.rotation import matrix_from_angles
from photocal.products.shots import Shots

Floats = NDArray[np.float64]


def oriented(folder: Path, run: Path | None) -> tuple[Block, Frame, Shots]:
    """Read a block and, where it was adjusted, the results in place of its start values.

    Parameters
    ----------
    folder : Path
        Block folder, or the set-up file of another program.
    run : Path or None
        Folder of its adjustment.

    Returns
    -------
    frame : Frame
        Between the block's coordinates and the local ones of the images.
    shots : Shots
        In local coordinates.

    Raises
    ------
    InputNotFoundError, InputMalformedError, ConfigurationError
        For what cannot be read, or results that belong to another block.
    """
    block = read_any_block(folder)
    frame = block_frame(block)
    for own in block.cameras:
        if (own.deviation_sigma > 0).any():
            raise ConfigurationError(
                f"camera {own.id} has parameters that vary from image to image",
                where=folder,
                remedy="adjust with a lens that does not vary; products take one lens for all images",
            )
    cameras, values = block.cameras, block.images.values
    if run is not None:
        cameras = _adjusted_cameras(block, run / "result.json")
        values = _adjusted_orientation(block, run / "images.csv")
    turn = nearest_rotation(frame.derivative(values[:, 3:]))
    rotation = matrix_from_angles(values[:, :3]) @ np.swapaxes(turn, 1, 2)
    station = frame.to_local(values[:, 3:])
    return block, frame, Shots(block.images.names, cameras, block.images.camera, station, rotation)


def _adjusted_cameras(block: Block, path: Path) -> tuple[Camera, ...]:
    if not path.is_file():
        raise InputNotFoundError("does not exist", where=path, remedy="name the folder of an adjustment")
    try:
        found: dict[str, Any] = json.loads(path.read_text(encoding="utf-8"))["cameras"]
        return tuple(
            camera.with_values([found[camera.id]["parameters"][name]["value"] for name in PARAMETERS])
            for camera in block.cameras
        )
    except (ValueError, KeyError, TypeError) as failure:
        raise InputMalformedError(
            f"does not hold the cameras of the block ({type(failure).__name__}: {failure})",
            where=path,
            remedy="name the run of this very block",
        ) from failure


def _adjusted_orientation(block: Block, path: Path) -> Floats:
    table = read_table(path, IMAGE_COLUMNS, IMAGE_SIGMAS)
    names = table.unique_names("image")
    missing = sorted(set(block.images.names) - set(names))
    if missing:
        raise InputMalformedError(
            f"lacks image {missing[0]}", where=path, remedy="name the run of this very block"
        )
    values = np.column_stack([table.numbers(c) for c in ("omega", "phi", "kappa", "X", "Y", "Z")])
    values[:, :3] = np.radians(values[:, :3])
    order = {name: row for row, name in enumerate(names)}
    return values[[order[name] for name in block.images.names]]
