"""Snapping: the right kind at the right place with a sigma that holds, and nothing where nothing is."""

from __future__ import annotations

import cv2
import numpy as np
import pytest
from numpy.typing import NDArray

from photocal.measurement.marking.snap import Kind, snap, symmetric_place
from tests.photocal.measurement.rendering import DARK, LIGHT, bend, perspective, render, warped
from tests.photocal.measurement.site import texture

Floats = NDArray[np.float64]
SIZE = 120


def cross(u: Floats, v: Floats) -> Floats:
    return np.where((abs(u) < 10) & (abs(v) < 2) | (abs(v) < 10) & (abs(u) < 2), LIGHT, DARK)


def hourglass(u: Floats, v: Floats) -> Floats:
    return np.where((np.hypot(u, v) < 10) & (u * v > 0), DARK, LIGHT)


def circle(u: Floats, v: Floats) -> Floats:
    return np.where(np.hypot(u, v) < 6, LIGHT, DARK)


def ring(u: Floats, v: Floats) -> Floats:
    return np.where((np.hypot(u, v) < 10) & (np.hypot(u, v) > 5), LIGHT, DARK)


@pytest.mark.parametrize(
    ("kind", "scene"), [("cross", cross), ("hourglass", hourglass), ("circle", circle), ("ring", ring)]
)
@pytest.mark.parametrize("scale", [0.8, 2.0])
def test_a_click_beside_a_target_finds_its_centre(kind: Kind, scene: object, scale: float) -> None:
    rng = np.random.default_rng(11)
    for _ in range(3):
        matrix = perspective(rng, SIZE)
        matrix[:2, :2] *= scale
        # In a plane that is tilted strongly, the centre of the ellipse is not that of the circle.
        matrix[2, :2] = 0 if kind in ("circle", "ring") else matrix[2, :2] / 3
        grey = render(scene, matrix, SIZE, rng)  # type: ignore[arg-type]
        x, y = matrix[:2, 2]
        found = snap(grey, (x + rng.uniform(-5, 5), y + rng.uniform(-5, 5)), 12)
        assert found is not None
        as_kind, centre = found
        assert as_kind == kind
        assert np.hypot(centre.column - x, centre.row - y) < 0.1
        assert abs(centre.column - x) < 4 * centre.sigma[0]
        assert abs(centre.row - y) < 4 * centre.sigma[1]


@pytest.mark.parametrize(("kind", "scene"), [("circle", circle), ("ring", ring)])
def test_with_the_bend_of_the_ground_a_circle_has_its_own_centre(kind: Kind, scene: object) -> None:
    """In a plane that is tilted strongly the ellipse lies aside: by its pole, half a pixel."""
    matrix = np.array([[2.4, 0.3, 60.2], [-0.1, 2.3, 59.6], [0.01, 0.006, 1.0]])
    grey = render(scene, matrix, SIZE, np.random.default_rng(1))  # type: ignore[arg-type]
    near = (61.5, 58.0)
    bare, mended = snap(grey, near, 12, (kind,)), snap(grey, near, 12, (kind,), bend=bend(matrix))
    assert bare is not None
    assert mended is not None
    assert np.hypot(bare[1].column - 60.2, bare[1].row - 59.6) > 0.4
    assert np.hypot(mended[1].column - 60.2, mended[1].row - 59.6) < 0.1


def test_a_coded_target_is_found_by_its_code() -> None:
    codes = cv2.aruco.getPredefinedDictionary(cv2.aruco.DICT_APRILTAG_36h11)
    plate = np.full((100, 100), 255, np.uint8)
    plate[10:90, 10:90] = codes.generateImageMarker(17, 80)
    matrix = np.array([[0.5, 0.03, 60.3], [-0.02, 0.48, 50.7], [0, 0, 1.0]])
    grey = warped(plate, matrix, (200, 160))
    x, y = (matrix @ [49.5, 49.5, 1])[:2]
    found = snap(grey, (x + 3, y - 4), 12)
    assert found is not None
    kind, centre = found
    assert kind == "code"
    assert np.hypot(centre.column - x, centre.row - y) < 0.05
    assert snap(grey, (x + 3, y - 4), 12, ("code",), ("4x4_50",)) is None


def test_nothing_is_found_where_no_target_is() -> None:
    ground = np.clip(texture(2, 900), 0, 255).astype(np.uint8)
    rng = np.random.default_rng(4)
    places = rng.uniform(100, 800, (12, 2))
    assert [snap(ground, (x, y), 12) for x, y in places] == [None] * len(places)
    assert snap(np.full((200, 200), 90, np.uint8), (100, 100), 12) is None
    # At the border of the image there is no room.
    assert snap(ground, (1, 1), 12) is None


def test_a_target_out_of_reach_is_left_alone() -> None:
    rng = np.random.default_rng(3)
    matrix = perspective(rng, SIZE)
    grey = render(circle, matrix, SIZE, rng)
    x, y = matrix[:2, 2]
    assert snap(grey, (x + 9, y), 12, ("circle",)) is not None
    assert snap(grey, (x + 9, y), 5, ("circle",)) is None


def test_symmetry_finds_the_middle_of_a_blot_but_not_of_a_bar() -> None:
    y, x = np.mgrid[:101, :101]
    blot = (200 * np.exp(-((x - 57) ** 2 / 30 + (y - 44) ** 2 / 90))).astype(np.float32)
    place, likeness = symmetric_place(blot, (50, 50), 14, 10)
    assert place == (57.0, 44.0)
    assert likeness > 0.99
