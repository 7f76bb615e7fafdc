"""Acceptance limits of the calibration report form of the Brazilian ministry of defence."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class Limit:
    """One quantity of the form against its limit.

    Attributes
    ----------
    item : str
        Item of the form.
    quantity : str
        What is compared.
    value, limit : float
        RMSE and what it may be, in the unit of the form.
    unit : str
        mm or cm.
    """

    item: str
    quantity: str
    value: float
    limit: float
    unit: str

    @property
    def kept(self) -> bool:
        """Whether the value is within the limit."""
        return self.value <= self.limit


@dataclass(frozen=True)
class Verdict:
    """Result of the form: acceptable only when every limit is kept."""

    limits: tuple[Limit, ...]

    @property
    def acceptable(self) -> bool:
        """Whether no new calibration is required."""
        return all(limit.kept for limit in self.limits)

    @property
    def text(self) -> str:
        """The word of the form."""
        return "ACCEPTABLE" if self.acceptable else "NEW CALIBRATION REQUIRED"


def form_verdict(
    image_rmse_m: tuple[float, float],
    pixel_m: float,
    plane_rmse_m: float,
    gsd_m: float,
    height_rmse_m: float,
    dz_m: float,
) -> Verdict:
    """Compare the four RMSE of the form with their limits.

    Only RMSE are accepted: the form also offers the mean square error for the same cells, but a square
    cannot be compared with a pixel size.
    """
    image = tuple(
        Limit("2.q", f"RMSE of the image residuals in {axis}", rmse * 1e3, pixel_m * 1e3, "mm")
        for axis, rmse in zip("xy", image_rmse_m, strict=True)
    )
    return Verdict(
        (
            *image,
            Limit("2.r", "planimetric RMSE at the check points", plane_rmse_m * 1e2, gsd_m * 1e2, "cm"),
            Limit("2.r", "height RMSE at the check points", height_rmse_m * 1e2, dz_m * 1e2, "cm"),
        )
    )
