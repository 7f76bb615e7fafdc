"""Resection: exact poses, gross errors, and the printed resections of the DCS460."""

from __future__ import annotations

import csv
from pathlib import Path

import numpy as np
import pytest

from photocal.adjustment.adjust import adjust
from photocal.adjustment.network import ExteriorOrientations, Network, Points, Rays, point_weights
from photocal.geometry.camera import camera
from photocal.geometry.resection import resection
from photocal.geometry.rotation import angles_from_matrix, matrix_from_angles
from tests.photocal import networks

DCS460 = Path(__file__).parents[2] / "reference" / "dcs460"


def seen(scene: networks.Scene, image: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Rotation and centre of an image, and its rays over the principal distance."""
    rotation, centre = matrix_from_angles(scene.exposures[image, :3]), scene.exposures[image, 3:]
    q = (scene.points - centre) @ rotation.T
    return rotation, centre, -q[:, :2] / q[:, 2:]


@pytest.mark.parametrize("count", [4, 5, 6, 20])
@pytest.mark.parametrize("flat", [False, True])
def test_exact_points_give_the_pose(count: int, flat: bool) -> None:
    scene = networks.convergent(points=20)
    if flat:
        scene.points[:, 2] = 0.1 * scene.points[:, 0]
    for image in range(6):
        rotation, centre, rays = seen(scene, image)
        found = resection(scene.points[:count], rays[:count])
        assert found is not None
        assert np.abs(found.rotation - rotation).max() < 1e-6
        assert np.abs(found.centre - centre).max() < 1e-5
        assert found.residual.max() < 1e-7


@pytest.mark.parametrize("share", [0.1, 0.3])
def test_gross_errors(share: float) -> None:
    """Wrong points do not bend the pose, and can be told from the right ones."""
    scene = networks.convergent(points=40)
    rng = np.random.default_rng(5)
    for image in range(6):
        rotation, centre, rays = seen(scene, image)
        rays = rays + rng.normal(0, 1e-4, rays.shape)
        wrong = rng.random(40) < share
        rays[wrong] += rng.uniform(-0.4, 0.4, (int(wrong.sum()), 2))
        found = resection(scene.points, rays)
        assert found is not None
        assert np.abs(found.rotation - rotation).max() < 2e-3
        assert np.abs(found.centre - centre).max() < 0.02
        assert found.residual[~wrong].max() < 3e-3


def test_what_gives_no_pose() -> None:
    scene = networks.convergent(points=20)
    _, _, rays = seen(scene, 0)
    line = np.outer(np.arange(20.0), [1.0, 2.0, 0.5])
    assert resection(scene.points[:3], rays[:3]) is None
    assert resection(line, rays) is None
    assert resection(np.ones((20, 3)), rays) is None


def rows(name: str) -> list[dict[str, str]]:
    with (DCS460 / name).open(encoding="utf-8", newline="") as text:
        return list(csv.DictReader(text))


@pytest.mark.parametrize("photo", ["1", "3", "4", "5", "7", "9", "10", "12"])
def test_printed_resections_of_the_dcs460(photo: str) -> None:
    """c = 20.000, no distortion; readings (3 um) and targets (5 mm) weighted; Z of point 37 is -0.001."""
    control = {r["point"]: [float(r[f"{a}_m"]) for a in "XYZ"] for r in rows("control_points.csv")}
    control["37"][2] = -0.001
    mine = [r for r in rows("image_observations.csv") if r["photo"] == photo]
    xyz = np.array([control[r["point"]] for r in mine])
    plane = np.array([[float(r["x_mm"]), float(r["y_mm"])] for r in mine])
    start = resection(xyz, plane / 20.0)
    assert start is not None
    pose = np.concatenate([angles_from_matrix(start.rotation), start.centre])[None]
    held, weight = point_weights(np.full(xyz.shape, 0.005))
    count = np.arange(len(mine))
    own = camera("dcs460", "brown-observed", "mm", (3060, 2036), (0.009, 0.009), {"c": 20.0})
    network = Network(
        (own,),
        ExteriorOrientations(np.zeros(1, np.int64), pose, np.full((1, 6), np.inf)),
        Points(xyz, held, weight),
        Rays(np.zeros(len(mine), np.int64), count, plane, np.full(plane.shape, 0.003)),
        (photo,),
        tuple(r["point"] for r in mine),
    )
    found = adjust(network).exposures[0]
    printed = next(r for r in rows("eo_initial_ori.csv") if r["photo"] == photo)
    angles = np.array([float(printed[f"{a}_rad"]) for a in ("omega", "phi", "kappa")])
    centre = np.array([float(printed[f"{a}0_m"]) for a in "XYZ"])
    turn = (found[:3] - angles + np.pi) % (2 * np.pi) - np.pi
    assert np.abs(turn).max() < 2e-4
    assert np.abs(found[3:5] - centre[:2]).max() < 0.8e-3
    assert abs(found[5] - centre[2]) < 2.6e-3
