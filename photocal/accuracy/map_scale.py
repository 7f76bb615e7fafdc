"""Map scales and contour intervals as people write them."""

from __future__ import annotations

import math
import re

from drivers.errors import ConfigurationError

_SCALE = re.compile(r"^(?:1:)?(?P<denominator>[0-9]+(?:\.[0-9]+)?)$")


def parse_scale(text: str) -> float:
    """Read a scale.

    Raises
    ------
    ConfigurationError
        When it is not a scale.
    """
    match = _SCALE.match(text.replace(" ", ""))
    if match is None or float(match["denominator"]) <= 0.0:
        raise ConfigurationError(f"{text!r} is not a scale", remedy="write it as 1:1000")
    return float(match["denominator"])


def scale_text(denominator: float) -> str:
    """Write a scale."""
    return f"1:{math.ceil(denominator - 1e-6):,}".replace(",", " ")


def size_text(basis: str, size: float) -> str:
    """Write a scale or a contour interval."""
    return scale_text(size) if basis == "scale" else f"interval {size:.4g} m"
