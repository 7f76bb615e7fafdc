"""Error budget: what each stage may contribute so that the product reaches its class."""

from __future__ import annotations

import math
from dataclasses import dataclass

from drivers.errors import ConfigurationError

STAGES = ("product", "triangulation", "control points")
# With a third, all earlier stages together add 5 % to the error of the last one.
EARLIER_SHARE = 1.0 / 3.0


@dataclass(frozen=True)
class Stage:
    """What one stage may contribute.

    name: the stage, the last one first.
    allowed_m: standard error that it may have, m.
    """

    name: str
    allowed_m: float


def error_budget(
    product_m: float, stages: tuple[str, ...] = STAGES, earlier_share: float = EARLIER_SHARE
) -> tuple[Stage, ...]:
    """Divide the standard error of a product among the stages that lead to it."""
    if not (product_m > 0.0 and 0.0 < earlier_share < 1.0):
        raise ConfigurationError(
            "the standard error must be positive and the share of earlier stages between 0 and 1"
        )
    return tuple(Stage(name, product_m * earlier_share**back) for back, name in enumerate(stages))


def joined(stages: tuple[Stage, ...]) -> float:
    """Join the contributions of all stages.

    Returns
    -------
    float
        Root of the sum of squares, m.
    """
    return math.sqrt(sum(stage.allowed_m**2 for stage in stages))
