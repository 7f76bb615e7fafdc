"""Lens models beside Brown's in the adjustment: against OpenCV's calibration and the dense comparison."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
from numpy.typing import NDArray

from photocal.adjustment.adjust import adjust
from photocal.adjustment.network import ExteriorOrientations, Network, Points, Rays, point_weights
from photocal.adjustment.solution import Solution
from photocal.exchange.pinhole import Pinhole, from_pinhole, from_vision
from photocal.geometry.camera import PARAMETERS, Camera, Model, camera, pixel_to_plane
from tests.photocal import networks, oracle

Floats = NDArray[np.float64]

SIZE, SIGMA = (1640, 1232), 0.15
BOARD = np.array([[x, y, 0.0] for y in range(6) for x in range(9)]) * 0.03
RATIONAL = ("k1", "k2", "p1", "p2", "k3", "k4", "k5", "k6", "s1", "s2", "s3", "s4")
# OpenCV 4 has flags of their own for fisheye lenses.
OF_FISHEYE = cv2.fisheye if hasattr(cv2.fisheye, "CALIB_FIX_SKEW") else cv2
RECOMPUTED = (
    OF_FISHEYE.CALIB_RECOMPUTE_EXTRINSIC | OF_FISHEYE.CALIB_FIX_SKEW | OF_FISHEYE.CALIB_USE_INTRINSIC_GUESS
)
CRITERIA = (cv2.TERM_CRITERIA_EPS + cv2.TERM_CRITERIA_COUNT, 300, 1e-15)


def boards(project: Any, seed: int, *, of: int = 25) -> list[Floats]:
    """Pictures of a board that fill the format, with errors."""
    rng, pictures = np.random.default_rng(seed), list[Floats]()
    while len(pictures) < of:
        turn, far = rng.uniform(-0.5, 0.5, 3), rng.uniform(0.1, 0.3)
        place = np.array([rng.uniform(-1.1, 1.1), rng.uniform(-0.8, 0.8), 1.0]) * far
        rotation = cv2.Rodrigues(turn)[0]
        shift = place - rotation @ BOARD.mean(axis=0)
        if ((BOARD @ rotation.T + shift)[:, 2] < 0.03).any():
            continue
        seen = project(BOARD[:, None], turn, shift)[0].reshape(-1, 2)
        if (seen >= 0).all() and (seen <= np.array(SIZE) - 1).all():
            noisy = seen + rng.normal(0, SIGMA, seen.shape)
            pictures.append(noisy.astype(np.float32).astype(float))
    return pictures


def network(seen: list[Floats], own: Camera, turns: Any, shifts: Any, board: Floats = BOARD) -> Network:
    """Known points of the board, free images."""
    rotation = np.array([cv2.Rodrigues(turn)[0] for turn in turns])
    pose = from_vision(rotation, np.array([np.ravel(shift) for shift in shifts]))
    images, points = len(seen), len(board)
    held, weight = point_weights(np.zeros(board.shape))
    image, point = np.tile(np.arange(images), points), np.repeat(np.arange(points), images)
    plane = pixel_to_plane(SIZE, (1, 1), np.array(seen)[image, point])
    return Network(
        (own,),
        ExteriorOrientations(np.zeros(images, np.int64), pose, np.full((images, 6), np.inf)),
        Points(board, held, weight),
        Rays(image, point, plane, np.full(plane.shape, SIGMA)),
        tuple(map(str, range(images))),
        tuple(map(str, range(points))),
    )


def with_free(own: Camera, terms: tuple[str, ...]) -> Camera:
    free = ("c", "x0", "y0", "B1", *terms)
    return replace(own, estimated=np.array([name in free for name in PARAMETERS]))


def sigmas(solution: Solution) -> dict[str, float]:
    """Standard deviations scaled by the residuals, as OpenCV's."""
    covariance = solution.camera_covariance[0] * solution.variance_factor
    return dict(zip(PARAMETERS, np.sqrt(np.diag(covariance)).tolist(), strict=True))


@pytest.mark.parametrize("prism", [False, True])
def test_rational_lens_is_calibrated_as_opencv_does(prism: bool) -> None:
    matrix = np.array([[700.0, 0, 811], [0, 699, 619], [0, 0, 1]])
    true = np.array([0.4, 0.06, 1e-3, -7e-4, 0.001, 0.75, 0.25, 0.012, 5e-4, -3e-4, 4e-4, 2e-4])
    true = true if prism else true[:8]
    project: Any = cv2.projectPoints
    seen = boards(lambda *at: project(*at, matrix, true), seed=1)
    flags = cv2.CALIB_RATIONAL_MODEL | cv2.CALIB_USE_INTRINSIC_GUESS
    calibrate: Any = cv2.calibrateCameraExtended
    rms, k, d, turns, shifts, deviation, *_ = calibrate(
        [BOARD.astype(np.float32)] * len(seen), [one.astype(np.float32) for one in seen], SIZE, matrix.copy(),
        true.copy(), flags=flags | (cv2.CALIB_THIN_PRISM_MODEL if prism else 0), criteria=CRITERIA,
    )  # fmt: skip
    values = dict(zip(RATIONAL, np.ravel(d).tolist()[: len(true)], strict=False))
    own = from_pinhole(Pinhole(SIZE, k[0, 0], k[1, 1], k[0, 2], k[1, 2], **values), "o", "x")
    own = with_free(own, own.lens.terms if prism else own.lens.terms[:8])
    start = own.with_values(own.values * 1.002)
    board = BOARD.astype(np.float32).astype(float)
    solution = adjust(network(seen, start, turns, shifts, board))
    sigma = sigmas(solution)
    estimated = np.flatnonzero(own.estimated)
    apart = (solution.cameras[0] - own.values)[estimated]
    assert np.abs(apart / [sigma[PARAMETERS[n]] for n in estimated]).max() < 0.05
    assert np.sqrt(2 * solution.chi_squared * SIGMA**2 / (2 * len(seen) * len(BOARD))) == pytest.approx(rms)
    theirs = dict(zip(("fx", "fy", "cx", "cy", *RATIONAL), np.ravel(deviation).tolist(), strict=False))
    names = {"c": "fy", "x0": "cx", "y0": "cy", "P1": "p2", "P2": "p1"}
    for name in (PARAMETERS[n] for n in estimated if PARAMETERS[n] != "B1"):
        assert sigma[name] == pytest.approx(theirs[names.get(name, name.lower())], rel=0.02), name


def test_fisheye_is_calibrated_as_opencv_does() -> None:
    matrix = np.array([[520.0, 0, 811], [0, 519, 619], [0, 0, 1]])
    true = np.array([-0.03, 0.01, -0.004, 0.0006])
    project: Any = cv2.fisheye.projectPoints
    seen = boards(lambda *at: project(*at, matrix, true), seed=2)
    calibrate: Any = cv2.fisheye.calibrate
    _, k, d, turns, shifts = calibrate(
        [BOARD[None]] * len(seen), [one[None] for one in seen], SIZE, matrix.copy(), true.copy(),
        flags=RECOMPUTED,
        criteria=CRITERIA,
    )  # fmt: skip
    values = dict(zip(("k1", "k2", "k3", "k4"), np.ravel(d).tolist(), strict=True))
    given = Pinhole(SIZE, k[0, 0], k[1, 1], k[0, 2], k[1, 2], **values, fisheye=True)
    own = with_free(from_pinhole(given, "o", "x"), ("K1", "K2", "K3", "K4"))
    start = own.changed(c=own.value("c") * 1.02, x0=0.0, y0=0.0, K1=0.0, K2=0.0, K3=0.0, K4=0.0)
    solution = adjust(network(seen, start, turns, shifts))
    sigma = sigmas(solution)
    for name in own.free:
        ours = float(solution.cameras[0, PARAMETERS.index(name)])
        assert abs(ours - own.value(name)) < 0.05 * sigma[name], name
    assert 0.9 < solution.variance_factor < 1.1


@pytest.mark.shared
def test_recorded_boards(shared: Path) -> None:
    """Ten pictures of a board: a fisheye's polynomial holds the lens as OpenCV does."""
    seen = []
    for path in sorted((shared / "data" / "calib-chessboard-picam" / "half").glob("*")):
        picture = cv2.imread(str(path), cv2.IMREAD_GRAYSCALE)
        if picture is not None:
            _, corners = cv2.findChessboardCorners(picture, (9, 6))
            fine = cv2.cornerSubPix(picture, corners, (5, 5), (-1, -1), (3, 60, 1e-4))
            seen.append(fine.reshape(-1, 2).astype(float))
    assert len(seen) == 10
    calibrate: Any = cv2.fisheye.calibrate
    guess = np.array([[1320.0, 0, 811], [0, 1320, 619], [0, 0, 1]])
    _, k, d, turns, shifts = calibrate(
        [BOARD[None]] * 10, [one[None] for one in seen], SIZE, guess, np.zeros(4),
        flags=RECOMPUTED,
        criteria=CRITERIA,
    )  # fmt: skip
    values = dict(zip(("k1", "k2", "k3", "k4"), np.ravel(d).tolist(), strict=True))
    given = Pinhole(SIZE, k[0, 0], k[1, 1], k[0, 2], k[1, 2], **values, fisheye=True)
    own = with_free(from_pinhole(given, "o", "x"), ("K1", "K2", "K3", "K4"))
    solution = adjust(network(seen, own, turns, shifts))
    sigma = sigmas(solution)
    for name in own.free:
        ours = float(solution.cameras[0, PARAMETERS.index(name)])
        assert abs(ours - own.value(name)) < 0.05 * sigma[name], name
    # Numerator and denominator do the same in a field this small: nobody can tell them apart.
    plain = camera("o", "rational", "px", SIZE, (1, 1), {"c": 1320.0})
    rational = with_free(plain, ("K1", "K2", "K3", "K4", "K5", "K6", "P1", "P2"))
    covariance = adjust(network(seen, rational, turns, shifts)).camera_covariance[0]
    k1, k4 = PARAMETERS.index("K1"), PARAMETERS.index("K4")
    assert covariance[k1, k4] > 0.999 * np.sqrt(covariance[k1, k1] * covariance[k4, k4])


@pytest.mark.parametrize("model", ["equidistant", "pix4d-fisheye", "rational"])
def test_covariance_is_that_of_the_dense_adjustment(model: Model) -> None:
    terms = {"equidistant": ("K1", "K2"), "pix4d-fisheye": ("K1", "K2")}.get(model, ("K1", "K5", "P1", "P2"))
    values = {"c": 20.0, "x0": -0.2, "y0": 0.15, "K1": -0.02, "K2": 0.01, "B1": 2e-4}
    own = camera(
        "a", model, "mm", (3000, 2000), (0.009, 0.009), values, estimate=("c", "x0", "y0", "B1", "B2", *terms)
    )
    scene = networks.convergent((own,), points=25)
    given = networks.observe(scene, np.random.default_rng(3))
    ours, theirs = adjust(given), oracle.adjust_densely(given)
    sigma = np.sqrt(np.diag(theirs.block("camera", 0, len(PARAMETERS))))
    apart = (ours.cameras[0] - theirs.cameras[0])[own.estimated] / sigma[own.estimated]
    assert np.abs(apart).max() < 1e-5
    assert ours.camera_covariance[0] == pytest.approx(
        theirs.block("camera", 0, len(PARAMETERS)), rel=1e-6, abs=1e-12
    )
    assert ours.redundancy == pytest.approx(theirs.redundancy, abs=1e-7)
