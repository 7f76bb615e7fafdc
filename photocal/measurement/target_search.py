"""Uncoded targets of a known look, searched in a part of an image.

Centres of circles and rings in perspective.
"""

from collections.abc import Iterator
from functools import partial

import numpy as np

from photocal.base.arrays import Floats
from photocal.measurement import target_centre
from photocal.measurement.image_file import Grey
from photocal.measurement.target_centre import (
    FLAT,
    LEAST_CONTRAST,
    Centre,
    TargetImage,
    Window,
    accepted,
    cut_window,
    fit_template,
    half_contrast,
)


def round_centre(
    grey: Grey,
    approximate: tuple[float, float],
    semi_axes: tuple[float, float],
    direction: float = 0.0,
    bend: Floats = FLAT,
    margin: float | None = None,
    hole: float = 0.0,
) -> Centre | None:
    """Centre of a filled circle in perspective; with a hole, a part of its size, of a ring.

    margin: even ground around it that may be used, px; None: as much as a window of the usual size has.
    """
    longest = max(semi_axes)
    window = cut_window(grey, approximate, longest + (max(3.0, 0.35 * longest) if margin is None else margin))
    if window is not None and margin is not None:
        x, y = approximate[0] - window.middle[0], approximate[1] - window.middle[1]
        outline = np.array([x, y, *_extent(semi_axes, direction)])
        window = window.rows(target_centre.inside_circle(outline, window.x, window.y) >= -margin)
    if window is None:
        return None
    filled = (hole, 1.0) if hole else (0.0, 0.6)
    start, sizes = _round_start(window, approximate, semi_axes, direction, filled)
    if not np.isfinite(start).all():
        return None
    if hole:
        start, sizes = np.insert(start, 5, hole), np.insert(sizes, 5, 0.1)
    template = partial(target_centre.ring if hole else target_centre.disc, bend=bend)
    fit = fit_template(window, template, start, sizes)
    if fit is None:
        return None
    outline = _axes(fit.parameters[2:5])
    alike = all(0.5 < a / b < 2 for a, b in zip(outline[:2], sorted(semi_axes)[::-1], strict=True))
    if not alike or (hole and not 0.05 < fit.parameters[5] < 0.95):
        return None
    farthest = longest * (1 - hole) / 2 + 1
    shape = np.r_[outline, fit.parameters[5:-2]]
    return accepted(window, fit, abs(fit.parameters[-1]), approximate, farthest, shape)


def _round_start(
    window: Window,
    approximate: tuple[float, float],
    semi_axes: tuple[float, float],
    direction: float,
    filled: tuple[float, float],
) -> tuple[Floats, Floats]:
    """Parameters of a disc to start from, and their sizes; NaN where a part of the picture has no pixel."""
    # `filled` tells between which parts of the radius the picture is inside.
    x, y = approximate[0] - window.middle[0], approximate[1] - window.middle[1]
    outline = np.array([x, y, *_extent(semi_axes, direction)])
    depth = target_centre.inside_circle(outline, window.x, window.y)
    shortest = min(semi_axes)
    inside = (depth >= (1 - filled[1]) * shortest) & (depth <= (1 - filled[0]) * shortest)
    outside = depth < -min(1.5, -depth.min() / 2)
    within, beside = (float(np.median(window.grey[m])) if m.any() else np.nan for m in (inside, outside))
    half = half_contrast(window)
    return np.r_[outline, 0.7, beside, within - beside], np.array([1, 1, 1, 1, 1, 0.5, half, half])


def _extent(semi_axes: tuple[float, float], direction: float) -> tuple[float, float, float]:
    """The symmetric matrix (xx, xy, yy) that takes the unit circle to an ellipse."""
    (a, b), cos, sin = semi_axes, np.cos(direction), np.sin(direction)
    return float(a * cos**2 + b * sin**2), float((a - b) * cos * sin), float(a * sin**2 + b * cos**2)


def _axes(extent: Floats) -> Floats:
    """The longer and the shorter semi-axis of an ellipse, and the direction of the longer one."""
    values, vectors = np.linalg.eigh(np.array([[extent[0], extent[1]], [extent[1], extent[2]]]))
    return np.array([values[1], values[0], np.arctan2(vectors[1, 1], vectors[0, 1])])


def saddle_centre(grey: Grey, approximate: tuple[float, float], radius: float) -> Centre | None:
    """Centre of a chessboard corner or an hourglass mark."""
    window = cut_window(grey, approximate, radius)
    if window is None:
        return None
    x, y = approximate[0] - window.middle[0], approximate[1] - window.middle[1]
    # The second harmonic around the centre gives the bisector of the light fields.
    angle = np.arctan2(window.y - y, window.x - x)
    wave = np.sum((window.grey - window.grey.mean()) * np.exp(2j * angle))
    bisector = 0.5 * float(np.angle(wave))
    half = half_contrast(window)
    # The product of the two edge functions is negative between the directions, positive beside them.
    start = np.array([x, y, bisector - np.pi / 4, bisector + np.pi / 4, 1.0, window.grey.mean(), -half])
    sizes = np.array([1, 1, 0.3, 0.3, 0.5, half, half])
    fit = fit_template(window, target_centre.saddle, start, sizes)
    if fit is None or abs(np.sin(fit.parameters[2] - fit.parameters[3])) < 0.2:
        return None
    return accepted(window, fit, 2 * abs(fit.parameters[6]), approximate, radius / 2, fit.parameters[2:5])


def cross_centre(
    grey: Grey, approximate: tuple[float, float], size: float, width: float | None = None, bend: Floats = FLAT
) -> Centre | None:
    """Centre of a cross of two bars."""
    window = cut_window(grey, approximate, size / 2)
    if window is None:
        return None
    x, y = approximate[0] - window.middle[0], approximate[1] - window.middle[1]
    half, broad = half_contrast(window), width or size / 5
    low, high = np.quantile(window.grey, [0.1, 0.9])
    sizes = np.array([1, 1, 0.3, 0.3, 1, 0.5, half, half])
    fits, template = [], partial(target_centre.cross, bend=bend)
    for turn in np.arange(0, np.pi / 2, np.pi / 8):
        for beside, contrast in ((low, high - low), (high, low - high)):
            start = np.array([x, y, turn, turn + np.pi / 2, broad, 1.0, beside, contrast])
            left = window.grey - template(start, window.x, window.y)
            fits.append((float(left @ left), start))
    _, start = min(fits, key=lambda pair: pair[0])
    fit = fit_template(window, template, start, sizes)
    if fit is None or not 0.3 * broad < fit.parameters[4] < 3 * broad:
        return None
    if abs(np.sin(fit.parameters[2] - fit.parameters[3])) < 0.4:
        return None
    return accepted(window, fit, abs(fit.parameters[7]), approximate, size / 4, fit.parameters[2:6])


Place = tuple[float, float]

# Of the places that may show the target this part of a plane normal distribution is searched: 99.9 %.
WITHIN = float(np.sqrt(-2 * np.log(0.001)))
# Correlation with the ideal picture: of a place that is worth a fit, less for small targets, whose pixels
# and turn are coarse; and of a target after the fit. A disc has the least form of all: it must fit best.
WORTH, WORTH_SMALL = 0.70, 0.62
LIKE = {"disc": 0.92, "ring": 0.85, "cross": 0.85, "hourglass": 0.85}
# The picture must explain the grey values: noise as a part of the contrast.
WORST_MISFIT = {"disc": 0.10, "ring": 0.12, "cross": 0.12, "hourglass": 0.12}
# Edges of a target are sharp, px or parts of its size; a small dark spot whose edges fill it is a blot.
_BLUNTEST_PX, _BLUNTEST_PART, _BLOT_PART = 1.8, 0.06, 0.14
# Sizes agree to this part, and this many pixels of blur.
_SIZE, _SIZE_PX = 0.15, 0.5
# So do both axes of a circle with each other, whatever the scale; ground slopes, and pixels are coarse.
_OUT_OF_ROUND, _OUT_OF_ROUND_PX = 0.10, 0.5
# Angles on the target, radians, and the part of a cross or ring.
_ANGLE, _PART = 0.22, 0.3
# Windows of fits, as parts of the shortest half side: nothing beside the target gets in.
_CROSS, _HOURGLASS = 0.92, 0.85


def find_targets(grey: Grey, place: Place, covariance: Floats, look: TargetImage) -> tuple[Centre, ...]:
    """Find all targets of a look where one is predicted."""
    inverse = np.linalg.inv(covariance + 1e-6 * np.eye(2))
    candidates: list[tuple[float, Centre]] = []
    for start, turn in _worth_a_fit(grey, place, covariance, look):
        centre = _fitted(grey, start, look)
        if centre is not None:
            # A window that is laid around the centre has the same of the ground on all sides.
            centre = _fitted(grey, (centre.column, centre.row), look)
        if centre is None or not (_clear(centre, look) and _agrees(centre, look)):
            continue
        away = np.array([centre.column - place[0], centre.row - place[1]])
        likeness = _likeness(grey, centre, look, turn)
        if away @ inverse @ away <= WITHIN**2 and likeness >= LIKE[look.kind]:
            candidates.append((likeness, centre))
    kept: list[Centre] = []
    for _, centre in sorted(candidates, key=lambda candidate: -candidate[0]):
        if all(
            np.hypot(centre.column - other.column, centre.row - other.row) >= look.size / 3 for other in kept
        ):
            kept.append(centre)
    return tuple(kept)


def _worth_a_fit(
    grey: Grey, place: Place, covariance: Floats, look: TargetImage
) -> Iterator[tuple[Place, float]]:
    """Places where the image is like the target, with its turn; those that are likest first."""
    import cv2

    # Large targets are searched for in a reduced image, where they are as long as this, px.
    sought_px = 24.0
    factor = max(look.size / sought_px, 1.0)
    small = look.smaller(factor)
    reach = np.array(small.reach)
    height, width = grey.shape
    half = WITHIN * np.sqrt(np.diag(covariance)) + factor * (reach + 2)
    left, top = (max(int(np.floor(v)), 0) for v in np.array(place) - half)
    right, bottom = (
        min(int(np.ceil(v)) + 1, n) for v, n in zip(np.array(place) + half, (width, height), strict=True)
    )
    if min(right - left, bottom - top) < 2:
        return
    part = grey[top:bottom, left:right].astype(np.float32)
    if factor > 1:
        rows, columns = (max(round(n / factor), 1) for n in part.shape)
        part = np.asarray(cv2.resize(part, (columns, rows), interpolation=cv2.INTER_AREA), np.float32)
    zoom = np.array([(right - left) / part.shape[1], (bottom - top) / part.shape[0]])
    if (np.array(part.shape) < 2 * reach[::-1] + 1).any():
        return
    likeness = np.stack(
        [
            np.abs(cv2.matchTemplate(part, small.picture(t).astype(np.float32), cv2.TM_CCOEFF_NORMED))
            for t in look.turns
        ]
    )
    # Even ground divides by zero.
    likeness[~np.isfinite(likeness)] = 0
    best, which = likeness.max(axis=0), likeness.argmax(axis=0)
    around = np.ones((3, 3), np.uint8)
    # Targets that count as small.
    small_px = 18.0
    worth = WORTH if look.size >= small_px else WORTH_SMALL
    peaks = np.argwhere((best >= worth) & (best <= 1.001) & (best == cv2.dilate(best, around)))
    # More places than this in a window are texture; the likest are tried.
    most = 15
    order = np.argsort(-best[peaks[:, 0], peaks[:, 1]], kind="stable")[:most]
    for row, column in peaks[order]:
        middle = (np.array([column, row]) + reach + 0.5) * zoom - 0.5 + [left, top]
        yield (float(middle[0]), float(middle[1])), float(look.turns[which[row, column]])


def _clear(centre: Centre, look: TargetImage) -> bool:
    blur = abs(float(centre.shape[-1]))
    sharp = blur <= min(max(_BLUNTEST_PX, _BLUNTEST_PART * look.size), _BLOT_PART * look.size)
    plain = centre.noise <= WORST_MISFIT[look.kind] * centre.contrast
    return sharp and plain and centre.contrast >= LEAST_CONTRAST


def _likeness(grey: Grey, centre: Centre, look: TargetImage, turn: float) -> float:
    """Correlation of the image about a centre with the ideal picture there."""
    column, row = round(centre.column), round(centre.row)
    columns, rows = look.reach
    if not (columns <= column < grey.shape[1] - columns and rows <= row < grey.shape[0] - rows):
        return 0.0
    if look.kind == "cross":
        turn = look.in_plane(float(centre.shape[0]))
    elif look.kind == "hourglass":
        # Its axis halves the angle between the sides, on the side where the search had it.
        sides = [look.in_plane(float(angle)) for angle in centre.shape[:2]]
        axis = 0.5 * (sides[0] + sides[1])
        turn = axis + np.pi / 2 * round(2 * (turn - axis) / np.pi)
    aside = (centre.column - column, centre.row - row)
    ideal, covered = look.picture(turn, aside, max(abs(float(centre.shape[-1])), 0.3)), look.covered(aside)
    seen = grey[row - rows : row + rows + 1, column - columns : column + columns + 1]
    return abs(float(np.corrcoef(ideal[covered], seen[covered])[0, 1]))


def _fitted(grey: Grey, place: Place, look: TargetImage) -> Centre | None:
    if look.kind == "cross":
        size = 2 * _CROSS * look.semi_axes[1]
        return cross_centre(grey, place, size, look.part * look.size, look.bend)
    if look.kind == "hourglass":
        return saddle_centre(grey, place, _HOURGLASS * look.semi_axes[1])
    hole = look.part if look.kind == "ring" else 0.0
    return round_centre(grey, place, look.semi_axes, look.direction, look.bend, look.margin, hole)


def _agrees(centre: Centre, look: TargetImage) -> bool:
    """Whether what was fitted has the form and the size of the target."""
    if look.kind in ("disc", "ring"):
        hollow = look.kind == "disc" or abs(centre.shape[3] / look.part - 1) <= _PART
        return _round(centre, look) and bool(hollow)
    wide = look.part * look.size
    broad = look.kind == "hourglass" or abs(centre.shape[2] - wide) <= _PART * wide + _SIZE_PX
    # The two lines are perpendicular in the target's plane.
    first, second = (look.in_plane(float(angle)) for angle in centre.shape[:2])
    return bool(broad and abs(np.cos(first - second)) <= np.sin(_ANGLE))


def _round(centre: Centre, look: TargetImage) -> bool:
    """Whether an ellipse is a circle of the right size in the target's plane."""
    a, b, direction = centre.shape[:3]
    turn = np.array([[np.cos(direction), -np.sin(direction)], [np.sin(direction), np.cos(direction)]])
    radii = np.linalg.svd(np.linalg.solve(look.affine, turn @ np.diag([a, b])), compute_uv=False)
    even = radii.max() <= radii.min() * (1 + _OUT_OF_ROUND + _OUT_OF_ROUND_PX / look.size)
    return bool(even and (np.abs(radii - 1) <= _SIZE + _SIZE_PX / look.semi_axes[1]).all())
