"""Control points that contradict the others: named, corrected, and the likely slip of the pen."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from drivers.errors import PhotocalError
from photocal.block.model import Block
from photocal.georeferencing.differences import CRITICAL_POINT, differences
from photocal.georeferencing.methods import checkable, of_method, with_roles
from photocal.georeferencing.plausible import by_start_values

Floats = NDArray[np.float64]

# With fewer control points a contradiction cannot be laid at the door of one of them.
_FEWEST = 5
_MOST_REMOVED = 3
# Less than this many times the stated sigma is a poor point, not a wrong one.
_WRONG = 10.0
# A point this far from where the start values see it, against all control points, spoils the iteration.
_FAR, _FAR_M = 10.0, 5.0
# A slip explains a coordinate when it comes this near, in standard deviations.
_NEAR = 4.0


@dataclass(frozen=True)
class Mistyped:
    """A control point whose coordinates do not fit the others.

    Attributes
    ----------
    d, sigma : ndarray, shape (3,)
        Given less computed from the other points, and its standard deviation, m.
    slips : tuple of str
        The likely slips, "code axis given wanted"; empty when none explains it.
    """

    point: str
    d: Floats
    sigma: Floats
    slips: tuple[str, ...]


def mistyped_control(block: Block, given: Floats) -> tuple[Block, tuple[Mistyped, ...]]:
    """Find control points that contradict the other ones.

    Image observations and control are adjusted alone, so that nothing else can be to blame; the point that
    fits worst is taken out and judged by the others, until all fit. Nothing is named when more than
    three are in contradiction: then it is not the points.
    """
    found: list[Mistyped] = []
    current = block
    to_given = _to_given(block.points.values, given)
    for _ in range(_MOST_REMOVED + 1):
        try:
            far = _far_away(current)
            worst = _worst(current) if far is None else far
        except PhotocalError:
            return block, ()
        if worst is None:
            return (current, tuple(found)) if found else (block, ())
        control = np.flatnonzero(current.points.of_role("control"))
        current = checkable(with_roles(current, control[control != worst]))
        one = _judged(current, worst, given[worst], to_given)
        if one is None:
            return block, ()
        found.append(one)
    return block, ()


def _far_away(block: Block) -> int | None:
    """Index of a control point so far from where the given orientations see it that no adjustment ends."""
    control = np.flatnonzero(block.points.of_role("control"))
    if len(control) < _FEWEST:
        return None
    apart = np.linalg.norm(by_start_values(block).xyz_m[control] - block.points.values[control], axis=1)
    if not np.isfinite(apart).any():
        return None
    usual = float(np.nanmedian(apart))
    k = int(np.nanargmax(apart))
    return int(control[k]) if apart[k] > max(_FAR_M, _FAR * usual) else None


def _worst(block: Block) -> int | None:
    """Index of the control point that fits worst, None when all fit; refuses too few of them."""
    fitted = differences(block, of_method(block, "indirect"), "control")
    enough = len(fitted.names) >= _FEWEST
    distance = np.nan_to_num(fitted.distance)
    if not enough or not len(distance) or distance.max() <= CRITICAL_POINT:
        return None
    return block.points.names.index(fitted.names[int(distance.argmax())])


def _judged(block: Block, point: int, given: Floats, to_given: Floats) -> Mistyped | None:
    """The point against what the others say of it; None when it is not plainly wrong."""
    name = block.points.names[point]
    try:
        check = differences(block, of_method(block, "indirect"), "check")
    except PhotocalError:
        return None
    if name not in check.names:
        return None
    k = check.names.index(name)
    d, sigma = check.d[k], np.sqrt(np.diagonal(check.covariance[k]))
    stated = np.where(np.isfinite(block.points.sigma[point]), block.points.sigma[point], np.inf)
    if not np.any((np.abs(d) > _WRONG * stated) & (np.abs(d) > _NEAR * sigma)):
        return None
    return Mistyped(name, d, sigma, _slips(given, given - to_given @ d, sigma))


def _to_given(local: Floats, given: Floats) -> Floats:
    """Derivative of the given coordinates by the local ones, (3, 3), from the points themselves."""
    known = np.isfinite(local).all(axis=1) & np.isfinite(given).all(axis=1)
    a, b = (values[known] - values[known].mean(axis=0) for values in (local, given))
    if np.linalg.matrix_rank(a) < 3:
        return np.eye(3)
    return np.asarray(np.linalg.lstsq(a, b, rcond=None)[0].T)


def _slips(given: Floats, wanted: Floats, sigma: Floats) -> tuple[str, ...]:
    """Name the slips of the pen that made the given coordinates of the wanted ones, see `Mistyped`."""
    tolerance = _NEAR * sigma
    wrong = np.abs(given - wanted) > tolerance
    for a, b in ((0, 1), (0, 2), (1, 2)):
        changed = given.copy()
        changed[[a, b]] = given[[b, a]]
        if wrong[a] and wrong[b] and np.all(np.abs(changed - wanted) <= tolerance):
            return (f"exchanged {'XYZ'[a]} {'XYZ'[b]}",)
    near = tolerance.tolist()
    slips = [(k, _digit_slip(float(given[k]), float(wanted[k]), near[k])) for k in np.flatnonzero(wrong)]
    if not all(slip for _, slip in slips):
        return ()
    return tuple(f"{slip[0]} {'XYZ'[k]} {' '.join(slip[1:])}" for k, slip in slips)


def _digit_slip(given: float, wanted: float, tolerance: float) -> tuple[str, ...]:
    """Two digits swapped, one digit or the sign wrong, feet for metres: code, given, nearly wanted value."""
    text = f"{given:.3f}"
    places = [i for i, mark in enumerate(text) if mark.isdigit()]
    for i, j in pairwise(places):
        marks = list(text)
        marks[i], marks[j] = marks[j], marks[i]
        swapped = "".join(marks)
        if swapped != text and abs(float(swapped) - wanted) <= tolerance:
            return "digits-exchanged", text, swapped
    if abs(-given - wanted) <= tolerance:
        return "sign", text, f"{-given:.3f}"
    if abs(given * 0.3048 - wanted) <= tolerance:
        return "feet", text, f"{given * 0.3048:.3f}"
    for i in places:
        for digit in "0123456789":
            other = f"{text[:i]}{digit}{text[i + 1 :]}"
            if digit != text[i] and abs(float(other) - wanted) <= tolerance:
                return "one-digit", text, other
    return ()
