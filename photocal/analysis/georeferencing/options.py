"""Options of an adjustment that is repeated to see what control and exposures are worth."""

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING, Annotated

from photocal.base.options import Option, Options

if TYPE_CHECKING:
    import numpy as np

    from photocal.analysis.georeferencing.methods import Degradation


@dataclass(frozen=True, kw_only=True)
class RepetitionOptions(Options):
    """Numbers of control points, and the noise of simulated exposures."""

    control_numbers: Annotated[
        str | None,
        Option("Repeat with these numbers of control points, such as 0,1,3,5, to see how many are needed."),
    ] = None
    simulate_direct: Annotated[
        str | None,
        Option("Noise M,DEG of simulated exposures for direct georeferencing from the adjusted orientation."),
    ] = None
    seed: Annotated[int, Option("Random seed of the simulated noise.")] = 0

    def noise(self) -> "tuple[Degradation, np.random.Generator] | None":
        """Give the noise of simulated exposures, m and rad; ConfigurationError for a text that is none."""
        if self.simulate_direct is None:
            return None
        import numpy as np

        from photocal.analysis.georeferencing.methods import Degradation
        from photocal.base.console import numbers_of

        form = "METRES,DEGREES: a noise such as 0.08,0.02"
        position, attitude = numbers_of(self.simulate_direct, "--simulate-direct", form)
        return Degradation(position, math.radians(attitude)), np.random.default_rng(self.seed)
