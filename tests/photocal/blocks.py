"""Block folders: written from arrays and from the published tables, to be read, adjusted and spoiled."""

from __future__ import annotations

import csv
import math
from collections.abc import Iterable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from photocal.block.model import Block
from photocal.block.results.adjusted import adjust_block
from photocal.block.results.folder import result_json
from tests.photocal import networks

REFERENCE = Path(__file__).parents[1] / "reference" / "dcs460"
Row = dict[str, str]

# The ratio of the two published pixel sizes, 27.6 / 3060 and 18.4 / 2036.
SQUARE = (27.6 / 3060) / (18.4 / 2036)

_TOML = """\
[block]
name = "dcs460"
frame = "local"
datum = "control"

[observations]
unit = "mm"
axes = "photo"
sigma = 0.003

[[camera]]
id = "dcs460"
model = "brown-observed"
distortion_at = "measured"
unit = "mm"
size_px = [3060, 2036]
pitch_mm = [0.00901960784313726, 0.00903732809430255]
parameters = {{ c = 20.0 }}
estimate = ["c", "x0", "y0", "K1", "K2", "K3", "P1", "P2"]
prior_sigma = {{ c = 1.0, x0 = 1.0, y0 = 1.0, K1 = {s}, K2 = {s}, K3 = {s}, P1 = {s}, P2 = {s} }}
"""


def published(name: str) -> list[Row]:
    """Rows of a published table."""
    with (REFERENCE / name).open(encoding="utf-8", newline="") as text:
        return list(csv.DictReader(text))


def dcs460(
    folder: Path,
    *,
    photo2: bool = False,
    tuned: bool = True,
    unused_too: bool = False,
    y_scale: float = 1.0,
    without: str = "",
) -> Path:
    """Write the DCS460 block from its published tables.

    Parameters
    ----------
    folder : Path
    photo2, tuned : bool
        Whether photo 2 is in, as reconstructed with or without use of the published fit.
    unused_too : bool
        Whether the two observations that the study left out are in.
    y_scale : float
        Factor on every y.
    without : str
        A photo to leave out.
    """
    ending = "_mm" if tuned else "_mm_untuned"
    seen = [
        (r["photo"], r["point"], r["x_mm"], r["y_mm"])
        for r in published("image_observations.csv")
        if unused_too or r["used_in_calibra"] == "1"
    ]
    poses = {
        r["photo"]: ([r[f"{axis}0_m"] for axis in "XYZ"] + [r[f"{a}_deg"] for a in ("omega", "phi", "kappa")])
        for r in published("eo_initial_ori.csv")
    }
    if photo2:
        seen += [
            ("2", r["point"], r["x" + ending], r["y" + ending])
            for r in published("image_observations_photo02_reconstructed.csv")
        ]
        final = next(r for r in published("eo_adjusted.csv") if r["photo"] == "2")
        poses["2"] = [final[f"{axis}C_m"] for axis in "XYZ"]
        poses["2"] += [final[f"{a}_deg"] for a in ("omega", "phi", "kappa")]
    poses.pop(without, None)
    folder.mkdir(parents=True)
    (folder / "block.toml").write_text(_TOML.format(s=math.sqrt(0.1)))
    table(
        folder / "images.csv",
        "image,camera,X,Y,Z,omega,phi,kappa",
        ([photo, "dcs460", *pose] for photo, pose in sorted(poses.items(), key=lambda item: int(item[0]))),
    )
    table(
        folder / "points.csv",
        "point,X,Y,Z,sX,sY,sZ,role",
        (
            [r["point"], *(r[f"{a}_m"] for a in "XYZ"), *(r[f"sigma_{a}_m"] for a in "XYZ"), "control"]
            for r in published("control_points.csv")
        ),
    )
    table(
        folder / "observations.csv",
        "image,point,x,y",
        ([i, p, x, repr(float(y) * y_scale)] for i, p, x, y in seen if i != without),
    )
    return folder


def table(path: Path, header: str, rows: Iterable[Iterable[object]]) -> None:
    """Write a comma separated table."""
    lines = [",".join(map(str, row)) for row in rows]
    path.write_text("\n".join([header, *lines]) + "\n", encoding="utf-8")


def small(folder: Path) -> Path:
    """Write a block of three images and six points, without errors, quick to read and easy to spoil."""
    own = networks.lens(
        estimate=("c",), K1=0.0, K2=0.0, K3=0.0, P1=0.0, P2=0.0, B1=0.0, B2=0.0, x0=0.0, y0=0.0
    )
    scene = networks.convergent((own,), images=3, points=7)
    network = networks.observe(scene, None)
    folder.mkdir(parents=True)
    (folder / "block.toml").write_text(SMALL_TOML)
    table(
        folder / "images.csv",
        "image,camera,X,Y,Z,omega,phi,kappa",
        (
            [name, "main", *(f"{v:.3f}" for v in (*pose[3:], *np.degrees(pose[:3])))]
            for name, pose in zip("abc", scene.exposures, strict=True)
        ),
    )
    table(
        folder / "points.csv",
        "point,X,Y,Z,sX,sY,sZ,role",
        [
            [f"p{j}", *(f"{v:.4f}" for v in xyz), *(["0.003"] * 3 if j < 5 else [""] * 3), role]
            for j, (xyz, role) in enumerate(zip(scene.points, SMALL_ROLES, strict=True))
        ],
    )
    rays = network.rays
    table(
        folder / "observations.csv",
        "image,point,x,y",
        (
            ["abc"[i], f"p{j}", f"{x:.4f}", f"{y:.4f}"]
            for i, j, (x, y) in zip(rays.image, rays.point, rays.plane, strict=True)
        ),
    )
    return folder


SMALL_ROLES = ["control"] * 5 + ["check", "tie"]
SMALL_TOML = """\
[block]
name = "small"
frame = "local"
datum = "control"

[observations]
unit = "mm"
axes = "photo"
sigma = 0.003

[[camera]]
id = "main"
model = "brown-observed"
unit = "mm"
size_px = [3000, 2000]
pitch_mm = 0.009
parameters = { c = 20.0 }
estimate = ["c"]
"""


def adjusted_json(*source: Any, **choices: Any) -> dict[str, Any]:
    """Adjust a block folder into a run folder; content of its `result.json`."""
    return result_json(adjust_block(*source, **choices))


def with_positions(block: Block, path: Path) -> Block:
    """Observe the positions of images that a table has: image, X, Y, Z and the sigma of each, m."""
    values, sigma = block.images.values.copy(), block.images.sigma.copy()
    for line in path.read_text().splitlines():
        if line.strip() and not line.startswith("#"):
            name, *cells = (cell.strip() for cell in line.split(","))
            k = block.images.names.index(name)
            values[k, 3:], sigma[k, 3:] = [float(cell) for cell in cells[:3]], float(cells[3])
    return replace(block, images=replace(block.images, values=values, sigma=sigma))
