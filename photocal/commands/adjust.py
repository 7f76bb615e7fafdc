"""`photocal adjust`: least squares adjustment of a block."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer


def adjust(
    block: Annotated[Path, typer.Argument(help="Block folder (block.toml, images.csv, points.csv, observations).")],
    output: Annotated[Path, typer.Option("-o", "--output", help="Folder for the results.")],
    as_json: Annotated[bool, typer.Option("--json", help="Print result.json instead of a summary.")] = False,
) -> None:
    """Adjust a block: camera, orientations and points with their complete statistics.

    Example: `photocal adjust configs/demo/dcs460 -o run`
    """
