"""Three numbers with commas between them, as options take them."""

from __future__ import annotations

import numpy as np

from drivers.arrays import Floats
from drivers.errors import ConfigurationError


def parse_triple(text: str, option: str) -> Floats:
    """Return three numbers.

    Raises
    ------
    ConfigurationError
        When they are not three finite numbers.
    """
    try:
        values = np.array([float(part) for part in text.split(",")])
    except ValueError:
        values = np.empty(0)
    if values.shape != (3,) or not np.isfinite(values).all():
        raise ConfigurationError(f"{text!r} is not three numbers", where=option, remedy="give A,B,C")
    return values
