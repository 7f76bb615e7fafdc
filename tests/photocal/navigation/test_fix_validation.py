"""Fixes are judged by their neighbours, whatever the receiver's interval."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from photocal.navigation.engine import FIXED, FLOAT, EngineSolution
from photocal.navigation.fix_validation import judge
from photocal.navigation.time import GpsTime


def still(interval_s: float, epochs: int, quality: int) -> EngineSolution:
    """A receiver that stands, with a scatter of 5 mm."""
    rng = np.random.default_rng(3)
    scatter = rng.normal(0.0, 0.005, (epochs, 3))
    return EngineSolution(
        GpsTime(1_400_000_000 * 10**9 + (np.arange(epochs) * interval_s * 1e9).astype(np.int64)),
        45.0 + scatter[:, 1] / 111_130,
        9.0 + scatter[:, 0] / 78_850,
        100.0 + scatter[:, 2],
        np.full(epochs, quality, dtype=np.int64),
        np.broadcast_to(np.eye(3) * 0.005**2, (epochs, 3, 3)).copy(),
        np.full(epochs, 50.0),
        np.zeros((epochs, 3)),
    )


_CODE = replace(still(1.0, 60, FLOAT), covariance_m2=np.broadcast_to(np.eye(3), (60, 3, 3)))


@pytest.mark.parametrize("interval_s", [0.2, 1.0, 15.0, 30.0])
def test_a_long_run_of_fixes_needs_no_second_direction(interval_s: float) -> None:
    combined, one_way = still(interval_s, 60, FIXED), still(interval_s, 60, FLOAT)
    judged = judge(combined, combined, one_way, replace(one_way), 3.0)
    assert (judged.solution.quality == FIXED).all()


@pytest.mark.parametrize(("interval_s", "count"), [(0.2, 4), (1.0, 4), (7.0, 4), (15.0, 2), (30.0, 2)])
def test_few_fixes_among_floats_need_one(interval_s: float, count: int) -> None:
    """Four fixes that last less than half a minute; of a slow receiver three last that long."""
    one_way = still(interval_s, 60, FLOAT)
    few = np.where((np.arange(60) >= 30) & (np.arange(60) < 30 + count), FIXED, FLOAT)
    combined = replace(one_way, quality=few)
    judged = judge(combined, combined, one_way, one_way, 3.0)
    assert (judged.solution.quality == FLOAT).all()
    assert judged.demoted["few fixes in a row, not confirmed"].sum() == count
    confirmed = judge(combined, combined, combined, one_way, 3.0)
    assert (confirmed.solution.quality == FIXED).sum() == count


def test_three_fixes_of_a_slow_receiver_need_no_second_direction() -> None:
    one_way = still(15.0, 60, FLOAT)
    three = replace(one_way, quality=np.where((np.arange(60) >= 30) & (np.arange(60) < 33), FIXED, FLOAT))
    judged = judge(three, three, one_way, one_way, 3.0)
    assert (judged.solution.quality == FIXED).sum() == 3


@pytest.mark.parametrize(("leap_m", "kept"), [(0.0, 2), (0.2, 0)])
def test_few_fixes_beside_a_sure_run_have_its_ambiguities_or_not(leap_m: float, kept: int) -> None:
    """What floats in the other direction stands 0.5 m beside, as before; or the two fixes leap against it."""
    floating, at = still(1.0, 60, FLOAT), np.arange(60)
    few = (at >= 40) & (at < 42)
    quality = np.where((at < 30) | few, FIXED, FLOAT)
    forward = replace(floating, quality=quality, height_m=floating.height_m + leap_m * few)
    other = replace(floating, height_m=floating.height_m + 0.5)
    judged = judge(forward, forward, other, _CODE, 3.0)
    assert (judged.solution.quality[few] == FIXED).sum() == kept
    assert (judged.solution.quality[:30] == FIXED).all()


@pytest.mark.parametrize(("which", "kept"), [("fix", 0), ("float", 8)])
def test_a_run_in_which_the_fix_leaps_is_two(which: str, kept: int) -> None:
    """0.2 m up after four of eight epochs: nothing in the path or the other direction goes with it."""
    floating, at = still(1.0, 60, FLOAT), np.arange(60)
    run = (at >= 20) & (at < 28)
    leapt = replace(floating, height_m=floating.height_m + 0.2 * (at >= 24))
    forward, other = (leapt, floating) if which == "fix" else (floating, leapt)
    fixes = replace(forward, quality=np.where(run, FIXED, FLOAT))
    assert (judge(fixes, fixes, other, _CODE, 3.0).solution.quality == FIXED).sum() == kept


def test_a_pause_ends_a_run() -> None:
    """Two fixes before a pause of minutes and two after it are no four in a row."""
    whole = still(15.0, 60, FLOAT)
    fixed = np.where((np.arange(60) >= 22) & (np.arange(60) < 26), FIXED, FLOAT)
    in_a_row = replace(whole, quality=fixed)
    assert (judge(in_a_row, in_a_row, whole, whole, 3.0).solution.quality == FIXED).sum() == 4
    late = GpsTime(whole.time.ns + 180_000_000_000 * (np.arange(60) >= 24))
    paused = replace(in_a_row, time=late)
    assert (judge(paused, paused, whole, whole, 3.0).solution.quality == FLOAT).all()


@pytest.mark.parametrize("wrong", ["forward", "backward"])
def test_a_refuted_fix_that_goes_on_alone_stays_refuted(wrong: str) -> None:
    """One direction stands 0.3 m too high from second 20 on; the other has no fix in seconds 25 to 29."""
    right = still(1.0, 60, FIXED)
    at = np.arange(60)
    high = (at >= 20) & (at < 30)
    alone = (at >= 25) & (at < 30)
    leaps = replace(right, height_m=right.height_m + 0.3 * high)
    pauses = replace(right, quality=np.where(alone, FLOAT, FIXED))
    both = (leaps, pauses) if wrong == "forward" else (pauses, leaps)
    judged = judge(replace(right, height_m=right.height_m + 0.3 * alone), *both, _CODE, 3.0)
    assert (judged.solution.quality[high] == FLOAT).all()
    assert (judged.solution.quality[~high] == FIXED).all()


def test_who_keeps_to_the_way_while_the_other_leaps_keeps_its_fix() -> None:
    right = still(1.0, 60, FIXED)
    at = np.arange(60)
    leaps = replace(
        right,
        height_m=right.height_m + 0.3 * ((at >= 20) & (at < 25)),
        quality=np.where((at >= 25) & (at < 30), FLOAT, FIXED),
    )
    judged = judge(right, right, leaps, _CODE, 3.0)
    assert (judged.solution.quality[25:30] == FIXED).all()


def test_it_is_told_which_direction_had_the_fix() -> None:
    fixed, floating = still(1.0, 60, FIXED), still(1.0, 60, FLOAT)
    judged = judge(fixed, floating, fixed.rows(np.arange(5, 60)), floating, 3.0)
    assert (judged.directions[:, 0] == FLOAT).all()
    assert (judged.directions[:5, 1] == 0).all()
    assert (judged.directions[5:, 1] == FIXED).all()


@pytest.mark.parametrize("interval_s", [1.0, 15.0, 60.0])
def test_float_sigmas_hold_for_errors_that_last(interval_s: float) -> None:
    """Errors of both directions keep for a minute (one metre, 5 mm claimed): the sigmas say so."""
    keep = np.exp(-interval_s / 60.0)
    normalised = []
    for seed in range(40):
        rng = np.random.default_rng(seed)
        errors = rng.normal(0.0, 1.0, (2, 60, 3))
        for k in range(1, 60):
            errors[:, k] = keep * errors[:, k - 1] + np.sqrt(1 - keep**2) * errors[:, k]
        base = still(interval_s, 60, FLOAT)
        forward, backward, combined = (
            replace(
                base,
                lat_deg=45.0 + e[:, 1] / 111_130,
                lon_deg=9.0 + e[:, 0] / 78_850,
                height_m=100.0 + e[:, 2],
            )
            for e in (*errors, errors.mean(axis=0))
        )
        judged = judge(combined, forward, backward, base, 3.0)
        normalised.append(errors.mean(axis=0) / judged.solution.sigma_m)
    rms = np.sqrt(np.mean(np.concatenate(normalised) ** 2, axis=0))
    assert (rms < 1.5).all()
    assert (rms > 0.5).all()
