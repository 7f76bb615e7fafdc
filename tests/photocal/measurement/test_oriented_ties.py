"""Blocks oriented by tie points: what places them, what is wrong with that, and what does not belong."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import replace

import numpy as np
import pytest
from numpy.typing import NDArray

from photocal.base.errors import ConfigurationError, IllPosedError
from photocal.block.model import NO_OBSERVATIONS, NO_POINTS, Block, Images
from photocal.geometry.camera import PARAMETERS, among, camera, plane_to_pixel
from photocal.geometry.oriented_images import OrientedImages, oriented_images
from photocal.measurement.oriented_ties import OF_RAY, _adjusted, _views, first_orientation, orient_ties
from photocal.measurement.tie_adjustment import _Ties, _where_rays_meet, adjust_ties, adjusted_again
from photocal.measurement.tie_block import intersected, place, rescaled_poses, with_ties, without_single_rays
from photocal.measurement.tie_orientation import oriented, position_sigmas
from photocal.measurement.tracks import Tracks
from tests.photocal import flights
from tests.photocal.findings.english import english

Floats = NDArray[np.float64]
LENS = camera("c", "brown-ideal", "px", (1000, 800), (1.0, 1.0), {"c": 900.0})


@contextmanager
def _quiet(_: str, __: float | None) -> Iterator[Callable[[float], None]]:
    yield lambda _: None


def _tracks(places: Floats, tilt: float = 0.0) -> Tracks:
    """Rays of 150 points of hilly ground, in images that are tilted along and across (rad)."""
    rng = np.random.default_rng(5)
    ground = np.column_stack([rng.uniform(-15, 15, (150, 2)), rng.uniform(-4, 4, 150)])
    count = len(places)
    angles = np.zeros((count, 3))
    angles[:, :2] = tilt * np.column_stack([np.cos(np.arange(count)), np.sin(2.0 * np.arange(count))])
    poses = np.hstack([angles, places])
    views = OrientedImages(("i",) * count, (LENS,), np.zeros(count, np.int64), poses)
    track, image = np.repeat(np.arange(150), count), np.tile(np.arange(count), 150)
    return Tracks(track, image, views.project(image, ground[track]), np.ones(len(track)))


def _strip(places: Floats, rng: np.random.Generator, noise_px: float = 0.5) -> Tracks:
    """Rays of hilly ground along a strip, each to images near it, with noise."""
    count = len(places)
    ground = np.column_stack(
        [rng.uniform(-15, 85, 1200), rng.uniform(-14, 18, 1200), rng.uniform(-4, 4, 1200)]
    )
    lens = LENS.with_values(np.where(np.arange(len(LENS.values)) == 3, -3e-9, LENS.values))
    views = OrientedImages(
        ("i",) * count, (lens,), np.zeros(count, np.int64), np.hstack([np.zeros((count, 3)), places])
    )
    track, image = np.repeat(np.arange(1200), count), np.tile(np.arange(count), 1200)
    pixels = views.project(image, ground[track]) + rng.normal(0, noise_px, (len(track), 2))
    inside = np.asarray(((pixels > 0) & (pixels < np.array(LENS.size_px) - 1)).all(axis=1))
    return Tracks(track, image, pixels, np.ones(len(track))).some(inside)


def _block(places: Floats) -> Block:
    values, sigma = np.full((len(places), 6), np.nan), np.full((len(places), 6), np.inf)
    values[:, 3:], sigma[:, 3:] = places, 1.0
    names = tuple(f"{k}.jpg" for k in range(len(places)))
    images = Images(names, np.zeros(len(places), np.int64), values, sigma)
    return Block("b", "local", "", "control", (LENS,), images)


def test_positions_in_a_line_place_a_level_block_and_that_is_told() -> None:
    """Any turn about the line fits: cameras that look down close it, and the block is adjusted free."""
    places = np.array([[-6.0, 0, 40], [0, 0, 40], [6.0, 0, 40]])
    block, poses, _, findings = oriented(_block(places), _tracks(places))
    assert block.datum == "free"
    assert any("in a line" in english(one) for one in findings)
    assert np.abs(poses[:, 3:] - places).max() < 0.1
    assert np.abs(poses[:, :2]).max() < 0.01


def test_positions_of_a_corridor_keep_all_that_they_say() -> None:
    """Scale, direction and place of good positions hold a block in a line; one level image holds its turn.

    Expected: the true poses, to the noise of positions of 1 cm over 40 m; the turn to 0.2 rad.
    """
    rng = np.random.default_rng(3)
    places = np.column_stack([np.arange(12) * 4.0, np.zeros(12), np.full(12, 40.0)])
    seen = places + rng.normal(0, 0.01, places.shape)
    # The lens of the strip, which would bend another.
    start = replace(_block(seen), cameras=(LENS.changed(K1=-3e-9),))
    start.images.sigma[:, 3:] = 0.01
    found = first_orientation(start, _strip(places, rng)).adjusted
    assert found.start.datum == "control"
    assert np.isfinite(found.start.images.sigma[:, :3]).all(axis=1).sum() == 1
    assert np.ptp(found.values[:, 3]) == pytest.approx(44.0, abs=0.03)
    assert np.abs(found.values[:, 1]).max() < 0.01
    assert np.abs(found.values[:, 0]).max() < 0.2
    told = [one for one in oriented(start, found.tracks)[3] if one.code == "positions-in-line"]
    assert 0.0 < float(told[0].figures["turn_deg"]) <= 11.5


def test_heights_of_another_surface_are_told_by_control() -> None:
    """Control puts all images 26 m below their own heights, as an undulation of -26 m does."""
    places = np.array([[x, y, 40.0] for x in (-9.0, -3, 3, 9) for y in (-6.0, 6)])
    images, values = _block(places).images, np.hstack([np.zeros((8, 3)), places - [0, 0, 26.0]])
    (found,) = position_sigmas(images, values, shifted=True)[2]
    assert (found.code, found.severity, found.figures) == ("heights-apart", "note", {"up_m": -26.0})
    values[:, 5] += 20.0
    assert position_sigmas(images, values, shifted=True)[2] == []


def test_heights_that_may_count_from_any_surface_say_nothing_once_control_is_far_from_them() -> None:
    """Above take-off, at a site 200 m above the sea: each of 50 m, together they would contradict control."""
    places = np.array([[x, y, 40.0] for x in (-9.0, -3, 3, 9) for y in (-6.0, 6)])
    images = _block(places).images
    sigma = np.hstack([images.sigma[:, :3], np.tile([1.5, 1.5, 50.0], (8, 1))])
    values = np.hstack([np.zeros((8, 3)), places + np.array([0, 0, 200.0])])
    found, _, (told,) = position_sigmas(replace(images, sigma=sigma), values, shifted=True)
    assert np.isinf(found[:, 5]).all()
    assert (found[:, 3:5] == 1.5).all()
    assert (told.code, told.severity) == ("heights-apart", "doubtful")


def test_positions_tens_of_metres_off_bend_nothing() -> None:
    """One is 300 m off: named and not used; all are 20 m off: their sigmas are enlarged."""
    rng = np.random.default_rng(8)
    places = np.array([[x, y, 40.0] for x in (-9.0, -3, 3, 9) for y in (-6.0, 6)])
    tracks = _tracks(places)
    wrong = places + rng.normal(0, 0.3, places.shape)
    wrong[2] += [0, 300, 0]
    found = first_orientation(_block(wrong), tracks)
    assert found.adjusted.start.datum == "control"
    assert any("2.jpg is wrong by 300 m" in english(one) for one in found.findings)
    assert np.isinf(found.adjusted.start.images.sigma[2, 3:]).all()
    relative = np.linalg.norm(np.diff(found.adjusted.values[:, 3:], axis=0), axis=1)
    assert relative == pytest.approx(np.linalg.norm(np.diff(places, axis=0), axis=1), rel=0.05)


def test_good_positions_keep_their_weight_though_rays_alone_bend() -> None:
    """A strip of 24 whose lens is not known well bends by decimetres; positions of 2 cm straighten it."""
    rng = np.random.default_rng(9)
    places = np.array([[3.0 * x, 4.0 * (x % 2), 40.0] for x in range(24)])
    tracks = _strip(places, rng)
    block = _block(places + rng.normal(0, 0.02, places.shape))
    block.images.sigma[:, 3:] = 0.02
    found = first_orientation(block, tracks)
    assert found.findings == ()
    assert found.adjusted.start.images.sigma[:, 3:] == pytest.approx(np.full((24, 3), 0.02))
    assert np.abs(found.adjusted.values[:, 3:] - places).max() < 0.08


@pytest.mark.parametrize("share", [0.8, 1.25])
def test_a_wrong_principal_distance_costs_iterations_only(share: float) -> None:
    """Tilted views show c (parallel ones stretch with the heights): a fifth off, it is found and told."""
    places = np.array([[x, y, 30.0 + 2 * x] for x in (-6.0, -2, 2, 6) for y in (-6.0, 6)])
    start = _block(places)
    values = LENS.values.copy()
    values[0] *= share
    block, _, _, findings = oriented(
        replace(start, cameras=(LENS.with_values(values),)), _tracks(places, 0.2)
    )
    assert block.cameras[0].value("c") == pytest.approx(900.0, rel=1e-3)
    assert block.cameras[0].estimated[0]
    assert any("was given as" in english(one) for one in findings)


def test_poses_of_another_principal_distance_come_as_much_nearer() -> None:
    places = np.array([[x, y, 40.0] for x in (-6.0, 6) for y in (-6.0, 6)])
    poses = np.hstack([np.zeros((4, 3)), places])
    found = rescaled_poses(_block(places), poses, _tracks(places), np.full(4, 0.75))
    assert found[:, :5] == pytest.approx(poses[:, :5], abs=1e-9)
    # The ground lies 40 m below, within its hills.
    assert found[:, 5] == pytest.approx(np.full(4, 30.0), abs=0.25)


def test_what_one_image_sees_leaves_a_free_block() -> None:
    seen = replace(
        NO_OBSERVATIONS,
        image=np.array([0, 1, 0]),
        point=np.array([0, 0, 1]),
        values=np.arange(6.0).reshape(3, 2),
        sigma=np.ones((3, 2)),
    )
    points = replace(NO_POINTS, names=("a", "b"), values=np.zeros((2, 3)), sigma=np.ones((2, 3)))
    block = replace(_block(np.zeros((2, 3))), points=points, observations=seen)
    left = without_single_rays(block).observations
    assert left.point.tolist() == [0, 0]
    assert left.values.tolist() == [[0.0, 1.0], [2.0, 3.0]]


def test_images_from_elsewhere_are_another_block() -> None:
    """Two groups that share nothing: the larger one is oriented, the others are named."""
    places = np.array([[x, y, 40.0] for x in (-6.0, 0, 6) for y in (-5.0, 5)])
    one = _tracks(places)
    other = _tracks(places[:3])
    both = Tracks(
        np.concatenate([one.track, other.track + 150]),
        np.concatenate([one.image, other.image + 6]),
        np.vstack([one.pixels, other.pixels[:, ::-1] * [1.0, 0.8]]),
        np.ones(len(one.track) + len(other.track)),
    )
    block = _block(np.vstack([places, places[:3] + np.array([500.0, 0, 0])]))
    reasons = oriented(block, both)[2]
    assert all(reason == "" for reason in reasons[:6])
    assert all("another block of 3 images" in reason or "do not orient" in reason for reason in reasons[6:])


def test_images_that_share_nothing_are_named() -> None:
    places = np.array([[-6.0, 0, 40], [0, 3, 40], [6.0, 0, 40]])
    few = _tracks(places).some(np.arange(450) < 9)
    with pytest.raises(IllPosedError, match="shares only 3 tie points"):
        orient_ties(_block(places), [], few, np.array([[0, 1]]), 1, _quiet)


def _rolling(readout_s: float, images: int) -> tuple[flights.Flight, Block, Floats, Tracks]:
    """A flight in gusts of which nobody said whether its shutter rolls, with 0.3 px of noise."""
    rng = np.random.default_rng(11)
    lens = replace(flights.wide(), shutter="unknown")
    truth = flights.flight(lens, rng, images=images, points=260, readout_s=readout_s)
    count, points = len(truth.centre), len(truth.points)
    track, image = np.repeat(np.arange(points), count), np.tile(np.arange(count), points)
    pixels = plane_to_pixel(np.array(flights.SIZE), np.ones(2), flights.recorded(truth, image, track))
    pixels += rng.normal(0, 0.3, pixels.shape)
    with np.errstate(invalid="ignore"):
        inside = ((pixels > 0) & (pixels < np.array(flights.SIZE) - 1)).all(axis=1)
    tracks = Tracks(track, image, pixels, np.ones(len(track))).some(np.asarray(inside), 3)
    views = oriented_images((lens,), np.zeros(count), truth.rotation, truth.centre)
    values, sigma = views.values.copy(), np.full((count, 6), np.inf)
    values[:, 3:] += rng.normal(0, 0.05, (count, 3))
    sigma[:, 3:] = 0.05
    seen = Images(views.names, views.camera, values, sigma, time=truth.time)
    block = Block("b", "local", "", "control", (lens,), seen)
    return truth, block, values, tracks


def test_a_rolling_shutter_makes_no_gross_errors_and_matching_follows_it() -> None:
    """Nobody said that it rolls: it is found, no ray is taken out, and views tell where points lie."""
    _, block, values, tracks = _rolling(0.03, 14)
    adjusted = adjust_ties(block, values, tracks)
    own = adjusted.start.cameras[0]
    assert own.rolling
    assert own.value("readout") == pytest.approx(0.03, abs=0.01)
    assert adjusted.rejected < 0.002 * len(tracks.track)
    left = adjusted.tracks
    views, points = _views(adjusted), intersected(_views(adjusted), left)
    miss = np.linalg.norm(views.project(left.image, points[left.track]) - left.pixels, axis=1)
    still = replace(views, movement=None)
    lost = np.linalg.norm(still.project(left.image, points[left.track]) - left.pixels, axis=1)
    assert np.median(miss) < 1.0
    # Points of the upper edge are recorded 15 ms before the middle: 0.12 m or 5 px of the way.
    assert np.median(lost) > 2.0


def test_few_images_that_do_not_bear_a_readout_are_adjusted_as_if_they_were_still() -> None:
    truth, block, values, tracks = _rolling(0.0, 4)
    hovering = replace(block.images, motion=np.zeros((4, 6)), motion_sigma=np.zeros((4, 6)))
    rolling = replace(block.cameras[0].changed(readout=0.02), shutter="rolling")
    rolling = replace(rolling, estimated=np.isin(PARAMETERS, ("c", "readout")))
    start = replace(block, images=hovering, cameras=(rolling,))
    adjusted = adjust_ties(start, values, tracks)
    (own,) = adjusted.start.cameras
    assert own.shutter == "global"
    assert own.value("readout") == 0.0
    assert own.estimated[PARAMETERS.index("c")]
    assert np.abs(adjusted.values[:, 3:] - truth.centre).max() < 0.5


def test_few_tie_points_whose_rays_do_not_meet_are_dropped() -> None:
    """Two of 152 are seen in one direction from two places, as stars are: nothing says where."""
    places = np.array([[x, y, 40.0] for x in (-6.0, 0, 6) for y in (-5.0, 5)])
    good = _tracks(places)
    pixels = np.array([[400.0, 300.0], [400.0, 300.0], [620.0, 500.0], [620.0, 500.0]])
    tracks = Tracks(
        np.r_[good.track, [150, 150, 151, 151]],
        np.r_[good.image, [0, 5, 1, 4]],
        np.vstack([good.pixels, pixels]),
        np.ones(len(good.track) + 4),
    )
    start = _block(places)
    poses = np.hstack([np.zeros((6, 3)), places])
    far = np.array([[0.0, 0.0, -1e9]] * 2)
    near = place(replace(start, images=replace(start.images, values=poses)), good)
    block = with_ties(start, tracks, np.vstack([near, far]), np.ones(len(tracks.track)))
    ties, block, (_, _, solution) = _where_rays_meet(
        _Ties(start, poses, tracks, np.ones(len(tracks.track)), np.full((tracks.count, 3), np.nan)),
        block,
        held=True,
    )
    assert ties.tracks.count == 150
    assert len(block.points.names) == 150
    assert np.abs(solution.exposures[:, 3:] - solution.exposures[:, 3:].mean(axis=0)).max() < 8.0


def test_what_is_known_of_a_camera_stays_what_it_was() -> None:
    """A prior observes the given c in every round: what a level strip makes of it does not creep on."""
    rng = np.random.default_rng(12)
    places = np.array([[3.0 * x, 4.0 * (x % 2), 40.0] for x in range(24)])
    block = _block(places + rng.normal(0, 0.05, places.shape))
    known = np.array([name == "c" for name in PARAMETERS])
    own = LENS.changed(c=918.0)
    own = replace(own, estimated=known, prior_sigma=np.where(known, 9.0, np.inf))
    block = replace(block, cameras=(own,))
    block.images.sigma[:, 3:] = 1.0
    poses = np.hstack([np.zeros((24, 3)), places])
    tracks = _strip(places, rng)
    once = adjust_ties(block, poses, tracks)
    again = once
    for _ in range(3):
        again = adjust_ties(again.start, again.values, again.tracks)
    adjusted, last = once.start.cameras[0], again.start.cameras[0]
    assert abs(adjusted.value("c") - 918.0) > 0.1
    assert last.value("c") == pytest.approx(adjusted.value("c"), abs=0.02)


def test_what_fitted_is_adjusted_again_from_its_sigmas() -> None:
    """Rays of two sigmas and some gross errors: the second time none falls out, and nothing moves."""
    rng = np.random.default_rng(8)
    places = np.array([[3.0 * x, 4.0 * (x % 2), 40.0] for x in range(16)])
    block, tracks = _block(places), _strip(places, rng)
    worse, wrong = tracks.image % 2 == 1, rng.random(len(tracks.track)) < 0.02
    noise = rng.normal(0, 1, tracks.pixels.shape)
    pixels = tracks.pixels + noise * np.where(wrong, 20.0, worse)[:, None]
    once = adjust_ties(block, np.hstack([np.zeros((16, 3)), places]), replace(tracks, pixels=pixels))
    assert np.count_nonzero(wrong) * 0.9 < once.rejected
    again = adjusted_again(once, once.start, once.values)
    assert again.rejected <= 1e-3 * len(once.tracks.track)
    sigma = np.sqrt(once.solution.variance_factor) * np.sqrt(
        np.einsum("nii->ni", once.solution.exposure_covariance)
    )
    assert np.abs((again.values - once.values) / sigma).max() < 0.05


def test_rays_are_not_to_blame_for_a_wrong_principal_distance() -> None:
    """Positions of two heights, brought in later, contradict the c that is held: all rays fit less."""
    places = np.array([[6.0 * x, y, z] for z in (40.0, 48.0) for y in (0.0, 6.0) for x in range(6)])
    tracks = _strip(places, np.random.default_rng(4), noise_px=0.03)
    held = replace(LENS.changed(c=918.0, K1=-3e-9), estimated=np.zeros_like(LENS.estimated))
    start = replace(_block(places), cameras=(held,))
    start.images.sigma[:, 3:] = 5.0
    alone = adjust_ties(start, np.hstack([np.zeros((24, 3)), places]), tracks)
    tight = np.where(np.isfinite(start.images.sigma), 3e-4, np.inf)
    positioned = replace(alone.start, images=replace(alone.start.images, sigma=tight))
    strained = adjusted_again(alone, positioned, alone.values)
    assert strained.tie_sigma > 2.0 * alone.tie_sigma == pytest.approx(0.06, rel=0.05)
    assert (alone.rejected, strained.rejected) == (0, 0)
    # With c free, as positions of two heights determine it, the rays fit as before.
    free = replace(strained.start.cameras[0], estimated=among("c"))
    freed = adjusted_again(strained, replace(strained.start, cameras=(free,)), strained.values)
    assert freed.start.cameras[0].value("c") == pytest.approx(900.0, abs=0.1)
    assert freed.tie_sigma == pytest.approx(alone.tie_sigma, rel=0.05)
    assert freed.rejected <= 1e-3 * len(tracks.track)


def test_rays_that_the_memory_does_not_hold_are_refused_before_they_are_adjusted(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    places = np.array([[-10.0, 0.0, 40.0], [0.0, 1.0, 40.0], [10.0, 0.0, 41.0], [0.0, 9.0, 40.0]])
    tracks = _tracks(places, tilt=0.02)
    oriented_block = first_orientation(_block(places), tracks).by_rays
    for free in (None, OF_RAY * len(tracks.track)):
        monkeypatch.setattr("photocal.measurement.oriented_ties.available_memory", lambda free=free: free)
        rays = len(_adjusted(oriented_block, tracks, None).tracks.track)
    monkeypatch.setattr("photocal.measurement.oriented_ties.available_memory", lambda: OF_RAY * rays - 1)
    with pytest.raises(ConfigurationError, match=f"{rays} rays of tie points take at least 0.0 GB of memory"):
        _adjusted(oriented_block, tracks, None)
