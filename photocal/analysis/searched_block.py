"""An adjusted block and what is wrong with it, found once: check and analysis of a project share it."""

from dataclasses import dataclass
from functools import cached_property

from photocal.analysis.systematic_errors.search import causes_in
from photocal.block.results.adjusted import AdjustedBlock
from photocal.hypotheses.search import SystematicErrors


@dataclass(frozen=True)
class SearchedBlock:
    """An adjusted block; the search is made when it is first asked for."""

    adjusted: AdjustedBlock

    @cached_property
    def causes(self) -> SystematicErrors:
        """What explains the contradictions of its network."""
        return causes_in(self.adjusted.minimum)
