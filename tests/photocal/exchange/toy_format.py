"""A format that nobody uses: a line for each image, and points with their rays."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np

from photocal.block.model import Block
from photocal.exchange.reconstruction import Choices, Reconstruction, vision_block
from photocal.geometry.conversion import Conversion


def export(folder: Path, given: Reconstruction, _: Choices) -> tuple[Conversion, ...]:
    """Write names and numbers as they are."""
    content = {
        "images": given.image_names, "poses": given.poses.tolist(), "points": given.point_names,
        "xyz": given.xyz.tolist(), "image": given.image.tolist(), "point": given.point.tolist(),
        "pixels": given.pixels.tolist(),
    }  # fmt: skip
    (folder / "block.toy").write_text(json.dumps(content), encoding="utf-8")
    return ()


def block(path: Path) -> Block:
    """Read it with a camera of its own."""
    from photocal.geometry.camera import camera

    content = json.loads(path.read_text(encoding="utf-8"))
    lens = camera("toy", "brown-ideal", "px", (100, 100), (1.0, 1.0), {"c": 100.0})
    names = tuple(content["images"])
    given = Reconstruction(
        (lens,), names, np.zeros(len(names), dtype=np.int64), np.array(content["poses"]),
        tuple(content["points"]), np.array(content["xyz"]), np.array(content["image"]),
        np.array(content["point"]), np.array(content["pixels"]),
    )  # fmt: skip
    return vision_block("toy", given, [path])
