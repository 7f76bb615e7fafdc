"""Images that an adjustment oriented, in the order of exposures."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from photocal.block.table import read_wider_table
from photocal.geometry.oriented_images import OrientedImages
from photocal.measurement.match_images import MatchingPlan
from photocal.measurement.measure_ties import measure_ties
from photocal.measurement.oriented_ties import Progress
from photocal.results.folder import RESULT, read_result


def oriented_images(folder: Path, images: list[str]) -> OrientedImages:
    """Read images of a run folder, a block folder, or a table of images with X, Y, Z, omega, phi, kappa."""
    if (folder / RESULT).is_file():
        return _in_order(read_result(folder).images, images)
    path = folder / "images.csv" if folder.is_dir() else folder
    angles = ("omega", "phi", "kappa")
    table = read_wider_table(path, ("image", "X", "Y", "Z"))
    # Without angles the positions serve all the same.
    values = [np.radians(table.numbers(name, empty=np.nan)) for name in angles]
    values += [table.numbers(axis) for axis in "XYZ"]
    names = table.unique_names("image")
    found = OrientedImages(names, (), np.full(len(names), -1), np.column_stack(values))
    return _in_order(found, images)


def oriented_by_ties(
    paths: list[Path], images: list[str], plan: MatchingPlan, progress: Progress
) -> OrientedImages:
    """Orient images by tie points, see `photocal.measurement.measure_ties`."""
    block = measure_ties(paths, "images", plan, progress).block
    made = block.images
    return _in_order(OrientedImages(made.names, block.cameras, made.camera, made.values), images)


def _in_order(found: OrientedImages, images: list[str]) -> OrientedImages:
    return found.named([name.split(" ")[0] for name in images])
