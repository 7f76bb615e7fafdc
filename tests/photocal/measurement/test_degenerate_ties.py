"""Ties that hold together poorly: a block, or a sentence of what they leave open, and nothing else."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from photocal.adjustment.adjust import adjust
from photocal.adjustment.datum import with_datum
from photocal.adjustment.normal import prepare
from photocal.adjustment.state import start_state
from photocal.base.errors import PhotocalError
from photocal.block.model import Block, Images, ObjectPoints
from photocal.block.network import assemble
from photocal.geometry.camera import camera
from photocal.geometry.oriented_images import OrientedImages
from photocal.measurement.oriented_ties import first_orientation
from photocal.measurement.tracks import Tracks

LENS = camera("c", "brown-ideal", "px", (1000, 800), (1.0, 1.0), {"c": 900.0})
KINDS = ("two images", "all on a line", "no overlap", "one point", "two components", "one station", "gross")


def degenerate(kind: str, seed: int, control: int, positions: str) -> tuple[Block, Tracks]:
    """A block whose ties are too few, too alike or wrong."""
    rng = np.random.default_rng(seed)
    count = 2 if kind == "two images" else int(rng.integers(2, 6))
    places = np.column_stack([rng.uniform(-8, 8, (count, 2)), 40 + rng.normal(0, 0.5, count)])
    ground = np.column_stack([rng.uniform(-15, 15, (24, 2)), rng.uniform(-4, 4, 24) * rng.integers(2)])
    if kind == "all on a line":
        places[:, 1] = 0.0
        ground[:, 1] = rng.normal(0, rng.choice([0.0, 1e-6, 1.0]), 24)
    elif kind == "one point":
        ground[:] = ground[0] + rng.normal(0, rng.choice([0.0, 1e-6, 1e-2]), ground.shape)
    elif kind == "one station":
        places[:] = places[0]
    angles = rng.normal(0, 0.05, (count, 3))
    names = tuple(f"{k}.jpg" for k in range(count))
    views = OrientedImages(names, (LENS,), np.zeros(count, np.int64), np.hstack([angles, places]))
    track, image = np.repeat(np.arange(24), count), np.tile(np.arange(count), 24)
    pixels = views.project(image, ground[track]) + rng.normal(0, rng.choice([0.0, 0.3, 30]), (len(track), 2))
    keep = rng.random(len(track)) < rng.uniform(0.5, 1)
    if kind == "gross":
        bad = rng.random(len(track)) < rng.uniform(0.2, 0.9)
        pixels[bad] = rng.uniform(0, 800, (int(bad.sum()), 2))
    elif kind == "no overlap":
        keep &= track % count == image
    elif kind == "two components":
        keep &= track % 2 == image % 2
    tracks = Tracks(track, image, pixels, np.ones(len(track))).some(keep)
    values, sigma = np.full((count, 6), np.nan), np.full((count, 6), np.inf)
    if positions != "none":
        values[:, 3:] = places + (rng.normal(0, 50, places.shape) if positions == "wrong" else 0.0)
        sigma[:, 3:] = 1.5
    images = Images(names, np.zeros(count, np.int64), values, sigma)
    block = Block("b", "local", "", "free" if positions == "none" else "control", (LENS,), images)
    if not control:
        return block, tracks
    xyz = ground[:control] + rng.choice([0.0, 50.0]) * rng.normal(0, 1, (control, 3))
    points = ObjectPoints(
        tuple(f"P{k}" for k in range(control)), xyz, np.full((control, 3), 0.02), np.zeros(control, np.int64)
    )
    image, point = np.repeat(np.arange(count), control), np.tile(np.arange(control), count)
    marks = views.project(image, xyz[point]) * rng.choice([1.0, 0.5])
    kept = np.isfinite(marks).all(axis=1) & (rng.random(len(marks)) < 0.7)
    seen = block.observations.plus(image[kept], point[kept], marks[kept], np.ones((int(kept.sum()), 2)))
    return replace(block, datum="control", points=points, observations=seen), tracks


@settings(max_examples=12, deadline=None, derandomize=True, suppress_health_check=list(HealthCheck))
@given(
    kind=st.sampled_from(KINDS),
    seed=st.integers(0, 10_000),
    control=st.integers(0, 5),
    positions=st.sampled_from(["none", "right", "wrong"]),
)
def test_ties_give_a_block_or_a_sentence(kind: str, seed: int, control: int, positions: str) -> None:
    """Warnings are errors here: no infinite or negative diagonal passes on the way."""
    block, tracks = degenerate(kind, seed, control, positions)
    if not tracks.count:
        return
    try:
        found = first_orientation(block, tracks)
    except PhotocalError:
        # What the ties leave open, in a sentence.
        return
    assert np.isfinite(found.adjusted.values).all()
    assert np.isfinite(found.adjusted.solution.points).all()


@pytest.mark.parametrize("depth", [1e-9, 1e-13])
def test_the_datum_of_points_beside_their_cameras(depth: float) -> None:
    """Positions that are far off start so: points in the cameras' own planes.

    Reduced diagonals that rounding has made negative hold nothing: they ended in a ValueError.
    """
    rng = np.random.default_rng(1)
    points = rng.uniform(-1, 1, (8, 3))
    poses = np.zeros((2, 6))
    points[:, 2] -= 1.0
    points[::2, 2] = -depth
    poses[1, 0] = 1.0
    names = ("a", "b")
    image, point = np.repeat([0, 1], 8), np.tile(np.arange(8), 2)
    block = Block(
        "b", "local", "", "free", (LENS,),
        Images(names, np.zeros(2, np.int64), poses, np.full((2, 6), np.inf)),
        ObjectPoints(tuple(f"p{k}" for k in range(8)), points),
    )  # fmt: skip
    seen = block.observations.plus(image, point, rng.uniform(0, 800, (16, 2)), np.ones((16, 2)))
    network = assemble(replace(block, observations=seen)).network
    assert len(with_datum(prepare(network), start_state(network)).stiffened) <= 7
    with pytest.raises(PhotocalError):
        adjust(network)
