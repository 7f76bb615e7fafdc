"""Long study: what an error of c does to heights, with and without oblique strips and a second height.

Writes `docs/evidence/height_from_c.md`. A block of straight-down pictures at one height turns an error of a
held c into heights by H / c, and cannot estimate c; strips that look aside, or a second height, estimate it.
What the covariance of the planned network predicts is held against simulated adjustments.

Run: `make evidence`, or `python -m tests.evidence.height_from_c [SIMULATIONS]`.
"""

from __future__ import annotations

import sys
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from photocal.adjustment.adjust import adjust
from photocal.adjustment.network import ExteriorOrientations, Network, Points, Rays, point_weights
from photocal.base.arrays import Floats
from photocal.base.errors import IllPosedError
from photocal.geometry.camera import among
from photocal.planning import simulated_adjustment as planned
from photocal.planning.flight import planned_camera

OUTPUT = Path(__file__).parents[2] / "docs" / "evidence" / "height_from_c.md"
CAMERA = planned_camera(8.8, 2.41, (5472, 3648))
HEIGHT, BASE, APART, SIDE = 100.0, 22.0, 40.0, 200.0
IMAGE_PX, GNSS_M, WRONG = 0.5, (0.02, 0.03), 1e-3
SIMULATIONS = 40


def strips(height: float, tilt_deg: float = 0.0, *, across: bool = False) -> Floats:
    """Poses of parallel strips, there and back; tilted they look to the side of the flight."""
    rows = []
    for k, y in enumerate(np.arange(-SIDE / 2, SIDE / 2 + 1, APART)):
        for x in np.arange(-SIDE / 2, SIDE / 2 + 1, BASE):
            place = (y, x) if across else (x, y)
            aside = np.radians(tilt_deg) * (1 if k % 2 else -1)
            kappa = np.pi * (k % 2) + (np.pi / 2 if across else 0.0)
            rows.append([aside, 0.0, kappa, *place, height])
    return np.array(rows)


@dataclass(frozen=True)
class Design:
    """Strips, and whether ground control stands in the corners."""

    name: str
    poses: Floats
    control: bool = False


DOWN = strips(HEIGHT)
DESIGNS = (
    Design("nadir, one height", DOWN),
    Design("the same, four control points", DOWN, control=True),
    Design("with cross strips at 1.4 times the height", np.vstack([DOWN, strips(1.4 * HEIGHT, across=True)])),
    Design(
        "with cross strips tilted 30 degrees to the side",
        np.vstack([DOWN, strips(HEIGHT, 30.0, across=True)]),
    ),
)


def network(design: Design, *, free: bool) -> tuple[Network, Floats]:
    """The network of a design without errors; and its points."""
    places = np.arange(-SIDE / 2, SIDE / 2 + 1, 20.0)
    plane = np.stack(np.meshgrid(places, places), axis=-1).reshape(-1, 2)
    xyz = np.column_stack([plane, 1.0 * np.sin(plane[:, 0] / 30.0)])
    image, point, seen = planned.visible_rays(design.poses, xyz, CAMERA)
    order = np.argsort(point, kind="stable")
    sigma = np.full(xyz.shape, np.inf)
    if design.control:
        corners = (np.abs(plane) == SIDE / 2).all(axis=1)
        sigma[corners] = [0.01, 0.01, 0.015]
    held, weight = point_weights(sigma)
    pose_sigma = np.full(design.poses.shape, np.inf)
    pose_sigma[:, 3:] = [GNSS_M[0], GNSS_M[0], GNSS_M[1]]
    lens = replace(CAMERA, estimated=among("c")) if free else CAMERA
    precision = np.full((len(order), 2), IMAGE_PX * CAMERA.pitch[0])
    made = Network(
        (lens,),
        ExteriorOrientations(np.zeros(len(design.poses), np.int64), design.poses, pose_sigma),
        Points(xyz, held, weight),
        Rays(image[order], point[order], seen[order], precision),
        tuple(f"photo {k}" for k in range(len(design.poses))),
        tuple(f"point {k}" for k in range(len(xyz))),
    )
    return made, xyz


def with_errors(made: Network, random: np.random.Generator, *, control: bool) -> Network:
    """Observations with their random errors."""
    noise = random.normal(0.0, 1.0, made.rays.plane.shape) * made.rays.sigma
    rays = replace(made.rays, plane=made.rays.plane + noise)
    poses = made.exposures.values.copy()
    poses[:, 3:] += random.normal(0.0, 1.0, poses[:, 3:].shape) * made.exposures.sigma[:, 3:]
    points = made.points
    if control:
        sigma = np.where(points.weight.any(axis=2), 0.01, 0.0) * [1.0, 1.0, 1.5]
        points = replace(points, values=points.values + random.normal(0.0, 1.0, sigma.shape) * sigma)
    return replace(made, rays=rays, points=points, exposures=replace(made.exposures, values=poses))


@dataclass(frozen=True)
class Seen:
    """What one design does.

    held_m: mean height error with a held c that is wrong by WRONG.
    sigma_c, predicted_m: of c, as share of it, and of the mean height, by the covariance with c free.
    simulated_c, simulated_m: their root mean squares; nan where c is not determined.
    """

    held_m: float
    sigma_c: float = np.nan
    predicted_m: float = np.nan
    simulated_c: float = np.nan
    simulated_m: float = np.nan


def study(design: Design, simulations: int) -> Seen:
    """Measure a design."""
    held, xyz = network(design, free=False)
    (lens,) = held.cameras
    wrong = replace(held, cameras=(lens.changed(c=lens.value("c") * (1.0 + WRONG)),))
    off = float((adjust(wrong).points - xyz)[:, 2].mean())
    free, _ = network(design, free=True)
    try:
        solution = adjust(free)
    except IllPosedError:
        return Seen(off)
    sigma_c = float(np.sqrt(solution.camera_covariance[0, 0, 0]) / lens.value("c"))
    heights, cs = [], []
    for seed in range(simulations):
        found = adjust(with_errors(free, np.random.default_rng(seed), control=design.control))
        heights.append(float((found.points - xyz)[:, 2].mean()))
        cs.append(found.cameras[0][0] / lens.value("c") - 1.0)
    # By the rule of the straight-down block, and the mean of the positions; control takes part of it away.
    common = np.hypot(HEIGHT * sigma_c, GNSS_M[1] / np.sqrt(len(design.poses)))
    of_height, of_c = (float(np.sqrt(np.mean(np.square(values)))) for values in (heights, cs))
    return Seen(off, sigma_c, float(common), of_c, of_height)


def page(simulations: int) -> str:
    """Write the page."""
    rule = HEIGHT * WRONG
    text = (
        f"FC6310 (c 8.8 mm) at {HEIGHT:.0f} m, positions {GNSS_M[0]:.2f} and {GNSS_M[1]:.2f} m, image "
        f"{IMAGE_PX} px; {simulations} simulations of each. A held c that is wrong by {WRONG:.1%} moves "
        f"heights by H dc/c = {rule:.3f} m where a block has only positions and nadir pictures; "
        "`photocal plan` states this in metres for each micrometre of c. With c free, all heights share an "
        "error of H times the relative standard deviation of c, and the mean of the positions' errors (less "
        "with control)."
    )
    free = "c free: sigma of c, %, predicted"
    heads = [
        "design",
        "held c wrong by 0.1 %: mean height, m",
        free,
        "simulated",
        "mean height, m, predicted",
        "simulated",
    ]
    lines = ["# Height error from c", "", text, "", f"| {' | '.join(heads)} |", "|---" * len(heads) + "|"]
    for design in DESIGNS:
        seen = study(design, simulations)
        figures = (100 * seen.sigma_c, 100 * seen.simulated_c, seen.predicted_m, seen.simulated_m)
        cells = ["not determined" if np.isnan(value) else f"{value:.4f}" for value in figures]
        lines.append(f"| {design.name} | {seen.held_m:+.3f} | {' | '.join(cells)} |")
    return "\n".join(lines) + "\n"


if __name__ == "__main__":
    OUTPUT.write_text(page(int(sys.argv[1]) if len(sys.argv) > 1 else SIMULATIONS), encoding="utf-8")
