"""What the surveyor notes down: control, base, rig, and the mistakes he makes when he is told to."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from acquire.simulate.world.configuration import Fault
from acquire.simulate.world.world import World
from drivers.arrays import Floats

_LEAST_SLIP_M = 0.5


@dataclass(frozen=True)
class FieldBook:
    """What is written into the files of the site.

    control: coordinates of each target as texts, in the system of the site.
    base_m (3,): announced place of the base's mark in the local frame.
    camera_to_antenna_m (3,).
    mistyped: name of the target with swapped digits, empty for none.
    """

    control: tuple[tuple[str, str, str], ...]
    base_m: Floats
    base_antenna_height_m: float
    camera_to_antenna_m: Floats
    mistyped: str


def take_notes(world: World, coordinates: Floats) -> FieldBook:
    """Write down the site."""
    given = world.configuration
    texts = [tuple(f"{value:.4f}" for value in row) for row in coordinates.tolist()]
    mistyped = ""
    if world.has(Fault.CONTROL_DIGITS):
        control = [k for k, role in enumerate(world.targets.roles) if role == "control"]
        row = control[int(world.random("faults").integers(len(control)))]
        added, wrong = given.fault_sizes.control_m, _swapped(texts[row])
        if any(added):
            wrong = tuple(f"{float(text) + more:.4f}" for text, more in zip(texts[row], added, strict=True))
        texts[row] = wrong
        mistyped = world.targets.names[row]
    base = world.base_m + world.base_error_m
    arm = np.array(given.rig.camera_to_antenna_m)
    if world.has(Fault.LEVER_ARM_AXIS):
        arm = arm[[2, 1, 0]]
    return FieldBook(
        tuple((x, y, z) for x, y, z in texts),
        base,
        given.gnss.base_antenna_height_m - world.antenna_height_error_m,
        arm,
        mistyped,
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
