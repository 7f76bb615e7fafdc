"""Centres of rendered targets: true to the stated sigma, to a twentieth of a pixel at 20 px and 2 % noise."""

from __future__ import annotations

from collections.abc import Callable

import cv2
import numpy as np
import pytest
from numpy.typing import NDArray
from scipy import stats

from photocal.geometry.camera import camera
from photocal.geometry.oriented_images import OrientedImages
from photocal.geometry.rotation import matrix_from_angles
from photocal.measurement.markers import moved_by_bend, on_bent_edges, quadrilateral_centre
from photocal.measurement.target_centre import (
    FINEST_BLUR_PX,
    Centre,
    flattened,
    ground_bend,
    quadrilateral,
    quadrilateral_slopes,
)
from photocal.measurement.target_search import cross_centre, round_centre, saddle_centre

from .rendering import DARK, LIGHT, bend, perspective, render

Floats = NDArray[np.float64]
SAMPLES = 40


def _errors(
    measure: Callable[[NDArray[np.uint8], Floats, Floats], Centre | None],
    scene: Callable[[Floats, Floats], Floats],
    size: int,
) -> tuple[Floats, Floats]:
    """Errors and standardised squares of `SAMPLES` rendered targets."""
    rng = np.random.default_rng(7)
    errors, squares = [], []
    for _ in range(SAMPLES):
        matrix = perspective(rng, size)
        true = matrix[:2, 2] / matrix[2, 2]
        centre = measure(render(scene, matrix, size, rng), true + rng.uniform(-1, 1, 2), matrix)
        assert centre is not None
        error: Floats = np.array([centre.column, centre.row]) - true
        errors.append(error)
        squares.append(error @ np.linalg.solve(centre.covariance, error))
    return np.array(errors), np.array(squares)


def _hourglass(u: Floats, v: Floats) -> Floats:
    return np.where(u * v > 0, LIGHT, DARK)


def _cross(u: Floats, v: Floats) -> Floats:
    return np.where((np.abs(u) < 2) | (np.abs(v) < 2), LIGHT, DARK)


def _disc(u: Floats, v: Floats) -> Floats:
    return np.where(np.hypot(u, v) < 10, DARK, LIGHT)


def _square(u: Floats, v: Floats) -> Floats:
    inside, code = np.maximum(np.abs(u), np.abs(v)) < 12, np.maximum(np.abs(u), np.abs(v)) < 8
    return np.where(inside & ~(code & (u > 0)), DARK, LIGHT)


def _ring(u: Floats, v: Floats) -> Floats:
    return np.where((np.hypot(u, v) < 10) & (np.hypot(u, v) > 5), DARK, LIGHT)


def _measured_disc(grey: NDArray[np.uint8], near: Floats, matrix: Floats) -> Centre | None:
    return round_centre(grey, (near[0], near[1]), (9.0, 8.0), bend=bend(matrix))


def _measured_ring(grey: NDArray[np.uint8], near: Floats, matrix: Floats) -> Centre | None:
    return round_centre(grey, (near[0], near[1]), (9.0, 8.0), hole=0.5, bend=bend(matrix))


def _measured_square(grey: NDArray[np.uint8], near: Floats, matrix: Floats) -> Centre | None:
    corners = np.array([[-12, -12, 1], [12, -12, 1], [12, 12, 1], [-12, 12, 1.0]]) @ matrix.T
    rough = corners[:, :2] / corners[:, 2:] + (near - matrix[:2, 2] / matrix[2, 2]) * 0.5
    found = quadrilateral_centre(grey, rough, 3.5)
    return None if found is None else found[0]


Measure = Callable[[NDArray[np.uint8], Floats, Floats], Centre | None]
CASES: dict[str, tuple[Measure, Callable[[Floats, Floats], Floats]]] = {
    "hourglass": (lambda g, n, _: saddle_centre(g, (n[0], n[1]), 10.0), _hourglass),
    "cross": (lambda g, n, _: cross_centre(g, (n[0], n[1]), 20.0), _cross),
    "disc": (_measured_disc, _disc),
    "ring": (_measured_ring, _ring),
    "square": (_measured_square, _square),
}


@pytest.mark.parametrize("kind", CASES)
def test_twenty_pixels_and_two_percent_noise(kind: str) -> None:
    measure, scene = CASES[kind]
    errors, squares = _errors(measure, scene, 56)
    assert np.sqrt(np.mean(errors**2)) < 0.05
    # The standardised squares are chi-squared with two degrees of freedom each; a stated sigma may be
    # up to a quarter too large, since a weak blur is poorly separated from the noise.
    low, high = (float(stats.chi2.ppf(p, 2 * SAMPLES)) for p in (0.0005, 0.9995))
    assert low / 1.6 < squares.sum() < high


@pytest.mark.parametrize("kind", CASES)
def test_a_shadow_across_the_target_moves_no_centre(kind: str) -> None:
    """Brightness changes by 0.2 % a pixel: taken for even it would move edges by several sigma."""
    measure, scene = CASES[kind]
    y, x = np.mgrid[:56, :56]
    shadow = 1 + 0.002 * (x - 28) - 0.0015 * (y - 28)
    rng = np.random.default_rng(12)
    squares = []
    for _ in range(12):
        matrix = perspective(rng, 56)
        true = matrix[:2, 2] / matrix[2, 2]
        bright = render(scene, matrix, 56, rng, noise=0) * shadow + rng.normal(0, 2.5, (56, 56))
        centre = measure(np.asarray(np.clip(np.round(bright), 0, 255), np.uint8), true + 0.3, matrix)
        assert centre is not None
        error: Floats = np.array([centre.column, centre.row]) - true
        squares.append(error @ np.linalg.solve(centre.covariance, error))
    low, high = (float(stats.chi2.ppf(p, 2 * 12)) for p in (0.0005, 0.9995))
    assert low / 1.6 < sum(squares) < high


def test_what_is_alike_on_both_sides_does_not_coarsen_sigma() -> None:
    """Soil around a plate is no noise of the disc's centre: it lies on all sides of it."""
    rng = np.random.default_rng(3)
    sigma, noise = {}, {}
    for beside in (LIGHT, 110.0):
        matrix = np.array([[1, 0, 20.3], [0, 1, 19.6], [0, 0, 1.0]])

        def plate(u: Floats, v: Floats, beside: float = beside) -> Floats:
            on_plate = np.maximum(np.abs(u), np.abs(v)) < 6
            return np.where(np.hypot(u, v) < 4, DARK, np.where(on_plate, LIGHT, beside))

        found = [round_centre(render(plate, matrix, 40, rng), (20.3, 19.6), (4.0, 4.0)) for _ in range(8)]
        sigma[beside] = np.mean([one.sigma for one in found if one is not None])
        noise[beside] = np.mean([one.noise for one in found if one is not None])
    # The edges of the plate are within the window.
    coarser = noise[110.0] / noise[LIGHT]
    assert coarser > 2
    assert sigma[110.0] / sigma[LIGHT] < 0.6 * coarser


@pytest.mark.parametrize("diameter", [6.0, 10.0, 60.0])
def test_discs_from_small_to_large(diameter: float) -> None:
    rng = np.random.default_rng(3)
    size = int(diameter * 1.6) + 24
    errors = []
    for _ in range(10):
        matrix = np.eye(3)
        matrix[:2, 2] = size / 2 + rng.uniform(-0.5, 0.5, 2)
        grey = render(lambda u, v: np.where(np.hypot(u, v) < diameter / 2, DARK, LIGHT), matrix, size, rng)
        near = (float(matrix[0, 2] + 0.4), float(matrix[1, 2] - 0.3))
        found = round_centre(grey, near, (diameter / 2, diameter / 2))
        assert found is not None
        errors.append([found.column - matrix[0, 2], found.row - matrix[1, 2]])
    assert np.sqrt(np.mean(np.square(errors))) < (0.08 if diameter < 10 else 0.05)


@pytest.mark.parametrize(("hole", "scene"), [(0.0, _disc), (0.5, _ring)])
def test_eccentricity_of_tilted_circles(hole: float, scene: Callable[[Floats, Floats], Floats]) -> None:
    """The circle's centre is the pole of its plane's vanishing line (Hartley and Zisserman, section 2.8)."""
    rng = np.random.default_rng(5)
    matrix = np.array([[1.6, 0.3, 40.2], [-0.1, 1.5, 39.7], [0.008, 0.005, 1.0]])
    back = np.linalg.inv(matrix)
    conic = back.T @ np.diag([1 / 100, 1 / 100, -1.0]) @ back
    pole = np.linalg.solve(conic, back.T @ [0.0, 0.0, 1.0])
    assert pole[:2] / pole[2] == pytest.approx(matrix[:2, 2], abs=1e-9)
    ellipse = np.linalg.solve(conic[:2, :2], -conic[:2, 2])
    assert np.hypot(*(ellipse - matrix[:2, 2])) > 1
    grey = render(scene, matrix, 80, rng, noise=0.01)
    near = (float(ellipse[0]), float(ellipse[1]))
    mended = round_centre(grey, near, (14.0, 13.0), bend=bend(matrix), hole=hole)
    bare = round_centre(grey, near, (14.0, 13.0), hole=hole)
    assert mended is not None
    assert bare is not None
    assert (mended.column, mended.row) == pytest.approx(tuple(matrix[:2, 2]), abs=0.03)
    if not hole:
        assert (bare.column, bare.row) == pytest.approx(tuple(ellipse), abs=0.03)


@pytest.mark.parametrize("k1", [0.0, -3e-9])
def test_the_bend_of_level_ground(k1: float) -> None:
    """A circle projected point by point: mended by the bend, its ellipse lies about its centre."""
    own = camera("c", "brown-ideal", "px", (4000, 3000), (1.0, 1.0), {"c": 3000.0, "x0": 12.0, "K1": k1})
    rotation, station = matrix_from_angles(np.array([[0.4, -0.3, 0.7]]))[0], np.array([3.0, -2.0, 50.0])
    angle = np.linspace(0, 2 * np.pi, 400, endpoint=False)
    circle = 0.5 * np.column_stack([np.cos(angle), np.sin(angle), 0 * angle])
    points = np.array([-10.0, 8.0, 0.0]) + np.vstack([circle, np.zeros((1, 3))])
    count = len(points)
    pose = np.r_[0.4, -0.3, 0.7, station]
    views = OrientedImages(("i",) * count, (own,), np.zeros(count, np.int64), np.tile(pose, (count, 1)))
    pixels = views.project(np.arange(count), points)
    middle = pixels[-1]
    assert (np.abs(middle - [1999.5, 1499.5]) < [1950, 1450]).all()
    x, y = (pixels[:-1] - middle).T
    assert np.hypot(*_ellipse_centre(x, y)) > 0.1
    flat = flattened(x, y, ground_bend(own, rotation, middle))
    assert np.hypot(*_ellipse_centre(*flat)) < 0.003


def _ellipse_centre(x: Floats, y: Floats) -> Floats:
    """Centre of the conic through points, by linear least squares."""
    a, b, c, d, e = np.linalg.lstsq(
        np.column_stack([x * x, x * y, y * y, x, y]), np.ones(len(x)), rcond=None
    )[0]
    return np.asarray(np.linalg.solve([[2 * a, b], [b, 2 * c]], [-d, -e]))


@pytest.mark.parametrize("kind", ["hourglass", "cross", "disc", "ring"])
def test_plain_ground_has_no_target(kind: str) -> None:
    rng = np.random.default_rng(1)
    grey = np.asarray(np.clip(rng.normal(120, 5, (56, 56)), 0, 255), np.uint8)
    assert CASES[kind][0](grey, np.array([28.0, 28.0]), np.eye(3)) is None


def test_a_window_beyond_the_edge_gives_nothing() -> None:
    grey = np.zeros((40, 40), dtype=np.uint8)
    assert saddle_centre(grey, (3.0, 20.0), 8.0) is None
    assert saddle_centre(grey, (float("nan"), 20.0), 8.0) is None


@pytest.mark.parametrize("k1", [-0.15, 0.1])
def test_corners_of_edges_that_the_lens_bends_lie_where_opencv_projects_them(k1: float) -> None:
    """A line fitted to an edge of 100 px, bent by 0.1 px and more, passes its ends: all to one side."""
    c, size, side = 1500.0, (1600, 1200), 144
    matrix = np.array([[c, 0, 799.5], [0, c, 599.5], [0, 0, 1.0]])
    lens = np.array([k1, 0, 0, 0, 0])
    own = camera("c", "brown-ideal", "px", size, (1.0, 1.0), {"c": c, "K1": k1 / c**2})
    square = np.array([[-1.0, -1, 0], [1, -1, 0], [1, 1, 0], [-1, 1, 0]])
    rng = np.random.default_rng(4)
    straight, bent, radial, met, middles = [], [], [], [], []
    for middle in ([1300, 300], [250, 250], [1400, 700], [800, 1050], [300, 900], [1200, 1000]):
        turn = cv2.Rodrigues(rng.normal(0, 0.15, 3))[0]
        ideal = cv2.undistortPoints(np.array([[middle]], dtype=float), matrix, lens).ravel()
        place = np.array([*ideal, 1.0]) * 2 * c / 100
        true = cv2.projectPoints(square @ turn.T + place, np.zeros(3), np.zeros(3), matrix, lens)[0].reshape(
            4, 2
        )
        corner = np.round(true.mean(axis=0)) - side // 2
        plane = np.linalg.inv(np.column_stack([turn[:, 0], turn[:, 1], place]))

        def scene(x: Floats, y: Floats, corner: Floats = corner, plane: Floats = plane) -> Floats:
            seen = np.stack([x.ravel(), y.ravel()], axis=-1) + corner
            rays = cv2.undistortPoints(seen[:, None], matrix, lens).reshape(-1, 2)
            u, v, w = plane @ np.vstack([rays.T, np.ones(len(rays))])
            return np.where(np.maximum(abs(u / w), abs(v / w)) < 1, DARK, LIGHT).reshape(x.shape)

        grey = render(scene, np.eye(3), side, rng, noise=0.005)
        found = quadrilateral_centre(grey, true - corner + 0.4, 12.0)
        assert found is not None
        corners = found[1] + corner
        straight.append(corners - true)
        bent.append(on_bent_edges(own, corners[None])[0] - true)
        shown = cv2.projectPoints(place[None], np.zeros(3), np.zeros(3), matrix, lens)[0].ravel()
        met.append(np.array([found[0].column, found[0].row]) + corner - shown)
        middles.append(met[-1] + moved_by_bend(own, corners[None])[0])
        away = true - matrix[:2, 2]
        radial.append(away / np.hypot(*away.T)[:, None])
    before, after = (np.sum(np.array(e) * radial, axis=-1) for e in (straight, bent))
    # Barrel distortion moves them outwards, pincushion distortion inwards.
    assert -np.sign(k1) * before.mean() > 0.03
    assert abs(after.mean()) < 0.1 * abs(before.mean())
    assert np.sqrt(np.mean(np.square(bent))) < 0.5 * np.sqrt(np.mean(np.square(straight)))
    # The diagonals meet aside of the middle.
    assert np.sqrt(np.mean(np.square(middles))) < 0.25 * np.sqrt(np.mean(np.square(met)))


@pytest.mark.parametrize("degrees", [60, 75, 90, 110])
def test_a_blurred_corner_is_a_bivariate_normal_integral(degrees: float) -> None:
    """By scipy; the product of two blurred edges is 0.04 to 0.08 off unless the angle is right."""
    turn, blur = np.radians(degrees), 0.8
    normals = np.array([[np.sin(turn), -np.cos(turn)], [0.0, 1.0]])
    angles = np.arctan2(*np.vstack([normals, -normals]).T[::-1])
    edges = np.column_stack([angles, [0, 0, 100, 100]]).ravel()
    x, y = (axis.ravel() for axis in np.meshgrid(np.arange(-3, 3.1, 0.5), np.arange(-3, 3.1, 0.5)))
    correlation = float(normals[0] @ normals[1])
    exact = stats.multivariate_normal([0, 0], [[1, correlation], [correlation, 1]])
    away = np.column_stack([x, y]) @ normals.T / blur
    assert quadrilateral(np.array([*edges, blur, 0.0, 1.0]), x, y) == pytest.approx(exact.cdf(away), abs=2e-3)


@pytest.mark.parametrize("blur", [0.9, -0.6, 0.5 * FINEST_BLUR_PX])
def test_slopes_of_a_quadrilateral_are_those_of_its_picture(blur: float) -> None:
    """By differences, of a slanted one with a corner of 70 degrees."""
    rng = np.random.default_rng(5)
    angles = np.radians([3.0, 73.0, 185.0, 268.0])
    p = np.r_[np.column_stack([angles, rng.uniform(5.0, 8.0, 4)]).ravel(), blur, 200.0, -150.0]
    x, y = rng.uniform(-10.0, 10.0, (2, 500))
    steps = 1e-5 * np.eye(11)
    numerical = [(quadrilateral(p + step, x, y) - quadrilateral(p - step, x, y)) / 2e-5 for step in steps]
    assert np.allclose(quadrilateral_slopes(p, x, y).T, numerical, rtol=1e-6, atol=2e-5)


def test_acute_corners_are_measured_where_obtuse_ones_are() -> None:
    """Squares in affine views: corners of 50 to 130 degrees, along the direction out of the target."""
    rng = np.random.default_rng(2)
    outward, cosine = [], []
    for turn in np.radians([5, 20, 35, 50, 65, 80]):
        matrix = np.eye(3)
        rotation = np.array([[np.cos(turn), -np.sin(turn)], [np.sin(turn), np.cos(turn)]])
        matrix[:2, :2] = np.array([[1.1, 0.35], [0.35, 0.9]]) @ rotation
        matrix[:2, 2] = 36 + rng.uniform(-0.5, 0.5, 2)
        true = np.array([[-20, -20], [20, -20], [20, 20], [-20, 20.0]]) @ matrix[:2, :2].T + matrix[:2, 2]
        grey = render(
            lambda u, v: np.where(np.maximum(abs(u), abs(v)) < 20, DARK, LIGHT), matrix, 72, rng, noise=0.002
        )
        found = quadrilateral_centre(grey, true + 0.3, 7.0)
        assert found is not None
        out, ahead, behind = (
            true - matrix[:2, 2],
            np.roll(true, -1, axis=0) - true,
            np.roll(true, 1, axis=0) - true,
        )
        outward += (np.sum((found[1] - true) * out, axis=1) / np.hypot(*out.T)).tolist()
        cosine += (np.sum(ahead * behind, axis=1) / np.hypot(*ahead.T) / np.hypot(*behind.T)).tolist()
    # Px for a corner of 0 degrees: -0.10 with the product of two edges, which puts acute corners 0.07 px in.
    assert abs(np.linalg.lstsq(np.array(cosine)[:, None], np.array(outward), rcond=None)[0][0]) < 0.01
    assert np.abs(outward).max() < 0.02


NOISE_AND_BLUR = [(1.0, 0.5), (1.0, 1.3), (2.5, 0.9), (5.0, 1.3)]


def _light(inside: Floats) -> Floats:
    """Grey values of a scene where a dark part begins, px; half a fine pixel soft, so that no edge is cut."""
    return LIGHT + (DARK - LIGHT) * np.clip(0.5 + 6 * inside, 0, 1)


def _coded(u: Floats, v: Floats) -> Floats:
    """A code of four by four cells, every other one white, in a border of 7 px."""
    within, cells = 21 - np.maximum(abs(u), abs(v)), 14 - np.maximum(abs(u), abs(v))
    white = (np.floor(u / 7) + np.floor(v / 7)) % 2 == 0
    return np.where((cells > 0) & white, LIGHT, _light(within))


@pytest.mark.parametrize(("noise", "blur"), NOISE_AND_BLUR)
def test_corners_of_coded_plates_are_as_sure_as_they_say(noise: float, blur: float) -> None:
    """Errors against the truth of the rendering, in its own standard deviations, of three seeds."""
    square, standardised = 21 * np.array([[-1.0, -1], [1, -1], [1, 1], [-1, 1]]), []
    for seed in range(3):
        rng = np.random.default_rng(seed)
        for _ in range(8):
            matrix = perspective(rng, 88, 0.8)
            true = np.column_stack([square, np.ones(4)]) @ matrix.T
            true = true[:, :2] / true[:, 2:]
            grey = render(_coded, matrix, 88, rng, blur=blur, noise=noise / 255)
            found = quadrilateral_centre(grey, true + rng.uniform(-0.4, 0.4, (4, 2)), 5.6)
            assert found is not None
            standardised.append((found[1] - true) / found[2])
    assert 0.85 < np.sqrt(np.mean(np.square(standardised))) < 1.15


@pytest.mark.parametrize(("noise", "blur"), NOISE_AND_BLUR)
def test_corners_of_chessboards_are_as_sure_as_they_say(noise: float, blur: float) -> None:
    standardised = []
    for seed in range(3):
        rng = np.random.default_rng(seed)
        for _ in range(25):
            matrix = perspective(rng, 32, 0.8)
            true = matrix[:2, 2]
            grey = render(
                lambda u, v: _light(np.sign(u * v) * np.minimum(abs(u), abs(v))),
                matrix,
                32,
                rng,
                blur=blur,
                noise=noise / 255,
            )
            found = saddle_centre(grey, tuple(true + rng.uniform(-0.4, 0.4, 2)), 9.0)
            assert found is not None
            standardised.append((np.array([found.column, found.row]) - true) / found.sigma)
    assert 0.85 < np.sqrt(np.mean(np.square(standardised))) < 1.15
