"""Validation of fixes: doubtful ones become float, and float sigmas are rescaled to what is observed."""

from dataclasses import dataclass, replace

import numpy as np

from photocal.base.arrays import Flags, Floats, Integers
from photocal.base.policy import policy
from photocal.navigation.engine import FIXED, FLOAT, EngineSolution
from photocal.navigation.satellite_residuals import CodeErrors
from photocal.navigation.time import GpsTime

# A claim of two runs to the same fix holds when they agree as well as two fixes do.
_SAME_FIX_M = np.array([0.05, 0.05, 0.10])
# So few fixes in a row need the other direction; of a slow receiver fewer, when they last so long: multipath,
# which feigns fixes, is another by then.
_SHORT_RUN, _FEWEST, _LASTING_NS = 5, 3, 30_000_000_000
# Fixes belong to one run when no more than this lies between them, or two epochs of a slow receiver.
_RUN_GAP_NS = 3_000_000_000
_RUN_GAP_EPOCHS = 2.5
# Separations near an epoch: within so long, or so many epochs of a slow receiver; float errors hold a minute.
_WINDOW_NS, _WINDOW_EPOCHS, _CORRELATED_NS = 30e9, 6, 60e9
# Phase multipath of a rover antenna, per component, that the engine's fixed sigmas leave out (Georgiadou and
# Kleusberg 1988: up to a quarter of the wavelength; 5 mm horizontally is common for patch antennas).
_FIXED_FLOOR_M = np.array([0.004, 0.004, 0.008])


@dataclass(frozen=True)
class ValidatedFixes:
    """The combined solution with its final status, and why epochs lost their fix.

    solution: same positions; quality and covariance as judged.
    float_factor (3,): by how much the engine's float sigmas are too small over the flight (east, north, up).
    separation_m (n, 3): forward minus backward; NaN where one of them has no position.
    directions (n, 2): quality of forward and backward, 0 where there is no position.
    velocity_m_s (n, 3): from Doppler, east, north, up; NaN where it is not known.
    velocity_sigma_m_s: robust standard deviation of one component of it.
    """

    solution: EngineSolution
    demoted: dict[str, Flags]
    float_factor: Floats
    separation_m: Floats
    directions: Integers
    velocity_m_s: Floats
    velocity_sigma_m_s: float


def judge(
    combined: EngineSolution,
    forward: EngineSolution,
    backward: EngineSolution,
    code: EngineSolution,
    ratio: float,
    codes: CodeErrors | None = None,
) -> ValidatedFixes:
    """Validate the fixes of a combined solution and rescale the sigmas of the rest.

    codes: how long errors of the codes last; None where too few satellites tell.
    """
    origin = combined.place[0]
    here = combined.offsets(origin)
    fore, back = forward.at(combined.time), backward.at(combined.time)
    difference = forward.offsets(origin)[fore] - backward.offsets(origin)[back]
    separation = np.where(((fore >= 0) & (back >= 0))[:, None], difference, np.nan)
    fixed = combined.quality == FIXED
    directions = np.column_stack([_quality(forward, fore), _quality(backward, back)])
    both = (directions == FIXED).all(axis=1)
    velocity, sigma = _velocity(combined.time, here, fixed, code)
    steps = np.column_stack(
        [
            np.linalg.norm(
                _steps(combined.time, solution.offsets(origin)[row], row >= 0, velocity)[0], axis=1
            )
            for solution, row in ((forward, fore), (backward, back))
        ]
    )
    disagree = both & (np.abs(separation) > _SAME_FIX_M).any(axis=1)
    demoted = {
        "ratio below the threshold": fixed & (combined.ratio < ratio),
        "forward and backward fixes differ": fixed
        & (disagree | _carried_on(directions == FIXED, disagree, steps)),
        "jump against the Doppler velocity": fixed & _jumps(combined.time, here, fixed, velocity, sigma),
        "off the code position": fixed & _off_code(here, combined, code, origin),
    }
    left = fixed & ~np.any(list(demoted.values()), axis=0)
    broken = _broken(combined.time, directions == FIXED, separation, steps)
    lonely = left & _lonely(combined.time, left, broken) & ~both
    lonely &= ~_carried(combined.time, left & ~lonely, directions == FIXED, separation)
    demoted["few fixes in a row, not confirmed"] = lonely
    left &= ~lonely
    quality = np.where(fixed & ~left, FLOAT, combined.quality)
    factor = _float_factor(forward, fore, backward, back, separation)
    covariance = _covariance(combined, quality, factor, separation, codes)
    judged = replace(combined, quality=quality, covariance_m2=covariance)
    floating = quality == FLOAT
    if floating.any():
        factor = np.sqrt(np.mean((judged.sigma_m / combined.sigma_m)[floating] ** 2, axis=0))
    return ValidatedFixes(judged, demoted, factor, separation, directions, velocity, sigma)


def _carried_on(fixed: Flags, disagree: Flags, steps_m: Floats) -> Flags:
    """Tell which fixes of one direction go on, unconfirmed, from where the other refuted them.

    fixed (n, 2) and steps_m (n - 1, 2), movement that the Doppler velocity does not know, of both directions.
    """
    from scipy.ndimage import label

    both = fixed.all(axis=1)
    unconfirmed = fixed & ~(both & ~disagree)[:, None]
    # What leads to an epoch and away from it.
    rough = np.nan_to_num(np.vstack([np.zeros(2), steps_m]) ** 2 + np.vstack([steps_m, np.zeros(2)]) ** 2)
    doubtful = np.zeros(len(fixed), bool)
    for direction in range(2):
        run, number = label(unconfirmed[:, direction])
        for k in range(1, number + 1):
            refuted = (run == k) & disagree
            this, other = rough[refuted].sum(axis=0)[[direction, 1 - direction]]
            # The direction that keeps to the Doppler velocity where the other leaps is the right one.
            if refuted.any() and not this < other / 4:
                doubtful |= run == k
    return doubtful & ~both


def _carried(time: GpsTime, sure: Flags, fixed: Flags, separation: Floats) -> Flags:
    """Tell which fixes of one direction are as far from the other as a sure one of that direction near by.

    fixed (n, 2): by direction. What floats in the other keeps its ambiguities from one to the other, so both
    fixes have the same.
    """
    carried, every = np.zeros(len(sure), bool), np.arange(len(sure))
    for of_direction in fixed.T:
        anchors = np.flatnonzero(sure & of_direction & np.isfinite(separation).all(axis=1))
        if not len(anchors):
            continue
        after = np.minimum(np.searchsorted(anchors, every), len(anchors) - 1)
        for at in (anchors[np.maximum(after - 1, 0)], anchors[after]):
            near = np.abs(time.ns[at] - time.ns) <= _LASTING_NS
            alike = (np.abs(separation - separation[at]) <= _SAME_FIX_M).all(axis=1)
            carried |= of_direction & near & alike
    return carried


def _quality(solution: EngineSolution, row: Integers) -> Integers:
    return np.where(row >= 0, solution.quality[row], 0)


def _velocity(time: GpsTime, here: Floats, fixed: Flags, code: EngineSolution) -> tuple[Floats, float]:
    """Return the Doppler velocity at the epochs (n, 3) and its scatter against the fixed positions."""
    row = code.at(time)
    velocity = np.where((row >= 0)[:, None], code.velocity_m_s[row], np.nan)
    step, seconds, pair = _steps(time, here, fixed, velocity)
    error = (step / seconds[:, None])[pair]
    if len(error) < 2 * _SHORT_RUN:
        return velocity, 0.1
    return velocity, max(float(policy.mad_to_sigma * np.median(np.abs(error)) * np.sqrt(2.0)), 0.02)


def _steps(time: GpsTime, here: Floats, fixed: Flags, velocity: Floats) -> tuple[Floats, Floats, Flags]:
    """Return displacement less mean velocity times time between neighbours, the time, and what counts."""
    seconds = np.diff(time.ns) / 1e9
    mean = (velocity[1:] + velocity[:-1]) / 2
    step = np.diff(here, axis=0) - mean * seconds[:, None]
    pair = fixed[1:] & fixed[:-1] & (seconds <= _RUN_GAP_NS / 1e9) & np.isfinite(step).all(axis=1)
    return step, seconds, pair


def _jumps(time: GpsTime, here: Floats, fixed: Flags, velocity: Floats, sigma: float) -> Flags:
    """Tell which fixes stand off the path that their neighbours and the velocities give."""
    # Doppler velocities have long tails.
    jump_sigmas = 5.0
    # Of the two sides of a jump the shorter run of fixes is the doubtful one.
    step, seconds, pair = _steps(time, here, fixed, velocity)
    # The mean of two velocities, and a manoeuvre of 1 m/s^2 within the step.
    limit = jump_sigmas * (sigma * seconds / np.sqrt(2) + 0.02) + seconds**2 / 8
    broken = pair & (np.abs(step) > limit[:, None] * np.array([1.0, 1.0, 2.0])).any(axis=1)
    flagged = np.zeros(len(time), bool)
    runs = _runs(time, fixed, broken)
    for at in np.flatnonzero(broken).tolist():
        left = next(r for r in runs if r[0] <= at < r[1])
        right = next(r for r in runs if r[0] <= at + 1 < r[1])
        worse = min(left, right, key=lambda r: r[1] - r[0])
        flagged[worse[0] : worse[1]] = True
    return flagged


def _runs(time: GpsTime, fixed: Flags, broken: Flags | None = None) -> list[tuple[int, int]]:
    """Return begin and end of the runs of fixes without a gap (or a break)."""
    usual_ns = float(np.median(np.diff(time.ns))) if len(time) > 1 else 0.0
    apart = np.diff(time.ns) > max(_RUN_GAP_NS, _RUN_GAP_EPOCHS * usual_ns)
    if broken is not None:
        apart |= broken
    begins = fixed & np.append(True, apart | ~fixed[:-1])
    ends = fixed & np.append(apart | ~fixed[1:], True)
    return list(zip(np.flatnonzero(begins).tolist(), (np.flatnonzero(ends) + 1).tolist(), strict=True))


def _broken(time: GpsTime, fixed: Flags, separation: Floats, steps_m: Floats) -> Flags:
    """Tell between which epochs the fixes of a direction leap, against what floats in the other.

    fixed (n, 2) and steps_m (n - 1, 2), movement that the Doppler velocity does not know, of both directions.
    """
    leaps = (np.abs(np.diff(separation, axis=0)) > _SAME_FIX_M).any(axis=1)
    # Over longer steps a float moves by as much of itself.
    held = fixed[1:] & fixed[:-1] & (np.diff(time.ns) <= _RUN_GAP_NS)[:, None]
    # Of the two the rougher has leapt; where that is the float, its ambiguities have slipped.
    return np.asarray(leaps & (held & (steps_m > steps_m[:, ::-1])).any(axis=1))


def _lonely(time: GpsTime, fixed: Flags, broken: Flags) -> Flags:
    flagged = np.zeros(len(fixed), bool)
    for start, stop in _runs(time, fixed, broken):
        lasting = stop - start >= _FEWEST and time.ns[stop - 1] - time.ns[start] >= _LASTING_NS
        if stop - start < _SHORT_RUN and not lasting:
            flagged[start:stop] = True
    return flagged


def _off_code(here: Floats, combined: EngineSolution, code: EngineSolution, origin: Floats) -> Flags:
    # Errors of code positions have long tails: five sigmas, not three.
    code_sigmas = 5.0
    row = code.at(combined.time)
    difference = here - code.offsets(origin)[row]
    known = row >= 0
    if known.sum() < _SHORT_RUN:
        return np.zeros(len(here), bool)
    # Code positions share the atmosphere's error: the median of the flight is taken out before the test.
    difference = difference - np.median(difference[known], axis=0)
    return np.asarray(known & (np.abs(difference) > code_sigmas * code.sigma_m[row]).any(axis=1))


def _float_factor(
    forward: EngineSolution, fore: Integers, backward: EngineSolution, back: Integers, separation: Floats
) -> Floats:
    """Return how much too small the float sigmas are, from the separation of the two directions.

    Errors that last longer than the flight both directions share: these it cannot show.
    """
    pair = (fore >= 0) & (back >= 0)
    floating = (_quality(forward, fore) == FLOAT) | (_quality(backward, back) == FLOAT)
    rows = pair & floating
    if rows.sum() < _SHORT_RUN:
        return np.ones(3)
    claimed = np.hypot(forward.sigma_m[fore[rows]], backward.sigma_m[back[rows]])
    return np.asarray(np.maximum(np.sqrt(np.mean((separation[rows] / claimed) ** 2, axis=0)), 1.0))


def _covariance(
    combined: EngineSolution,
    quality: Integers,
    factor: Floats,
    separation: Floats,
    codes: CodeErrors | None,
) -> Floats:
    """Return honest covariances: scaled where float, with a floor for multipath where fixed."""
    scale = np.ones((len(combined), 3))
    sigma = combined.sigma_m
    floating = quality == FLOAT
    # A float epoch is as uncertain as its directions are apart near it. Neighbours share their errors, a
    # window is worth few separations: the whole flight counts as one more. The engine's own sigmas of
    # combined epochs count the same errors twice.
    window_ns = max(_WINDOW_NS, _WINDOW_EPOCHS * float(np.median(np.diff(combined.time.ns))))
    worth = max(2.0 * window_ns / _CORRELATED_NS, 1.0)
    local = _local_rms(combined.time, separation, floating, window_ns) / np.sqrt(2)
    whole = sigma * factor
    joint = np.where(np.isfinite(local), np.sqrt((worth * local**2 + whole**2) / (worth + 1.0)), whole)
    if codes is not None:
        # What both directions share only the codes show.
        joint = np.maximum(joint, codes.sigma_m(sigma))
    scale[floating] = (np.maximum(joint, sigma) / sigma)[floating]
    fixed = quality == FIXED
    scale[fixed] = (np.hypot(sigma, _FIXED_FLOOR_M) / sigma)[fixed]
    return np.asarray(combined.covariance_m2 * scale[:, :, None] * scale[:, None, :])


def _local_rms(time: GpsTime, separation: Floats, floating: Flags, window_ns: float) -> Floats:
    known = np.isfinite(separation).all(axis=1) & floating
    squares = np.where(known[:, None], separation**2, 0.0)
    sums = np.vstack([np.zeros(3), np.cumsum(squares, axis=0)])
    count = np.concatenate([[0], np.cumsum(known)])
    low = np.searchsorted(time.ns, time.ns - window_ns)
    high = np.searchsorted(time.ns, time.ns + window_ns, side="right")
    number = (count[high] - count[low])[:, None]
    with np.errstate(invalid="ignore", divide="ignore"):
        rms = np.sqrt((sums[high] - sums[low]) / number)
    at_epoch = np.where(known[:, None], np.abs(separation), 0.0)
    return np.asarray(np.where(number > 0, np.maximum(rms, at_epoch), np.nan))
