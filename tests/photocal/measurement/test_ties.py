"""Tie points: features, matches, tracks, pairs, cache and workers."""

from __future__ import annotations

import os
from collections.abc import Callable
from pathlib import Path
from typing import Protocol

import cv2
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray
from PIL import Image
from pyproj import Geod

from photocal.base.progress import quiet
from photocal.base.workers import run_tasks
from photocal.block.folder import read_block
from photocal.measurement.features import Features, FeatureSettings, cached, detect, made_once
from photocal.measurement.image_facts import read_facts
from photocal.measurement.image_pairs import among_nearest, footprints, select_pairs
from photocal.measurement.match_images import (
    JOINED,
    MatchingPlan,
    detect_all,
    match_all,
    match_where_needed,
    same_pictures,
)
from photocal.measurement.pair_matching import match, mutual_matches, search_windows
from photocal.measurement.thinning import spaced, thin
from photocal.measurement.tracks import Tracks, in_common, join_tracks


class Answer(Protocol):
    """What a command said."""

    code: int
    out: str
    err: str


def _texture(seed: int = 0, size: int = 700) -> NDArray[np.uint8]:
    """Blobs of all sizes."""
    rng = np.random.default_rng(seed)
    total = np.zeros((size, size), np.float32)
    for sigma in (2, 4, 8, 16):
        layer = cv2.GaussianBlur(rng.normal(0, 1, (size, size)).astype(np.float32), (0, 0), sigma)
        total += layer / layer.std()
    return np.asarray(np.clip(128 + 35 * total, 0, 255), np.uint8)


def _features(pixels: list[list[float]]) -> Features:
    count = len(pixels)
    return Features(
        np.array(pixels, np.float32), np.ones(count, np.float32), np.zeros((count, 128), np.uint8)
    )


@pytest.mark.parametrize("longest", [2400, 100])
def test_features_stand_where_the_blobs_are(longest: int) -> None:
    """A bright spot at a known place: no half pixel is lost, nor by reducing the image."""
    place = np.array([90.3, 60.8])
    y, x = np.mgrid[0:140, 0:200]
    for sigma in (6.0, 9.0):
        spot = 40 + 180 * np.exp(-((x - place[0]) ** 2 + (y - place[1]) ** 2) / (2 * sigma**2))
        found = detect(np.asarray(spot, np.uint8), FeatureSettings(longest_px=longest))
        nearest = np.hypot(*(found.pixels - place).T).min()
        assert nearest < 0.1


def test_the_finest_features_are_detected_where_they_are_kept() -> None:
    """A picture that shows enough features when it is reduced is not examined in full size."""
    picture = _texture(4)
    longest = max(picture.shape)
    whole = detect(picture, FeatureSettings(most=100_000, longest_px=longest, part=1.0))
    half = detect(picture, FeatureSettings(most=100_000, longest_px=longest // 2, part=1.0))
    few, many = len(half.scale) // 2, 2 * len(half.scale)
    assert len(whole.scale) > many
    # Rich enough: those of the half, the coarsest ones. Too poor: those of the whole, the finest among them.
    rich = detect(picture, FeatureSettings(most=few, longest_px=longest))
    poor = detect(picture, FeatureSettings(most=many, longest_px=longest))
    assert len(rich.scale) == few
    assert rich.scale.min() >= half.scale.min()
    assert len(poor.scale) == many
    assert {tuple(place) for place in poor.pixels.tolist()} <= {tuple(p) for p in whole.pixels.tolist()}
    # A picture that is only a little longer than the part stays whole.
    hardly = detect(picture, FeatureSettings(most=few, longest_px=longest * 2 - longest // 2, part=0.6))
    assert {tuple(place) for place in hardly.pixels.tolist()} <= {tuple(p) for p in whole.pixels.tolist()}


def test_plain_images_have_no_features() -> None:
    found = detect(np.full((64, 80), 90, np.uint8), FeatureSettings())
    assert found.pixels.shape == (0, 2)
    assert len(mutual_matches(found.descriptors, found.descriptors, 0.8)) == 0


def test_matches_follow_a_known_homography() -> None:
    texture = _texture()
    move = np.array([[0.96, -0.2, 60], [0.2, 0.96, -40], [5e-5, 2e-5, 1.0]])
    moved = np.asarray(cv2.warpPerspective(texture, move, (700, 700)), np.uint8)
    first, second = (detect(image, FeatureSettings(most=1500)) for image in (texture, moved))
    pairs = match(first, second)
    assert len(pairs) > 200
    there = np.column_stack([first.pixels[pairs[:, 0]], np.ones(len(pairs))]) @ move.T
    miss = np.hypot(*(there[:, :2] / there[:, 2:] - second.pixels[pairs[:, 1]]).T)
    assert np.median(miss) < 0.3
    assert np.mean(miss > 3) < 0.02


def test_few_matches_tell_where_the_others_are_sought() -> None:
    """Every feature's partner stands in its window, on ground that rises by 20 px of parallax."""
    rng = np.random.default_rng(2)
    first = rng.uniform(0, 1000, (4000, 2)).astype(np.float32)
    move = np.array([[0.9, -0.3, 200], [0.3, 0.9, -100], [1e-4, 5e-5, 1.0]])
    there = np.column_stack([first, np.ones(len(first))]) @ move.T
    relief = np.column_stack([20 * np.sin(first[:, 0] / 90), np.zeros(len(first))])
    second = (there[:, :2] / there[:, 2:] + relief).astype(np.float32)
    known = rng.choice(len(first), 60, replace=False)
    # Some of the known matches are wrong.
    wrong = np.r_[known[:-8], np.roll(known[-8:], 1)]
    windows = search_windows(first, second, first[known], second[wrong])
    assert windows is not None
    sought = {
        int(i): np.concatenate([windows.columns[slice(*span)] for span in spans])
        for rows, spans in zip(np.split(windows.rows, windows.begins[1:-1]), windows.spans, strict=True)
        for i in rows
    }
    assert np.mean([i in sought.get(i, ()) for i in range(len(first))]) > 0.995
    assert sum(len(columns) for columns in sought.values()) < 0.15 * len(first) * len(second)


def test_matches_without_a_common_plane_narrow_nothing() -> None:
    rng = np.random.default_rng(3)
    first, second = (rng.uniform(0, 1000, (500, 2)).astype(np.float32) for _ in range(2))
    assert search_windows(first, second, first[:40], second[:40]) is None
    line = np.column_stack([np.arange(40.0), np.zeros(40)]).astype(np.float32)
    assert search_windows(first, second, line, line) is None


def test_narrowed_matching_finds_what_the_whole_finds() -> None:
    texture = _texture()
    move = np.array([[0.96, -0.2, 60], [0.2, 0.96, -40], [5e-5, 2e-5, 1.0]])
    moved = np.asarray(cv2.warpPerspective(texture, move, (700, 700)), np.uint8)
    first, second = (detect(image, FeatureSettings(most=1500)) for image in (texture, moved))
    whole = match(first, second)
    narrowed = match(first, second, sketch=300)
    both = set(map(tuple, whole.tolist())) & set(map(tuple, narrowed.tolist()))
    assert len(both) > 0.97 * len(whole)
    there = np.column_stack([first.pixels[narrowed[:, 0]], np.ones(len(narrowed))]) @ move.T
    miss = np.hypot(*(there[:, :2] / there[:, 2:] - second.pixels[narrowed[:, 1]]).T)
    assert np.mean(miss > 3) < 0.02


def test_strangers_do_not_match() -> None:
    first, second = (detect(_texture(seed), FeatureSettings(most=1500)) for seed in (1, 2))
    assert len(match(first, second)) == 0


def test_nearest_neighbours_as_by_brute_force() -> None:
    rng = np.random.default_rng(4)
    a, b = (rng.integers(0, 200, (n, 128)).astype(np.uint8) for n in (300, 260))
    b[:100] = np.clip(a[100:200].astype(int) + rng.integers(-3, 4, (100, 128)), 0, 255)
    root = [np.sqrt(d / d.sum(axis=1, keepdims=True)) for d in (a.astype(float), b.astype(float))]
    distance = np.linalg.norm(root[0][:, None] - root[1][None], axis=2)
    expected = []
    for i, row in enumerate(distance):
        j, k = np.argsort(row)[:2]
        if row[j] < 0.8 * row[k] and distance[:, j].argmin() == i:
            expected.append((i, j))
    assert mutual_matches(a, b, 0.8).tolist() == [list(pair) for pair in expected]


def test_tracks_join_pairs_and_lose_conflicts() -> None:
    features = [_features([[float(10 * j), 5.0] for j in range(4)]) for _ in range(3)]
    pairs = np.array([[0, 1], [1, 2], [0, 2]])
    # Place 0 is seen three times; place 1 of image 0 runs into places 1 and 2 of image 2: a conflict.
    matches = [np.array([[0, 0], [1, 1]]), np.array([[0, 0], [1, 1]]), np.array([[1, 2], [3, 3]])]
    tracks = join_tracks(features, pairs, matches)
    assert tracks.conflicts == 1
    assert tracks.rays.tolist() == [3, 2]
    assert tracks.image.tolist() == [0, 1, 2, 0, 2]


def test_features_at_one_place_are_one() -> None:
    features = [_features([[10.0, 10.0], [10.0, 10.0]]), _features([[20.0, 10.0]]), _features([[30.0, 10.0]])]
    pairs = np.array([[0, 1], [0, 2]])
    tracks = join_tracks(features, pairs, [np.array([[0, 0]]), np.array([[1, 0]])])
    assert tracks.rays.tolist() == [3]


def test_thinning_keeps_strong_points_everywhere() -> None:
    rng = np.random.default_rng(2)
    rays = rng.integers(2, 6, 3000)
    track = np.repeat(np.arange(3000), rays)
    image = np.concatenate([rng.permutation(6)[:n] for n in rays])
    order = np.lexsort((image, track))
    pixels = rng.uniform(0, 1000, (len(track), 2))
    tracks = Tracks(track[order], image[order].astype(np.int64), pixels, np.ones(len(track)))
    few = thin(tracks, np.full((6, 2), 1000.0), 8, 2)
    assert few.count < 0.5 * tracks.count
    assert few.rays.mean() > tracks.rays.mean()
    for k in range(6):
        cells = {(int(x // 125), int(y // 125)) for x, y in few.pixels[few.image == k]}
        assert len(cells) == 64


def test_pairs_grow_with_the_images_not_with_their_square() -> None:
    def grid(count: int) -> int:
        side = int(np.sqrt(count))
        east, north = np.meshgrid(np.arange(side) * 30.0, np.arange(count // side) * 20.0)
        places = np.column_stack([east.ravel(), north.ravel()])
        n = len(places)
        seen = footprints(
            places,
            np.full(n, 60.0),
            np.full((n, 2), np.nan),
            np.tile([4000.0, 3000.0], (n, 1)),
            np.full(n, 3000.0),
        )
        pairs, rule = select_pairs(seen, n)
        assert rule == "footprints"
        assert len(pairs) == len(np.unique(pairs, axis=0))
        return len(pairs)

    small, large = grid(250), grid(1000)
    assert large < 4.6 * small
    assert large <= 24 * 1000


def test_pairs_without_exposures() -> None:
    unknown = (np.full((5, 2), np.nan), np.full(5, np.nan))
    pairs, rule = select_pairs(unknown, 5)
    assert (len(pairs), rule) == (10, "all")
    many = (np.full((200, 2), np.nan), np.full(200, np.nan))
    pairs, rule = select_pairs(many, 200)
    assert rule == "sequence"
    assert len(pairs) < 12 * 200


def test_one_image_without_a_position_takes_that_of_no_other() -> None:
    """A hundred in a row, one lost: it goes with all, the others with their neighbours as before."""
    centre = np.column_stack([np.arange(100) * 10.0, np.zeros(100)])
    centre[40] = np.nan
    pairs, rule = select_pairs((centre, np.full(100, 20.0)), 100)
    assert rule == "footprints"
    lost = (pairs == 40).any(axis=1)
    assert lost.sum() == 99
    assert np.ptp(pairs[~lost], axis=1).max() <= 4


def test_an_oblique_view_looks_ahead() -> None:
    seen = footprints(
        np.zeros((1, 2)),
        np.array([100.0]),
        np.radians([[90.0, -45.0]]),
        np.array([[4000.0, 3000]]),
        np.array([3000.0]),
    )
    assert seen[0][0] == pytest.approx([100.0, 0.0], abs=1e-9)


def test_cached_results_are_not_made_again_and_damage_is_repaired(tmp_path: Path) -> None:
    made = []

    def make() -> dict[str, NDArray[np.int64]]:
        made.append(1)
        return {"a": np.arange(3)}

    for _ in range(2):
        assert cached(tmp_path, "ab12", ("a",), make)["a"].tolist() == [0, 1, 2]
    assert len(made) == 1
    (tmp_path / "ab" / "ab12.npz").write_bytes(b"PK\x03\x04 damaged")
    assert cached(tmp_path, "ab12", ("a",), make)["a"].tolist() == [0, 1, 2]
    assert len(made) == 2


def test_an_object_is_made_anew_of_other_data_and_by_other_code(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    made = []

    def of(given: NDArray[np.float64]) -> tuple[str, float]:
        """What is made of some numbers, or was once."""

        def make() -> tuple[str, float]:
            made.append(given)
            return str(given.shape), float(given.sum())

        return made_once(tmp_path, tuple[str, float], (given, "a"), make)

    flat, square = np.array([1.0, np.inf, 3.0, 4.0]), np.array([[1.0, np.inf], [3.0, 4.0]])
    for values in (flat, square, flat, square):
        assert of(values) == (str(values.shape), np.inf)
    assert len(made) == 2
    monkeypatch.setattr("photocal.measurement.features.program", lambda _: {"version": "another"})
    assert of(flat) == ("(4,)", np.inf)
    assert len(made) == 3


def test_workers_give_the_same_in_the_same_order() -> None:
    assert list(run_tasks(abs, range(-9, 0), 2)) == list(run_tasks(abs, range(-9, 0), 1))


def test_what_is_kept_is_taken_here_and_only_the_rest_elsewhere() -> None:
    odd = list(run_tasks(_where, range(6), 2, at_hand=lambda task: task % 2 == 0))
    assert [task for task, _ in odd] == list(range(6))
    assert [process == os.getpid() for _, process in odd] == [True, False] * 3
    assert {process for _, process in run_tasks(_where, range(6), 2, at_hand=lambda _: True)} == {os.getpid()}


def _where(task: int) -> tuple[int, int]:
    return task, os.getpid()


def test_two_workers_give_the_tracks_of_one(tmp_path: Path) -> None:
    texture = _texture(3, 500)
    paths = []
    for k, shift in enumerate((0, 40, 80)):
        path = tmp_path / f"{k}.png"
        Image.fromarray(texture[shift : shift + 400, shift : shift + 400]).save(path)
        paths.append(path)
    (tmp_path / "bad.png").write_bytes(b"none")
    results = []
    for processes in (1, 2):
        plan = MatchingPlan(tmp_path / f"cache{processes}", processes, FeatureSettings(most=800))
        keys, reasons = detect_all([*paths, tmp_path / "bad.png"], plan, quiet)
        assert reasons == ("", "", "", "is not an image")
        pairs = np.array([[0, 1], [0, 2], [1, 2]])
        results.append(match_all(keys[:3], pairs, plan, lambda _: None)[0])
    assert results[0].count > 100
    assert np.array_equal(results[0].pixels, results[1].pixels)
    assert np.array_equal(results[0].track, results[1].track)


def test_what_tracks_join_already_is_not_matched_again(tmp_path: Path) -> None:
    """Six pictures in a row, each with two thirds of the one before."""
    texture, size, step = _texture(3, 900), 400, 70
    paths = [tmp_path / f"{k}.png" for k in range(6)]
    for k, path in enumerate(paths):
        Image.fromarray(texture[:size, k * step : k * step + size]).save(path)
    plan = MatchingPlan(tmp_path / "cache", 1, FeatureSettings(most=3000))
    keys, _ = detect_all(paths, plan, quiet)
    pairs = np.column_stack(np.triu_indices(6, 1)).astype(np.int64)
    apart = np.diff(pairs, axis=1).ravel()
    whole, of_all = match_all(keys, pairs, plan, lambda _: None)
    told, counts = match_where_needed(keys, pairs, apart == 1, plan, quiet)
    joined = in_common(whole, pairs, 6)
    # Those with few tracks in common, by their near neighbours, are matched; the others are not.
    chain = in_common(match_all(keys, pairs[apart == 1], plan, lambda _: None)[0], pairs, 6)
    assert len(counts) == 5 + np.count_nonzero(chain[apart > 1] < JOINED)
    assert 5 < len(counts) < len(pairs) == len(of_all)
    found = in_common(told, pairs, 6)
    assert (found > 0.9 * joined).all()
    # Where all are near, all are matched.
    again, counts = match_where_needed(keys, pairs, apart > 0, plan, quiet)
    assert np.array_equal(again.pixels, whole.pixels)
    assert np.array_equal(counts, of_all)


def test_tracks_in_common_are_counted_for_each_pair() -> None:
    chance = np.random.default_rng(1)
    seen = chance.random((40, 7)) < 0.5
    track, image = np.nonzero(seen[seen.sum(axis=1) > 1])
    rays = len(track)
    tracks = Tracks(track, image, np.zeros((rays, 2)), np.ones(rays))
    pairs = np.column_stack(np.triu_indices(7, 1))
    sets = [set(track[image == k].tolist()) for k in range(7)]
    assert in_common(tracks, pairs, 7).tolist() == [len(sets[a] & sets[b]) for a, b in pairs]


def test_pairs_of_nearest_images() -> None:
    """Against a sorted list of each image; one that is lost goes with all that it is paired with."""
    places = np.random.default_rng(2).uniform(0.0, 100.0, (30, 2))
    places[7] = np.nan
    pairs = np.column_stack(np.triu_indices(30, 1)).astype(np.int64)
    near = {tuple(pair) for pair in pairs[among_nearest(places, pairs, 5)].tolist()}
    expected = {(min(7, k), max(7, k)) for k in range(30) if k != 7}
    for k in set(range(30)) - {7}:
        order = np.argsort(np.linalg.norm(places - places[k], axis=1))
        nearest = [int(j) for j in order if j not in (7, k)][:5]
        expected |= {(min(j, k), max(j, k)) for j in nearest}
    assert near == expected


def test_heads_of_a_rig_are_no_neighbours_of_one_another() -> None:
    """Five at each place: with ten neighbours a picture goes with those of the two nearest places, too."""
    heads, count = 5, 12
    middles = np.random.default_rng(4).uniform(0.0, 100.0, (count, 2))
    pairs = np.column_stack(np.triu_indices(heads * count, 1)).astype(np.int64)
    near = among_nearest(np.repeat(middles, heads, axis=0), pairs, 2 * heads)
    together = pairs[:, 0] // heads == pairs[:, 1] // heads
    assert near[together].all()
    for k in range(count):
        _, *nearest = np.argsort(np.linalg.norm(middles - middles[k], axis=1)).tolist()
        for j in nearest[:2]:
            assert near[(pairs // heads == sorted((k, j))).all(axis=1)].all()


def test_a_picture_that_was_saved_twice_is_no_second_observation(tmp_path: Path) -> None:
    texture = _texture(3, 500)
    paths = [tmp_path / f"{name}.png" for name in ("1", "1 (1)", "2", "of 1", "dark", "dark too")]
    for path, shift in zip(paths, (0, 0, 40, 0, 0, 0), strict=True):
        grey = texture[shift : shift + 400, shift : shift + 400] * np.uint8("dark" not in path.name)
        # The copy of another program has other tags, and is another file.
        Image.fromarray(grey).save(path, compress_level=9 if path.stem == "of 1" else 6)
    plan = MatchingPlan(tmp_path / "cache", 1, FeatureSettings(most=800))
    keys, _ = detect_all(paths, plan, quiet)
    assert same_pictures(dict(enumerate(keys)), plan) == {0: 0, 1: 0, 2: 2, 3: 0, 4: 4, 5: 5}


@pytest.mark.shared
@pytest.mark.slow
def test_small_drone_images_in_one_block(
    shared: Path, tmp_path: Path, photocal: Callable[..., Answer]
) -> None:
    """Four small images of two strips of the recorded flight."""
    folder = tmp_path / "images"
    folder.mkdir()
    for k in (28, 29, 30, 31):
        source = shared / f"data/uav-brighton-beach/images/DJI_00{k}.JPG"
        with Image.open(source) as image:
            half = image.resize((1000, 563), Image.Resampling.BOX)
            half.save(folder / source.name, quality=95, exif=image.getexif(), xmp=image.info["xmp"])
    (folder / "empty.jpg").touch()
    said = photocal(
        "measure",
        "--images",
        folder,
        "-o",
        tmp_path / "block",
        "--workers",
        "1",
        "--cache",
        tmp_path / "cache",
    )
    assert said.code == 0, said.err
    assert "4 images in one block" in said.out
    assert "left out: empty.jpg: is empty" in said.out
    # The observed positions are those of the EXIF (distances between them are free of the frame).
    written = read_block(tmp_path / "block").images
    facts = [read_facts(folder / name) for name in written.names]
    geodesic = Geod(ellps="WGS84").inv(
        facts[0].longitude_deg, facts[0].latitude_deg, facts[1].longitude_deg, facts[1].latitude_deg
    )
    apart = written.values[1, 3:5] - written.values[0, 3:5]
    assert np.hypot(*apart) == pytest.approx(geodesic[2], abs=0.01)
    assert photocal("adjust", tmp_path / "block", "-o", tmp_path / "run").code == 0


def test_no_two_points_of_an_image_are_neighbours() -> None:
    rng = np.random.default_rng(5)
    count = 400
    rays = rng.integers(2, 6, count)
    track = np.repeat(np.arange(count), rays)
    image = np.concatenate([np.sort(rng.choice(6, n, replace=False)) for n in rays])
    # Each image shows the points of a field of 300 px moved.
    place = rng.uniform(0, 300, (count, 2))
    pixels = place[track] + 7.0 * image[:, None] + rng.normal(0, 0.1, (len(track), 2))
    tracks = Tracks(track, image, pixels, rng.uniform(0.02, 0.1, len(track)))
    kept = spaced(tracks, 20.0)
    assert 60 < kept.count < 200
    for k in range(6):
        mine = kept.pixels[kept.image == k]
        apart = np.linalg.norm(mine[:, None] - mine, axis=2) + 1e9 * np.eye(len(mine))
        assert apart.min() >= 20.0
    # Each point that went has a neighbour that stayed and is at least as strong.
    stayed = {tuple(row): n for row, n in zip(kept.pixels.tolist(), kept.rays[kept.track], strict=True)}
    for j in range(count):
        mine = track == j
        if tuple(pixels[mine][0].tolist()) in stayed:
            continue
        beside = [
            n
            for k, at in zip(image[mine], pixels[mine], strict=True)
            for other, n in zip(
                kept.pixels[kept.image == k], kept.rays[kept.track[kept.image == k]], strict=True
            )
            if np.linalg.norm(other - at) < 20.0
        ]
        assert max(beside) >= rays[j]


def test_the_strongest_points_stay() -> None:
    tracks = Tracks(
        np.array([0, 0, 1, 1, 1, 2, 2]),
        np.array([0, 1, 0, 1, 2, 0, 1]),
        np.array([[10.0, 10], [10, 10], [15, 10], [15, 10], [15, 10], [60, 10], [60, 10]]),
        np.full(7, 0.05),
    )
    assert spaced(tracks, 20.0).rays.tolist() == [3, 2]


@given(st.integers(0, 10_000), st.integers(1, 5), st.floats(5.0, 60.0))
@settings(max_examples=25)
def test_thinning_is_what_its_rule_says_track_by_track(seed: int, in_a_cell: int, least_px: float) -> None:
    """Beside loops over all tracks and rays; places may lie before the first pixel."""
    rng = np.random.default_rng(seed)
    count = 60
    rays = rng.integers(2, 5, count)
    image = np.concatenate([np.sort(rng.choice(4, n, replace=False)) for n in rays])
    track = np.repeat(np.arange(count), rays)
    tracks = Tracks(track, image, rng.uniform(-30, 300, (len(track), 2)), rng.uniform(0.1, 1, len(track)))
    order = sorted(range(tracks.count), key=lambda j: (-tracks.rays[j], tracks.scale[track == j].min()))
    filled, stays, apart = dict[tuple[int, ...], int](), list[int](), list[int]()
    for j in order:
        mine = np.flatnonzero(track == j)
        cells = [(image[k], *np.floor(np.maximum(tracks.pixels[k], 0) / 50)) for k in mine]
        if any(filled.get(cell, 0) < in_a_cell for cell in cells):
            stays.append(j)
            filled |= {cell: filled.get(cell, 0) + 1 for cell in cells}
        others = np.flatnonzero(np.isin(track, apart))
        away = np.hypot(*(tracks.pixels[mine, None] - tracks.pixels[others]).transpose(2, 0, 1))
        if not ((away <= least_px) & (image[mine, None] == image[others])).any():
            apart.append(j)
    sizes = np.full((4, 2), 300.0)
    for made, kept in ((thin(tracks, sizes, 6, in_a_cell), stays), (spaced(tracks, least_px), apart)):
        assert made.pixels.tolist() == tracks.pixels[np.isin(track, kept)].tolist()
