"""Checks of exposures by images: their own tie points, or a block that was adjusted before."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from drivers.errors import PhotocalError
from photocal.block.table import read_wider_table
from photocal.findings.finding import Finding, untested
from photocal.geometry.oriented_images import OrientedImages
from photocal.measurement.match_images import MatchingPlan
from photocal.measurement.measure_ties import measure_ties
from photocal.measurement.oriented_ties import Progress
from photocal.navigation.exposures import Exposures
from photocal.navigation.image_metadata import ImageMetadata
from photocal.navigation.position_comparison import judge_positions
from photocal.navigation.rig import Rig
from photocal.navigation.rotation_check import CODE, boresight_check, compare_with_oriented, rotation_check
from photocal.results.folder import RESULT, read_result


@dataclass(frozen=True)
class TieMatching:
    """How tie points of the images are found.

    plan: cache, processes, settings.
    progress: shows a bar for a title and an amount of work.
    """

    plan: MatchingPlan
    progress: Progress


def check_oriented(oriented: OrientedImages, exposures: Exposures, rig: Rig, source: str) -> list[Finding]:
    """Hold exposures against images that an adjustment oriented."""
    found = [judge_positions("adjusted-images", exposures, oriented.station, rig, "similarity")]
    pairs = compare_with_oriented(exposures, oriented, rig)
    if pairs:
        found.append(rotation_check(exposures, pairs, source))
        found.append(boresight_check(exposures, oriented, rig))
    return found


def check_images(
    exposures: Exposures, images: list[ImageMetadata], rig: Rig, how: TieMatching
) -> list[Finding]:
    """Hold exposures against their images, oriented together by tie points.

    Two images alone would not do: over flat ground a tilt and a shift look alike.
    """
    paths = [image.path for image in images if image.path is not None and image.name in exposures.image]
    try:
        oriented = oriented_by_ties(paths, exposures.image, how.plan, how.progress)
    except PhotocalError as refusal:
        return [untested(CODE, "images-not-oriented", {"source": "tie-points", "reason": refusal.what})]
    return check_oriented(oriented, exposures, rig, "tie-points")


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
