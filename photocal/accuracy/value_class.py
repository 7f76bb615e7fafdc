"""Class as the value reached (ASPRS 2024): the RMSE in cm, with the survey of the check points."""

from __future__ import annotations

import math
from dataclasses import dataclass

from photocal.accuracy.classes import Sample
from photocal.accuracy.standard import ValueStandard


@dataclass(frozen=True)
class ValueClass:
    """RMSE of a product with the survey accuracy of its check points.

    Attributes
    ----------
    standard : ValueStandard
        The standard, with the sources of its figures.
    horizontal_m, vertical_m, spatial_m : float or None
        RMSE with the survey accuracy, m; None where the component was not checked.
    survey_included_horizontal, survey_included_vertical : bool
        Whether a survey accuracy was given; without one the class is too good.
    points_horizontal, points_vertical : int
        Number of check points.
    systematic : tuple of str
        Components whose mean exceeds the standard's share of the RMSE.
    survey_too_coarse : tuple of str
        Components whose survey is worse than the standard's share of the product RMSE.
    """

    standard: ValueStandard
    horizontal_m: float | None
    vertical_m: float | None
    spatial_m: float | None
    survey_included_horizontal: bool
    survey_included_vertical: bool
    points_horizontal: int
    points_vertical: int
    systematic: tuple[str, ...]
    survey_too_coarse: tuple[str, ...]

    @property
    def enough_points(self) -> bool:
        """Whether every checked component has the number of points that the standard asks for."""
        counts = [count for count in (self.points_horizontal, self.points_vertical) if count]
        return all(count >= self.standard.minimum_points.value for count in counts)


def class_cm(rmse_m: float) -> float:
    """Give the class that an RMSE reaches, in cm, rounded up to a tenth."""
    return math.ceil(rmse_m * 1000.0 - 1e-9) / 10.0


def value_class(
    standard: ValueStandard,
    plane: Sample | None,
    height: Sample | None,
    survey_horizontal_m: float | None,
    survey_vertical_m: float | None,
) -> ValueClass:
    """Compute the class reached."""
    horizontal = _with_survey(plane, survey_horizontal_m)
    vertical = _with_survey(height, survey_vertical_m)
    share = standard.mean_share_of_rmse.value
    parts = [
        *zip("EN", plane.components if plane else (), strict=False),
        *zip("h", height.components if height else (), strict=False),
    ]
    half = standard.survey_share_of_product.value
    return ValueClass(
        standard,
        horizontal,
        vertical,
        None if horizontal is None or vertical is None else math.hypot(horizontal, vertical),
        survey_horizontal_m is not None,
        survey_vertical_m is not None,
        plane.components[0].n if plane else 0,
        height.components[0].n if height else 0,
        tuple(name for name, part in parts if abs(part.mean_m) > share * part.rmse_m),
        tuple(
            kind
            for kind, survey, product in (
                ("horizontal", survey_horizontal_m, horizontal),
                ("vertical", survey_vertical_m, vertical),
            )
            if survey is not None and product is not None and survey > half * product
        ),
    )


def _with_survey(product: Sample | None, survey_m: float | None) -> float | None:
    return None if product is None else math.hypot(product.rmse_m, survey_m or 0.0)


def value_class_text(value: ValueClass) -> str:
    """Write the class reached."""
    parts = (("horizontal", value.horizontal_m), ("vertical", value.vertical_m), ("3D", value.spatial_m))
    return ", ".join(f"{name} {class_cm(rmse):.1f} cm" for name, rmse in parts if rmse is not None)
