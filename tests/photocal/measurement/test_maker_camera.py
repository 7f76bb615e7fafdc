"""Cameras that pictures state: OpenCV's rays of the same tags, both kinds of equivalents, wide priors."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest
from numpy.typing import NDArray

from photocal.adjustment.adjust import adjust
from photocal.block.folder import read_block
from photocal.geometry.camera import PARAMETERS, among, pixel_to_plane
from photocal.geometry.distortion import undistorted
from photocal.measurement.image_facts import ImageFacts, read_facts
from photocal.measurement.maker_camera import stated_camera
from photocal.measurement.tie_adjustment import assembled
from photocal.run.new_project import new_project
from tests.photocal.conftest import Answer

Photocal = Callable[..., Answer]
Floats = NDArray[np.float64]

# Of the four pictures of a Phantom 4 Multispectral, and one as a Matrice 4E may have it.
P4M = "1973.0899658,1955.6500244,-19.0419922,-11.4249878,-0.4227500,0.3691010,0.0040638,0.0040638,-0.2643060"
K6 = "3720.5,3722.25,-7.5,12.25,0.31,-0.12,0.0004,-0.0003,0.05,0.42,-0.05,0.01"


def rays_of_opencv(size: tuple[int, int], values: list[float], cy: float, pixels: Floats) -> Floats:
    """Slopes x right and y up; `values` fx, fy, cx, cy, k1 and so on; cy from the middle, downwards."""
    middle = (np.array(size) - 1) / 2
    matrix = np.array([[values[0], 0, middle[0] + values[2]], [0, values[1], middle[1] + cy], [0, 0, 1]])
    criteria = (cv2.TERM_CRITERIA_COUNT | cv2.TERM_CRITERIA_EPS, 500, 1e-14)
    points = pixels.reshape(-1, 1, 2)
    slopes = cv2.undistortPoints(points, matrix, np.array(values[4:]), criteria=criteria)
    return np.asarray(slopes[:, 0] * [1.0, -1.0])


@pytest.mark.parametrize(("model", "size", "key", "text", "downwards"), [
    ("FC6360", (1600, 1300), "DewarpData", P4M, 11.4249878),
    ("FC6310R", (1600, 1300), "DewarpData", P4M, -11.4249878),
    ("M4E", (5280, 3956), "DewarpDataK6", K6, 12.25),
])  # fmt: skip
def test_the_rays_of_a_tag_are_those_of_opencv(
    model: str, size: tuple[int, int], key: str, text: str, downwards: float
) -> None:
    tags = {key: f"2024-01-01;{text}" if key == "DewarpData" else text, "DewarpFlag": "0"}
    stated = stated_camera("c", ImageFacts("a.jpg", size, model=model, maker_camera=tags))
    own = stated.camera
    assert stated.source == own.stated_by == f"{key} of its maker"
    pixels = np.stack(np.meshgrid(*(np.linspace(5, n - 6, 9) for n in size)), axis=-1).reshape(-1, 2)
    ours = undistorted(own, pixel_to_plane(size, (1.0, 1.0), pixels)) / own.value("c")
    theirs = rays_of_opencv(size, [float(v) for v in text.split(",")], downwards, pixels)
    # A ten-thousandth of a pixel.
    assert np.abs(ours - theirs).max() < 1e-4 / own.value("c")


def test_a_dewarped_picture_has_no_tag() -> None:
    tags = {"DewarpData": f"2022-03-02;{P4M}", "DewarpFlag": "1", "CalibratedFocalLength": "1913.333"}
    stated = stated_camera("c", ImageFacts("a.jpg", (1600, 1300), maker_camera=tags))
    assert (stated.camera.value("c"), stated.camera.stated_by) == (1913.333, "")


def test_the_priors_of_a_tag_cover_its_maker_s_errors() -> None:
    """fx for fy, no decentring, square pixels, the other sign of cy: none is farther than two sigmas."""
    tags = {"DewarpData": f"2022-03-02;{P4M}"}
    stated = stated_camera("c", ImageFacts("a.jpg", (1600, 1300), model="FC6360", maker_camera=tags))
    own, sigma = stated.camera, stated.prior_sigma()
    assert {"B1", "B2"} <= sigma.keys()
    for fx_or_fy in (1955.65, 1973.09):
        assert abs(own.value("c") - fx_or_fy) <= sigma["c"]
    # A flight of 32 pictures finds B1 near -0.003 (README of the pictures).
    for name, other in (("B1", 0.0), ("B1", -0.003), ("P1", 0.0), ("P2", 0.0), ("y0", -own.value("y0"))):
        assert abs(own.value(name) - other) <= 2 * sigma[name], name
    # What the flight confirms to 2 % is not thrown away.
    for name in ("K1", "K2", "K3"):
        assert sigma[name] < 2.0 * abs(own.value(name))
    assert sigma["K1"] < 0.1 * abs(own.value("K1"))


@pytest.mark.parametrize(("size", "equivalent", "width_px", "diagonal_px", "maker_px"), [
    ((1600, 1300), 40, 1778, 1906, 1913.3),  # P4 Multispectral
    ((5280, 3956), 24, 3520, 3660, 3725.2),  # M4E
    ((640, 512), 58, 1031, 1099, 13.5 / 0.012),  # H20T, thermal
])  # fmt: skip
def test_a_35_mm_equivalent_goes_by_the_diagonal(
    size: tuple[int, int], equivalent: int, width_px: float, diagonal_px: float, maker_px: float
) -> None:
    stated = stated_camera("c", ImageFacts("a.jpg", size, focal_35mm=float(equivalent)))
    c, sigma = stated.camera.value("c"), stated.prior_sigma()["c"]
    assert c == pytest.approx(diagonal_px, abs=1.0)
    assert abs(c - width_px) <= 1.01 * sigma
    assert abs(c - maker_px) <= sigma
    assert not stated.guessed


def test_frames_of_three_to_two_know_no_difference() -> None:
    stated = stated_camera("c", ImageFacts("a.jpg", (5472, 3648), focal_35mm=24.0))
    assert stated.camera.value("c") == pytest.approx(5472 * 24 / 36, rel=1e-4)
    assert stated.share == 0.03


@pytest.mark.shared
def test_new_asks_nothing_that_the_pictures_say(shared: Path, tmp_path: Path) -> None:
    for name, least, most in (("p4m", 1956.0, 1973.0), ("h20t", 1099.0, 1125.0)):
        folder = tmp_path / name
        folder.mkdir()
        for path in (shared / "data/dji-xmp" / name).glob("*.JPG"):
            (folder / path.name).symlink_to(path)
        made = new_project(folder)
        assert made.asked == []
        assert [line for line in made.missing if "control" not in line] == []
        image = read_facts(next(folder.glob("*.JPG")))
        stated = stated_camera("c", image)
        c, sigma = stated.camera.value("c"), stated.prior_sigma()["c"]
        assert least - sigma <= c <= most + sigma
        text = made.path.read_text(encoding="utf-8")
        assert 'height = "ellipsoidal"  # as the pictures state' in text
        assert ('"B1"' in text) == (name == "p4m")
        assert any(line.startswith("laser distances") for line in made.known) == (name == "h20t")


@pytest.mark.shared
def test_four_pictures_prove_the_sign_of_the_principal_point(
    photocal: Photocal, shared: Path, tmp_path: Path
) -> None:
    """Their tie points, adjusted with the principal point of each sign: the distortion is about it."""
    folder = tmp_path / "p4m"
    folder.mkdir()
    for path in (shared / "data/dji-xmp/p4m").glob("*.JPG"):
        (folder / path.name).symlink_to(path)
    new_project(folder)
    out = folder / "block"
    answer = photocal("measure", folder / "project.toml", "-o", out, "--cache", tmp_path / "cache")
    assert answer.code == 0, answer.err
    block = read_block(folder / "block")
    (own,) = block.cameras
    assert [own.value("x0"), own.value("y0")] == pytest.approx([-19.0419922, -11.4249878])
    free = np.full(len(PARAMETERS), np.inf)

    def adjusted(x: float, y: float, *names: str) -> tuple[float, Floats, Floats]:
        camera = replace(
            own.changed(x0=x * own.value("x0"), y0=y * own.value("y0"), P1=0.0, P2=0.0),
            estimated=among(*names), prior_sigma=free, shutter="global",
        )  # fmt: skip
        assembly, state = assembled(replace(block, cameras=(camera,)), block.images.values)
        solution = adjust(assembly.network, None, state)
        sigma = np.sqrt(np.diag(solution.camera_covariance[0]))
        return solution.chi_squared, solution.cameras[0], sigma

    least = {(x, y): adjusted(x, y, "B1", "B2", "P1", "P2")[0] for x in (1, -1) for y in (1, -1)}
    assert min(least, key=lambda signs: least[signs]) == (1, 1)
    _, values, sigma = adjusted(0, 0, "x0", "y0", "K1", "K2", "K3", "P1", "P2", "B1", "B2")
    # Found without the tag: left of the middle and below it, by many sigmas; y counts upwards here.
    for name, stated in (("x0", -19.04), ("y0", -11.42)):
        k = PARAMETERS.index(name)
        assert values[k] < -5 * sigma[k]
        assert math.copysign(1.0, values[k]) == math.copysign(1.0, stated)
    assert values[PARAMETERS.index("y0")] == pytest.approx(-11.42, abs=3 * sigma[PARAMETERS.index("y0")])
