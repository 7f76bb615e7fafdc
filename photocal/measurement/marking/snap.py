"""From a click to the centre of the target beneath it."""

import math
from collections.abc import Iterator
from dataclasses import replace
from typing import Literal, get_args

import numpy as np

from photocal.base.arrays import Floats
from photocal.measurement.image_file import Grey
from photocal.measurement.markers import COMMON_PX, find_markers
from photocal.measurement.target_centre import FLAT, HOLE, Centre
from photocal.measurement.target_search import cross_centre, round_centre, saddle_centre

Kind = Literal["cross", "hourglass", "circle", "ring", "code"]
KINDS: tuple[Kind, ...] = get_args(Kind)
_SIMPLE: tuple[Kind, ...] = ("cross", "hourglass", "circle")
_HOLLOW: tuple[Kind, ...] = ("ring",)
# Sizes of targets that are tried, px: each half as large again as the one before; from the smallest at which
# the picture of a kind still has its form.
SIZES = (8.0, 12.0, 18.0, 27.0, 40.0, 60.0)
SMALLEST_PX: dict[Kind, float] = {"circle": 8.0, "cross": 8.0, "ring": 12.0, "hourglass": 8.0}
# Codes that are tried when the project names none.
DICTIONARIES = ("apriltag_36h11", "4x4_1000", "5x5_1000", "6x6_1000")
# Even ground around circles and rings that is used once their size is known: px, and as a part of it.
_BESIDE_PX, _BESIDE = 1.5, 0.13
# Edges of a target are sharp, px or parts of its size; blots of soil and leaves are not.
BLUNTEST_PX, BLUNTEST_PART = 1.6, 0.06


def snap(
    grey: Grey,
    place: tuple[float, float],
    reach: float,
    kinds: tuple[Kind, ...] = KINDS,
    dictionaries: tuple[str, ...] = DICTIONARIES,
    bend: Floats = FLAT,
) -> tuple[Kind, Centre] | None:
    """Find the target at a place and its centre, whose covariance has what all targets have in common."""
    # All kinds and sizes are fitted; of those whose picture fits, the one that determines the centre best is
    # taken.
    if "code" in kinds:
        # A code is proven by its bits; its border alone could pass for something else.
        codes = [c for c in _codes(grey, place, reach, dictionaries) if _good(c, place, reach)]
        if codes:
            return _snapped("code", min(codes, key=_variance))
    best: tuple[Kind, Centre] | None = None
    in_vain = 0
    # Targets look the same when turned by 180 degrees: what is less alike (correlation) is not fitted at all.
    least_alike = 0.75
    # The search ends when so many larger sizes in a row determine the centre no better.
    most_in_vain = 2
    for size in SIZES:
        middle, likeness = symmetric_place(grey, place, reach, size / 2)
        # Of small targets there may be several within reach: the one that was clicked counts, too.
        starts = (place, middle) if size <= 2 * reach else (middle,)
        fits: list[tuple[Kind, Centre]] = []
        # A ring is none where something simpler fits.
        for group in (_SIMPLE, _HOLLOW) if likeness >= least_alike else ():
            fits = fits or [
                (kind, centre)
                for kind in kinds
                if kind in group and size >= SMALLEST_PX[kind]
                for start in starts
                for centre in [_fitted(kind, grey, start, size, bend)]
                if centre is not None and _good(centre, place, reach) and _sharp(kind, centre, size)
            ]
        better = min(fits, key=lambda fit: _variance(fit[1]), default=None)
        if better is not None and (best is None or _variance(better[1]) < _variance(best[1])):
            best, in_vain = better, 0
        elif best is not None:
            in_vain += 1
        if in_vain == most_in_vain:
            break
    return None if best is None else _snapped(*best)


def _fitted(kind: Kind, grey: Grey, start: tuple[float, float], size: float, bend: Floats) -> Centre | None:
    """Fit a kind of target, and again in a window that is laid around it, as large as it is."""
    rough = _fit(kind, grey, start, size, bend)
    if rough is None:
        return None
    place = (rough.column, rough.row)
    if kind not in ("circle", "ring"):
        return _fit(kind, grey, place, size, bend)
    a, b, direction = (float(value) for value in rough.shape[:3])
    margin = max(_BESIDE_PX, _BESIDE * (a + b))
    hole = float(rough.shape[3]) if kind == "ring" else 0.0
    return round_centre(grey, place, (a, b), direction, bend, margin, hole)


def _sharp(kind: Kind, centre: Centre, size: float) -> bool:
    # The blur stands last among the parameters of all pictures.
    blur = abs(float(centre.shape[-1]))
    across = float(centre.shape[:2].sum()) if kind == "circle" else size
    # A circle or hourglass whose edges fill it is a blot itself: as a part of its size.
    blot_part = 0.13
    blot = kind in ("circle", "hourglass") and blur > blot_part * across
    return not blot and blur <= max(BLUNTEST_PX, BLUNTEST_PART * size)


def _variance(centre: Centre) -> float:
    return float(np.trace(centre.covariance))


def _snapped(kind: Kind, centre: Centre) -> tuple[Kind, Centre]:
    return kind, replace(centre, covariance=centre.covariance + COMMON_PX**2 * np.eye(2))


def symmetric_place(
    grey: Grey, place: tuple[float, float], reach: float, radius: float
) -> tuple[tuple[float, float], float]:
    """Find the pixel about which an image is most alike when turned by 180 degrees, as targets are."""
    far, r = math.ceil(reach), math.ceil(radius)
    column, row = round(place[0]), round(place[1])
    height, width = grey.shape
    if not (far + r <= column < width - far - r and far + r <= row < height - far - r):
        return place, 1.0
    cut = grey[row - far - r : row + far + r + 1, column - far - r : column + far + r + 1].astype(np.float32)
    windows = np.lib.stride_tricks.sliding_window_view(cut, (2 * r + 1, 2 * r + 1))
    centred = windows - windows.mean(axis=(2, 3), keepdims=True)
    energy = np.einsum("abij,abij->ab", centred, centred)
    likeness = np.einsum("abij,abij->ab", centred, centred[:, :, ::-1, ::-1]) / np.maximum(energy, 1e-6)
    # Straight edges are alike, too, and so is even ground: only where the grey values vary both ways.
    down, right = np.gradient(cut)
    cells = [np.lib.stride_tricks.sliding_window_view(g, (2 * r + 1, 2 * r + 1)) for g in (right, down)]
    xx, xy, yy = (np.einsum("abij,abij->ab", cells[i], cells[j]) for i, j in ((0, 0), (0, 1), (1, 1)))
    weaker = (xx + yy) / 2 - np.hypot((xx - yy) / 2, xy)
    aside = np.hypot(*np.mgrid[-far : far + 1, -far : far + 1])
    score = np.where(aside <= reach, likeness * np.maximum(weaker, 0) ** 0.25, -1)
    down_by, right_by = np.unravel_index(int(score.argmax()), score.shape)
    middle = (float(column - far + right_by), float(row - far + down_by))
    return middle, float(likeness[aside <= reach].max())


def _good(centre: Centre, place: tuple[float, float], reach: float) -> bool:
    near = math.hypot(centre.column - place[0], centre.row - place[1]) <= reach
    # The picture of the target must explain the grey values: noise in parts of the contrast.
    worst_misfit = 0.15
    least_contrast = 12.0
    clear = centre.contrast >= least_contrast and centre.noise <= worst_misfit * centre.contrast
    # Who clicks knows better than this, px.
    coarsest_px = 0.1
    return near and clear and max(centre.sigma) <= coarsest_px


def _fit(kind: Kind, grey: Grey, place: tuple[float, float], size: float, bend: Floats) -> Centre | None:
    if kind == "cross":
        return cross_centre(grey, place, size, bend=bend)
    if kind == "hourglass":
        # Straight lines stay straight.
        return saddle_centre(grey, place, size / 2)
    return round_centre(grey, place, (size / 2, size / 2), bend=bend, hole=HOLE if kind == "ring" else 0.0)


def _codes(
    grey: Grey, place: tuple[float, float], reach: float, dictionaries: tuple[str, ...]
) -> Iterator[Centre]:
    """Find codes in the part of the image that a target of the largest size would cover."""
    height, width = grey.shape
    far = reach + SIZES[-1]
    left, top = (max(math.floor(p - far), 0) for p in place)
    right, bottom = (min(math.ceil(p + far) + 1, n) for p, n in zip(place, (width, height), strict=True))
    if right - left < SIZES[0] or bottom - top < SIZES[0]:
        return
    # The detector wants rows one after the other in memory.
    part = grey[top:bottom, left:right].copy()
    for name in dictionaries:
        for marker in find_markers(part, name):
            centre = marker.centre
            yield replace(centre, column=centre.column + left, row=centre.row + top)
