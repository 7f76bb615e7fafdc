"""Options of `photocal analyse`."""

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

from photocal.base.options import Option, Options


@dataclass(frozen=True, kw_only=True)
class AnalysisOptions(Options):
    """Block, levels and bootstrap of an analysis."""

    block: Annotated[
        Path | None, Option("Block folder of the run, or its set-up file, when it is not found.")
    ] = None
    alpha: Annotated[float, Option("Level of the significance tests.", least=1e-4, most=0.5)] = 0.10
    correlation: Annotated[
        float, Option("Report correlations |r| from this value on.", least=0.0, most=1.0)
    ] = 0.8
    bootstrap: Annotated[
        int,
        Option(
            "Number of bootstrap blocks, with images drawn with replacement; 100 are enough.",
            least=0,
            most=10_000,
        ),
    ] = 0


@dataclass(frozen=True, kw_only=True)
class PublishedOptions(Options):
    """Options that complete a published table of parameters."""

    matrix: Annotated[
        Path | None, Option("CSV of the correlations or the covariance of published parameters.")
    ] = None
    set_name: Annotated[str | None, Option("Set of a published table; default: all sets.", ("--set",))] = None
    degrees_of_freedom: Annotated[float, Option("Redundancy behind published parameters.", least=1.0)] = (
        float("inf")
    )
