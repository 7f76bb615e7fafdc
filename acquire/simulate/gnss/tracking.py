"""When a receiver holds a signal: acquisition, loss of lock, cycle slips, half cycles."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from drivers.arrays import Flags, Floats, Integers

# A channel that was locked before the session began; one that sees its satellite rise; one that slipped.
_LOCKED_BEFORE_S, _ACQUIRING_S, _RELOCKING_S = (60.0, 900.0), (0.5, 4.0), (0.05, 0.6)
# Until the navigation data have shown the sign of the phase.
_HALF_CYCLE_S = (0.6, 6.0)
_LARGEST_SLIP = 40


@dataclass(frozen=True)
class Tracking:
    """A signal at the epochs of a receiver.

    code: whether there is a pseudorange.
    phase: whether there is a carrier phase.
    lock_s (n,): how long the phase has been followed without a break; 0 where it is not.
    ambiguity (n,): cycles beyond the ones that bring the phase near the pseudorange: whole, or half where
        `half_valid` is not yet set.
    half_valid: whether the ambiguity is known to be whole.
    half_subtracted: whether half a cycle was taken off to make it whole.
    arc (n,): number of the unbroken stretch; -1 without phase.
    """

    code: Flags
    phase: Flags
    lock_s: Floats
    ambiguity: Floats
    half_valid: Flags
    half_subtracted: Flags
    arc: Integers


def track(
    seconds: Floats, visible: Flags, slips_per_hour: float, data: bool, rng: np.random.Generator
) -> Tracking:
    """Follow a signal."""
    code = np.zeros(len(seconds), bool)
    starts: list[float] = []
    ends: list[float] = []
    edges = np.flatnonzero(np.diff(np.concatenate([[False], visible, [False]]).astype(np.int8)))
    for first, after in edges.reshape(-1, 2).tolist():
        begin, end = float(seconds[first]), float(seconds[after - 1])
        at = begin - rng.uniform(*_LOCKED_BEFORE_S) if first == 0 else begin + rng.uniform(*_ACQUIRING_S)
        code[first:after] = seconds[first:after] >= at
        count = rng.poisson(max(end - begin, 0) * slips_per_hour / 3600)
        slips = np.sort(rng.uniform(begin, end, count))
        relocked = slips + rng.uniform(*_RELOCKING_S, count)
        starts += [at, *relocked.tolist()]
        ends += [*slips.tolist(), end]
    return _arcs(seconds, code, np.array(starts), np.array(ends), data, rng)


def _arcs(
    seconds: Floats, code: Flags, starts: Floats, ends: Floats, data: bool, rng: np.random.Generator
) -> Tracking:
    count = len(starts)
    # Steps of 1 to 80 cycles, modulo 81: two arcs in a row never have the same number.
    values = 2 * _LARGEST_SLIP + 1
    whole = (np.cumsum(rng.integers(1, values, count)) % values - _LARGEST_SLIP).astype(np.float64)
    # A slip while the lock is being found again only delays it.
    starts = np.maximum.accumulate(starts)
    known = starts + rng.uniform(*_HALF_CYCLE_S, count) if data else starts
    turned = rng.random(count) < 0.5 if data else np.zeros(count, bool)
    if not count:
        none, zero = np.zeros(len(seconds), bool), np.zeros(len(seconds))
        return Tracking(code, none, zero, zero, none, none, np.full(len(seconds), -1, np.int64))
    arc = np.searchsorted(starts, seconds, side="right") - 1
    phase = code & (arc >= 0) & (seconds <= ends[arc])
    valid = phase & (seconds >= known[arc])
    return Tracking(
        code,
        phase,
        np.where(phase, seconds - starts[arc], 0.0),
        whole[arc] + np.where(turned[arc] & ~valid, 0.5, 0.0),
        valid,
        valid & turned[arc],
        np.where(phase, arc, -1),
    )
