"""The frame of a camera as planning needs it, and flight geometry over level ground."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

from drivers.errors import ConfigurationError

Side = Literal["columns", "rows"]


@dataclass(frozen=True)
class Frame:
    """Camera frame for planning.

    focal_m: principal distance, m.
    pixel_m: pixel pitch, m, the same in both directions.
    columns, rows: image size, px.
    """

    focal_m: float
    pixel_m: float
    columns: int
    rows: int

    def __post_init__(self) -> None:
        if not (self.focal_m > 0.0 and self.pixel_m > 0.0 and self.columns > 0 and self.rows > 0):
            raise ConfigurationError("focal length, pixel size and image size must be positive")

    def side_px(self, side: Side) -> int:
        """Give the number of pixels along one side of the image."""
        return self.columns if side == "columns" else self.rows


def scale_denominator(gsd_m: float, pixel_m: float) -> float:
    """Give the photo scale that has a ground sample distance (canon-elph study, equation 31).

    gsd_m: ground sample distance, m.
    pixel_m: pixel pitch, m.

    Returns
    -------
    float
        Denominator of the photo scale.
    """
    return gsd_m / pixel_m


def flying_height(focal_m: float, denominator: float) -> float:
    """Give the height above ground of a photo scale (canon-elph study, equation 32).

    focal_m: principal distance, m.
    denominator: denominator of the photo scale.

    Returns
    -------
    float
        Height above ground, m; with `scale_denominator` it is f GSD / pixel (Alves Junior et al. 2015,
        equation 1).
    """
    return focal_m * denominator


def ground_sample_distance(height_m: float, frame: Frame) -> float:
    """Give the size of a pixel on level ground."""
    return height_m * frame.pixel_m / frame.focal_m


def footprint(gsd_m: float, frame: Frame) -> tuple[float, float]:
    """Give the ground that a vertical photo shows."""
    return frame.columns * gsd_m, frame.rows * gsd_m


def air_base(overlap: float, ground_side_m: float) -> float:
    """Give the distance of neighbouring photos or strips (canon-elph study, equation 33)."""
    if not 0.0 <= overlap < 1.0:
        raise ConfigurationError(
            f"an overlap of {overlap:g} cannot be flown", remedy="give a share below 1, such as 0.8"
        )
    return (1.0 - overlap) * ground_side_m


def overlap_at(base_m: float, ground_side_m: float) -> float:
    """Give the overlap that a distance of photos or strips leaves."""
    return 1.0 - base_m / ground_side_m


def image_point(column: float, row: float, frame: Frame) -> tuple[float, float]:
    """Give photo coordinates of a pixel (canon-elph study, equations 34-35)."""
    return (
        (column - (frame.columns - 1) / 2.0) * frame.pixel_m,
        -(row - (frame.rows - 1) / 2.0) * frame.pixel_m,
    )
