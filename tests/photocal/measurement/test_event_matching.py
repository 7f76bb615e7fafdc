"""Matching on simulated flights: no wrong pair, hardly a right one missed; doubt is refused."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray

from photocal.base.errors import IllPosedError
from photocal.measurement.event_matching import Places, UnrelatedImagesError, match

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


LATITUDE, LONGITUDE, METRES_OF_DEGREE = 47.6, 16.4, 111_200.0
LOSSES = ("none", "beginning", "middle", "end", "here and there")


def degrees(place: Floats) -> Floats:
    """Latitude, longitude and height of north and east, m."""
    scale = METRES_OF_DEGREE * np.array([1.0, np.cos(np.radians(LATITUDE))])
    return np.column_stack([place / scale + (LATITUDE, LONGITUDE), np.full(len(place), 500.0)])


def strips(rng: np.random.Generator, *, timer: bool) -> tuple[Floats, Floats, Floats]:
    """Times, places (north, east) and velocities of shots at equal intervals in strips there and back.

    timer: whether the camera keeps its beat over the turns.
    """
    count, each = int(rng.integers(1, 9)), int(rng.integers(6, 40))
    interval, speed = float(rng.choice([1.5, 2.0, 2.5, 3.0, 4.0])), rng.uniform(5, 15)
    way = np.where(np.arange(count) % 2, -1.0, 1.0)
    turn = interval * rng.integers(1, 6, count) if timer else rng.uniform(5, 25, count)
    begin = np.concatenate([[0.0], np.cumsum(each * interval + turn)[:-1]])
    along = interval * np.arange(each)
    time = (begin[:, None] + along).ravel() + rng.normal(0, 0.02, count * each)
    north = (np.where(way > 0, 0.0, each * interval)[:, None] + way[:, None] * along) * speed
    place = np.column_stack([north.ravel(), np.repeat(40.0 * np.arange(count), each)])
    return time, place, np.column_stack([np.repeat(way * speed, each), np.zeros(count * each)])


def kept(rng: np.random.Generator, count: int, loss: str) -> NDArray[np.int64]:
    """Which of so many are left."""
    some = int(rng.integers(1, 4))
    first = int(rng.integers(1, count - 4))
    lost = {
        "none": [],
        "beginning": range(some),
        "middle": range(first, first + some),
        "end": range(count - some, count),
        "here and there": rng.choice(count, max(1, count // 30), replace=False),
    }[loss]
    return np.setdiff1d(np.arange(count), list(lost))


@pytest.mark.parametrize("timer", [False, True], ids=["by distance", "by a timer"])
@pytest.mark.parametrize("step_s", [0.01, 1.0], ids=["hundredths", "whole seconds"])
@pytest.mark.parametrize("positions", ["none", "of code", "fixed"])
def test_lists_with_other_lines_than_pictures(timer: bool, step_s: float, positions: str) -> None:
    """Lines and pictures are lost, a test shot is added, no clock is known: no pair is wrong."""
    rng = np.random.default_rng(3)
    flights, refused, right, possible = 100, 0, 0, 0
    for _ in range(flights):
        time, place, velocity = strips(rng, timer=timer)
        noted, taken = (kept(rng, len(time), str(rng.choice(LOSSES))) for _ in range(2))
        event, where = time[noted], place[noted]
        if rng.random() < 0.3:
            event, where = np.append(event, time[0] - rng.uniform(10, 60)), np.vstack([where, place[0]])
            noted = np.append(noted, -1)
        clock = time[taken] - rng.uniform(-30_000, 30_000)
        told = place[taken] + rng.normal(0, 0.02, (len(taken), 2))
        if positions == "of code":
            drift = np.cumsum(rng.normal(0, 0.2, told.shape), axis=0)
            told += rng.normal(0, 1.5, 2) + drift - rng.uniform(0.1, 0.9) * velocity[taken]
        late_s = (-0.25, 0.25) if positions == "fixed" else (-0.5, 1.0)
        places = None if positions == "none" else Places(degrees(told), degrees(where), late_s)
        stamp = np.floor(clock / step_s) * step_s
        try:
            found = match(
                np.asarray(stamp), event, resolution_s=step_s, largest_offset_s=np.inf, places=places
            )
        except IllPosedError:
            refused += 1
            continue
        assert (taken[found.image] == noted[found.event]).all()
        right += len(found.image)
        possible += len(np.intersect1d(noted, taken))
    assert right > 0.95 * possible
    # Single strips at equal intervals, of which something is lost, are left to their positions.
    assert refused < (0.3 if positions == "none" else 0.05) * flights


def test_equal_intervals_are_decided_by_positions() -> None:
    """One strip, of which the first line is lost: positions that are half an interval late leave it open."""
    time: Floats = np.asarray(2.0 * np.arange(40), np.float64)
    place = np.column_stack([10.0 * time, 0.0 * time])
    lost = 1
    for late_s, decided in ((0.0, True), (0.8, True), (1.2, False)):
        told = place - np.array([10.0 * late_s, 0.0])
        places = Places(degrees(told), degrees(place[lost:]), (-0.5, 1.0))
        if decided:
            found = match(time - 5.0, time[lost:], resolution_s=1.0, places=places)
            assert (found.image == found.event + lost).all()
            assert found.unmatched_images.tolist() == [0]
        else:
            with pytest.raises(IllPosedError, match=r"pairs 39 of 40 images, one of .* pairs 3\d"):
                match(time - 5.0, time[lost:], resolution_s=1.0, places=places)
    with pytest.raises(IllPosedError, match="pairs 39 of 40 images"):
        match(time - 5.0, time[lost:], resolution_s=1.0)


def test_other_flights_do_not_fit() -> None:
    rng = np.random.default_rng(4)
    for k in range(100):
        one, other = (strips(rng, timer=bool(k % 2))[0] for _ in range(2))
        with pytest.raises(IllPosedError):
            match(np.floor(one), other, resolution_s=1.0, largest_offset_s=np.inf)
