"""Flights of a multispectral camera with RTK positions whose maker's tag is wrong."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from photocal.block.model import Block
from photocal.block.writer import write_block
from photocal.geometry.camera import PARAMETERS, Camera
from photocal.measurement.image_facts import ImageFacts
from photocal.measurement.maker_camera import StatedCamera, stated_camera
from tests.simulated import PLANS, block_of, world_of

SIZE = (1600, 1300)
# Truth in OpenCV's terms: what a Phantom 4 Multispectral states, with square pixels and without P1 and P2.
FX, FY, CX, CY = 1964.0, 1964.0, -12.0, 11.4
K1, K2, K3 = -0.4227, 0.3691, -0.2643
SIGMA_M = np.array([0.012, 0.015, 0.022])
CAMERA = {
    "id": "p4m",
    "size_px": SIZE,
    "pitch_mm": 0.003,
    "nominal_mm": 5.74,
    "fx": FX,
    "fy": FY,
    "cx": (SIZE[0] - 1) / 2 + CX,
    "cy": (SIZE[1] - 1) / 2 + CY,
    "k1": K1,
    "k2": K2,
    "k3": K3,
}
PASS = {"speed_m_s": 5.0, "forward_overlap": 0.76, "side_overlap": 0.5}
PLAN = {
    "area_m": [[-20, -20], [20, -20], [20, 20], [-20, 20]],
    "take_off_m": [-30, -30],
    "on_ground_s": 8,
    "pass": [{**PASS, "height_m": 44, "course_deg": 90}, {**PASS, "height_m": 57, "course_deg": 0}],
}
PROJECT = """
[project]
name = "tagged"
crs = "local"
height = "local"
output = "work"
[measurements]
block = "block"
"""


def tag(ratio: float = 1.009, cy_sign: int = 1, p: float = 0.0, model: str = "FC6310R") -> ImageFacts:
    """Facts of a picture whose DewarpData has fx this much too long, cy of a sign, and p1 = p2."""
    values = (FX * ratio, FY, CX, cy_sign * CY, K1, K2, p, p, K3)
    text = "2022-03-02;" + ",".join(f"{value:.7f}" for value in values)
    return ImageFacts("a.jpg", SIZE, model=model, maker_camera={"DewarpData": text, "DewarpFlag": "0"})


def estimated(stated: StatedCamera) -> Camera:
    """The camera as `photocal new` writes it into a project: all that has a prior is estimated."""
    sigma = stated.prior_sigma()
    return Camera(
        stated.camera.id, stated.camera.model, "px", SIZE, (1.0, 1.0), stated.camera.values,
        np.array([name in sigma for name in PARAMETERS]),
        np.array([sigma.get(name, np.inf) for name in PARAMETERS]),
        affinity="after", stated_by=stated.camera.stated_by,
    )  # fmt: skip


def fly(facts: ImageFacts, seed: int) -> Block:
    """Strips at one height and crossing ones above, over hills; positions by RTK."""
    world = world_of(
        PLANS / "small.toml", seed=seed, camera=CAMERA, plan=PLAN, targets={"control": 0, "check": 0},
        terrain={"relief_m": 2.0, "longest_m": 40.0}, observing={"ties": 700, "sigma_px": 0.25},
    )  # fmt: skip
    return block_of(world, estimated(stated_camera("p4m", facts)), SIGMA_M, np.random.default_rng(seed))


def write_project(folder: Path, block: Block) -> Path:
    """Write a project of the ready block."""
    folder.mkdir(parents=True, exist_ok=True)
    write_block(folder / "block", block)
    (folder / "project.toml").write_text(PROJECT, encoding="utf-8")
    return folder / "project.toml"
