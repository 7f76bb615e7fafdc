"""The frame of a camera as planning needs it: flight geometry over level ground, and expected precision."""

import math
from dataclasses import dataclass
from typing import Literal

from photocal.base.errors import ConfigurationError

Side = Literal["columns", "rows"]

# Konecny: from here on tilt changes the overlap; 5 degrees is the conventional tolerance of vertical
# photographs (Alves Junior et al. 2015, section 4).
TILT_WITH_EFFECT_RAD = math.radians(3.0)
TILT_TOLERANCE_RAD = math.radians(5.0)


@dataclass(frozen=True)
class PlanningCamera:
    """Camera frame for planning.

    pixel_m: pixel pitch, m, the same in both directions.
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
    """Give the photo scale that has a ground sample distance (canon-elph study, equation 31)."""
    return gsd_m / pixel_m


def flying_height(focal_m: float, denominator: float) -> float:
    """Give the height above ground of a photo scale (canon-elph study, equation 32).

    returns: height above ground, m; with `scale_denominator` it is f GSD / pixel (Alves Junior et al. 2015,
        equation 1).
    """
    return focal_m * denominator


def ground_sample_distance(height_m: float, frame: PlanningCamera) -> float:
    """Give the size of a pixel on level ground."""
    return height_m * frame.pixel_m / frame.focal_m


def footprint(gsd_m: float, frame: PlanningCamera) -> tuple[float, float]:
    """Give the ground that a vertical photo shows."""
    return frame.columns * gsd_m, frame.rows * gsd_m


def air_base(overlap: float, ground_side_m: float) -> float:
    """Give the distance of neighbouring photos or strips (canon-elph study, equation 33)."""
    if not 0.0 <= overlap < 1.0:
        raise ConfigurationError(
            f"an overlap of {overlap:g} cannot be flown", remedy="give a fraction below 1, such as 0.8"
        )
    return (1.0 - overlap) * ground_side_m


def image_point(column: float, row: float, frame: PlanningCamera) -> tuple[float, float]:
    """Give photo coordinates of a pixel (canon-elph study, equations 34-35)."""
    return (
        (column - (frame.columns - 1) / 2.0) * frame.pixel_m,
        -(row - (frame.rows - 1) / 2.0) * frame.pixel_m,
    )


def exposure_interval(base_m: float, ground_speed_m_s: float) -> float:
    """Give the time between exposures at a ground speed."""
    if not ground_speed_m_s > 0.0:
        raise ConfigurationError(f"a ground speed of {ground_speed_m_s:g} m/s allows no exposure interval")
    return base_m / ground_speed_m_s


def parallax_sigma(image_sigma_m: float) -> float:
    """Give the standard deviation of an x parallax, the difference of two measured coordinates."""
    return math.sqrt(2.0) * image_sigma_m


def stereo_precision(
    height_m: float, base_m: float, focal_m: float, point_m: tuple[float, float], image_sigma_m: float
) -> dict[str, float]:
    """Expect the precision of a point intersected from one pair of vertical photos.

    returns: standard deviations, m, "x" and "y" along the axes of the photo, "z" in height, and "plane" of
        both coordinates (canon-elph study, equation 39).
    """
    parallax = parallax_sigma(image_sigma_m)
    scale = height_m / focal_m

    def plane(coordinate: float) -> float:
        """Standard deviation of a ground coordinate: of its parallax and of the image point itself."""
        return scale * math.hypot(coordinate / focal_m * height_m / base_m * parallax, image_sigma_m)

    x, y = map(plane, point_m)
    height = normal_case_height_sigma(height_m, base_m, focal_m, parallax)
    return {"x": x, "y": y, "z": height, "plane": math.hypot(x, y)}


def normal_case_height_sigma(
    height_m: float, base_m: float, focal_m: float, parallax_sigma_m: float
) -> float:
    """Expect the standard deviation of a height in the normal case."""
    return height_m**2 / (base_m * focal_m) * parallax_sigma_m


def expected_altimetric_accuracy(height_m: float, base_m: float, focal_m: float, pixel_m: float) -> float:
    """Give the dz of the calibration report form of the Brazilian ministry of defence."""
    return normal_case_height_sigma(height_m, base_m, focal_m, parallax_sigma(pixel_m))


def corner_precision(
    frame: PlanningCamera, height_m: float, base_m: float, image_sigma_px: float
) -> dict[str, float]:
    """Expect the precision far out in the image, where it is worst."""
    share = 0.95
    point = image_point(share * frame.columns, share * frame.rows, frame)
    return stereo_precision(height_m, base_m, frame.focal_m, point, image_sigma_px * frame.pixel_m)
