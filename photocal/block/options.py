"""Options of `photocal adjust`: figures beside the usual ones, and blocks in parts."""

import os
from dataclasses import dataclass
from typing import Annotated

from photocal.base.errors import ConfigurationError
from photocal.base.options import Option, Options
from photocal.base.workers import Cluster, Workers


@dataclass(frozen=True, kw_only=True)
class Wanted(Options):
    """What is asked for beside the tables that every run has."""

    ellipses: Annotated[
        float | None, Option("Write error ellipses and ellipsoids of this probability, such as 0.95.")
    ] = None
    reliability: Annotated[
        bool, Option("Write the smallest errors that the tests detect.", ("--reliability",))
    ] = False
    components: Annotated[
        bool, Option("Estimate the sigma of each group of observations and use it.", ("--components",))
    ] = False
    joint: Annotated[
        str, Option("Write the joint covariance of `image:NAME,point:NAME,camera:ID,head:CAMERA,mounting`.")
    ] = ""

    def __post_init__(self) -> None:
        """Refuse what is no probability, and names of no unknowns."""
        if self.ellipses is not None and not 0 < self.ellipses < 1:
            raise ConfigurationError(
                f"--ellipses {self.ellipses:g} is not a probability", "give 0.95 for 95 %"
            )
        parse_joint(self.joint)

    @property
    def unknowns(self) -> tuple[tuple[str, str], ...]:
        """Kinds and names of the unknowns whose joint covariance is written."""
        return parse_joint(self.joint)


def parse_joint(text: str) -> tuple[tuple[str, str], ...]:
    """Read `image:12,camera:P4P,head:NIR,mounting`; raises ConfigurationError for a kind that is none."""
    chosen = []
    for part in filter(None, (part.strip() for part in text.split(","))):
        kind, _, name = part.partition(":")
        if kind not in ("image", "point", "camera", "head", "mounting") or bool(name) == (kind == "mounting"):
            raise ConfigurationError(
                f"{part!r} names no unknowns",
                "use image:NAME, point:NAME, camera:ID, head:CAMERA or mounting, with commas between",
                where="--joint",
            )
        chosen.append((kind, name))
    return tuple(chosen)


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
