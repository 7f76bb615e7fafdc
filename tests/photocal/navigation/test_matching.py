"""Matching on simulated flights: no wrong pair, hardly a right one missed; doubt is refused."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray

from photocal.base.errors import IllPosedError
from photocal.navigation.exposures import UnrelatedImagesError, match

Floats = NDArray[np.float64]
JITTER_S = 0.0005


def flight(rng: np.random.Generator) -> tuple[Floats, Floats, NDArray[np.int64], NDArray[np.int64]]:
    """Times of images and events with the true shot of each (-1: none)."""
    shots = int(rng.integers(40, 160))
    true = np.cumsum(rng.uniform(1.6, 3.2, shots))
    taken, noted = rng.random(shots) > 0.05, rng.random(shots) > 0.05
    stray_i, stray_e = (rng.uniform(0, true[-1], int(rng.binomial(shots, 0.05))) for _ in range(2))
    offset, drift = rng.uniform(-60, 60), rng.uniform(-50e-6, 50e-6)
    camera = np.concatenate([true[taken], stray_i])
    camera = (camera - offset) * (1 + drift) + rng.normal(0, JITTER_S, len(camera))
    event = np.concatenate([true[noted], stray_e])
    index = np.arange(shots)
    of_image = np.concatenate([index[taken], np.full(len(stray_i), -1)])
    of_event = np.concatenate([index[noted], np.full(len(stray_e), -2)])
    return np.asarray(camera, np.float64), np.asarray(event, np.float64), of_image, of_event


@pytest.mark.slow
def test_a_thousand_flights() -> None:
    rng = np.random.default_rng(20260)
    wrong = right = possible = 0
    for _ in range(1000):
        camera, event, of_image, of_event = flight(rng)
        found = match(camera, event, resolution_s=0.01)
        same = of_image[found.image] == of_event[found.event]
        wrong += int((~same).sum())
        right += int(same.sum())
        possible += len(np.intersect1d(of_image[of_image >= 0], of_event[of_event >= 0]))
        listed = np.sort(np.concatenate([found.image, found.unmatched_images]))
        assert (listed == np.arange(len(camera))).all()
        assert len(found.event) + len(found.unmatched_events) == len(event)
    assert wrong == 0
    assert right >= 0.99 * possible


def test_equal_intervals_are_refused() -> None:
    event = np.linspace(0.0, 198.0, 100)
    with pytest.raises(IllPosedError, match="ambiguous"):
        match(event[3:90] + 7.0, event, resolution_s=0.01)


def test_order_alone_is_not_enough() -> None:
    rng = np.random.default_rng(4)
    event = np.cumsum(rng.uniform(1.6, 3.2, 60))
    # The first shot was not noted: the n-th image is not the n-th event.
    found = match(event - 12.0, event[1:], resolution_s=0.01)
    assert (found.image == found.event + 1).all()
    assert found.unmatched_images.tolist() == [0]


def test_whole_seconds_of_exif() -> None:
    rng = np.random.default_rng(5)
    event = np.cumsum(rng.uniform(6, 14, 80))
    found = match(
        np.asarray(np.floor(event + 21.0), np.float64), np.asarray(event, np.float64), resolution_s=1.0
    )
    assert (found.image == found.event).all()
    assert len(found.image) >= 72


def test_a_late_stamp_is_no_lost_event() -> None:
    """Delays are one-sided: one of 400 lies beyond four standard deviations of the usual scatter."""
    rng = np.random.default_rng(7)
    for _ in range(200):
        event = np.cumsum(rng.uniform(2.0, 5.0, 40))
        camera = event + 7.3 + np.abs(rng.normal(0, 0.003, 40))
        found = match(np.floor(camera * 1e3) / 1e3, event, resolution_s=0.001)
        assert (found.image == found.event).all()
        assert len(found.image) == 40


def test_a_late_stamp_is_none_where_marks_were_lost() -> None:
    """Six images of marks that nobody recorded do not make the late one's partner a chance."""
    rng = np.random.default_rng(8)
    missed = 0
    for _ in range(200):
        event = np.cumsum(rng.uniform(1.5, 2.5, 42))
        camera = event + 7.3 + np.abs(rng.normal(0, 0.003, 42))
        recorded = np.setdiff1d(np.arange(42), rng.integers(1, 35) + np.arange(6))
        found = match(np.floor(camera * 1e3) / 1e3, event[recorded], resolution_s=0.001)
        assert (recorded[found.event] == found.image).all()
        missed += len(found.image) < len(recorded)
    assert missed <= 1


def test_clock_is_told_with_its_sigma() -> None:
    rng = np.random.default_rng(6)
    event = np.cumsum(rng.uniform(1.6, 3.2, 120))
    camera = event / (1 + 30e-6) - 17.25 + rng.normal(0, 0.002, 120)
    found = match(camera, event, resolution_s=0.01)
    assert found.drift == pytest.approx(30e-6, abs=4 * found.drift_sigma)
    assert 1e-6 < found.drift_sigma < 1e-5


def test_two_images_for_one_event_are_left_out() -> None:
    rng = np.random.default_rng(7)
    event = np.cumsum(rng.uniform(1.6, 3.2, 60))
    camera = np.append(event + rng.normal(0, 0.001, 60), event[30] + 0.0005)
    found = match(camera, event, resolution_s=0.01)
    assert {30, 60} <= set(found.unmatched_images.tolist())
    assert {30, 60} <= set(found.ambiguous_images.tolist())
    assert 30 in found.unmatched_events


def test_a_clock_three_hours_off_is_no_other_flight() -> None:
    rng = np.random.default_rng(8)
    event = np.cumsum(rng.uniform(1.6, 3.2, 60))
    camera = np.delete(event, [4, 30]) - 10_800.0 + rng.normal(0, 0.001, 58)
    with pytest.raises(IllPosedError, match=r"58 of 58 images fit if their clock is -10800 s off") as refusal:
        match(camera, event, resolution_s=0.01)
    assert not isinstance(refusal.value, UnrelatedImagesError)
    assert len(match(camera, event, resolution_s=0.01, largest_offset_s=10_801.0).image) == 58
    with pytest.raises(UnrelatedImagesError, match="images of another flight"):
        match(np.cumsum(rng.uniform(1.6, 3.2, 58)) - 10_800.0, event, resolution_s=0.01)


def test_nothing_in_common() -> None:
    few = np.linspace(0.0, 9.0, 10)
    with pytest.raises(UnrelatedImagesError, match="no event lies within"):
        match(few, few**2 + 1e4, resolution_s=0.01)
    with pytest.raises(IllPosedError, match="at least 4"):
        match(few[:2], few, resolution_s=0.01)
