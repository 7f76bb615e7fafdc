"""Least squares matching of patches, and tie points measured with it."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
import pytest
from numba import typeof
from numpy.typing import NDArray
from PIL import Image

from photocal.geometry.camera import camera
from photocal.geometry.oriented_images import OrientedImages
from photocal.measurement.compile import compile_kernels
from photocal.measurement.patch_kernel import match_patches
from photocal.measurement.patch_matching import ImageSource, refine
from photocal.measurement.tie_block import intersected, reprojection_errors
from photocal.measurement.tracks import Tracks, of_images, without_twins

Floats = NDArray[np.float64]
SIZE = 420


def _ground(seed: int = 0, size: int = 900) -> NDArray[np.float32]:
    rng = np.random.default_rng(seed)
    total = np.zeros((size, size), np.float32)
    for sigma in (1.5, 3, 6, 12):
        layer = cv2.GaussianBlur(rng.normal(0, 1, (size, size)).astype(np.float32), (0, 0), sigma)
        total += layer / layer.std()
    return np.asarray(128 + 20 * total, np.float32)


def _match(
    patches: NDArray[np.float32], image: NDArray[np.float32], place: Floats, affinity: Floats
) -> tuple[Floats, Floats, Floats]:
    count = len(place)
    found, likeness, covariance = np.empty((count, 2)), np.empty(count), np.zeros((count, 2, 2))
    match_patches(patches, image, place, affinity, 4.0, found, likeness, covariance)
    return found, likeness, covariance


def test_matches_stand_where_an_affinity_puts_them() -> None:
    """Start values are wrong by pixels and degrees, brightness and contrast differ, there is noise."""
    rng = np.random.default_rng(3)
    first = _ground()
    turn = np.array([[1.05, -0.25], [0.22, 0.97]])
    move = np.array([-30.4, 61.7])
    second = cv2.warpAffine(first, np.column_stack([turn, move]), (900, 900), flags=cv2.INTER_CUBIC)
    noisy = [image + rng.normal(0, 2.0, image.shape) for image in (first, 0.7 * second + 20)]
    smooth = [
        np.asarray(cv2.GaussianBlur(image.astype(np.float32), (0, 0), 0.8), dtype=np.float32)
        for image in noisy
    ]
    middle = rng.integers(250, 650, (300, 2))
    patches = np.array([smooth[0][r - 11 : r + 12, c - 11 : c + 12] for c, r in middle])
    truth = middle @ turn.T + move
    start = truth + rng.uniform(-1.5, 1.5, truth.shape)
    found, likeness, covariance = _match(
        patches, smooth[1], start, np.broadcast_to(np.eye(2), (300, 2, 2)).copy()
    )
    good = np.isfinite(found).all(axis=1) & (likeness > 0.8)
    assert good.mean() > 0.95
    miss = (found - truth)[good]
    assert np.sqrt(np.mean(miss**2)) < 0.05
    # No bias, and errors of the size that the covariance says (smoothing makes neighbours alike: within 3).
    assert np.abs(miss.mean(axis=0)).max() < 0.01
    claimed = np.sqrt(np.trace(covariance[good], axis1=1, axis2=2) / 2)
    assert 0.5 < np.sqrt(np.mean(miss**2)) / np.sqrt(np.mean(claimed**2)) < 3


def test_a_patch_matches_the_picture_it_was_cut_from_without_misfit() -> None:
    """Rounding must not make the square of a misfit that is nothing negative: its root would be no number."""
    picture, rng = _ground(5), np.random.default_rng(2)
    middle = rng.integers(50, 850, (400, 2))
    patches = np.array([picture[r - 11 : r + 12, c - 11 : c + 12] for c, r in middle])
    identity = np.broadcast_to(np.eye(2), (400, 2, 2)).copy()
    found, likeness, covariance = _match(patches, picture, middle.astype(float), identity)
    assert found == pytest.approx(middle, abs=1e-4)
    assert likeness == pytest.approx(np.ones(400), abs=1e-6)
    variance = np.trace(covariance, axis1=1, axis2=2)
    assert (variance >= 0.0).all()
    assert variance.max() < 1e-8


def test_nothing_is_found_where_there_is_nothing() -> None:
    flat = np.full((100, 100), 90, np.float32)
    edge = flat.copy()
    edge[:, 50:] = 160
    smooth = np.asarray(cv2.GaussianBlur(edge, (0, 0), 0.8), dtype=np.float32)
    patches = np.array([image[39:62, 39:62] for image in (flat, smooth)])
    place = np.full((2, 2), 50.0)
    found, likeness, _ = _match(patches, smooth, place, np.broadcast_to(np.eye(2), (2, 2, 2)).copy())
    assert np.isnan(found).all()
    assert (likeness == 0).all()
    # Other ground, and a place outside the image.
    stranger = _ground(7)[:23, :23][None]
    far = np.array([[5.0, 5.0]])
    for where in (place[:1], far):
        found, likeness, _ = _match(stranger, _ground(8)[:100, :100].copy(), where, np.eye(2)[None].copy())
        assert not (likeness > 0.8).any()


def _views(places: Floats, kappa: Floats) -> OrientedImages:
    own = camera("c", "brown-ideal", "px", (SIZE, SIZE), (1.0, 1.0), {"c": 400.0, "K1": -1e-7})
    poses = np.column_stack([np.zeros((len(kappa), 2)), kappa, places])
    return OrientedImages(("i",) * len(kappa), (own,), np.zeros(len(kappa), np.int64), poses)


def _pictures(views: OrientedImages, folder: Path) -> list[ImageSource]:
    """Views of level ground of 0.1 m pixels, made by the inverse of the projection."""
    ground = _ground()
    sources = []
    y, x = np.mgrid[0:SIZE, 0:SIZE].astype(float)
    pixels = np.column_stack([x.ravel(), y.ravel()])
    for k in range(len(views.station)):
        ideal, c = views.ideal(np.full(len(pixels), k), pixels)
        ray = np.column_stack([ideal, -c]) @ views.rotation[k]
        there = views.station[k] - ray * (views.station[k, 2] / ray[:, 2])[:, None]
        column = (there[:, 0] / 0.1 + 450).reshape(SIZE, SIZE).astype(np.float32)
        row = (450 - there[:, 1] / 0.1).reshape(SIZE, SIZE).astype(np.float32)
        picture = cv2.remap(ground, column, row, cv2.INTER_CUBIC)
        path = folder / f"{k}.png"
        Image.fromarray(np.clip(picture, 0, 255).astype(np.uint8)).save(path)
        sources.append(ImageSource(path, f"key{k}", folder / "cache"))
    return sources


def test_tracks_become_precise_and_find_their_other_images(tmp_path: Path) -> None:
    """Tracks of two rough rays in four views of a level ground; two are turned by half and a quarter."""
    places = np.array([[-4.0, 0, 40], [0, 1.0, 40], [4.0, 0, 41], [0, -4.0, 40]])
    views = _views(places, np.radians([0.0, 180.0, 0.0, 90.0]))
    sources = _pictures(views, tmp_path)
    rng = np.random.default_rng(1)
    truth = np.column_stack([rng.uniform(-8, 8, (120, 2)), np.zeros(120)])
    track = np.repeat(np.arange(120), 2)
    image = np.tile([0, 2], 120)
    exact = views.project(image, truth[track])
    rough = Tracks(track, image, exact + rng.normal(0, 0.5, exact.shape), np.ones(240))
    partners = [np.array([j for j in range(4) if j != k]) for k in range(4)]
    found = [
        refine(sources, views, rough, intersected(views, rough), partners, 1, lambda _: None) for _ in (1, 2)
    ]
    assert np.array_equal(found[0].pixels, found[1].pixels)
    precise = found[0]
    assert np.mean(precise.rays == 4) > 0.95
    miss = reprojection_errors(views, precise, intersected(views, precise))
    before = reprojection_errors(views, rough, intersected(views, rough))
    assert np.sqrt(np.mean(miss**2)) < 0.06 < 0.2 < np.sqrt(np.mean(before**2))


def test_strips_of_little_side_overlap_are_matched(tmp_path: Path) -> None:
    """Level ground looks alike from above however far it lies aside: here from 51 degrees apart."""
    views = _views(np.array([[-19.0, 0, 40], [19.0, 0, 40]]), np.radians([0.0, 180.0]))
    sources = _pictures(views, tmp_path)
    rng = np.random.default_rng(4)
    truth = np.column_stack([rng.uniform(-0.6, 0.6, 60), rng.uniform(-8, 8, 60), np.zeros(60)])
    track, image = np.repeat(np.arange(60), 2), np.tile([0, 1], 60)
    exact = views.project(image, truth[track])
    rough = Tracks(track, image, exact + rng.normal(0, 0.5, exact.shape), np.ones(120))
    partners = [np.array([1]), np.array([0])]
    precise = refine(sources, views, rough, intersected(views, rough), partners, 1, lambda _: None)
    assert np.sum(precise.rays == 2) > 50


def test_rays_farther_off_than_matching_reaches_are_found_in_reduced_pictures(tmp_path: Path) -> None:
    """Features of very large pictures are off by many stored pixels: here 8 px, in pictures halved twice."""
    places = np.array([[-4.0, 0, 40], [0, 1.0, 40], [4.0, 0, 41]])
    views = _views(places, np.radians([0.0, 180.0, 0.0]))
    sources = _pictures(views, tmp_path)
    rng = np.random.default_rng(2)
    truth = np.column_stack([rng.uniform(-6, 6, (60, 2)), np.zeros(60)])
    track, image = np.repeat(np.arange(60), 3), np.tile(np.arange(3), 60)
    exact = views.project(image, truth[track])
    rough = Tracks(track, image, exact + rng.normal(0, 8.0, exact.shape), np.ones(180))
    partners = [np.array([j for j in range(3) if j != k]) for k in range(3)]
    points = intersected(views, rough)
    tracks = [refine(sources, views, rough, points, partners, 1, lambda _: None, level) for level in (0, 2)]
    full, reduced = (np.mean(one.rays[: one.count] == 3) * one.count / 60 for one in tracks)
    assert full < 0.5 < 0.8 < reduced
    miss = reprojection_errors(views, tracks[1], intersected(views, tracks[1]))
    assert np.sqrt(np.mean(miss**2)) < 0.5


def test_setup_compiles_what_the_matching_calls(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A kernel compiled for other types would be compiled again in the first measurement."""
    calls: list[list[str]] = []

    def told(*arguments: object) -> None:
        calls.append([str(typeof(one)) for one in arguments])  # type: ignore[no-untyped-call]

    for module in ("compile", "patch_kernel"):
        monkeypatch.setattr(f"photocal.measurement.{module}.match_patches", told)
    compile_kernels()
    views = _views(np.array([[-4.0, 0, 40], [4.0, 0, 40]]), np.zeros(2))
    exact = views.project(np.array([0, 1]), np.zeros((2, 3)))
    tracks = Tracks(np.zeros(2, np.int64), np.array([0, 1]), exact, np.ones(2))
    partners = [np.array([1]), np.array([0])]
    refine(_pictures(views, tmp_path), views, tracks, np.zeros((1, 3)), partners, 1, lambda _: None)
    assert len(calls) == 2
    assert calls[0] == calls[1]


def test_twins_and_images() -> None:
    pixels = np.array([[10.0, 10], [20, 20], [30, 30], [10.5, 10.5], [90, 90], [50, 50], [60, 60]])
    tracks = Tracks(np.array([0, 0, 0, 1, 1, 2, 2]), np.array([0, 1, 2, 0, 1, 0, 1]), pixels, np.ones(7))
    assert without_twins(tracks, 4.0).rays.tolist() == [3, 2]
    fewer = of_images(tracks, np.array([False, True, True]))
    assert fewer.rays.tolist() == [2]
    assert fewer.image.tolist() == [0, 1]
