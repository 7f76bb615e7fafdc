"""Coded markers, ArUco and AprilTag: identity, centre and corners."""

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from photocal.base.arrays import Floats
from photocal.base.errors import ConfigurationError
from photocal.base.workers import Workers, run_tasks
from photocal.exchange.parts import Mark
from photocal.measurement import target_patterns
from photocal.measurement.features import Arrays, cached, combined_key
from photocal.measurement.image_file import Grey, as_eight_bit, read_grey
from photocal.measurement.patch_matching import Source
from photocal.measurement.target_centre import LEAST_CONTRAST, Centre, accepted, half_contrast, measurable
from photocal.measurement.template_fit import cut_part, fit_template

DICTIONARIES = (
    *(f"{n}x{n}_{count}" for n in (4, 5, 6, 7) for count in (50, 100, 250, 1000)),
    "apriltag_16h5",
    "apriltag_25h9",
    "apriltag_36h10",
    "apriltag_36h11",
    "aruco_original",
    "aruco_mip_36h12",
)
# Raised whenever the meaning of cached results changes.
VERSION = 4
# Plates are not flat and lenses not modelled to the last: what the grey values cannot know, px.
COMMON_PX = 0.02


def quadrilateral_centre(grey: Grey, corners: Floats, cell: float) -> tuple[Centre, Floats] | None:
    """Centre and corners of a dark quadrilateral, such as the border of a coded marker."""
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
    window = window.rows(np.abs(depth) <= max(0.75 * cell, 1.5))
    if len(window.grey) < 20:
        return None
    half = half_contrast(window)
    edges = np.column_stack([np.arctan2(normal[:, 1], normal[:, 0]), distance]).ravel()
    light, dark = np.quantile(window.grey, [0.9, 0.1])
    start = np.concatenate([edges, [0.7, light, dark - light]])
    side = float(np.hypot(*along.T).mean())
    sizes = np.array([1 / side, 1] * 4 + [0.5, half, half])
    fit = fit_template(window, target_patterns.quadrilateral, start, sizes)
    if fit is None or fit.parameters[10] > 0:
        return None
    fitted = _corners(fit.parameters)
    if np.abs(fitted - local).max() > max(2.0, 0.15 * side):
        return None
    step = np.eye(11) * 1e-5
    slope = np.column_stack(
        [(_diagonals(fit.parameters + s) - _diagonals(fit.parameters - s)) / 2e-5 for s in step]
    )
    place = _diagonals(fit.parameters)
    refined = replace(fit, parameters=place, cofactor=slope @ fit.cofactor @ slope.T)
    target = (float(middle[0]), float(middle[1]))
    centre = accepted(window, refined, -fit.parameters[10], target, 0.15 * side + 1, fit.parameters[:9])
    return None if centre is None else (centre, fitted + window.middle)


def _corners(p: Floats) -> Floats:
    lines = np.array([[np.cos(p[2 * k]), np.sin(p[2 * k]), p[2 * k + 1]] for k in range(4)])
    # Edge k runs from corner k to corner k + 1.
    meeting = np.cross(np.roll(lines, 1, axis=0), lines)
    return np.asarray(meeting[:, :2] / meeting[:, 2:])


def _diagonals(p: Floats) -> Floats:
    corners = np.column_stack([_corners(p), np.ones(4)])
    meeting = np.cross(np.cross(corners[0], corners[2]), np.cross(corners[1], corners[3]))
    return np.asarray(meeting[:2] / meeting[2])


@dataclass(frozen=True)
class Marker:
    """A coded marker in an image.

    corners (4, 2): columns and rows, px, clockwise from the marker's own first corner.
    """

    identity: int
    centre: Centre
    corners: Floats


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
        side = float(np.hypot(*(np.roll(rough, -1, axis=0) - rough).T).min())
        measured = quadrilateral_centre(grey, rough, side / cells)
        if measured is None:
            continue
        centre, refined = measured
        if centre.contrast < LEAST_CONTRAST or centre.noise > worst_misfit * centre.contrast:
            continue
        by_identity.setdefault(int(identity), []).append(Marker(int(identity), centre, refined))
    return tuple(marks[0] for _, marks in sorted(by_identity.items()) if len(marks) == 1)


def find_coded_targets(
    sources: Sequence[Source],
    dictionary_name: str,
    names: Mapping[str, str],
    processes: Workers,
    done: Callable[[float], None],
) -> tuple[tuple[Mark, ...], tuple[str, ...]]:
    """Find coded targets in images."""
    dictionary(dictionary_name)
    marks, strangers = [], []
    tasks = ((source, dictionary_name) for source in sources)
    for source, targets in zip(sources, run_tasks(_find, tasks, processes, done), strict=True):
        for code, x, y, sx, sy in targets.tolist():
            name = names.get(str(int(code)))
            if name is None:
                strangers.append(f"code {int(code)} in {source.path.name}")
            else:
                sigma = (math.hypot(sx, COMMON_PX), math.hypot(sy, COMMON_PX))
                marks.append(Mark(source.path.name, name, x, y, sigma, f"code {int(code)}"))
    return tuple(marks), tuple(strangers)


def _find(task: tuple[Source, str]) -> Floats:
    source, dictionary_name = task

    def make() -> Arrays:
        """Find the coded targets of one picture."""
        markers = find_markers(read_grey(source.path), dictionary_name)
        rows = [(m.identity, m.centre.column, m.centre.row, *m.centre.sigma) for m in markers]
        return {"targets": np.array(rows, dtype=float).reshape(-1, 5)}

    key = combined_key(VERSION, "coded targets", source.key, dictionary_name)
    return np.asarray(cached(source.cache, key, ("targets",), make)["targets"], dtype=np.float64)
