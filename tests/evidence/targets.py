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

from photocal.base.workers import run_tasks
from photocal.measurement.image_file import as_eight_bit, list_images, read_grey
from photocal.measurement.markers import Board, find_board, find_markers
from photocal.measurement.target_centre import PARTS, SMALLEST_PX, Kind, TargetImage
from photocal.measurement.target_search import WITHIN, find_targets

Floats = NDArray[np.float64]
ROOT = Path(__file__).parents[2]
OUTPUT = ROOT / "docs" / "evidence" / "targets.md"
FOLDERS = (
    "uav-brighton-beach/images",
    "micmac-saisies-gcp",
    "opensfm-berlin-gcp/images",
    "dbat-sxb/images",
)
PATCHES, SIDE = 5_000, 160
DICTIONARIES = ("apriltag_36h11", "apriltag_25h9", "4x4_50", "6x6_250", "aruco_mip_36h12")
# The patches are drawn twice: thresholds were set without a look at the second draw.
SEEDS = (8, 2029)
# Sizes of uncoded targets are drawn between the least that is read and this, px.
LARGEST = 50.0
CHESSBOARD, CHARUCO = Board(7, 5, 0.03), Board(7, 5, 0.03, "charuco")
# The search for chessboards is slow.
BOARD_EVERY = 10
PROCESSES = 2


@dataclass(frozen=True)
class Piece:
    """Places in a picture: upper-left pixels of the patches, rows and columns, shape (n, 2)."""

    path: Path
    corners: NDArray[np.int64]


def pieces(shared: Path, seed: int) -> list[Piece]:
    """Draw the patches: each picture as often as any other, each place in it alike."""
    paths = [path for folder in FOLDERS for path in list_images(shared / "data" / folder)]
    rng = np.random.default_rng(seed)
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
        for kind in get_args(Kind):
            size = float(np.exp(rng.uniform(np.log(SMALLEST_PX[kind]), np.log(LARGEST))))
            look = TargetImage(kind, size / 2 * np.eye(2), PARTS[kind])
            middle = (SIDE - 1) / 2
            centres = find_targets(patch, (middle, middle), (middle / WITHIN) ** 2 * np.eye(2), look)
            found += [(kind, f"{where}, {look.size:.1f} px")] * len(centres)
    return found


def main(shared: Path) -> None:
    """Run the study and write its table."""
    draws = [pieces(shared, seed) for seed in SEEDS]
    tasks = [task for draw in draws for task in draw]
    found: list[list[tuple[str, str]]] = []
    for done, own in enumerate(run_tasks(searched, tasks, PROCESSES), 1):
        found.append(own)
        print(f"{done} of {len(tasks)} pieces of work", *own, file=sys.stderr, flush=True)
    first = len(draws[0])
    counts = [Counter(kind for own in part for kind, _ in own) for part in (found[:first], found[first:])]
    boards = sum(-(-len(task.corners) // BOARD_EVERY) for task in draws[0])
    rows = [(name, PATCHES) for name in (*DICTIONARIES, "ChArUco board", *get_args(Kind))]
    least = ", ".join(f"{kind} {size:g}" for kind, size in SMALLEST_PX.items())
    text = [
        "# False detections of targets",
        "",
        "Made by `python -m tests.evidence.targets`.",
        "",
        f"Patches of {SIDE} x {SIDE} px, {PATCHES} of {len({task.path for task in tasks})} recorded",
        "pictures without targets (a beach, a facade, a street, a church from the air), drawn twice.",
        "Thresholds were set without looking at the second draw. An uncoded target is searched for in the",
        "whole patch, as if its prediction were that uncertain. Its size is drawn between the smallest",
        f"that is read ({least} px) and {LARGEST:g} px. In a project it must also be the only one in the",
        "window of its point. Boards have 7 x 5 squares.",
        "",
        "| kind | patches of a draw | found in the first | in the second |",
        "|---|---|---|---|",
        *(
            f"| {kind} | {count} | {counts[0][kind]} | {counts[1][kind]} |"
            for kind, count in (*rows, ("chessboard", boards))
        ),
    ]
    if any(counts):
        text += ["", "Found in:", "", *(f"- {kind}: {where}" for own in found for kind, where in own)]
    OUTPUT.write_text("\n".join(text) + "\n", encoding="utf-8")
    print("\n".join(text))


if __name__ == "__main__":
    main(Path(sys.argv[1]) if len(sys.argv) > 1 else ROOT.parent / "shared")
