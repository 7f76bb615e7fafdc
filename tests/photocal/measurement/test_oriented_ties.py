"""Blocks that tie points join, but that nothing places."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager

import numpy as np
import pytest
from numpy.typing import NDArray

from drivers.errors import IllPosedError
from photocal.block.model import Block, Images
from photocal.geometry.camera import camera
from photocal.geometry.oriented_images import OrientedImages
from photocal.measurement.oriented_ties import orient_ties
from photocal.measurement.start_block import NO_OBSERVATIONS, NO_POINTS
from photocal.measurement.tracks import Tracks

Floats = NDArray[np.float64]
LENS = camera("c", "brown-ideal", "px", (1000, 800), (1.0, 1.0), {"c": 900.0})


@contextmanager
def _quiet(_: str, __: float | None) -> Iterator[Callable[[float], None]]:
    yield lambda _: None


def _tracks(places: Floats) -> Tracks:
    """Rays of 150 points of hilly ground in level images."""
    rng = np.random.default_rng(5)
    ground = np.column_stack([rng.uniform(-15, 15, (150, 2)), rng.uniform(-4, 4, 150)])
    count = len(places)
    poses = np.hstack([np.zeros((count, 3)), places])
    views = OrientedImages(("i",) * count, (LENS,), np.zeros(count, np.int64), poses)
    track, image = np.repeat(np.arange(150), count), np.tile(np.arange(count), 150)
    return Tracks(track, image, views.project(image, ground[track]), np.ones(len(track)))


def _block(places: Floats) -> Block:
    values, sigma = np.full((len(places), 6), np.nan), np.full((len(places), 6), np.inf)
    values[:, 3:], sigma[:, 3:] = places, 1.0
    names = tuple(f"{k}.jpg" for k in range(len(places)))
    images = Images(names, np.zeros(len(places), np.int64), values, sigma)
    return Block("b", "local", "", "control", (), (LENS,), images, NO_POINTS, NO_OBSERVATIONS, ())


def test_positions_in_a_line_are_named_as_the_reason() -> None:
    """Any turn about the line fits: the images are joined, but not placed."""
    places = np.array([[-6.0, 0, 40], [0, 0, 40], [6.0, 0, 40]])
    pairs = np.array([[0, 1], [0, 2], [1, 2]])
    with pytest.raises(IllPosedError, match="join the images, but their positions and control do not say"):
        orient_ties(_block(places), [], _tracks(places), pairs, 1, _quiet)


def test_images_that_share_nothing_are_named() -> None:
    places = np.array([[-6.0, 0, 40], [0, 3, 40], [6.0, 0, 40]])
    few = _tracks(places).some(np.arange(450) < 9)
    with pytest.raises(IllPosedError, match="shares only 3 tie points"):
        orient_ties(_block(places), [], few, np.array([[0, 1]]), 1, _quiet)
