"""Checks of exposures by images: their own tie points, or a block that was adjusted before."""

from __future__ import annotations

from dataclasses import dataclass

from drivers.errors import PhotocalError
from photocal.findings.finding import Finding, untested
from photocal.geometry.oriented_images import OrientedImages
from photocal.measurement.match_images import MatchingPlan
from photocal.measurement.oriented_ties import Progress
from photocal.navigation.exposures import Exposures
from photocal.navigation.image_metadata import ImageMetadata
from photocal.navigation.oriented_images import oriented_by_ties
from photocal.navigation.oriented_rotations import boresight_check, compare_with_oriented
from photocal.navigation.position_check import judge_positions
from photocal.navigation.rig import Rig
from photocal.navigation.rotation_check import CODE, rotation_check


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
