"""Control brought to a block of pictures: gross errors are named one by one, and none of them ends it."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

from photocal.base.codec import same
from photocal.block.model import Block, Images, ObjectPoints
from photocal.findings.texts import catalogue, remedy_text
from photocal.geometry.camera import Camera, camera
from photocal.geometry.oriented_images import OrientedImages
from photocal.measurement.oriented_ties import Oriented, first_orientation
from photocal.measurement.tracks import Tracks
from tests.photocal.findings.english import english

Floats = NDArray[np.float64]
LENS = camera("c", "brown-ideal", "px", (1000, 800), (1.0, 1.0), {"c": 900.0})
STATIONS = np.array([[x, y, 60.0 + 0.3 * x] for x in (-18.0, -6, 6, 18) for y in (-10.0, 10)])
# Of nine points in the corners, at the sides and in the middle.
SURVEY = np.array(
    [[x, y, 0.1 * x - 0.05 * y + (2 if x * y else 0)] for x in (-30.0, 0, 30) for y in (-20.0, 0, 20)]
)
NAMES = tuple(f"P{k + 1}" for k in range(9))


def _views() -> OrientedImages:
    rng = np.random.default_rng(2)
    angles = np.radians(rng.normal(0, 3, (8, 3)))
    return OrientedImages(("i",) * 8, (LENS,), np.zeros(8, np.int64), np.hstack([angles, STATIONS]))


def _rays(places: Floats, noise_px: float, seed: int) -> tuple[NDArray[np.int64], NDArray[np.int64], Floats]:
    views, count = _views(), len(places)
    point, image = np.repeat(np.arange(count), 8), np.tile(np.arange(8), count)
    pixels = views.project(image, places[point])
    pixels += np.random.default_rng(seed).normal(0, noise_px, pixels.shape)
    inside = ((pixels > 0) & (pixels < [999, 799])).all(axis=1)
    return point[inside], image[inside], pixels[inside]


def oriented(
    given: Floats,
    positions: Floats | None = None,
    marks: Floats | None = None,
    some: slice = slice(None),
    *,
    cache: Path | None = None,
    beside: Camera | None = None,
    survey: Floats = SURVEY,
    frame: str = "local",
) -> Oriented:
    """Orient eight pictures of hilly ground with control as somebody has typed it.

    beside: camera of one more picture, which shows nothing of the ground.
    survey: where the points are.
    """
    rng = np.random.default_rng(5)
    ground = np.column_stack([rng.uniform(-40, 40, 160), rng.uniform(-28, 28, 160), rng.uniform(-4, 4, 160)])
    track, image, pixels = _rays(ground, 0.3, 1)
    tracks = Tracks(track, image, pixels, np.ones(len(track))).some(np.ones(len(track), dtype=np.bool_))
    cameras = (LENS,) if beside is None else (beside, LENS)
    count = 8 + len(cameras) - 1
    values, sigma = np.full((count, 6), np.nan), np.full((count, 6), np.inf)
    if positions is not None:
        values[:8, 3:], sigma[:8, 3:] = positions, 1.5
    taken_by = np.where(np.arange(count) < 8, len(cameras) - 1, 0)
    images = Images(tuple(f"{k}.jpg" for k in range(count)), taken_by, values, sigma)
    points = ObjectPoints(NAMES, given, np.full((9, 3), 0.02), np.zeros(9, np.int64))
    block = Block("b", frame, "" if frame == "local" else "ellipsoidal", "control", cameras, images, points)
    point, image, pixels = _rays(survey, 0.5, 3)
    pixels = pixels if marks is None else pixels + marks[: len(pixels)]
    kept = np.isin(point, np.arange(9)[some])
    seen = block.observations.plus(image[kept], point[kept], pixels[kept], np.ones((int(kept.sum()), 2)))
    return first_orientation(replace(block, observations=seen), tracks, cache)


def said(found: Oriented, code: str) -> list[str]:
    return [one.subject for one in found.findings if one.code == code]


def stations(found: Oriented) -> float:
    """By how much the stations are off, m: three pixels on the ground, of 60 m in 900 px, are 0.2 m."""
    return float(np.abs(found.adjusted.values[:, 3:] - STATIONS).max())


@pytest.mark.parametrize("positioned", [False, True])
def test_right_control_places_the_block(positioned: bool) -> None:
    rng = np.random.default_rng(4)
    found = oriented(SURVEY, STATIONS + rng.normal(0, 1.0, STATIONS.shape) if positioned else None)
    assert not [one for one in found.findings if one.code.startswith(("control", "mark", "block"))]
    assert found.adjusted.start.datum == "control"
    assert stations(found) < 0.2


@pytest.mark.parametrize("positioned", [False, True])
def test_a_picture_of_another_camera_costs_itself_alone(positioned: bool) -> None:
    """A snapshot of the crew in the folder of the flight, by a camera that comes first."""
    phone = camera("a", "brown-ideal", "px", (1200, 1600), (1.0, 1.0), {"c": 1200.0})
    found = oriented(SURVEY, STATIONS if positioned else None, beside=phone)
    assert [one["image"] for one in found.left_out] == ["8.jpg"]
    assert [own.id for own in found.adjusted.block.cameras] == ["c"]
    assert stations(found) < 0.2


def test_views_that_patches_are_cut_in_are_those_of_rays_and_positions_alone() -> None:
    """Other marks and other coordinates of control leave them as they are, to the last bit."""
    rng = np.random.default_rng(4)
    positions = STATIONS + rng.normal(0, 1.0, STATIONS.shape)
    one = oriented(SURVEY, positions)
    other = oriented(SURVEY + np.eye(9, 3) * 50.0, positions, rng.normal(0, 0.5, (72, 2)))
    assert np.array_equal(one.by_rays.values, other.by_rays.values)
    assert np.array_equal(one.by_rays.tracks.pixels, other.by_rays.tracks.pixels)
    assert not np.array_equal(one.adjusted.values, other.adjusted.values)


@pytest.mark.parametrize("positioned", [False, True])
def test_pictures_are_oriented_to_each_other_once_whatever_marks_change(
    positioned: bool, tmp_path: Path
) -> None:
    """What is kept of it gives, to the last bit, what is found anew."""
    positions = STATIONS + np.random.default_rng(4).normal(0, 1.0, STATIONS.shape) if positioned else None
    stored, folder = set[int](), tmp_path / "kept"
    for k, marks in enumerate((np.zeros((72, 2)), np.full((72, 2), 0.1), np.zeros((72, 2)))):
        kept = oriented(SURVEY, positions, marks, cache=folder)
        stored.add(len(list(folder.rglob("*.npz"))))
        anew = oriented(SURVEY, positions, marks, cache=tmp_path / f"anew {k}")
        assert same(kept.adjusted.block, anew.adjusted.block)
    # Other marks add nothing to what is kept.
    assert len(stored) == 1
    assert min(stored) > 0


@pytest.mark.parametrize("positioned", [False, True])
@pytest.mark.parametrize("wrong", ["5 m", "up", "swapped", "half a metre"])
def test_a_third_of_the_control_may_be_gross(wrong: str, positioned: bool) -> None:
    """Expected: exactly those are named, by what was added, and the block lies as without them."""
    given, bad = SURVEY.copy(), [1, 4, 6]
    if wrong == "5 m":
        given[bad] += [[5.0, 0, 0], [0, -5.0, 0], [3.0, 4.0, 0]]
    elif wrong == "up":
        given[bad] += [[0, 0, 5.0], [0, 0, -5.0], [0, 0, 5.0]]
    elif wrong == "half a metre":
        given[bad] += [[0.9, 0, 0], [0, -0.9, 0], [0, 0.9, 0]]
    else:
        bad = [0, 5]
        given[bad] = given[bad][:, [1, 0, 2]]
    positions = STATIONS + np.random.default_rng(4).normal(0, 1.0, STATIONS.shape) if positioned else None
    found = oriented(given, positions)
    assert said(found, "control-off") == [NAMES[k] for k in bad]
    texts = [english(one) for one in found.findings if one.code == "control-off"]
    added = np.linalg.norm(given - SURVEY, axis=1)[bad]
    for text, metres in zip(texts, added, strict=True):
        stated = float(text.split(": by ")[1].split(" m")[0])
        assert stated == pytest.approx(metres, abs=0.3)
    assert stations(found) < 0.2
    assert [
        name
        for name in found.marked.points.names
        if found.marked.points.of_role("control")[found.marked.points.names.index(name)]
    ] == [n for k, n in enumerate(NAMES) if k not in bad]


def test_control_that_contradicts_itself_leaves_the_block_free() -> None:
    """Every point somewhere else: the block is adjusted, and what is known of it is its shape."""
    found = oriented(SURVEY + np.random.default_rng(7).normal(0, 20, SURVEY.shape))
    assert found.adjusted.start.datum == "free"
    assert any("contradict each other" in english(one) for one in found.findings)
    assert said(found, "block-not-placed") == [""]
    assert not found.marked.points.of_role("control").any()


@pytest.mark.parametrize("relief", [0.0, 1.0])
def test_control_with_exchanged_axes_is_named_and_places_nothing(relief: float) -> None:
    """Of flat ground it would fit, too, seen by cameras below it that look up."""
    survey = SURVEY * [1.0, 1.0, relief]
    there = np.array([634600.0, 485300.0, 110.0])
    found = oriented((survey + there)[:, [1, 0, 2]], survey=survey, frame="EPSG:2180")
    # The cause comes first, with what to do about it.
    first, *_ = found.findings
    assert "E and N of all of them are exchanged" in english(first)
    assert remedy_text(first, catalogue("en")) == "Exchange the columns of E and N in the control table."
    assert found.adjusted.start.datum == "free"
    right = oriented(survey + there, survey=survey, frame="EPSG:2180")
    assert right.adjusted.start.datum == "control"
    assert not said(right, "control-not-used")


def test_points_in_a_line_or_too_few_are_a_sentence() -> None:
    line = oriented(SURVEY, some=slice(3, 6))
    assert any("lie in one line" in english(one) for one in line.findings)
    few = oriented(SURVEY, some=slice(0, 2))
    assert any("2 of 9 are marked" in english(one) for one in few.findings)
    assert {line.adjusted.start.datum, few.adjusted.start.datum} == {"free"}


def test_control_against_positions_is_said_and_places_the_block() -> None:
    found = oriented(SURVEY, STATIONS + np.array([100.0, -30, 0]))
    (one,) = [one for one in found.findings if one.code == "control-against-positions"]
    assert (one.figures["east_m"], one.figures["north_m"]) == pytest.approx((-100.0, 30.0), abs=0.5)
    assert stations(found) < 0.2


def test_a_mark_beside_its_point_is_left_out_alone() -> None:
    marks = np.zeros((72, 2))
    marks[3] = [60.0, -80.0]
    found = oriented(SURVEY, marks=marks)
    (one,) = [one for one in found.findings if one.code == "mark-left-out"]
    assert one.figures["px"] == pytest.approx(100.0, abs=8.0)
    assert stations(found) < 0.2
