"""Study of targets where there are none: pieces of recorded pictures searched for every kind.

Writes `docs/evidence/targets.md`.

Run: `make evidence`, or `python -m tests.evidence.targets [SHARED]`.
"""

from __future__ import annotations

import sys
from collections import Counter
from dataclasses import dataclass
from pathlib import Path
from typing import get_args

import numpy as np
from numpy.typing import NDArray

from photocal.measurement.boards import Board, find_board
from photocal.measurement.image_file import as_eight_bit, list_images, read_grey
from photocal.measurement.markers import find_markers
from photocal.measurement.target_look import PARTS, SMALLEST_PX, Kind, Look
from photocal.measurement.target_search import WITHIN, find_targets
from photocal.measurement.workers import run_tasks

Floats = NDArray[np.float64]
ROOT = Path(__file__).parents[2]
OUTPUT = ROOT / "docs" / "evidence" / "targets.md"
FOLDERS = (
    "uav-brighton-beach/images",
    "micmac-saisies-gcp",
    "opensfm-berlin-gcp/images",
    "dbat-sxb/images",
)
PATCHES, SIDE = 10_000, 160
DICTIONARIES = ("apriltag_36h11", "apriltag_25h9", "4x4_50", "6x6_250", "aruco_mip_36h12")
# Sizes of uncoded targets are drawn between these, px.
SMALLEST, LARGEST = 10.0, 50.0
CHESSBOARD, CHARUCO = Board(7, 5, 0.03), Board(7, 5, 0.03, "charuco")
# The search for chessboards is slow.
BOARD_EVERY = 10
PROCESSES = 2


@dataclass(frozen=True)
class Piece:
    """Places in a picture: upper-left pixels of the patches, rows and columns, shape (n, 2)."""

    path: Path
    corners: NDArray[np.int64]


def pieces(shared: Path) -> list[Piece]:
    """Draw the patches: each picture as often as any other, each place in it alike."""
    paths = [path for folder in FOLDERS for path in list_images(shared / "data" / folder)]
    rng = np.random.default_rng(8)
    chosen = np.bincount(rng.integers(len(paths), size=PATCHES), minlength=len(paths))
    drawn = []
    for path, count in zip(paths, chosen.tolist(), strict=True):
        height, width = read_grey(path).shape
        corners = rng.integers([0, 0], [height - SIDE + 1, width - SIDE + 1], size=(count, 2))
        # Pieces of work of about the same size.
        drawn += [Piece(path, part) for part in np.array_split(corners, max(count // 100, 1))]
    return drawn


def searched(piece: Piece) -> list[tuple[str, str]]:
    """What was found in the patches of a picture: the kind and the place."""
    grey = read_grey(piece.path)
    eight = as_eight_bit(grey)
    found = []
    # Seams between patches only add to what might be taken for a target.
    sheet = np.hstack([eight[r : r + SIDE, c : c + SIDE] for r, c in piece.corners.tolist()])
    for name in DICTIONARIES:
        found += [(name, piece.path.name)] * len(find_markers(sheet, name))
    rng = np.random.default_rng(int(piece.corners.sum()))
    for k, (row, column) in enumerate(piece.corners.tolist()):
        patch = eight[row : row + SIDE, column : column + SIDE].copy()
        where = f"{piece.path.name} ({column}, {row})"
        found += [("ChArUco board", where)] * (find_board(patch, CHARUCO) is not None)
        if k % BOARD_EVERY == 0:
            found += [("chessboard", where)] * (find_board(patch, CHESSBOARD) is not None)
        size = float(np.exp(rng.uniform(np.log(SMALLEST), np.log(LARGEST))))
        for kind in get_args(Kind):
            look = Look(kind, max(size, SMALLEST_PX[kind]) / 2 * np.eye(2), PARTS[kind])
            middle = (SIDE - 1) / 2
            centres = find_targets(patch, (middle, middle), (middle / WITHIN) ** 2 * np.eye(2), look)
            found += [(kind, f"{where}, {look.size:.1f} px")] * len(centres)
    return found


def main(shared: Path) -> None:
    """Run the study and write its table."""
    tasks = pieces(shared)
    total = sum(len(task.corners) for task in tasks)
    found: list[tuple[str, str]] = []
    for done, own in enumerate(run_tasks(searched, tasks, PROCESSES), 1):
        found += own
        print(f"{done} of {len(tasks)} pieces of work, {len(found)} found", *own, file=sys.stderr, flush=True)
    counts = Counter(kind for kind, _ in found)
    boards = sum(-(-len(task.corners) // BOARD_EVERY) for task in tasks)
    rows = [(name, total) for name in (*DICTIONARIES, "ChArUco board", *get_args(Kind))]
    text = [
        "# Targets where there are none",
        "",
        "Made by `python -m tests.evidence.targets`.",
        "",
        f"Patches of {SIDE} x {SIDE} px, {total} of {len({task.path for task in tasks})} recorded pictures",
        "(a beach, a facade, a street, a church from the air). An uncoded target of a size that is drawn",
        f"between {SMALLEST:g} (cross, hourglass: {SMALLEST_PX['cross']:g}) and {LARGEST:g} px is sought in",
        "the whole patch, as if the prediction were as unsure as that; in a project it must also be the",
        "only one in the window of its point. Boards have 7 x 5 squares.",
        "",
        "| kind | patches | found |",
        "|---|---|---|",
        *(f"| {kind} | {count} | {counts[kind]} |" for kind, count in (*rows, ("chessboard", boards))),
    ]
    if found:
        text += ["", "Found in:", "", *(f"- {kind}: {where}" for kind, where in found)]
    OUTPUT.write_text("\n".join(text) + "\n", encoding="utf-8")
    print("\n".join(text))


if __name__ == "__main__":
    main(Path(sys.argv[1]) if len(sys.argv) > 1 else ROOT.parent / "shared")
