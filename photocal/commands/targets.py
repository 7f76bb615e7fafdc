"""`photocal targets`: target sheets to print."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from acquire.console import answer
from drivers.errors import ConfigurationError


def targets(
    kind: Annotated[
        str,
        typer.Argument(
            help="disc, ring, cross, hourglass, chessboard, charuco, or a dictionary such as apriltag_36h11."
        ),
    ],
    output: Annotated[Path, typer.Option("-o", "--output", help="PDF to write.")],
    size_mm: Annotated[
        float, typer.Option(help="Diameter or side of the target, of a square for boards, mm.")
    ] = 120.0,
    numbers: Annotated[str, typer.Option(help="Numbers of coded targets, such as 1-20 or 3,7.")] = "0",
    board: Annotated[str, typer.Option(help="Squares of a board in a row and in a column.")] = "10x7",
    charuco: Annotated[str, typer.Option(help="Marker dictionary of a ChArUco board.")] = "4x4_50",
    paper: Annotated[str, typer.Option(help="a4, a3, a2, a1 or a0.")] = "a4",
    as_json: Annotated[bool, typer.Option("--json", help="Print what was written as JSON.")] = False,
) -> None:
    """Write target sheets as PDF, true to scale, for all targets that `photocal measure` reads.

    Example: `photocal targets apriltag_36h11 --numbers 1-20 --size-mm 160 -o targets.pdf`
    """
    from acquire.outputs import output_file
    from photocal.measurement.boards import parse_board
    from photocal.measurement.markers import DICTIONARIES
    from photocal.measurement.target_shapes import board_target, coded_target, plain_target, sheets_pdf

    if not 1 <= size_mm <= 1000:
        raise ConfigurationError(f"a size of {size_mm:g} mm is impossible", remedy="give 1 to 1000 mm")
    if kind.lower() in DICTIONARIES:
        sheets = [coded_target(kind.lower(), number, size_mm) for number in _numbers(numbers)]
    elif kind in ("chessboard", "charuco"):
        wanted = parse_board(board, size_mm / 1000, charuco if kind == "charuco" else "")
        sheets = [board_target(wanted)]
    else:
        sheets = [plain_target(kind, size_mm)]
    content = sheets_pdf(sheets, paper)
    with output_file(output) as aside:
        aside.write_bytes(content)
    titles = [sheet.title for sheet in sheets]
    answer(
        as_json,
        lambda: {"file": str(output), "sheets": titles},
        lambda: "\n".join([*titles, f"{output}: print at 100 % and measure the bar of 100 mm"]),
    )


def _numbers(text: str) -> list[int]:
    found: list[int] = []
    try:
        for part in text.split(","):
            first, _, last = part.partition("-")
            found += range(int(first), int(last or first) + 1)
    except ValueError:
        found = []
    if not found or len(found) > 1000:
        raise ConfigurationError(
            f"numbers {text!r} are not understood", remedy="write them as 1-20 or 3,7 (at most 1000)"
        )
    return found
