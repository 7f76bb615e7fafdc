"""Projects of real size, made up and adopted: processor time, from the program's start to the certificate.

`python -m tests.benchmarks.adopt_projects one` is 581 images of one camera and some 104 000 rays, `five`
1 420 images of a rig whose oblique heads look 40 degrees out, by a common clock, and some 457 000 rays.
"""

from __future__ import annotations

import resource
import subprocess
import sys
import tempfile
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from photocal.block.model import ROLES, Block, Images, ObjectPoints
from photocal.exchange.parts import pixels as in_px
from photocal.geometry.camera import Camera, camera, plane_to_pixel
from photocal.geometry.distortion import projected
from photocal.geometry.rotation import angles_from_matrix
from tests.photocal.exchange.pix4d_folder import write_params

Floats = NDArray[np.float64]
SIZE, HEIGHT_M, OUT = (6000, 4000), 150.0, np.radians(40.0)
# As rotation vectors about the axes of the head that looks down.
NOMINAL = np.array([[0, 0, 0], [0, -OUT, 0], [0, OUT, 0], [OUT, 0, 0], [-OUT, 0, 0]])
ORIGIN = np.array([677000.0, 7184000.0, 0.0])
CONTROL, NOISE_PX, POSITION_M, SURVEY_M = 15, 0.5, 0.02, (0.02, 0.02, 0.03)
# Exposures, heads and rays that are wanted of an image.
PROJECTS = {"one": (581, 1, 190), "five": (284, 5, 250)}


def lens(k: int, rng: np.random.Generator) -> Camera:
    """A camera of a frame of 6000 x 4000 px: the oblique ones are longer."""
    c = (5000 if k == 0 else 7500) + rng.normal(0, 10)
    values = {"c": c, "x0": rng.normal(0, 10), "y0": rng.normal(0, 10)}
    values |= {"K1": -0.05 / c**2, "K2": 0.02 / c**4, "K3": -0.01 / c**6, "P1": 1e-4 / c, "P2": -2e-4 / c}
    return camera(f"h{k}", "brown-ideal", "px", SIZE, (1.0, 1.0), values)


def project(exposures: int, heads: int, rays: int) -> tuple[Block, Floats]:
    """Crossing strips over a plain: the truth, measured with noise, and positions by GNSS (images, 3)."""
    rng = np.random.default_rng(3)
    cameras = tuple(lens(k, rng) for k in range(heads))
    real = NOMINAL[:heads] + rng.normal(0, np.radians(0.5), (heads, 3)) * (np.arange(heads) > 0)[:, None]
    turn = Rotation.from_rotvec(real).as_matrix()
    arm = rng.normal(0, 0.1, (heads, 3)) * (np.arange(heads) > 0)[:, None]
    strip, along = np.divmod(np.arange(exposures), int(np.ceil(np.sqrt(exposures))))
    place = np.column_stack([strip * 45.0, along * 30.0, np.full(exposures, HEIGHT_M)])
    place += rng.normal(0, 2, place.shape)
    angles = rng.normal(0, np.radians(3), (exposures, 3))
    angles[:, 2] = np.where(strip % 2, np.pi / 2, -np.pi / 2)
    first = Rotation.from_euler("zyx", -angles[:, ::-1]).as_matrix()
    rotation = np.einsum("hab,ebc->heac", turn, first).reshape(-1, 3, 3)
    centre = (place + np.einsum("eba,hb->hea", first, arm)).reshape(-1, 3)
    member = np.repeat(np.arange(heads), exposures)
    low, high = place.min(axis=0) - HEIGHT_M, place.max(axis=0) + HEIGHT_M
    count = int(rays * len(centre) / 3)
    ground = rng.uniform([*low[:2], 0], [*high[:2], 15], (count, 3))
    seen = [_seen(cameras[member[i]], rotation[i], centre[i], ground) for i in range(len(centre))]
    image = np.repeat(np.arange(len(centre)), [len(points) for points, _ in seen])
    point, pixels = np.concatenate([p for p, _ in seen]), np.vstack([xy for _, xy in seen])
    # Tracks are short: two images and a few more; those of control are longer.
    order = np.lexsort((rng.random(len(point)), point))
    rank = np.empty(len(point), dtype=np.int64)
    rank[order] = np.arange(len(point)) - np.searchsorted(point[order], point[order])
    wanted = 2 + rng.poisson(2, count)
    wanted[: 4 * CONTROL] = 12
    kept = rank < wanted[point]
    kept &= (np.bincount(point[kept], minlength=count) > 1)[point]
    used, point = np.unique(point[kept], return_inverse=True)
    roles = tuple("control" if k < 3 * CONTROL and k % 3 == 0 else "tie" for k in range(len(used)))
    surveyed = np.array([role == "control" for role in roles])[:, None]
    xyz = ground[used] + ORIGIN + surveyed * rng.normal(0, SURVEY_M, (len(used), 3))
    measured = pixels[kept] + rng.normal(0, NOISE_PX, (int(kept.sum()), 2))
    names = tuple(f"H{head}_{k:04d}.JPG" for head in range(heads) for k in range(exposures))
    poses = np.column_stack([angles_from_matrix(rotation), centre + ORIGIN])
    role = np.array([ROLES.index("control" if word == "control" else "tie") for word in roles])
    points = ObjectPoints(tuple(str(1000 + k) for k in range(len(used))), xyz, role=role)
    rays_of = in_px(image[kept], point, measured)
    made = Block("block", "local", "", "control", cameras, Images(names, member, poses), points, rays_of)
    return made, np.tile(place + ORIGIN + rng.normal(0, POSITION_M, place.shape), (heads, 1))


def _seen(own: Camera, rotation: Floats, centre: Floats, ground: Floats) -> tuple[NDArray[np.int64], Floats]:
    inside = (ground - centre) @ rotation.T
    ahead = np.flatnonzero((np.abs(inside[:, :2]) < -0.9 * inside[:, 2:]).all(axis=1))
    pixels = plane_to_pixel(own.size_px, own.pitch, projected(own, inside[ahead]))
    kept = np.isfinite(pixels).all(axis=1) & (pixels > 0).all(axis=1) & (pixels < own.size_px).all(axis=1)
    return ahead[kept], pixels[kept]


def main(name: str) -> None:
    """Make a project, adopt it and say what that took."""
    made, positions = project(*PROJECTS[name])
    with tempfile.TemporaryDirectory() as folder:
        params = Path(folder, "params")
        params.mkdir()
        write_params(params, made, positions=positions, offset=np.round(made.images.values[0, 3:]))
        command = [sys.executable, "-m", "photocal", "adopt", str(params), "-o", str(Path(folder, "out"))]
        subprocess.run(command, check=True)
    used = resource.getrusage(resource.RUSAGE_CHILDREN)
    print(
        f"{len(made.images.names)} images, {len(made.observations.image)} rays: "
        f"{used.ru_utime + used.ru_stime:.1f} s of processor time, {used.ru_maxrss / 1024:.0f} MB"
    )


if __name__ == "__main__":
    main(sys.argv[1] if len(sys.argv) > 1 else "one")
