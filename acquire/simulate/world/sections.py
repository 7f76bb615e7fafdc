"""Tables and kinds of values of the configuration of a simulated flight."""

from __future__ import annotations

from typing import Annotated

from pydantic import Field, FiniteFloat, PositiveFloat

Pair = tuple[FiniteFloat, FiniteFloat]
Triple = tuple[FiniteFloat, FiniteFloat, FiniteFloat]
NonNegative = Annotated[FiniteFloat, Field(ge=0)]
Sigmas = tuple[NonNegative, NonNegative, NonNegative]
PositiveSigmas = tuple[PositiveFloat, PositiveFloat, PositiveFloat]
Share = Annotated[float, Field(ge=0, lt=1)]
