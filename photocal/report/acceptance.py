"""The ministry's limits of acceptance, items 2.q and 2.r of its technical report."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Literal

Verdict = Literal["acceptable", "new_calibration", "not_determined"]


@dataclass(frozen=True)
class Limit:
    """One figure and what it may not exceed; None where it is not determined.

    key: "image_x", "image_y", "planimetric" or "altimetric".
    unit: unit of both.
    value, limit: the root mean square error and its limit.
    """

    key: str
    unit: str
    value: float | None
    limit: float | None

    @property
    def met(self) -> bool | None:
        """Whether the limit is kept; None when not determined."""
        return None if self.value is None or self.limit is None else self.value <= self.limit


def expected_altimetric_error_cm(height_m: float, base_m: float, focal_mm: float, pixel_mm: float) -> float:
    """Expected altimetric accuracy dz by which the ministry measures the check points.

    Notes
    -----
    Ministry of Defence of Brazil, technical report for aerial survey with remotely piloted aircraft,
    item 2.r.
    """
    return 100.0 * math.sqrt(2.0) * height_m**2 / (base_m * focal_mm) * pixel_mm


def limits(
    image_rmse_mm: tuple[float, float] | None,
    pixel_mm: float | None,
    check_rmse_cm: tuple[float, float] | None,
    gsd_cm: float | None,
    dz_cm: float | None,
) -> tuple[Limit, ...]:
    """Set each figure against its limit.

    image_rmse_mm: root mean square of the image residuals in x and y, mm.
    pixel_mm: pixel size, their limit.
    check_rmse_cm: planimetric and altimetric root mean square error of the check points, cm.
    gsd_cm, dz_cm: their limits: ground sampling distance, expected altimetric accuracy.
    """
    x, y = image_rmse_mm if image_rmse_mm is not None else (None, None)
    plane, height = check_rmse_cm if check_rmse_cm is not None else (None, None)
    return (
        Limit("image_x", "mm", x, pixel_mm),
        Limit("image_y", "mm", y, pixel_mm),
        Limit("planimetric", "cm", plane, gsd_cm),
        Limit("altimetric", "cm", height, dz_cm),
    )


def verdict(checked: tuple[Limit, ...]) -> Verdict:
    """Judge over all limits: one that is broken decides, one that is not determined leaves it open."""
    kept = [limit.met for limit in checked]
    if False in kept:
        return "new_calibration"
    return "acceptable" if all(kept) else "not_determined"
