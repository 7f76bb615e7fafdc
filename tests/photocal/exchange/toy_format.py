"""A format that nobody uses, as another package would have it: one file, with its entry."""

from __future__ import annotations

import json
from pathlib import Path
from typing import TYPE_CHECKING

from photocal.block.model import ROLES, Block
from photocal.exchange.formats import Format

if TYPE_CHECKING:
    from photocal.exchange.exporting import Choices
    from photocal.exchange.foreign_project import ForeignProject
    from photocal.geometry.conversion import Conversion

TOY = Format(
    "toy", __name__, "Toy", ("cameras", "orientations", "points", "marks"), "cartesian",
    "centre of the first pixel", "x right, y up, z backwards", "none", "px, m", "read", "write:block.toy",
    ("*.toy",),
)  # fmt: skip


def write(path: Path, given: Block, _: Choices) -> tuple[Conversion, ...]:
    """Write names and numbers as they are, and of the only camera its principal distance, px."""
    (camera,) = given.cameras
    images, points, seen = given.images, given.points, given.observations
    content = {
        "c": camera.value("c") / camera.pitch[0], "size": camera.size_px,
        "images": images.names, "poses": images.values.tolist(),
        "points": points.names, "xyz": points.values.tolist(), "roles": [ROLES[k] for k in points.role],
        "image": seen.image.tolist(), "point": seen.point.tolist(), "pixels": seen.values.tolist(),
    }  # fmt: skip
    path.write_text(json.dumps(content), encoding="utf-8")
    return ()


def read(path: Path) -> ForeignProject:
    """Read it; control is known to a centimetre."""
    import numpy as np

    from photocal.block.model import Images, ObjectPoints
    from photocal.exchange.foreign_project import ForeignProject
    from photocal.exchange.parts import block, pixels
    from photocal.geometry.camera import camera

    content = json.loads(path.read_text(encoding="utf-8"))
    lens = camera("toy", "brown-ideal", "px", tuple(content["size"]), (1.0, 1.0), {"c": content["c"]})
    names, xyz = tuple(content["images"]), np.array(content["xyz"])
    role = np.array([ROLES.index(word) for word in content["roles"]])
    points = ObjectPoints(tuple(content["points"]), xyz, np.full(xyz.shape, 0.01), role)
    images = Images(names, np.zeros(len(names), dtype=np.int64), np.array(content["poses"]))
    image, point, values = (np.array(content[key]) for key in ("image", "point", "pixels"))
    seen = pixels(image, point, values)
    return ForeignProject("Toy", block("toy", (lens,), images, points, seen, [path]))
