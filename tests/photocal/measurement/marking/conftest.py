"""A small survey with painted targets of known places, and its project."""

from __future__ import annotations

import shutil
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

from photocal.geometry.camera import camera
from tests.photocal.measurement.site import SIDE, Site, plate_place, texture, with_plate

Floats = NDArray[np.float64]
POINTS = 10
IMAGES = 5
ATTITUDE_SIGMA_DEG, POSITION_SIGMA_M = 0.4, 0.05
PROJECT = f"""
[project]
name = "field"
crs = "local"
height = "local"
output = "work"
[images]
folder = "images"
[[camera]]
id = "cam"
model = "brown-ideal"
unit = "px"
size_px = [480, 360]
parameters = {{ c = 450.0, K1 = -8e-8 }}
estimate = ["c"]
prior_sigma = {{ c = 1.0 }}
[control]
points = "control.csv"
marks = "marks.csv"
[rig]
camera_to_antenna_m = [0.0, 0.0, -0.3]
camera_to_antenna_sigma_m = 0.01
boresight_sigma_deg = [{ATTITUDE_SIGMA_DEG}, {ATTITUDE_SIGMA_DEG}, {ATTITUDE_SIGMA_DEG}]
attitude_sigma_deg = [0.1, 0.1, 0.1]
time_offset_sigma_s = 0.005
"""


@dataclass(frozen=True)
class Survey:
    """Folder of a project, and where its images truly show its points (columns and rows, px)."""

    folder: Path
    site: Site
    points: Floats

    @property
    def file(self) -> Path:
        return self.folder / "PROJECT.toml"

    def truth(self, image: str, point: str) -> tuple[float, float]:
        k = np.array([self.site.names.index(image)])
        x, y = self.site.views.project(k, self.points[int(point[1:]) - 1][None])[0]
        return float(x), float(y)


def plate(number: int) -> NDArray[np.uint8]:
    """A cross, an hourglass or a circle, light on dark, 48 px of the ground's picture."""
    side = 48
    y, x = np.mgrid[:side, :side] - (side - 1) / 2
    light = (
        (np.abs(x) < 4.5) & (np.abs(y) < 21) | (np.abs(y) < 4.5) & (np.abs(x) < 21),
        (x * y > 0) & (np.hypot(x, y) < 22),
        np.hypot(x, y) < 12,
    )[number % 3]
    return np.where(light, 220, 50).astype(np.uint8)


def fly(folder: Path) -> Survey:
    """Make pictures, control points and exposures that are a little wrong, as their sigmas say."""
    rng = np.random.default_rng(5)
    own = camera("cam", "brown-ideal", "px", (480, 360), (1.0, 1.0), {"c": 450.0, "K1": -8e-8})
    poses = np.zeros((IMAGES, 6))
    poses[:, 3:] = [(2.5 * (k - 2), rng.uniform(-1, 1), 20 + rng.uniform(-0.5, 0.5)) for k in range(IMAGES)]
    poses[:, :3] = np.radians([(*rng.uniform(-3, 3, 2), rng.uniform(-8, 8)) for _ in range(IMAGES)])
    site = Site(own, poses, tuple(f"p{k + 1}.png" for k in range(IMAGES)))
    ground = np.clip(texture(3, SIDE) * 0.3 + 90, 0, 255).astype(np.float32)
    points = []
    for k in range(POINTS):
        wanted = (-4.0 + 2.0 * (k % 5), -2.5 + 5.0 * (k // 5) + rng.uniform(-1, 1))
        with_plate(ground, plate(k), wanted)
        points.append((*plate_place(plate(k), wanted), 0.0))
    (folder / "images").mkdir(parents=True)
    site.render(ground, folder / "images")
    (folder / "PROJECT.toml").write_text(PROJECT)
    rows = [
        f"P{k + 1},{x:.4f},{y:.4f},{z:.4f},0.01,0.01,0.01,{'check' if k == 9 else 'control'}"
        for k, (x, y, z) in enumerate(points)
    ]
    (folder / "control.csv").write_text("\n".join(["point,X,Y,Z,sX,sY,sZ,role", *rows]) + "\n")
    wrong = (
        poses
        + rng.normal(0, 1, poses.shape)
        * np.r_[np.full(3, np.radians(ATTITUDE_SIGMA_DEG)), np.full(3, POSITION_SIGMA_M)]
    )
    exposures = folder / "work" / "exposures"
    exposures.mkdir(parents=True)
    head = "image,camera,X,Y,Z,omega,phi,kappa,sX,sY,sZ,so,sp,sk"
    lines = [
        ",".join(
            [name, "cam", *(f"{v:.6f}" for v in (*pose[3:], *np.degrees(pose[:3])))]
            + [f"{POSITION_SIGMA_M}"] * 3
            + ["0.05"] * 3
        )
        for name, pose in zip(site.names, wrong, strict=True)
    ]
    (exposures / "images.csv").write_text("\n".join([head, *lines]) + "\n")
    return Survey(folder, site, np.array(points))


@pytest.fixture(scope="session")
def flown(tmp_path_factory: pytest.TempPathFactory) -> Survey:
    return fly(tmp_path_factory.mktemp("survey") / "field")


@pytest.fixture
def survey(flown: Survey, tmp_path: Path) -> Survey:
    """A copy of the survey without marks."""
    folder = tmp_path / "field"
    shutil.copytree(flown.folder, folder)
    return Survey(folder, flown.site, flown.points)
