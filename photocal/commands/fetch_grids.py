"""`photocal fetch-grids`: geoid and datum grids for an area, before the trip."""

from __future__ import annotations

from typing import Annotated

import typer

from acquire.console import answer


def fetch_grids(
    crs: Annotated[str, typer.Argument(help="System of the project, with its heights: EPSG:31982+5773.")],
    area: Annotated[
        tuple[float, float, float, float] | None,
        typer.Option(metavar="W S E N", help="Degrees; without, the whole area of the system."),
    ] = None,
    dry: Annotated[bool, typer.Option("--dry-run", help="Only say what is missing.")] = False,
    as_json: Annotated[bool, typer.Option("--json", help="Print the names as JSON.")] = False,
) -> None:
    """Fetch the grids that a reference system needs, so that it can be used without a network.

    Example: `photocal fetch-grids EPSG:31982+5773 --area -54 -31 -53 -30`
    """
    from photocal.geometry.grids import fetch_grids as fetched
    from photocal.geometry.grids import missing_grids

    names = missing_grids(crs, area) if dry else fetched(crs, area)
    word = "missing" if dry else "fetched"
    answer(
        as_json,
        lambda: {"crs": crs, word: list(names)},
        lambda: "\n".join(f"{word}: {name}" for name in names) or f"all grids of {crs} are here",
    )
