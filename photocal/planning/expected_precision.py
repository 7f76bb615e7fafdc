"""Precision that a flight may be expected to give, before it is flown."""

from __future__ import annotations

import math
from dataclasses import dataclass

from photocal.planning.frame import Frame


@dataclass(frozen=True)
class ExpectedPrecision:
    """Standard deviations of an intersected ground point, m.

    x_m, y_m, z_m: along the x and y axes of the photo, and in height.
    """

    x_m: float
    y_m: float
    z_m: float

    @property
    def plane_m(self) -> float:
        """Planimetric standard deviation, m (canon-elph study, equation 39)."""
        return math.hypot(self.x_m, self.y_m)


def parallax_sigma(image_sigma_m: float) -> float:
    """Give the standard deviation of an x parallax, the difference of two measured coordinates."""
    return math.sqrt(2.0) * image_sigma_m


def stereo_precision(
    height_m: float, base_m: float, focal_m: float, point_m: tuple[float, float], image_sigma_m: float
) -> ExpectedPrecision:
    """Expect the precision of a point intersected from one pair of vertical photos.

    More rays make it better, errors of the orientation worse; neither is in here.
    """
    parallax = parallax_sigma(image_sigma_m)
    scale = height_m / focal_m

    def plane(coordinate: float) -> float:
        return scale * math.hypot(coordinate / focal_m * height_m / base_m * parallax, image_sigma_m)

    height = normal_case_height_sigma(height_m, base_m, focal_m, parallax)
    return ExpectedPrecision(plane(point_m[0]), plane(point_m[1]), height)


def normal_case_height_sigma(
    height_m: float, base_m: float, focal_m: float, parallax_sigma_m: float
) -> float:
    """Expect the standard deviation of a height in the normal case."""
    return height_m**2 / (base_m * focal_m) * parallax_sigma_m


def expected_altimetric_accuracy(height_m: float, base_m: float, focal_m: float, pixel_m: float) -> float:
    """Give the dz of the calibration report form of the Brazilian ministry of defence.

    It is the acceptance limit of the height RMSE at the check points: the normal case with one pixel
    in each image.
    """
    return normal_case_height_sigma(height_m, base_m, focal_m, parallax_sigma(pixel_m))


def corner_precision(
    frame: Frame, height_m: float, base_m: float, image_sigma_px: float, share: float = 0.95
) -> ExpectedPrecision:
    """Expect the precision far out in the image, where it is worst."""
    x = (share * frame.columns - (frame.columns - 1) / 2.0) * frame.pixel_m
    y = -(share * frame.rows - (frame.rows - 1) / 2.0) * frame.pixel_m
    return stereo_precision(height_m, base_m, frame.focal_m, (x, y), image_sigma_px * frame.pixel_m)
