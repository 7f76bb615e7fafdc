"""Coded markers, ArUco and AprilTag: identity, centre and corners.

Calibration boards: chessboard and ChArUco, found in an image and measured to a fraction of a pixel.
"""

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import Any, Literal

import numpy as np

from photocal.base.arrays import Bytes, Floats, Integers
from photocal.base.errors import ConfigurationError
from photocal.exchange.parts import Mark
from photocal.geometry.camera import Camera, pixel_to_plane, plane_to_pixel
from photocal.geometry.distortion import distorted, undistorted
from photocal.measurement import target_centre
from photocal.measurement.features import Arrays, cached, combined_key, kept
from photocal.measurement.image_file import Grey, as_eight_bit, read_grey
from photocal.measurement.patch_matching import ImageSource
from photocal.measurement.target_centre import (
    LEAST_CONTRAST,
    Centre,
    Fit,
    accepted,
    cut_part,
    fit_template,
    half_contrast,
    measurable,
)
from photocal.measurement.target_search import saddle_centre

DICTIONARIES = (
    *(f"{n}x{n}_{count}" for n in (4, 5, 6, 7) for count in (50, 100, 250, 1000)),
    "apriltag_16h5",
    "apriltag_25h9",
    "apriltag_36h10",
    "apriltag_36h11",
    "aruco_original",
    "aruco_mip_36h12",
)
# The light of a blurred edge is even at this multiple of the blur.
BLURS = 2.5
# Raised whenever the meaning of cached results changes.
VERSION = 6
# Plates are not flat and lenses not modelled to the last: what the grey values cannot know, px.
COMMON_PX = 0.02


def quadrilateral_centre(grey: Grey, corners: Floats, cell: float) -> tuple[Centre, Floats, Floats] | None:
    """Centre, corners and their standard deviations of a dark quadrilateral, such as the border of a code.

    corners (4, 2): where they are about, px.
    cell: width of the border, px.
    returns: the centre; columns and rows of the corners and their standard deviations, (4, 2), px.
    """
    middle = corners.mean(axis=0)
    reach = float(np.hypot(*(corners - middle).T).max()) + 0.7 * cell + 1
    # Near the border of the picture, where distortion wants targets, part of the margin is enough.
    if (corners < 0).any() or (corners > np.array(grey.shape[::-1]) - 1).any():
        return None
    window = cut_part(grey, (float(middle[0]), float(middle[1])), reach)
    local = corners - window.middle
    along = np.roll(local, -1, axis=0) - local
    normal = np.column_stack([-along[:, 1], along[:, 0]]) / np.hypot(*along.T)[:, None]
    inward = np.sign(np.sum(normal * (local.mean(axis=0) - local), axis=1))
    normal *= inward[:, None]
    distance = -np.sum(normal * local, axis=1)
    depth = np.min(np.column_stack([window.x, window.y]) @ normal.T + distance, axis=1)
    # Inside the border lies the code, beyond the margin anything.
    near = np.abs(depth) <= max(0.75 * cell, 1.5)
    window, depth = window.rows(near), depth[near]
    if len(window.grey) < 20:
        return None
    half = half_contrast(window)
    edges = np.column_stack([np.arctan2(normal[:, 1], normal[:, 0]), distance]).ravel()
    light, dark = np.quantile(window.grey, [0.9, 0.1])
    start = np.concatenate([edges, [0.7, light, dark - light]])
    side = float(np.hypot(*along.T).mean())
    sizes = np.array([1 / side, 1] * 4 + [0.5, half, half])
    slopes = target_centre.quadrilateral_slopes
    fit = fit_template(window, target_centre.quadrilateral, start, sizes, slopes)
    if fit is None or fit.parameters[10] > 0:
        return None
    # The code shines through the border as far as blur takes it.
    clear = depth <= cell - BLURS * abs(fit.parameters[8])
    if not clear.all():
        window = window.rows(clear)
        fit = fit_template(window, target_centre.quadrilateral, fit.parameters, sizes, slopes)
    if fit is None or fit.parameters[10] > 0:
        return None
    fitted = _corners(fit.parameters)
    if np.abs(fitted - local).max() > max(2.0, 0.15 * side):
        return None
    place, cofactor = _carried(_diagonals, fit)
    refined = replace(fit, parameters=place, cofactor=cofactor)
    target = (float(middle[0]), float(middle[1]))
    centre = accepted(window, refined, -fit.parameters[10], target, 0.15 * side + 1, fit.parameters[:9])
    sigma = fit.noise * np.sqrt(np.diag(_carried(_corners, fit)[1])).reshape(4, 2)
    return None if centre is None else (centre, fitted + window.middle, sigma)


def _carried(function: Callable[[Floats], Floats], fit: Fit) -> tuple[Floats, Floats]:
    """Value of a function of a quadrilateral's parameters and its cofactor matrix."""
    step = 1e-5 * np.eye(len(fit.parameters))
    slope = [(function(fit.parameters + s) - function(fit.parameters - s)).ravel() / 2e-5 for s in step]
    return function(fit.parameters), np.asarray(np.transpose(slope) @ fit.cofactor @ slope)


def _corners(p: Floats) -> Floats:
    lines = np.array([[np.cos(p[2 * k]), np.sin(p[2 * k]), p[2 * k + 1]] for k in range(4)])
    return _meeting(lines)


def _meeting(lines: Floats) -> Floats:
    """Corners of quadrilaterals, (..., 4, 2): edge k runs from corner k to corner k + 1."""
    meeting = np.cross(np.roll(lines, 1, axis=-2), lines)
    return np.asarray(meeting[..., :2] / meeting[..., 2:])


def on_bent_edges(lens: Camera, corners: Floats) -> Floats:
    """Give the corners of quadrilaterals whose edges the lens bends, from those of straight edges fitted.

    corners (n, 4, 2): columns and rows, px, as `quadrilateral_centre` measures them.
    returns (n, 4, 2): where the ends of the bent edges are; as they were where the lens sees nothing.
    """
    # The line fitted to a flat arc by least squares meets it at the zeros of Legendre's second polynomial, at
    # 1 / sqrt 3 of half its length, and so passes its ends by two thirds of the arc's height.
    flat = undistorted(lens, pixel_to_plane(lens.size_px, lens.pitch, corners.reshape(-1, 2)))
    start = flat.reshape(corners.shape)
    along = np.roll(start, -1, axis=1) - start

    def met(place: float) -> Floats:
        """Where the lens shows the points at a part of the edges' lengths, homogeneous."""
        arc = distorted(lens, (start + place * along).reshape(-1, 2))
        pixels = plane_to_pixel(lens.size_px, lens.pitch, arc).reshape(corners.shape)
        return np.concatenate([pixels, np.ones_like(pixels[..., :1])], axis=-1)

    away = 0.5 / np.sqrt(3)
    straight = _meeting(np.cross(met(0.5 - away), met(0.5 + away)))
    return corners - np.nan_to_num(straight - corners)


def moved_by_bend(lens: Camera, corners: Floats) -> Floats:
    """Give by how much the middles of quadrilaterals lie aside of where their diagonals meet, px.

    corners (n, 4, 2): columns and rows, px, as `quadrilateral_centre` measures them.
    returns (n, 2): from the measured centres to where the lens shows the middles.
    """
    bent = on_bent_edges(lens, corners)
    flat = undistorted(lens, pixel_to_plane(lens.size_px, lens.pitch, bent.reshape(-1, 2)))
    shown = distorted(lens, _crossing(flat.reshape(corners.shape)))
    return np.nan_to_num(plane_to_pixel(lens.size_px, lens.pitch, shown) - _crossing(corners))


def _diagonals(p: Floats) -> Floats:
    return _crossing(_corners(p))


def _crossing(corners: Floats) -> Floats:
    """Where the diagonals of quadrilaterals meet, (..., 2)."""
    whole = np.concatenate([corners, np.ones_like(corners[..., :1])], axis=-1)
    first, second = (np.cross(whole[..., k, :], whole[..., k + 2, :]) for k in (0, 1))
    meeting = np.cross(first, second)
    return np.asarray(meeting[..., :2] / meeting[..., 2:])


@dataclass(frozen=True)
class Marker:
    """A coded marker in an image.

    corners (4, 2): columns and rows, px, clockwise from the marker's own first corner.
    sigma (4, 2): standard deviations of the corners, px.
    """

    identity: int
    centre: Centre
    corners: Floats
    sigma: Floats


def dictionary(name: str) -> Any:
    """Give a dictionary of markers by its name; raises ConfigurationError for another name."""
    import cv2

    if name.lower() not in DICTIONARIES:
        raise ConfigurationError(f"marker dictionary {name!r} is not known", f"use {', '.join(DICTIONARIES)}")
    return cv2.aruco.getPredefinedDictionary(getattr(cv2.aruco, f"DICT_{name.upper()}"))


def find_markers(grey: Grey, dictionary_name: str) -> tuple[Marker, ...]:
    """Find the coded markers of a dictionary and measure them."""
    import cv2

    codes, grey = dictionary(dictionary_name), measurable(grey)
    parameters = cv2.aruco.DetectorParameters()
    parameters.errorCorrectionRate = 0.0
    parameters.cornerRefinementMethod = cv2.aruco.CORNER_REFINE_SUBPIX
    # Small cells are read from more samples than they have pixels: their edges lie between pixels.
    parameters.perspectiveRemovePixelPerCell = 8
    cells = int(codes.markerSize) + 2
    # A cell of a code has at least so many pixels.
    smallest_cell_px = 1.25
    # The library takes the shortest outline as a part of the longer side of the image, however large that is.
    parameters.minMarkerPerimeterRate = 4 * cells * smallest_cell_px / max(grey.shape)
    detected: Any = cv2.aruco.ArucoDetector(codes, parameters).detectMarkers(as_eight_bit(grey))
    corners, identities, _ = detected
    if identities is None:
        return ()
    by_identity: dict[int, list[Marker]] = {}
    # A marker whose picture differs from the ideal one by more than this part of its contrast is none.
    worst_misfit = 0.2
    for identity, quadrilateral in zip(np.ravel(identities), corners, strict=True):
        rough = np.asarray(quadrilateral, dtype=float).reshape(4, 2)
        # Cells are as wide across an edge as the code's border; along the edge perspective shows them longer.
        along = np.roll(rough, -1, axis=0) - rough
        before = np.roll(along, 1, axis=0)
        area = np.abs(before[:, 0] * along[:, 1] - before[:, 1] * along[:, 0])
        across = np.minimum(area, np.roll(area, -1)) / np.hypot(*along.T)
        measured = quadrilateral_centre(grey, rough, float(across.min()) / cells)
        if measured is None:
            continue
        centre, *refined = measured
        if centre.contrast < LEAST_CONTRAST or centre.noise > worst_misfit * centre.contrast:
            continue
        by_identity.setdefault(int(identity), []).append(Marker(int(identity), centre, *refined))
    return tuple(marks[0] for _, marks in sorted(by_identity.items()) if len(marks) == 1)


def find_coded_targets(
    sources: Sequence[ImageSource],
    lenses: Sequence[Camera],
    dictionary_name: str,
    names: Mapping[str, str],
) -> tuple[tuple[Mark, ...], tuple[str, ...]]:
    """Find coded targets in images: their middles, where the lens that is known of a camera shows them.

    lenses: camera of each image.
    """
    marks, strangers = [], []
    for source, lens in zip(sources, lenses, strict=True):
        targets = coded_targets(source, dictionary_name, partial(read_grey, source.path))
        places = targets[:, 1:3] + moved_by_bend(lens, targets[:, 5:].reshape(-1, 4, 2))
        for code, (x, y), (sx, sy) in zip(targets[:, 0], places.tolist(), targets[:, 3:5], strict=True):
            name = names.get(str(int(code)))
            if name is None:
                strangers.append(f"code {int(code)} in {source.path.name}")
            else:
                sigma = (math.hypot(sx, COMMON_PX), math.hypot(sy, COMMON_PX))
                marks.append(Mark(source.path.name, name, x, y, sigma, f"code {int(code)}"))
    return tuple(marks), tuple(strangers)


def _targets_key(source: ImageSource, dictionary_name: str) -> str:
    return combined_key(VERSION, "coded targets", source.key, dictionary_name)


def coded_targets_kept(source: ImageSource, dictionary_name: str) -> bool:
    """Whether the cache has the coded targets of an image."""
    return kept(source.cache, _targets_key(source, dictionary_name))


def coded_targets(source: ImageSource, dictionary_name: str, picture: Callable[[], Grey]) -> Floats:
    """Coded targets of an image, from the cache or found in its picture.

    returns (n, 13): code; column, row and their standard deviations; columns and rows of the corners; px.
    """

    def make() -> Arrays:
        """Find the coded targets of one picture."""
        rows = [
            (m.identity, m.centre.column, m.centre.row, *m.centre.sigma, *m.corners.ravel())
            for m in find_markers(picture(), dictionary_name)
        ]
        return {"targets": np.array(rows, dtype=float).reshape(-1, 13)}

    key = _targets_key(source, dictionary_name)
    return np.asarray(cached(source.cache, key, ("targets",), make)["targets"], dtype=np.float64)


# The window of a corner must not reach the next edge, nor be so large that the lens bends the edges.
_WINDOW = 0.4
_SMALLEST_WINDOW_PX, _LARGEST_WINDOW_PX = 2.5, 11.0
# Side of a ChArUco marker over that of a square.
_MARKER = 0.75


@dataclass(frozen=True)
class Board:
    """A flat board of squares.

    dictionary: of the ChArUco markers.
    """

    columns: int
    rows: int
    square_m: float
    kind: Literal["chessboard", "charuco"] = "chessboard"
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


def find_board(grey: Grey, board: Board) -> tuple[Integers, Floats, Floats] | None:
    """Find a board and measure its corners.

    returns: which of its inner corners, (n,); columns and rows, (n, 2); and their standard deviations, px.
    """
    grey, eight = measurable(grey), as_eight_bit(grey)
    rough = _chessboard(eight, board) if board.kind == "chessboard" else _charuco(eight, board)
    fewest_corners = 8
    if rough is None or len(rough[0]) < fewest_corners:
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
    if len(measured) < fewest_corners:
        return None
    pixels = np.array([(centre.column, centre.row) for centre in centres])
    return np.array(measured, dtype=np.int64), pixels, np.array([centre.sigma for centre in centres])


def charuco_board(board: Board) -> Any:
    """Make the detector library's form of a ChArUco board."""
    import cv2

    return cv2.aruco.CharucoBoard((board.columns, board.rows), 1.0, _MARKER, dictionary(board.dictionary))


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
        return np.asarray(nearest * (1 - _MARKER) / 2 * np.sqrt(2) / _WINDOW * 0.9)
    return nearest
