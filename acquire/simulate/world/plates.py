"""The plates in a picture: sampled many times in each pixel, so that their edges lie where they must."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from drivers.arrays import Floats
from drivers.errors import ConfigurationError

# Samples along the side of a pixel.
SAMPLES = 5
MARGIN_CELLS = 1
BLACK, WHITE = 25.0, 225.0


@dataclass(frozen=True)
class Plate:
    """A horizontal square plate.

    centre_m (3,).
    turn: direction of its upper edge, from east towards north, rad.
    cell_m: size of a cell.
    cells (k, k): grey values, the first row at the upper edge, with the light margin.
    """

    centre_m: Floats
    turn: float
    cell_m: float
    cells: Floats

    @property
    def half_m(self) -> float:
        """Half of its side."""
        return float(self.cells.shape[0] * self.cell_m / 2)

    @property
    def corners_m(self) -> Floats:
        """Its corners, shape (4, 3)."""
        corners = np.array([[-1, 1], [1, 1], [1, -1], [-1, -1]]) * self.half_m
        return np.asarray(self.centre_m + np.pad(corners @ self._axes, ((0, 0), (0, 1))))

    @property
    def _axes(self) -> Floats:
        """Rows: direction of the upper edge and of the sides, in east and north."""
        cos, sin = np.cos(self.turn), np.sin(self.turn)
        return np.array([[cos, sin], [-sin, cos]])

    def grey(self, start_m: Floats, direction: Floats) -> Floats:
        """Give what rays see of it, NaN where they pass beside it, shape (n,)."""
        along = (self.centre_m[2] - start_m[..., 2]) / direction[..., 2]
        place = start_m[..., :2] + along[..., None] * direction[..., :2] - self.centre_m[:2]
        own = place @ self._axes.T / self.cell_m
        count = self.cells.shape[0]
        column = np.floor(own[..., 0] + count / 2).astype(np.int64)
        row = np.floor(count / 2 - own[..., 1]).astype(np.int64)
        inside = (column >= 0) & (column < count) & (row >= 0) & (row < count)
        greys = self.cells[np.clip(row, 0, count - 1), np.clip(column, 0, count - 1)]
        return np.asarray(np.where(inside, greys, np.nan))


def make_plate(centre_m: Floats, turn: float, code: int, dictionary: str, side_m: float) -> Plate:
    """Make the plate of a code; `side_m` is the side of the dark border, as surveyors give it."""
    codes = dictionary_of(dictionary)
    if code >= len(codes.bytesList):
        raise ConfigurationError(
            f"{dictionary} has no more than {len(codes.bytesList) - 1} codes for plates",
            where="[targets]",
            remedy="lay fewer, or take a larger dictionary",
        )
    cells = int(codes.markerSize) + 2
    marker = codes.generateImageMarker(code, cells)
    pattern = np.where(np.asarray(marker) > 0, WHITE, BLACK)
    pattern = np.pad(pattern, MARGIN_CELLS, constant_values=WHITE)
    return Plate(centre_m, turn, side_m / cells, pattern)


def dictionary_of(name: str) -> Any:
    """Give OpenCV's dictionary of a name such as ``apriltag_36h11``."""
    import cv2

    number = getattr(cv2.aruco, f"DICT_{name.upper()}", None)
    if number is None:
        raise ConfigurationError(
            f"there is no dictionary {name!r}", where="[targets]", remedy="for example apriltag_36h11"
        )
    return cv2.aruco.getPredefinedDictionary(number)
