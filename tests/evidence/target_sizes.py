"""Study of targets from 5 to 60 px: how many are found, how far from the truth, and whether sigma tells.

Views of plates are rendered finely by a homography, blurred, summed up to pixels, lit unevenly and given
noise; the true centre is known. Writes `docs/evidence/target-sizes.md`.

Run: `make evidence`, or `python -m tests.evidence.target_sizes`.
"""

from __future__ import annotations

import sys
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from photocal.base.workers import run_tasks
from photocal.geometry.camera import camera
from photocal.measurement.markers import COMMON_PX, Board, charuco_board, dictionary, find_board, find_markers
from photocal.measurement.marking.snap import snap
from photocal.measurement.target_centre import PARTS, SMALLEST_PX, TargetImage, ground_bend
from photocal.measurement.target_search import find_targets

Floats = NDArray[np.float64]
Bytes = NDArray[np.uint8]
ROOT = Path(__file__).parents[2]
OUTPUT = ROOT / "docs" / "evidence" / "target-sizes.md"
PROCESSES = 2

SIZES = (5, 6, 8, 10, 12, 16, 20, 30, 40, 60)
# A click looks for all kinds and sizes: fewer of them.
CLICKED = (6, 8, 12, 20, 40)
TRIALS = {"window": 50, "click": 24, "whole image": 40}
# Of the plate: dark, light; of the ground about it; noise of a picture. Grey values.
DARK, LIGHT, GROUND, NOISE = 50.0, 210.0, 110.0, 0.02 * 255
# Light around a target, as a part of its side: what the sheets of `photocal targets` have at least.
MARGIN = {"code": 0.25}
PLAIN_MARGIN = 0.15
# Brightness changes across the image by up to so much of itself, per px.
UNEVEN = 0.002
FINE = 8
# A camera far away: focal length, px, and the place of the target in its image from the middle.
FOCAL, FARTHEST, TILT = 3000.0, 1000.0, np.radians(35)
# Standard deviation of a prediction, px; of the size that it gives, parts of it.
PREDICTED_PX, SCALE = 4.0, 0.02
CLICK_PX = 2.0
DICTIONARY = "apriltag_36h11"
BOARD = Board(6, 5, 1.0, "charuco")
# What is farther from the truth is another thing.
WRONG_PX = 1.0
FEW = 15
SEED = 1


@dataclass(frozen=True)
class View:
    """A rendered picture of a plate.

    Attributes
    ----------
    grey : ndarray, shape (height, width)
    homography : ndarray, shape (3, 3)
        From the plate, in half sides of the target, to px.
    bend : ndarray, shape (2, 2, 2)
        Of the plate's plane, as the exposure would tell.
    """

    grey: Bytes
    homography: Floats
    bend: Floats

    def place(self, plate: Floats) -> Floats:
        """Column and row of places on the plate, shape (n, 2)."""
        seen = np.column_stack([plate, np.ones(len(plate))]) @ self.homography.T
        return np.asarray(seen[:, :2] / seen[:, 2:])

    @property
    def centre(self) -> Floats:
        """Where the middle of the target is seen."""
        return np.asarray(self.place(np.zeros((1, 2)))[0])

    @property
    def affine(self) -> Floats:
        """From half sides to px about the centre."""
        step = 1e-5 * np.array([[1, 0], [-1, 0], [0, 1], [0, -1]])
        seen = self.place(step)
        return np.column_stack([seen[0] - seen[1], seen[2] - seen[3]]) / 2e-5


def dark(kind: str, u: Floats, v: Floats) -> NDArray[np.bool_]:
    """Where a target is dark, by its definition; u, v in half sides (of a square of the board)."""
    away = np.hypot(u, v)
    if kind == "disc":
        return np.asarray(away < 1)
    if kind == "ring":
        return np.asarray((away < 1) & (away > 0.5))
    if kind == "cross":
        return np.asarray(((abs(u) < 1) & (abs(v) < 0.2)) | ((abs(v) < 1) & (abs(u) < 0.2)))
    if kind == "hourglass":
        return np.asarray((abs(v) > abs(u)) & (abs(v) < 1))
    if kind == "code":
        cells = dictionary(DICTIONARY).generateImageMarker(7, 8)
        columns, rows = 8.0, 8.0
        across, down = (u + 1) / 2 * 8, (v + 1) / 2 * 8
    else:
        # Eight steps a square: markers of 4 x 4 bits and their border fill six of them.
        columns, rows = 8.0 * BOARD.columns, 8.0 * BOARD.rows
        cells = charuco_board(BOARD).generateImage((int(columns), int(rows)), None, 0, 1)
        across, down = 4 * u + columns / 2, 4 * v + rows / 2
    inside = (across >= 0) & (across < columns) & (down >= 0) & (down < rows)
    row, column = (np.clip(w, 0, n - 1).astype(int) for w, n in ((down, rows), (across, columns)))
    return np.asarray(inside & (np.asarray(cells)[row, column] < 128))


def plate(kind: str, half_side_px: float) -> tuple[Floats, Floats]:
    """Draw a target on its plate, and tell which pixel shows which half side, shape (3, 3)."""
    margin = MARGIN.get(kind, PLAIN_MARGIN)
    half = np.array([BOARD.columns + 1, BOARD.rows + 1]) if kind == "board" else np.full(2, 1 + 2 * margin)
    columns, rows = (max(round(2 * n * half_side_px), 16) for n in half)
    # Large plates are drawn finely enough as they are, and would not fit into memory.
    over = 4 if half_side_px < 100 else 1
    u, v = (
        ((np.arange(n * over) + 0.5) / (n * over) - 0.5) * 2 * h
        for n, h in ((columns, half[0]), (rows, half[1]))
    )
    grey = np.where(dark(kind, *np.meshgrid(u, v)), DARK, LIGHT)
    coarse = np.asarray(grey.reshape(rows, over, columns, over).mean(axis=(1, 3)))
    step = 2 * half / [columns, rows]
    return coarse, np.array(
        [[step[0], 0, step[0] / 2 - half[0]], [0, step[1], step[1] / 2 - half[1]], [0, 0, 1.0]]
    )


def view(kind: str, size: float, rng: np.random.Generator) -> View:
    """Render a target whose picture has the area of a square of a side in px."""
    tilt, round_about, turn = rng.uniform(0, TILT), *rng.uniform(0, 2 * np.pi, 2)
    axis = np.array([np.cos(round_about), np.sin(round_about), 0])
    rotation = cv2.Rodrigues(axis * tilt)[0] @ cv2.Rodrigues(np.array([0, 0, turn]))[0]
    # Camera axes of vision here: x right, y down, z ahead; the plate's are u right, v down.
    pixel = rng.uniform(-FARTHEST, FARTHEST, 2)
    ray = np.array([*pixel / FOCAL, 1.0])
    away = FOCAL * 2 / size
    for _ in range(8):
        homography = np.diag([FOCAL, FOCAL, 1]) @ np.column_stack([rotation[:, :2], away * ray])
        shown = View(np.zeros((0, 0), np.uint8), homography, np.zeros((2, 2, 2)))
        away *= 2 * np.sqrt(abs(np.linalg.det(shown.affine))) / size
    half = BOARD.columns + 2 if kind == "board" else 1.5
    side = int(2 * np.ceil(half * size / 2 * 1.5 + 4 * PREDICTED_PX + 10))
    homography = np.array([[1, 0, side / 2 - round(pixel[0])], [0, 1, side / 2 - round(pixel[1])], [0, 0, 1]])
    homography = homography @ np.diag([FOCAL, FOCAL, 1]) @ np.column_stack([rotation[:, :2], away * ray])
    homography = homography / homography[2, 2]
    # The exposure knows the plane: photogrammetric axes are x right, y up, z backwards.
    frame = np.diag([1, -1, -1]) @ rotation @ np.diag([1, -1, -1])
    own = camera("c", "brown-ideal", "px", (6000, 4000), (1.0, 1.0), {"c": FOCAL})
    bend = ground_bend(own, frame, pixel + np.array([2999.5, 1999.5]))
    return View(exposed(kind, size, homography, side, rng), homography, bend)


def exposed(kind: str, size: float, homography: Floats, side: int, rng: np.random.Generator) -> Bytes:
    """What a sensor makes of a plate: blur, pixels, uneven light, noise, whole numbers."""
    drawn, texel = plate(kind, FINE * size / 2 * 1.5)
    fine = np.array([[FINE, 0, (FINE - 1) / 2], [0, FINE, (FINE - 1) / 2], [0, 0, 1.0]])
    shown = cv2.warpPerspective(
        drawn.astype(np.float32),
        fine @ homography @ texel,
        (side * FINE, side * FINE),
        flags=cv2.INTER_LINEAR,
        borderValue=(GROUND,),
    )
    blurred = cv2.GaussianBlur(shown, (0, 0), rng.uniform(0.5, 1.5) * FINE)
    grey = blurred.reshape(side, FINE, side, FINE).mean(axis=(1, 3))
    y, x = np.mgrid[:side, :side] - side / 2
    slope, towards = rng.uniform(0, UNEVEN), rng.uniform(0, 2 * np.pi)
    light = 1 + slope * (x * np.cos(towards) + y * np.sin(towards))
    return np.asarray(np.clip(np.round(grey * light + rng.normal(0, NOISE, grey.shape)), 0, 255), np.uint8)


Place = tuple[float, float]
# Column, row and their sigmas from the grey values; and the truth, column and row.
Found = list[tuple[float, float, float, float, float, float]]


def by_prediction(kind: str, seen: View, rng: np.random.Generator) -> Found:
    """`photocal measure` of a project with exposures: a window about the predicted place."""
    place = seen.centre + rng.normal(0, PREDICTED_PX, 2)
    look = TargetImage(kind, seen.affine * (1 + rng.normal(0, SCALE)), PARTS[kind], seen.bend)  # type: ignore[arg-type]
    if not look.large_enough:
        return []
    found = find_targets(
        seen.grey, (float(place[0]), float(place[1])), (PREDICTED_PX**2 + 1) * np.eye(2), look
    )
    # Two in one window are ambiguous.
    return [(c.column, c.row, *c.sigma, *seen.centre.tolist()) for c in found] if len(found) == 1 else []


def by_click(_: str, seen: View, rng: np.random.Generator) -> Found:
    """`photocal mark`: a click near to the target."""
    x, y = (seen.centre + rng.normal(0, CLICK_PX, 2)).tolist()
    found = snap(seen.grey, (x, y), 12.0, bend=seen.bend)
    if found is None:
        return []
    _, centre = found
    sx, sy = (np.sqrt(s**2 - COMMON_PX**2) for s in centre.sigma)
    return [(centre.column, centre.row, float(sx), float(sy), *seen.centre.tolist())]


def in_whole_image(kind: str, seen: View, _: np.random.Generator) -> Found:
    """Codes and boards, which need no prediction."""
    if kind == "code":
        marks = find_markers(seen.grey, DICTIONARY)
        return [(m.centre.column, m.centre.row, *m.centre.sigma, *seen.centre.tolist()) for m in marks]
    board = find_board(seen.grey, BOARD)
    if board is None:
        return []
    corners, pixels, sigmas = board
    truth = seen.place(2 * BOARD.points()[corners, :2] * [1, -1] - np.array(BOARD.inner) + [1, 1])
    return list(map(tuple, np.hstack([pixels, sigmas, truth]).tolist()))


WAYS: dict[str, Callable[[str, View, np.random.Generator], Found]] = {
    "window": by_prediction,
    "click": by_click,
    "whole image": in_whole_image,
}
PLAIN = ("disc", "ring", "cross", "hourglass")
TASKS = (
    *(("window", kind, size) for kind in PLAIN for size in SIZES),
    *(("click", kind, size) for kind in (*PLAIN, "code") for size in CLICKED),
    *(("whole image", kind, size) for kind in ("code", "board") for size in SIZES),
)


@dataclass(frozen=True)
class Row:
    """What came of one kind and size in one way."""

    way: str
    kind: str
    size: int
    wanted: int
    found: int
    wrong: int
    rms_px: float
    sigma_px: float
    ratio: float


def row(task: tuple[str, str, int]) -> Row:
    """Measure the views of a kind and size."""
    way, kind, size = task
    rng = np.random.default_rng([SEED, len(way), *kind.encode(), size])
    corners = BOARD.inner[0] * BOARD.inner[1] if kind == "board" else 1
    trials = max(TRIALS[way] // corners, 4)
    found: Found = []
    for _ in range(trials):
        found += WAYS[way](kind, view(kind, size, rng), rng)
    table = np.array(found, dtype=float).reshape(-1, 6)
    errors, sigma = table[:, :2] - table[:, 4:], table[:, 2:4]
    right = np.hypot(*errors.T) <= WRONG_PX
    errors, sigma = errors[right], sigma[right]
    if not len(errors):
        return Row(way, kind, size, trials * corners, 0, int((~right).sum()), np.nan, np.nan, np.nan)
    return Row(
        *(way, kind, size, trials * corners, len(errors), int((~right).sum())),
        float(np.sqrt(np.mean(errors**2))),
        float(np.sqrt(np.mean(sigma**2))),
        float(np.mean((errors / sigma) ** 2)),
    )


def page(rows: list[Row]) -> str:
    """Write the table."""
    text = [
        "# Targets from 5 to 60 px",
        "",
        "Made by `python -m tests.evidence.target_sizes`.",
        "",
        f"Plates rendered by a homography at {FINE} times the resolution: tilted by up to",
        f"{np.degrees(TILT):.0f} degrees, blurred (0.5 to 1.5 px), in light that changes by up to",
        f"{100 * UNEVEN:.1f} % a px, with noise of 2 %. Grey values: dark {DARK:.0f}, light {LIGHT:.0f},",
        f"ground around the plate {GROUND:.0f}. Size: side of a square of the same area (for a board, of",
        "one of its squares), px. The white margin of a target is that of the sheets of",
        "`photocal targets`.",
        "",
        f"- window: predicted with a standard deviation of {PREDICTED_PX:g} px, as by `photocal measure`;",
        "  a target is not searched for if its shortest extent in the picture is smaller than",
        "  " + ", ".join(f"{kind} {least:g}" for kind, least in SMALLEST_PX.items()) + " px;",
        f"- click: within {CLICK_PX:g} px (standard deviation), as on the page of `photocal mark`;",
        f"- whole image: codes ({DICTIONARY}) and a ChArUco board, which need no prediction.",
        "",
        "rms: the error of a coordinate, px; sigma: its standard deviation as stated by the measurement,",
        f"without the common {COMMON_PX} px that marks get for errors that grey values cannot show.",
        "(e/s)^2: the mean of squared errors over variances, 1 where sigma is true; in brackets where",
        f"fewer than {FEW} were found. Other: a detection farther than {WRONG_PX:g} px from the truth.",
        "",
        "| way | target | size | found | other | rms | sigma | (e/s)^2 |",
        "|---|---|---|---|---|---|---|---|",
    ]
    for own in rows:
        ratio = f"{own.ratio:.2f}" if own.found >= FEW else f"({own.ratio:.2f})"
        figures = f"{own.rms_px:.3f} | {own.sigma_px:.3f} | {ratio}" if own.found else "- | - | -"
        share = f"{own.found} of {own.wanted}"
        text.append(f"| {own.way} | {own.kind} | {own.size} | {share} | {own.wrong} | {figures} |")
    return "\n".join(text) + "\n"


def main() -> None:
    """Run the study and write its table."""
    rows = []
    for done, own in enumerate(run_tasks(row, TASKS, PROCESSES), 1):
        rows.append(own)
        print(f"{done} of {len(TASKS)}", own, file=sys.stderr, flush=True)
    OUTPUT.write_text(page(rows), encoding="utf-8")
    print(page(rows))


if __name__ == "__main__":
    main()
