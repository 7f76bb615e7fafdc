"""Calibration boards: rendered ones against the truth, photographed ones against OpenCV."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any, Protocol

import cv2
import numpy as np
import pytest
from PIL import Image

from photocal.base.errors import ConfigurationError
from photocal.block.folder import read_block
from photocal.geometry.camera import camera
from photocal.measurement.markers import (
    Board,
    charuco_board,
    dictionary,
    find_board,
    find_coded_targets,
    find_markers,
    parse_board,
)
from photocal.measurement.patch_matching import ImageSource

from .rendering import DARK, LIGHT, Floats, render, warped


class Answer(Protocol):
    """What a command said."""

    code: int
    out: str
    err: str


RNG = np.random.default_rng(11)


def _view(scale: float) -> np.ndarray[tuple[int, ...], np.dtype[np.float64]]:
    matrix = np.eye(3)
    angle = RNG.uniform(-0.4, 0.4)
    matrix[:2, :2] = scale * np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])
    matrix[2, :2] = RNG.uniform(-1, 1, 2) * 1e-4 * scale
    matrix[:2, 2] = [150, 150]
    return matrix


def test_charuco_corners_of_rendered_boards() -> None:
    board = Board(7, 5, 0.03, "charuco", dictionary="4x4_50")
    texture = np.asarray(charuco_board(board).generateImage((1400, 1000), marginSize=0), np.uint8)
    texture = np.pad(texture, 100, constant_values=255)
    errors, squares = [], []
    for _ in range(4):
        matrix = _view(0.4)
        grey = warped(texture, matrix, (760, 700)).astype(float)
        grey = np.asarray(
            np.clip(np.round(grey * 0.6 + 40 + RNG.normal(0, 5.1, grey.shape)), 0, 255), np.uint8
        )
        view = find_board(grey, board)
        assert view is not None
        corners, pixels, sigmas = view
        assert len(corners) >= 20
        row, column = np.divmod(corners, 6)
        place = np.column_stack(
            [100 + 200 * (column + 1) - 0.5, 100 + 200 * (row + 1) - 0.5, np.ones(len(row))]
        )
        true = place @ matrix.T
        error = pixels - true[:, :2] / true[:, 2:]
        errors.append(error)
        squares.append((error / sigmas) ** 2)
    assert np.sqrt(np.mean(np.concatenate(errors) ** 2)) < 0.05
    assert 0.5 < np.mean(np.concatenate(squares)) < 1.6


@pytest.mark.parametrize("name", ["apriltag_36h11", "4x4_50"])
def test_markers_of_rendered_sheets(name: str) -> None:
    codes = dictionary(name)
    errors = []
    for identity in (3, 17, 42):
        texture = np.full((400, 400), 255, np.uint8)
        texture[100:300, 100:300] = cv2.aruco.generateImageMarker(codes, identity, 200)
        matrix = _view(0.25)
        grey = warped(texture, matrix, (320, 320)).astype(float)
        grey = np.asarray(
            np.clip(np.round(grey * 0.6 + 40 + RNG.normal(0, 5.1, grey.shape)), 0, 255), np.uint8
        )
        found = find_markers(grey, name)
        assert [marker.identity for marker in found] == [identity]
        true = matrix @ [199.5, 199.5, 1.0]
        errors.append(np.array([found[0].centre.column, found[0].centre.row]) - true[:2] / true[2])
    assert np.sqrt(np.mean(np.square(errors))) < 0.05


def test_codes_seen_steeply_do_not_move_their_corners() -> None:
    """Across an edge the border is narrower than along it: rms 0.008 px where the code counts as border."""
    errors = []
    for identity in (3, 8, 17, 42):
        texture = np.full((400, 400), 255, np.uint8)
        texture[100:300, 100:300] = cv2.aruco.generateImageMarker(dictionary("4x4_50"), identity, 200)
        for turn in np.radians([10, 40, 70, 100]):
            rotation = np.array([[np.cos(turn), -np.sin(turn)], [np.sin(turn), np.cos(turn)]])
            matrix = np.eye(3)
            matrix[:2, :2] = 0.24 * np.diag([1.0, 0.55]) @ rotation
            matrix[:2, 2] = [60.2, 59.7] - matrix[:2, :2] @ [199.5, 199.5]
            (marker,) = find_markers(warped(texture, matrix, (120, 120)), "4x4_50")
            true = np.array([[99.5, 99.5], [299.5, 99.5], [299.5, 299.5], [99.5, 299.5]]) @ matrix[:2, :2].T
            errors.append(marker.corners - true - matrix[:2, 2])
    assert np.sqrt(np.mean(np.square(errors))) < 0.006


@pytest.mark.parametrize("text", ["10", "axb", "2x5", "10x7x3", "", "1000x3"])
def test_unusable_boards_are_refused(text: str) -> None:
    with pytest.raises(ConfigurationError, match="board"):
        parse_board(text, 0.03)


def test_unusable_squares_and_dictionaries_are_refused() -> None:
    with pytest.raises(ConfigurationError, match="square"):
        parse_board("7x5", -1.0)
    with pytest.raises(ConfigurationError, match="dictionary"):
        parse_board("7x5", 0.03, "9x9")


@pytest.mark.shared
def test_photographed_chessboards_against_two_peers(
    shared: Path, tmp_path: Path, photocal: Callable[..., Answer]
) -> None:
    folder = shared / "data/calib-chessboard-picam"
    block, run = tmp_path / "block", tmp_path / "run"
    said = photocal("measure", "--images", folder / "half", "--board", "10x7", "-o", block)
    assert said.code == 0, said.err
    assert "determine the principal distance to 1.2 % only" in said.out
    assert photocal("adjust", block, "-o", run).code == 0
    camera = json.loads((run / "result.json").read_text())["cameras"]["camera"]
    value = {name: entry["value"] for name, entry in camera["parameters"].items()}
    sigma = {name: entry["sigma"] or 0.0 for name, entry in camera["parameters"].items()}
    measured = read_block(block)
    assert len(measured.images.names) == 10
    assert len(measured.observations.image) == 540

    # OpenCV on the same corners: values and, with the a posteriori factor near 1, the same sigmas.
    seen = measured.observations
    boards = [(measured.points.values[seen.point[seen.image == j]] * [1, -1, 1]) for j in range(10)]
    corners = [seen.values[seen.image == j].astype(np.float32) for j in range(10)]
    size = measured.cameras[0].size_px
    calibrate: Any = cv2.calibrateCameraExtended
    peer_boards = [b.astype(np.float32) for b in boards]
    _, matrix, lens, _, _, deviations, _, _ = calibrate(peer_boards, corners, size, None, None)
    peer_sigma = np.ravel(deviations)[:9]
    c = value["c"]
    ours = np.array([c * (1 + value["B1"]), c, value["x0"] + 819.5, 615.5 - value["y0"]])
    assert np.abs(ours - [matrix[0, 0], matrix[1, 1], matrix[0, 2], matrix[1, 2]]).max() < 0.2
    k1, k2, k3 = value["K1"] * c**2, value["K2"] * c**4, value["K3"] * c**6
    assert [k1, k2, k3] == pytest.approx(np.ravel(lens)[[0, 1, 4]], abs=0.01)
    assert [sigma["c"], sigma["x0"], sigma["y0"]] == pytest.approx(peer_sigma[[1, 2, 3]], rel=0.1)
    assert [sigma["P2"] * c, sigma["P1"] * c] == pytest.approx(peer_sigma[[6, 7]], rel=0.1)

    # The publisher's result for these images, and the second peer of the data's description.
    for peer in (
        (1329.4946, 1329.3365, 809.9529, 618.5528, 0.166415, -0.223439, -0.607959),
        (1317.81, 1317.61, 811.20, 618.19, 0.16363, -0.2225, -0.559),
    ):
        difference = np.array([*ours, k1, k2, k3]) - peer
        assert (np.abs(difference) < 2 * peer_sigma[[0, 1, 2, 3, 4, 5, 8]]).all()


def test_images_without_the_board_are_named(tmp_path: Path, photocal: Callable[..., Answer]) -> None:
    images = tmp_path / "images"
    images.mkdir()
    Image.new("L", (64, 64), 128).save(images / "grey.png")
    (images / "empty.jpg").touch()
    said = photocal("measure", "--images", images, "--board", "10x7", "-o", tmp_path / "block")
    assert said.code == 3
    assert "0 of 2 images show a board of 10 x 7 squares" in said.err
    assert len(said.err.splitlines()) == 1
    assert not (tmp_path / "block").exists()


def test_coded_targets_lie_where_the_lens_shows_their_middles(tmp_path: Path) -> None:
    """A plate of 110 px near the border, where the lens bends it; its middle by OpenCV."""
    c, size, side, code = 1500.0, (1600, 1200), 190, 7
    matrix, bend = np.array([[c, 0, 799.5], [0, c, 599.5], [0, 0, 1.0]]), np.array([-0.15, 0, 0, 0, 0])
    cells = cv2.aruco.generateImageMarker(cv2.aruco.getPredefinedDictionary(cv2.aruco.DICT_4X4_50), code, 6)
    picture = np.full(size[::-1], LIGHT, np.uint8)
    truth = []
    for at in ([1400.0, 200.0], [190.0, 1010.0]):
        middle = np.asarray(cv2.undistortPoints(np.array([[at]]), matrix, bend).ravel(), np.float64)
        corner = np.round(at).astype(int) - side // 2

        def scene(x: Floats, y: Floats, corner: Floats = corner, middle: Floats = middle) -> Floats:
            seen = np.stack([x.ravel(), y.ravel()], axis=-1) + corner
            away = cv2.undistortPoints(seen[:, None], matrix, bend).reshape(-1, 2) - middle
            cell = np.floor(away * c / 110 * 6 + 3).astype(int)
            inside = ((cell >= 0) & (cell < 6)).all(axis=1)
            column, row = np.clip(cell, 0, 5).T
            return np.where(inside & (cells[row, column] < 128), DARK, LIGHT).reshape(x.shape)

        part = render(scene, np.eye(3), side, np.random.default_rng(1), noise=0.002)
        picture[corner[1] : corner[1] + side, corner[0] : corner[0] + side] = part
        truth.append(at)
        source = tmp_path / f"{len(truth)}.png"
        cv2.imwrite(str(source), picture)
        picture[:] = int(LIGHT)
    sources = [ImageSource(tmp_path / f"{k}.png", f"{k}", tmp_path / "cache") for k in (1, 2)]

    def aside(k1: float) -> Floats:
        lens = camera("c", "brown-ideal", "px", size, (1.0, 1.0), {"c": c, "K1": k1})
        marks, _ = find_coded_targets(sources, [lens, lens], "4x4_50", {str(code): "A"})
        return np.array([(mark.x, mark.y) for mark in marks]) - truth

    straight, bent = (np.hypot(*aside(k1).T) for k1 in (0.0, bend[0] / c**2))
    assert (straight > 0.04).all()
    assert (bent < 0.2 * straight).all()
