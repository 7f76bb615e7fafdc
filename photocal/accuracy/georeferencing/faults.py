"""Systematic errors as mistakes of a field day: antenna height, base station, axes of the lever arm."""

from __future__ import annotations

from itertools import permutations, product

import numpy as np
from numpy.typing import NDArray

from photocal.accuracy.findings import Finding
from photocal.accuracy.georeferencing.freed_groups import Estimate
from photocal.accuracy.georeferencing.hypotheses import SystematicErrors

Floats = NDArray[np.float64]

# An estimate is the permuted given one when it comes this near: standard deviations, and metres at least.
_NEAR, _NEAR_M = 4.0, 0.02
# Below this a shift is no mistake of a person.
_NOTEWORTHY_M = 0.03
_AXES = ("forward", "right", "down")


def fault_findings(errors: SystematicErrors) -> tuple[Finding, ...]:
    """Name the mistakes that the systematic errors look like.

    Parameters
    ----------
    errors : SystematicErrors

    Returns
    -------
    tuple of Finding
        Codes "antenna-height", "base-position", "lever-arm-axes".
    """
    groups = {error.found.name: error.found.estimates for error in errors.errors}
    same = {name for error in errors.errors for name in error.same}
    said = []
    if "lever arm" in groups:
        said += _swapped_axes(groups["lever arm"])
    if "datum shift" in groups:
        said += _shift(groups["datum shift"])
    elif "datum shift" in same:
        tested = next((one for one in errors.tested if one.name == "datum shift"), None)
        said += [] if tested is None else _shift(tested.estimates)
    return tuple(said)


def _shift(estimates: tuple[Estimate, ...]) -> list[Finding]:
    """A shift common to all positions: of the height alone, or of the base."""
    axes = {one.name.removeprefix("shift_"): one for one in estimates}
    noteworthy = {
        axis: one for axis, one in axes.items() if one.significant and abs(one.correction) > _NOTEWORTHY_M
    }
    if not noteworthy:
        return []
    if set(noteworthy) == {"z"}:
        z = axes["z"]
        side = "above" if z.correction > 0 else "below"
        return [
            Finding(
                "antenna-height",
                f"all GNSS positions lie {abs(z.correction):.3f} +- {z.sigma:.3f} m {side} what the control "
                "says, and in plane they agree: an antenna height (of the base or on the vehicle), "
                "ellipsoidal against geoid heights, or the vertical lever arm.",
            )
        ]
    shift = ", ".join(
        f"{axis.upper()} {one.correction:+.3f} +- {one.sigma:.3f}" for axis, one in axes.items()
    )
    return [
        Finding(
            "base-position",
            f"all GNSS positions are shifted against the control by {shift} m: the coordinates of the base "
            "station, or its datum or epoch, are not those of the control.",
        )
    ]


def _swapped_axes(estimates: tuple[Estimate, ...]) -> list[Finding]:
    """A lever arm that was given with its axes in another order or with another sign."""
    value = np.array([one.value for one in estimates])
    given = value - np.array([one.correction for one in estimates])
    tolerance = np.maximum(_NEAR * np.array([one.sigma for one in estimates]), _NEAR_M)
    best: tuple[int, str] | None = None
    if np.all(np.abs(given - value) <= tolerance):
        return []
    for order in permutations(range(3)):
        for sign in product((1.0, -1.0), repeat=3):
            meant = given[list(order)] * np.array(sign)
            # Equal or zero components make many orders the same vector: the least change is named.
            changed = [k for k in range(3) if order[k] != k or sign[k] < 0]
            fits = bool(np.all(np.abs(meant - value) <= tolerance))
            if fits and (best is None or len(changed) < best[0]):
                best = len(changed), _words(order, sign)
    if best is None:
        return []
    estimate = ", ".join(f"{v:+.3f}" for v in value)
    stated = ", ".join(f"{v:+.3f}" for v in given)
    return [
        Finding(
            "lever-arm-axes",
            f"the lever arm was given as ({stated}) m where the flight finds ({estimate}) m in forward, "
            f"right, down: {best[1]}.",
        )
    ]


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
