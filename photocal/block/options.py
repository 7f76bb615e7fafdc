"""Options of `photocal adjust` for blocks in parts."""

import os
from dataclasses import dataclass
from typing import Annotated

from photocal.base.errors import ConfigurationError
from photocal.base.options import Option, Options
from photocal.base.workers import Cluster, Workers


@dataclass(frozen=True, kw_only=True)
class PartsOptions(Options):
    """Whether a block is adjusted in parts, and the processes that do it."""

    parts: Annotated[
        int, Option("Adjust the block in about so many parts, with the same results; 0: whole.", least=0)
    ] = 0
    workers: Annotated[int, Option("Processes for the parts; 0: one for each core.", least=0)] = 0
    cluster: Annotated[
        str, Option("Dask scheduler whose workers share the results' folder, such as tls://HOST:8786.")
    ] = ""

    def __post_init__(self) -> None:
        """Refuse options that contradict each other."""
        if self.cluster and self.workers:
            raise ConfigurationError(
                "--workers and --cluster are both given", "choose processes here or a cluster"
            )
        if (self.cluster or self.workers) and not self.parts:
            raise ConfigurationError("a whole block is adjusted in this process", "give --parts, too")

    @property
    def who(self) -> Workers:
        """Who works on the parts."""
        return Cluster(self.cluster) if self.cluster else self.workers or os.cpu_count() or 1
