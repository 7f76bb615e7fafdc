"""What the surveyor notes down: control, base, rig, and the mistakes he makes when he is told to."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from acquire.simulate.world.configuration import Fault
from acquire.simulate.world.world import World

Floats = NDArray[np.float64]

# Noted too low by this: a slant height taken for a vertical one, or a mark confused with its tripod's plate.
ANTENNA_HEIGHT_ERROR_M = 0.2
BASE_ERROR_M = np.array([0.7, -0.5, 0.5])
_LEAST_SLIP_M = 0.5


@dataclass(frozen=True)
class FieldBook:
    """What is written into the files of the site.

    Attributes
    ----------
    control : tuple of (str, str, str)
        Coordinates of each target as texts, in the system of the site.
    base_m : ndarray, shape (3,)
        Announced place of the base's mark in the local frame.
    base_antenna_height_m : float
    camera_to_antenna_m : ndarray, shape (3,)
    mistyped : str
        Name of the target with swapped digits, empty for none.
    """

    control: tuple[tuple[str, str, str], ...]
    base_m: Floats
    base_antenna_height_m: float
    camera_to_antenna_m: Floats
    mistyped: str


def take_notes(world: World, coordinates: Floats) -> FieldBook:
    """Write down the site.

    Parameters
    ----------
    world : World
    coordinates : ndarray, shape (n, 3)
        Surveyed coordinates of the targets in the system of the site.

    Returns
    -------
    FieldBook
    """
    given = world.configuration
    texts = [tuple(f"{value:.4f}" for value in row) for row in coordinates.tolist()]
    mistyped = ""
    if world.has(Fault.CONTROL_DIGITS):
        control = [k for k, role in enumerate(world.targets.roles) if role == "control"]
        row = control[int(world.random("faults").integers(len(control)))]
        texts[row] = _swapped(texts[row])
        mistyped = world.targets.names[row]
    base = world.base_m + (BASE_ERROR_M if world.has(Fault.BASE_OFF) else 0.0)
    lower = ANTENNA_HEIGHT_ERROR_M if world.has(Fault.ANTENNA_HEIGHT) else 0.0
    arm = np.array(given.rig.camera_to_antenna_m)
    if world.has(Fault.LEVER_ARM_AXIS):
        arm = arm[[2, 1, 0]]
    return FieldBook(
        tuple((x, y, z) for x, y, z in texts), base, given.gnss.base_antenna_height_m - lower, arm, mistyped
    )


def _swapped(texts: tuple[str, ...]) -> tuple[str, ...]:
    """Swap two neighbouring digits of a coordinate, the last ones that make half a metre."""
    for axis, text in enumerate(texts):
        for place in range(len(text) - 2, -1, -1):
            pair = text[place : place + 2]
            changed = text[:place] + pair[::-1] + text[place + 2 :]
            if pair.isdigit() and abs(float(changed) - float(text)) >= _LEAST_SLIP_M:
                return (*texts[:axis], changed, *texts[axis + 1 :])
    # All digits of all coordinates alike: a metre is missed instead.
    return (f"{float(texts[0]) + 1:.4f}", *texts[1:])
