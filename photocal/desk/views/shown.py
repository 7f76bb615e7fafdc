"""A project that was run, as Look shows it: block, result and the system in which the map is drawn."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np

from photocal.base.arrays import Floats, Integers
from photocal.base.errors import InputNotFoundError
from photocal.block.folder import read_block
from photocal.block.model import Block
from photocal.block.network import block_frame
from photocal.block.results.folder import RESULT, read_result
from photocal.block.results.result import Result
from photocal.geometry.frames import LocalFrame
from photocal.geometry.oriented_images import OrientedImages


@dataclass(frozen=True, eq=False)
class Shown:
    """Everything that the views are made of.

    work: the work folder of the project.
    frame: between the block's coordinates and local ones.
    """

    work: Path
    block: Block
    result: Result
    frame: LocalFrame

    @cached_property
    def images(self) -> OrientedImages:
        """The adjusted images in local coordinates."""
        return self.result.images.in_local(self.frame)

    @cached_property
    def in_metres(self) -> bool:
        """Whether the block's coordinates are metres, as of a projected or local system."""
        if self.block.frame == "local":
            return True
        from pyproj import CRS

        return bool(CRS.from_user_input(self.block.frame).is_projected)

    def on_map(self, given: Floats) -> Floats:
        """Places, (n, 3), in the metres of the map: the block's own, or local ones."""
        return given if self.in_metres else self.frame.to_local(given)

    def covariance_on_map(self, given: Floats, covariance: Floats) -> Floats:
        """Covariances (n, 3, 3) of places in the metres of the map."""
        if self.in_metres:
            return covariance
        turn = self.frame.derivative(given)
        return np.asarray(turn @ covariance @ np.swapaxes(turn, 1, 2))

    @cached_property
    def point_rows(self) -> dict[str, int]:
        """Adjusted points by name."""
        return {name: k for k, name in enumerate(self.result.points.names)}

    @cached_property
    def image_rows(self) -> dict[str, int]:
        """Adjusted images by name."""
        return {name: k for k, name in enumerate(self.result.images.names)}

    @cached_property
    def surveyed(self) -> dict[str, int]:
        """Points of the block by name, adjusted or not."""
        return {name: k for k, name in enumerate(self.block.points.names)}

    @cached_property
    def of_image(self) -> tuple[Integers, Integers]:
        """Rows of residuals in the order of their images, and where each image begins."""
        return grouped(self.result.residuals.image, len(self.result.residuals.image_names))

    @cached_property
    def of_point(self) -> tuple[Integers, Integers]:
        """Rows of residuals in the order of their points, and where each point begins."""
        return grouped(self.result.residuals.point, len(self.result.residuals.point_names))


def grouped(keys: Integers, count: int) -> tuple[Integers, Integers]:
    """Rows sorted by key, and the first of each key, with the end behind the last."""
    order = np.argsort(keys, kind="stable")
    return order, np.searchsorted(keys[order], np.arange(count + 1))


def adjusted_in(work: Path) -> Path:
    """Folder of the last adjustment of a project; raises InputNotFoundError where there is none."""
    for stage in ("analysis", "calibration"):
        if (work / stage / RESULT).is_file() and (work / "block" / "block.toml").is_file():
            return work / stage
    raise InputNotFoundError("nothing was adjusted yet", "run the project first", where=work)


def read_shown(work: Path) -> Shown:
    """Read what a project's run has left; errors as of its readers."""
    block, result = read_block(work / "block"), read_result(adjusted_in(work))
    return Shown(work, block, result, block_frame(block))


def numbers(values: Floats, decimals: int = 4) -> Any:
    """Values for JSON: rounded, None for what is not a number."""
    rounded = np.round(np.asarray(values, dtype=np.float64), decimals)
    return np.where(np.isfinite(rounded), rounded, None).tolist()  # type: ignore[call-overload]
