"""Systematic errors as mistakes of a field day: antenna height, base station, axes of the lever arm."""

from __future__ import annotations

from itertools import permutations, product

import numpy as np
from numpy.typing import NDArray

from photocal.accuracy.findings import Finding
from photocal.georeferencing.freed_groups import CHANGE, Estimate
from photocal.georeferencing.hypotheses import Hypothesis
from photocal.georeferencing.systematic import SystematicError

Floats = NDArray[np.float64]

# An estimate is the permuted given one when it comes this near: standard deviations, and metres at least.
_NEAR, _NEAR_M = 4.0, 0.02
# Below this a shift is no mistake of a person.
_NOTEWORTHY_M = 0.03
_AXES = ("forward", "right", "down")


def fault_of(error: SystematicError) -> Finding | None:
    """Name the mistake that a systematic error looks like."""
    same = (error.found, *error.alternatives)
    shift = next((one for one in same if one.name == "datum shift"), None)
    if shift is None:
        return _swapped_axes(error.found.estimates) if error.found.name == "lever arm" else None
    # What explains as much as a shift in plane leaves no mistake of the base alone.
    alone = error.found.name == "datum shift" and not error.alternatives
    change = next((one for one in same if one.name == CHANGE), None)
    return _shift(shift.estimates, alone, "" if change is None else _or_change(change))


def _or_change(change: Hypothesis) -> str:
    """Add what looks the same where the camera is calibrated over two heights."""
    before, after = change.estimates
    percent = 100.0 * (after.value / before.value - 1.0)
    return (
        f" A principal distance that changed by {percent:+.2f} % ({after.name}) would explain it as well "
        "(camera-change)."
    )


def _shift(estimates: tuple[Estimate, ...], in_plane: bool, besides: str) -> Finding | None:
    """A shift common to all positions: of the height alone, or of the base."""
    axes = {one.name.removeprefix("shift_"): one for one in estimates}
    noteworthy = {
        axis for axis, one in axes.items() if one.significant and abs(one.correction) > _NOTEWORTHY_M
    }
    if noteworthy == {"z"}:
        z = axes["z"]
        side = "above" if z.correction > 0 else "below"
        return Finding(
            "antenna-height",
            f"all GNSS positions lie {abs(z.correction):.3f} +- {z.sigma:.3f} m {side} what the control "
            "says, and in plane they agree: an antenna height (of the base or on the vehicle), "
            f"ellipsoidal against geoid heights, or the vertical lever arm.{besides}",
        )
    if not noteworthy or not in_plane:
        return None
    shift = ", ".join(
        f"{axis.upper()} {one.correction:+.3f} +- {one.sigma:.3f}" for axis, one in axes.items()
    )
    return Finding(
        "base-position",
        f"all GNSS positions are shifted against the control by {shift} m: the coordinates of the base "
        "station, or its datum or epoch, are not those of the control.",
    )


def _swapped_axes(estimates: tuple[Estimate, ...]) -> Finding | None:
    """A lever arm that was given with its axes in another order or with another sign."""
    value = np.array([one.value for one in estimates])
    given = value - np.array([one.correction for one in estimates])
    tolerance = np.maximum(_NEAR * np.array([one.sigma for one in estimates]), _NEAR_M)
    best: tuple[int, str] | None = None
    if np.all(np.abs(given - value) <= tolerance):
        return None
    for order in permutations(range(3)):
        for sign in product((1.0, -1.0), repeat=3):
            meant = given[list(order)] * np.array(sign)
            # Equal or zero components make many orders the same vector: the least change is named.
            changed = [k for k in range(3) if order[k] != k or sign[k] < 0]
            fits = bool(np.all(np.abs(meant - value) <= tolerance))
            if fits and (best is None or len(changed) < best[0]):
                best = len(changed), _words(order, sign)
    if best is None:
        return None
    estimate = ", ".join(f"{v:+.3f}" for v in value)
    stated = ", ".join(f"{v:+.3f}" for v in given)
    return Finding(
        "lever-arm-axes",
        f"the lever arm was given as ({stated}) m where the flight finds ({estimate}) m in forward, "
        f"right, down: {best[1]}.",
    )


def _words(order: tuple[int, ...], sign: tuple[float, ...]) -> str:
    moved = [k for k in range(3) if order[k] != k]
    parts = []
    if len(moved) == 2:
        parts.append(f"{_AXES[moved[0]]} and {_AXES[moved[1]]} have changed places")
    elif moved:
        parts.append("its three axes are in another order")
    turned = [_AXES[k] for k in range(3) if sign[k] < 0]
    if turned:
        parts.append(f"the sign of {' and '.join(turned)} is opposite")
    return "; ".join(parts)
