"""Calibration boards: chessboard and ChArUco, found in an image and measured to a fraction of a pixel."""

from dataclasses import dataclass
from typing import Any, Literal

import numpy as np

from photocal.base.arrays import Bytes, Floats, Integers
from photocal.base.errors import ConfigurationError
from photocal.measurement.image_file import Grey, as_eight_bit
from photocal.measurement.markers import dictionary
from photocal.measurement.round_targets import saddle_centre
from photocal.measurement.target_centre import Centre, measurable

FEWEST_CORNERS = 8
# The window of a corner must not reach the next edge, nor be so large that the lens bends the edges.
_WINDOW = 0.4
_SMALLEST_WINDOW_PX, _LARGEST_WINDOW_PX = 2.5, 11.0


@dataclass(frozen=True)
class Board:
    """A flat board of squares.

    marker: side of a ChArUco marker over that of a square.
    dictionary: of the ChArUco markers.
    """

    columns: int
    rows: int
    square_m: float
    kind: Literal["chessboard", "charuco"] = "chessboard"
    marker: float = 0.75
    dictionary: str = "4x4_50"

    @property
    def inner(self) -> tuple[int, int]:
        """Number of inner corners in a row and in a column."""
        return self.columns - 1, self.rows - 1

    def points(self) -> Floats:
        """Inner corners row by row: X right, Y up, Z towards the viewer, m; shape (n, 3)."""
        across, down = self.inner
        y, x = np.mgrid[0:down, 0:across].astype(float)
        return np.column_stack([x.ravel(), -y.ravel(), np.zeros(across * down)]) * self.square_m


def parse_board(text: str, square_m: float, dictionary_name: str = "") -> Board:
    """Read a board from "10x7" (squares in a row and in a column); raises ConfigurationError."""
    try:
        columns, rows = (int(part) for part in text.lower().split("x"))
    except ValueError:
        columns, rows = 0, 0
    if not (3 <= columns <= 200 and 3 <= rows <= 200):
        raise ConfigurationError(
            f"board {text!r} is not understood", "give its squares as COLUMNSxROWS, at least 3x3"
        )
    if not (np.isfinite(square_m) and square_m > 0):
        raise ConfigurationError(f"a square of {square_m} m is impossible", "give its side in metres")
    if not dictionary_name:
        return Board(columns, rows, square_m)
    dictionary(dictionary_name)
    return Board(columns, rows, square_m, "charuco", dictionary=dictionary_name)


@dataclass(frozen=True)
class BoardView:
    """A board in an image; `corners` (n,): which of the board's inner corners."""

    corners: Integers
    centres: tuple[Centre, ...]

    @property
    def pixels(self) -> Floats:
        """Columns and rows, shape (n, 2)."""
        return np.array([[c.column, c.row] for c in self.centres]).reshape(-1, 2)

    @property
    def sigmas(self) -> Floats:
        """Standard deviations of columns and rows, px, shape (n, 2)."""
        return np.array([c.sigma for c in self.centres]).reshape(-1, 2)


def find_board(grey: Grey, board: Board) -> BoardView | None:
    """Find a board and measure its corners."""
    grey, eight = measurable(grey), as_eight_bit(grey)
    rough = _chessboard(eight, board) if board.kind == "chessboard" else _charuco(eight, board)
    if rough is None or len(rough[0]) < FEWEST_CORNERS:
        return None
    corners, places = rough
    spacing = _spacing(corners, places, board)
    measured, centres = [], []
    for corner, place, reach in zip(corners, places, spacing, strict=True):
        radius = float(np.clip(_WINDOW * reach, _SMALLEST_WINDOW_PX, _LARGEST_WINDOW_PX))
        centre = saddle_centre(grey, (float(place[0]), float(place[1])), radius)
        if centre is not None:
            measured.append(corner)
            centres.append(centre)
    if len(measured) < FEWEST_CORNERS:
        return None
    return BoardView(np.array(measured, dtype=np.int64), tuple(centres))


def charuco_board(board: Board) -> Any:
    """Make the detector library's form of a ChArUco board."""
    import cv2

    return cv2.aruco.CharucoBoard(
        (board.columns, board.rows), 1.0, board.marker, dictionary(board.dictionary)
    )


def _chessboard(eight: Bytes, board: Board) -> tuple[Integers, Floats] | None:
    import cv2

    across, down = board.inner
    # From the quick search to the thorough one: only the rough places are wanted here.
    flags = cv2.CALIB_CB_ADAPTIVE_THRESH | cv2.CALIB_CB_NORMALIZE_IMAGE | cv2.CALIB_CB_FAST_CHECK
    success, corners = cv2.findChessboardCorners(eight, (across, down), flags=flags)
    for thorough in (0, cv2.CALIB_CB_EXHAUSTIVE):
        if success:
            break
        flags = cv2.CALIB_CB_NORMALIZE_IMAGE | thorough
        success, corners = cv2.findChessboardCornersSB(eight, (across, down), flags=flags)
    if not success:
        return None
    grid = np.asarray(corners, dtype=float).reshape(down, across, 2)
    # Seen from the front, rows follow columns clockwise (rows point down): else the order is mirrored.
    right, below = grid[0, -1] - grid[0, 0], grid[-1, 0] - grid[0, 0]
    if right[0] * below[1] - right[1] * below[0] < 0:
        grid = grid[:, ::-1]
    return np.arange(across * down), np.asarray(grid.reshape(-1, 2))


def _charuco(eight: Bytes, board: Board) -> tuple[Integers, Floats] | None:
    import cv2

    parameters = cv2.aruco.DetectorParameters()
    parameters.errorCorrectionRate = 0.0
    detector = cv2.aruco.CharucoDetector(
        charuco_board(board), cv2.aruco.CharucoParameters(), parameters, cv2.aruco.RefineParameters()
    )
    corners, names, _, _ = detector.detectBoard(eight)
    if names is None or len(names) == 0:
        return None
    return np.ravel(names).astype(np.int64), np.asarray(corners, dtype=float).reshape(-1, 2)


def _spacing(corners: Integers, places: Floats, board: Board) -> Floats:
    """Distance from each corner to its nearest neighbour on the board, px; for ChArUco to the marker."""
    across = board.inner[0]
    where = {int(name): k for k, name in enumerate(corners)}
    nearest = np.full(len(corners), np.inf)
    for k, name in enumerate(corners):
        column = int(name) % across
        beside = [int(name) + across, int(name) - across]
        beside += [int(name) + 1] * (column + 1 < across) + [int(name) - 1] * (column > 0)
        others = [where[other] for other in beside if other in where]
        if others:
            nearest[k] = np.hypot(*(places[others] - places[k]).T).min()
    known = np.isfinite(nearest)
    nearest[~known] = np.median(nearest[known]) if known.any() else 2 * _SMALLEST_WINDOW_PX
    if board.kind == "charuco":
        # The markers begin (1 - marker) / 2 of a square from the edges; diagonally that is sqrt 2 farther.
        return np.asarray(nearest * (1 - board.marker) / 2 * np.sqrt(2) / _WINDOW * 0.9)
    return nearest
